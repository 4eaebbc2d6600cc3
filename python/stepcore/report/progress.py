"""A progress bar on the error stream, and only where that is a terminal."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from types import TracebackType
from typing import TextIO

# What callers may pass as `progress`: None (a bar on a terminal), False (nothing), or a function
# of the label, the count done and the total.
Report = Callable[[str, int, int], None]
Choice = Report | bool | None

BAR = 28


class Progress:
    """Counts work done under a label; safe to advance from several threads."""

    def __init__(self, label: str, total: int, choice: Choice = None) -> None:
        self.label, self.total, self.done = label, max(total, 1), 0
        self._lock = threading.Lock()
        self._stream: TextIO | None = None
        self._report = choice if callable(choice) else None
        if self._report is None and choice is not False and _terminal():
            self._stream = sys.stderr
        self._drawn = ""

    def advance(self, count: int = 1) -> None:
        """Notes that `count` more pieces of work are done."""
        with self._lock:
            self.done += count
            if self._report is not None:
                self._report(self.label, self.done, self.total)
            self._draw()

    def _draw(self) -> None:
        if self._stream is None:
            return
        full = min(self.done, self.total) * BAR // self.total
        line = f"{self.label:<24} [{'#' * full}{'.' * (BAR - full)}] {self.done}/{self.total}"
        if line != self._drawn:
            self._stream.write("\r" + line)
            self._stream.flush()
            self._drawn = line

    def __enter__(self) -> Progress:
        self._draw()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._stream is not None:
            self._stream.write("\r" + " " * len(self._drawn) + "\r")
            self._stream.flush()


def _terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()
