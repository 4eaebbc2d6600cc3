"""A progress bar on the error stream of a terminal or a notebook, with the remaining time.

Without a terminal, as in the log of a cluster, a line every ten seconds replaces the bar.

tqdm has the same features, but numpy is stepcore's only dependency at run time. tqdm would be an
optional dependency, and users without tqdm would still need this bar. Users who prefer tqdm pass a
function as `progress`:

>>> shown = []
>>> with Progress("runs", 2, lambda label, done, total: shown.append((label, done, total))) as bar:
...     bar.advance()
>>> shown
[('runs', 1, 2)]
"""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Callable
from time import monotonic
from time import monotonic as clock
from types import TracebackType

from stepcore import checks
from stepcore.deadline import OutOfTime
from stepcore.report.terminal import last_line, watched
from stepcore.report.units import seconds

# The argument `progress` of users: None (a bar in a terminal or a notebook), False (nothing), or a
# function of the label, the count done and the total.
Choice = Callable[[str, int, int], None] | bool | None

# The remaining time is shown only after this time [s], because earlier estimates are unreliable.
BEGUN = 2.0
# The time between two lines without a terminal [s].
LINES = 10.0


class Progress:
    """A labelled count of work done; several threads can advance it.

    after: the bar appears only after this time [s].
    """

    def __init__(self, label: str, total: int, choice: Choice = None, after: float = 0.0) -> None:
        checks.progress(label, choice)
        self.label = checks.cut(label, 200)
        self.total, self.done, self.after = max(total, 1), 0, after
        self._lock = threading.Lock()
        self._call = choice if callable(choice) else None
        self._shows = self._call is None and choice is not False
        self._begun = monotonic()

    def advance(self, count: int = 1) -> None:
        """Count `count` more pieces of work as done."""
        with self._lock:
            self.done += count
            # The work can exceed the announced total.
            self.total = max(self.total, self.done)
            if self._call is not None:
                self._call(self.label, self.done, self.total)
            self._draw()

    def show_life(self) -> None:
        """Write the next line without a terminal, if it is due."""
        if self._shows and _lines.due and not watched():
            with self._lock:
                self._draw()

    def _draw(self) -> None:
        if not self._shows or (self.after and monotonic() - self._begun < self.after):
            return
        if not watched():
            if _lines.due:
                _lines.write(f"{self.label}: {self.done} of {self.total}{self._left()}")
            return
        total, room = self.total, last_line.room
        full = self.done * 28 // total
        bar = f"[{'#' * full:.<28}]"
        line = f"{self.label:<24} {bar} {self.done}/{total}{self._left()}"
        if len(line) > room:
            line = f"{self.label} {self.done}/{total}{self._left()}"[:room]
        last_line.draw(line)

    def _left(self) -> str:
        """Return the remaining time at the present pace, in words."""
        spent = monotonic() - self._begun
        if spent < BEGUN or not 0 < self.done < self.total:
            return ""
        left = spent / self.done * (self.total - self.done)
        return f", {left / 60:.0f} min left" if left > 100 else f", {seconds(round(left))} left"

    def __enter__(self) -> Progress:
        if not _open:
            _lines.begin()
        _open.append(self)
        self._draw()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        _open.remove(self)
        if not _open:
            _lines.end()
        if isinstance(error, (KeyboardInterrupt, OutOfTime)):
            # The message of a command that ends early contains this note.
            error.add_note(f"{self.done} of {self.total} {self.label}")
        if self._shows:
            last_line.draw("")


class _Lines:
    """The times of the lines that all bars of a process share."""

    def __init__(self) -> None:
        self._last = self._ended = -math.inf

    def begin(self) -> None:
        """Begin to count, unless the last work has only just ended."""
        if clock() - self._ended > 1.0:  # a pause restarts the lines
            self._last = clock()

    def end(self) -> None:
        self._ended = clock()

    @property
    def due(self) -> bool:
        """Whether a line is due."""
        return clock() - self._last >= LINES

    def write(self, text: str) -> None:
        """Write a line to the error stream."""
        self._last = clock()
        if sys.stderr is not None:
            print(text, file=sys.stderr, flush=True)


# The bars that are open, the innermost last.
_open: list[Progress] = []
_lines = _Lines()


def show_life() -> None:
    """Show that long work goes on, if a line is due; see `Progress.show_life`."""
    if _open:
        _open[-1].show_life()
