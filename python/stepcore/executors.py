"""Runs a function at many points: in threads of this process, or in a user's executor.

`Executor.map(chunksize=…)` would be shorter, but it reports no progress, ignores `chunksize` for
threads and for Dask, and gives up all results when one worker is lost. So points are submitted
here, in chunks: the function, with its model, is then sent once for many points.
"""

from __future__ import annotations

import os
import pickle
import sys
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
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from stepcore import checks
from stepcore.report.progress import Progress

if TYPE_CHECKING:
    from stepcore.engine.sim import Sim

T = TypeVar("T")
R = TypeVar("R")

# Points go to an executor in at most so many chunks: enough for dozens of workers to end together,
# for progress that moves, and for little to be done again when a worker is lost. (How many workers
# there are, no executor tells.)
MAX_CHUNKS = 512
# A long run of steps looks this often whether it should stop.
STEPS_PER_CHECK = 1000
# How often a point is tried again whose worker was lost.
MAX_RETRIES = 3

_thread = threading.local()


def each(
    function: Callable[[T], R],
    points: Sequence[T],
    *,
    bar: Progress,
    threads: int = 1,
    executor: Executor | None = None,
) -> list[R]:
    """The results of `function` in the order of the points; the bar advances as they come.

    executor: any `concurrent.futures` executor, used in place of threads and left open. If it uses
        processes, function and points must pickle (a function of a module, or a
        `functools.partial` of one).

    The first error is raised, and points that have not begun are cancelled, as after Ctrl-C. A
    point whose worker was lost (on a Dask cluster) is tried again by itself.

    Raises ValueError for work that cannot be sent to processes, and RuntimeError if processes die
    and are not replaced.
    """
    if executor is not None:
        _check_sendable(function, points, executor)
        return _Chunks(function, points, executor, -(-len(points) // MAX_CHUNKS), bar).results()
    if threads == 1 or len(points) < 2:
        results = []
        for point in points:
            results.append(function(point))
            bar.advance()
        return results
    stop = threading.Event()

    def unless_stopped(point: T) -> R:
        _thread.stop = stop
        checkpoint()
        return function(point)

    with ThreadPoolExecutor(threads) as pool:
        try:
            return _Chunks(unless_stopped, points, pool, 1, bar).results()
        finally:
            # Points that have begun end at their next checkpoint.
            stop.set()


class _Chunks(Generic[T, R]):
    """Chunks of points that an executor works on, by the future that will have their results."""

    def __init__(
        self,
        function: Callable[[T], R],
        points: Sequence[T],
        executor: Executor,
        size: int,
        bar: Progress,
    ) -> None:
        self.function, self.points, self.executor, self.bar = function, points, executor, bar
        self.size = size
        self.key = os.urandom(8).hex()
        self.done: list[Any] = [None] * len(points)
        self.pending: dict[Future[list[R]], range] = {}
        self.finished: SimpleQueue[Future[list[R]]] = SimpleQueue()
        self.losses: dict[int, int] = {}

    def results(self) -> list[R]:
        """All results; whatever ends this early cancels the chunks that have not begun."""
        total = len(self.points)
        try:
            for first in range(0, total, self.size or 1):
                self._submit(range(first, min(first + self.size, total)))
            while self.pending:
                future = self.finished.get()
                self._take(future, self.pending[future])
                del self.pending[future]
        except BrokenExecutor as error:
            count = sum(map(len, self.pending.values()))
            raise RuntimeError(
                f"the executor's workers died ({type(error).__name__}: {checks.one_line(error)}) "
                f"with {count} of {total} points to do; it cannot be used again: make a "
                "new one. A script that starts processes needs 'if __name__ == \"__main__\":'"
            ) from error
        finally:
            for future in self.pending:
                future.cancel()
        return self.done

    def _submit(self, indices: range, attempt: int = 0) -> None:
        chunk = [self.points[i] for i in indices]
        # Dask takes two submissions with equal arguments for one; the key tells them apart.
        key = f"{self.key} {attempt}"
        work = _run_chunk if isinstance(self.executor, ThreadPoolExecutor) else _run_sent_chunk
        future = self.executor.submit(work, self.function, chunk, key)
        self.pending[future] = indices
        future.add_done_callback(self.finished.put)

    def _take(self, future: Future[list[R]], indices: range) -> None:
        try:
            results = future.result()
        except Exception as error:
            if not _worker_was_lost(error):
                raise
            self._retry(indices, error)
            return
        self.done[indices.start : indices.stop] = results
        self.bar.advance(len(indices))

    def _retry(self, indices: range, error: Exception) -> None:
        """Submits each point by itself, so that one that kills its worker is identified."""
        for i in indices:
            self.losses[i] = self.losses.get(i, 0) + 1
            if self.losses[i] > MAX_RETRIES:
                raise RuntimeError(
                    f"point {i} ({checks.shown(self.points[i])}) lost its worker "
                    f"{self.losses[i]} times: {checks.one_line(error)}"
                ) from error
            self._submit(range(i, i + 1), self.losses[i])


def _run_chunk(function: Callable[[T], R], points: Sequence[T], key: str) -> list[R]:
    """What a worker does with a chunk."""
    return [function(point) for point in points]


def _run_sent_chunk(function: Callable[[T], R], points: Sequence[T], key: str) -> list[R]:
    """The same in another process, whose errors must come back: what cannot keeps its text."""
    try:
        return _run_chunk(function, points, key)
    except Exception as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            text = f"{type(error).__name__}: {checks.one_line(error)}"
            raise RuntimeError(f"{text} (raised in another process)") from None
        raise


def checkpoint() -> None:
    """Called by long work: ends it if the work of other threads has failed or was interrupted."""
    stop = getattr(_thread, "stop", None)
    if stop is not None and stop.is_set():
        raise CancelledError


def steps(sim: Sim, n: int) -> None:
    """`sim.step(n)` with checkpoints."""
    for done in range(0, n, STEPS_PER_CHECK):
        checkpoint()
        sim.step(min(STEPS_PER_CHECK, n - done))


def _worker_was_lost(error: Exception) -> bool:
    """Whether a Dask cluster lost the worker; Dask is no dependency, but has raised the error."""
    dask = sys.modules.get("distributed")
    killed = dask is not None and isinstance(error, dask.KilledWorker)
    return killed or isinstance(error, CancelledError) or _was_lost_on_the_way(error)


def _was_lost_on_the_way(error: Exception) -> bool:
    """Whether a worker died while Dask fetched its result: Dask's executor then unpacks an answer
    that it has not got. An error of the work itself is raised elsewhere."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    raised_in = trace.tb_frame.f_globals.get("__name__") if trace is not None else None
    return isinstance(error, ValueError) and raised_in == "distributed.cfexecutor"


def _check_sendable(function: Callable[[T], R], points: Sequence[T], executor: Executor) -> None:
    """A ValueError in plain words for what a pool of processes would fail on later."""
    if not isinstance(executor, ProcessPoolExecutor) or not points:
        return
    try:
        pickle.dumps((function, points[0]))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ValueError(
            f"this work cannot be sent to the executor's processes: {checks.one_line(error)}; use "
            "functions of a module, not lambdas or functions within functions"
        ) from error


def check_executor(owner: str, executor: object) -> None:
    """ValueError for an object that takes no work."""
    if executor is not None and not hasattr(executor, "submit"):
        raise checks.refuse(owner, "executor", executor, "a concurrent.futures executor")
