"""A progress bar on the error stream of a terminal or a notebook, with the time that is left.

tqdm was weighed. It has the same bar, time left and notebooks, but numpy is the only package that
stepcore needs at run time: tqdm would be an extra, beside which this bar would still be needed for
those who do not have it. Whoever prefers tqdm passes a function as `progress`:

>>> shown = []
>>> with Progress("runs", 2, lambda label, done, total: shown.append((label, done, total))) as bar:
...     bar.advance()
>>> shown
[('runs', 1, 2)]
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from time import monotonic
from types import TracebackType
from typing import TextIO

from stepcore import checks
from stepcore.report.table import window
from stepcore.report.units import seconds

# What users may pass as `progress`: None (a bar where somebody watches), False (nothing), or a
# function of the label, the count done and the total.
Choice = Callable[[str, int, int], None] | bool | None

BAR = 28
# The time left is shown from here on [s]: before, it is not known.
BEGUN = 2.0


class Progress:
    """Counts work done under a label; safe to advance from several threads.

    after: work that takes less time has no bar [s].
    """

    def __init__(self, label: str, total: int, choice: Choice = None, after: float = 0.0) -> None:
        checks.progress(label, choice)
        self.label = checks.cut(label, 200)
        self.total, self.done, self.after = max(total, 1), 0, after
        self._lock = threading.Lock()
        self._call = choice if callable(choice) else None
        self._shows = self._call is None and choice is not False
        self._stream: TextIO | None = None
        self._drawn, self._room = "", 0
        self._begun = monotonic()

    def advance(self, count: int = 1) -> None:
        """Note that `count` more pieces of work are done."""
        with self._lock:
            self.done += count
            if self._call is not None:
                self._call(self.label, self.done, self.total)
            self._draw()

    def _draw(self) -> None:
        if not self._shows or (self.after and monotonic() - self._begun < self.after):
            return
        if self._stream is None:
            if not _watched():
                self._shows = False
                return
            self._stream = sys.stderr
            self._room = window()
        # More work than was foreseen is not done when the bar is full.
        total = max(self.total, self.done)
        full = self.done * BAR // total
        bar = f"[{'#' * full}{'.' * (BAR - full)}]"
        line = f"{self.label:<24} {bar} {self.done}/{total}{self._left()}"
        if len(line) >= self._room:
            # A line that wraps cannot be drawn over.
            line = f"{self.label} {self.done}/{total}{self._left()}"[: self._room - 1]
        if line != self._drawn:
            self._stream.write("\r" + line.ljust(len(self._drawn)))
            self._stream.flush()
            self._drawn = line

    def _left(self) -> str:
        """The time left at the present pace, in words."""
        spent = monotonic() - self._begun
        if spent < BEGUN or not 0 < self.done < self.total:
            return ""
        left = spent / self.done * (self.total - self.done)
        return f", {left / 60:.0f} min left" if left > 100 else f", {seconds(round(left))} left"

    def __enter__(self) -> Progress:
        self._draw()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(error, KeyboardInterrupt):
            # What an interrupted command says of the work that it had done.
            error.add_note(f"{self.done} of {self.total} {self.label}")
        if self._stream is not None:
            self._stream.write("\r" + " " * len(self._drawn) + "\r")
            self._stream.flush()


def _watched() -> bool:
    """Whether the error stream is a terminal's or a notebook's."""
    stream = sys.stderr
    return stream is not None and (
        stream.isatty() or type(stream).__module__.startswith("ipykernel")
    )
