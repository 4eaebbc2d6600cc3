"""The same work at many points: in threads of this process, or wherever an executor has it done.

An executor gets points by the handful, so that what a piece of work costs beside its points (the
function with its model, a message to and fro) is paid once for many of them.
"""

from __future__ import annotations

import os
import pickle
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from functools import partial
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from stepcore import checks
from stepcore.report.progress import Progress

if TYPE_CHECKING:
    from stepcore.engine.sim import Sim

T = TypeVar("T")
R = TypeVar("R")

# Into so many handfuls many points are split for each worker, or in all where nobody knows how many
# there are: enough for all to end together, for progress that moves, and for little to be done
# again when a worker is lost.
EACH, HANDFULS = 32, 512
# Steps after which a long run looks whether all is over.
PORTION = 1000
# How often a point is tried again whose worker was lost.
AGAIN = 3

_here = threading.local()


def each(
    function: Callable[[T], R],
    points: Sequence[T],
    *,
    bar: Progress,
    threads: int = 1,
    executor: Executor | None = None,
) -> list[R]:
    """The results in the order of the points; the bar advances as they are done.

    executor: any `concurrent.futures` executor in place of threads; with one that uses processes,
        function and points must pickle (a function of a module, or a `functools.partial` of one).
        It is left open.

    The first error is raised, and what has not begun is not begun, as after Ctrl-C. Points whose
    worker was lost (on a Dask cluster) are tried again, one by one.

    Raises ValueError for work that cannot be sent to processes, RuntimeError where processes die
    and no others take their place.
    """
    if executor is None and (threads == 1 or len(points) < 2):
        results = []
        for point in points:
            results.append(function(point))
            bar.advance()
        return results
    if executor is None:
        ended = threading.Event()
        with ThreadPoolExecutor(threads) as pool:
            try:
                return _Work(partial(_unless, ended, function), points, pool, bar).done()
            finally:
                # Handfuls that have begun end with their present point, or at its next checkpoint.
                ended.set()
    _check_sendable(function, points, executor)
    return _Work(function, points, executor, bar).done()


class _Work(Generic[T, R]):
    """What is under way: handfuls of points, by the future that will have their results."""

    def __init__(
        self,
        function: Callable[[T], R],
        points: Sequence[T],
        executor: Executor,
        bar: Progress,
    ) -> None:
        self.function, self.points, self.executor, self.bar = function, points, executor, bar
        self.name = os.urandom(8).hex()
        self.results: list[Any] = [None] * len(points)
        self.under_way: dict[Future[list[R]], range] = {}
        self.finished: SimpleQueue[Future[list[R]]] = SimpleQueue()
        self.lost: dict[int, int] = {}

    def done(self) -> list[R]:
        """All results; whatever ends this early cancels what has not begun."""
        total = len(self.points)
        size = -(-total // handfuls(self.executor)) or 1
        try:
            for first in range(0, total, size):
                self._submit(range(first, min(first + size, total)))
            while self.under_way:
                future = self.finished.get()
                self._take(future, self.under_way[future])
                del self.under_way[future]
        except BrokenExecutor as error:
            count = sum(map(len, self.under_way.values()))
            raise RuntimeError(
                f"the executor's workers died ({type(error).__name__}: {checks.one_line(error)}) "
                f"with {count} of {total} points to do; it cannot be used again: make a "
                "new one. A script that starts processes needs 'if __name__ == \"__main__\":'"
            ) from error
        finally:
            for future in self.under_way:
                future.cancel()
        return self.results

    def _submit(self, indices: range, attempt: int = 0) -> None:
        handful = [self.points[i] for i in indices]
        # The name makes it another piece of work to executors that know work by its content.
        name = f"{self.name} {attempt}"
        future = self.executor.submit(_all, self.function, handful, name)
        self.under_way[future] = indices
        future.add_done_callback(self.finished.put)

    def _take(self, future: Future[list[R]], indices: range) -> None:
        try:
            results = future.result()
        except Exception as error:
            if not _worker_lost(error):
                raise
            self._again(indices, error)
            return
        self.results[indices.start : indices.stop] = results
        self.bar.advance(len(indices))

    def _again(self, indices: range, error: BaseException) -> None:
        """Each point for itself, so that one that kills its worker is found out."""
        for i in indices:
            self.lost[i] = self.lost.get(i, 0) + 1
            if self.lost[i] > AGAIN:
                raise RuntimeError(
                    f"point {i} ({checks.shown(self.points[i])}) lost its worker {AGAIN + 1} "
                    f"times: {checks.one_line(error)}"
                ) from error
            self._submit(range(i, i + 1), self.lost[i])


def handfuls(executor: Executor) -> int:
    """Into how many handfuls many points are split."""
    workers = getattr(executor, "_max_workers", None)
    threads = getattr(getattr(executor, "_client", None), "nthreads", None)  # of a Dask client
    if workers is None and callable(threads):
        workers = sum(threads().values())
    return min(HANDFULS, EACH * workers) if isinstance(workers, int) and workers else HANDFULS


def _all(function: Callable[[T], R], points: Sequence[T], name: str) -> list[R]:
    """What a worker does with a handful."""
    return [function(point) for point in points]


def _unless(ended: threading.Event, function: Callable[[T], R], point: T) -> R:
    """One point of threads here, unless all is over."""
    if ended.is_set():
        raise CancelledError
    _here.ended = ended
    try:
        return function(point)
    finally:
        _here.ended = None


def checkpoint() -> None:
    """For long points: ends this one if all is over, as after Ctrl-C, which only main sees."""
    ended = getattr(_here, "ended", None)
    if ended is not None and ended.is_set():
        raise CancelledError


def steps(sim: Sim, n: int) -> None:
    """`sim.step(n)`, with a checkpoint now and then."""
    for done in range(0, n, PORTION):
        checkpoint()
        sim.step(min(PORTION, n - done))


def _worker_lost(error: BaseException) -> bool:
    """Whether Dask says so: by name, since it is no dependency."""
    module = type(error).__module__.partition(".")[0]
    return isinstance(error, CancelledError) or (
        module == "distributed" and type(error).__name__ in ("KilledWorker", "FutureCancelledError")
    )


def _check_sendable(function: Callable[[T], R], points: Sequence[T], executor: Executor) -> None:
    """ValueError now, in words, for what a pool of processes would fail on later."""
    if not isinstance(executor, ProcessPoolExecutor) or not points:
        return
    try:
        pickle.dumps((function, points[0]))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ValueError(
            f"the executor's processes cannot be sent this work: {checks.one_line(error)}; use "
            "functions of a module, not lambdas or functions within functions"
        ) from error


def check_executor(owner: str, executor: object) -> None:
    """ValueError for what cannot take work."""
    if executor is not None and not hasattr(executor, "submit"):
        raise checks.refuse(owner, "executor", executor, "a concurrent.futures executor")
