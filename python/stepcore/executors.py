"""Run a function at many points, in threads of this process or in a user's executor.

`Executor.map(chunksize=…)` reports no progress, ignores `chunksize` for threads and for Dask, and
loses all results when one worker is lost.
"""

from __future__ import annotations

import contextlib
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
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import Any, Generic, TypeVar

from stepcore import checks, deadline
from stepcore.report.progress import Progress, show_life

T = TypeVar("T")
R = TypeVar("R")

# Largest number of chunks: the function with its model is sent once for each, dozens of workers
# finish together, and little is repeated when a worker is lost. (An executor does not report its
# number of workers.)
MAX_CHUNKS = 512

_thread = threading.local()


def each(
    function: Callable[[T], R],
    points: Sequence[T],
    *,
    bar: Progress,
    threads: int = 1,
    executor: Executor | None = None,
    done: list[R | None] | None = None,
    took: Callable[[range, list[R]], object] | None = None,
) -> list[R]:
    """Return the results of `function` in the order of the points.

    function: called with each point.
    points: the arguments of the calls.
    bar: the progress bar, which advances with each result.
    threads: number of threads.
    executor: any `concurrent.futures` executor, used instead of threads and left open. An executor
        of processes needs a function and points that pickle (a function of a module, or a
        `functools.partial` of such a function).
    done: a list that receives the results as they come, for a caller that catches OutOfTime; None
        marks points without a result.
    took: called with the indices of points and their results, as results come.

    The first error is raised. After an error or Ctrl-C, points that have not started are cancelled.
    The executor handles lost workers: a Dask cluster repeats their points.

    Raises ValueError for work that cannot be sent to processes, RuntimeError if processes die and
    are not replaced, and OutOfTime at the deadline of this thread.
    """
    done = [] if done is None else done
    done[:] = [None] * len(points)
    if executor is not None:
        _check_sendable(function, points, executor)
        size = -(-len(points) // MAX_CHUNKS)
        return _Chunks(function, points, executor, size, bar, done, took).results()
    if threads == 1 or len(points) < 2:
        results = []
        for index, point in enumerate(points):
            checkpoint()
            results.append(function(point))
            done[index] = results[-1]
            if took is not None:
                took(range(index, index + 1), results[-1:])
            bar.advance()
        return results
    stop, limit = threading.Event(), deadline.current()

    def unless_stopped(point: T) -> R:
        _thread.stop = stop
        with contextlib.nullcontext() if limit is None else limit.opened():
            checkpoint()
            return function(point)

    with ThreadPoolExecutor(threads) as pool:
        try:
            return _Chunks(unless_stopped, points, pool, 1, bar, done, took).results()
        finally:
            # Running points end at their next checkpoint.
            stop.set()


@dataclass
class _Chunks(Generic[T, R]):
    """The points of `each`, sent to an executor `size` at a time."""

    function: Callable[[T], R]
    points: Sequence[T]
    executor: Executor
    size: int
    bar: Progress
    done: list[Any]
    took: Callable[[range, list[R]], object] | None
    # Dask merges submissions with equal arguments; the key keeps them apart.
    key: str = field(default_factory=lambda: os.urandom(8).hex())
    pending: dict[Future[list[R]], range] = field(default_factory=dict)
    finished: SimpleQueue[Future[list[R]]] = field(default_factory=SimpleQueue)

    def results(self) -> list[R]:
        """Return all results; on any exception, cancel the chunks that have not started."""
        total = len(self.points)
        try:
            for first in range(0, total, self.size or 1):
                self._submit(range(first, min(first + self.size, total)))
            while self.pending:
                future = self._next()
                results, indices = future.result(), self.pending.pop(future)
                self._keep(indices, results)
                self.bar.advance(len(indices))
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
            # After an error, results that came before it was raised are kept.
            for future, indices in self.pending.items():
                if future.done() and not future.cancelled() and future.exception() is None:
                    self._keep(indices, future.result())
        return self.done

    def _keep(self, indices: range, results: list[R]) -> None:
        self.done[indices.start : indices.stop] = results
        if self.took is not None:
            self.took(indices, results)

    def _next(self) -> Future[list[R]]:
        """Wait for a finished chunk.

        Threads check the deadline themselves. Other executors cannot.
        """
        if isinstance(self.executor, ThreadPoolExecutor) or deadline.current() is None:
            return self.finished.get()
        while True:
            deadline.check()
            with contextlib.suppress(Empty):
                # The deadline is checked every 0.1 s while another executor works.
                return self.finished.get(timeout=0.1)

    def _submit(self, indices: range) -> None:
        chunk = [self.points[i] for i in indices]
        work = _run_chunk if isinstance(self.executor, ThreadPoolExecutor) else _run_sent_chunk
        future = self.executor.submit(work, self.function, chunk, self.key)
        self.pending[future] = indices
        future.add_done_callback(self.finished.put)


def _run_chunk(function: Callable[[T], R], points: Sequence[T], key: str) -> list[R]:
    return [function(point) for point in points]


def _run_sent_chunk(function: Callable[[T], R], points: Sequence[T], key: str) -> list[R]:
    """Run a chunk in another process; replace an error that does not pickle by its text."""
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
    """Raise CancelledError if another thread has failed or the work was interrupted.

    Raises OutOfTime if the deadline of this thread is over. Long work calls this function from time
    to time.
    """
    show_life()
    deadline.check()
    stop = getattr(_thread, "stop", None)
    if stop is not None and stop.is_set():
        raise CancelledError


def _check_sendable(function: Callable[[T], R], points: Sequence[T], executor: Executor) -> None:
    """Raise ValueError, with a fix, for work that cannot be pickled for a pool of processes."""
    if not isinstance(executor, ProcessPoolExecutor) or not points:
        return
    try:
        pickle.dumps((function, points[0]))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ValueError(
            f"this work cannot be sent to the executor's processes: {checks.one_line(error)}; use "
            "functions of a module, not lambdas or functions within functions"
        ) from error
