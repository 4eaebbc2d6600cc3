"""The same work at many points: in threads of this process, or wherever an executor has it done."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import TypeVar

from stepcore import checks
from stepcore.progress import Progress

T = TypeVar("T")
R = TypeVar("R")


def each(
    function: Callable[[T], R],
    points: Sequence[T],
    *,
    bar: Progress,
    threads: int = 1,
    executor: Executor | None = None,
) -> list[R]:
    """The results in the order of the points; the bar advances as they are done.

    executor: in place of threads; with one that uses processes, function and points must pickle
        (a function of a module, or a `functools.partial` of one). It is left open.

    The first error is raised, and what has not begun is not begun.
    """
    if executor is None and (threads == 1 or len(points) < 2):
        results = []
        for point in points:
            results.append(function(point))
            bar.advance()
        return results
    pool = executor or ThreadPoolExecutor(threads)
    futures = []
    try:
        for point in points:
            future = pool.submit(function, point)
            future.add_done_callback(lambda _: bar.advance())
            futures.append(future)
        return [future.result() for future in futures]
    finally:
        for future in futures:
            future.cancel()
        if executor is None:
            pool.shutdown(cancel_futures=True)


def check_executor(owner: str, executor: object) -> None:
    """ValueError for what cannot take work."""
    if executor is not None and not hasattr(executor, "submit"):
        raise checks.refuse(owner, "executor", executor, "a concurrent.futures executor")
