"""The terminal: its width, and its last line, which says what goes on and is drawn over.

On this line stands what a command does, then the bars of its work. Text goes above it.
"""

from __future__ import annotations

import os
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from time import monotonic as clock
from typing import TextIO

from stepcore.checks import cut

# The width without a terminal, sufficient for every column of a trade.
WIDTH = 160
# What a command does stands alone for this time [s]; a command that has ended by then leaves no
# trace of it.
ALONE = 1.0


def window() -> int:
    """Return the number of characters in a line of the terminal."""
    return shutil.get_terminal_size((WIDTH, 40)).columns


def room() -> int:
    """Return the number of characters in a line of the terminal of the error stream."""
    columns = WIDTH
    with suppress(OSError, ValueError):
        # Standard output, which `window` asks, can be a file.
        columns = os.get_terminal_size(sys.stderr.fileno()).columns or WIDTH
    return shutil.get_terminal_size((columns, 40)).columns


def watched() -> bool:
    """Return whether the error stream is that of a terminal or a notebook."""
    stream = sys.stderr
    return stream is not None and (
        stream.isatty() or type(stream).__module__.startswith("ipykernel")
    )


class _LastLine:
    """The last line of the error stream. Threads, and a handler of Ctrl-C, can change it."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._stream: TextIO = sys.stderr
        self._drawn = ""
        # What the command does, if that stands here, and since when.
        self._described: tuple[str, float] | None = None

    @property
    def due(self) -> bool:
        """Whether a bar is to follow what the command does."""
        return self._described is not None and clock() - self._described[1] >= ALONE

    def describe(self, text: str) -> None:
        """Write what a command does."""
        # A line that wraps could not be drawn over; "…" can become three characters.
        self.draw(cut(text, room() - 3))
        self._described = text, clock()

    def draw(self, text: str) -> None:
        """Draw over the line, unless it still says what the command does."""
        with self._lock:
            if self.due:
                self.end(keep=True)
            if self._described is None and text != self._drawn:
                self._stream = sys.stderr
                self._write("\r" + text.ljust(len(self._drawn)))
                self._drawn = text

    def erase(self) -> None:
        """Erase a bar."""
        if self._described is None:
            self.end(keep=False)

    def end(self, keep: bool) -> None:
        """Make room for text; keep: whether what the command does stays, above the text."""
        with self._lock:
            if keep and self._described is not None:
                self._write(f"\r{self._described[0]}\n")
            elif self._drawn:
                # At Ctrl-C a terminal adds ^C.
                self._write("\r" + " " * min(len(self._drawn) + 2, room() - 1) + "\r")
            self._drawn, self._described = "", None

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()

    @contextmanager
    def free(self, keep: bool) -> Iterator[None]:
        """Make room for text, and draw nothing meanwhile; see `end`."""
        with self._lock:
            self.end(keep)
            yield


last_line = _LastLine()


def describe(text: str) -> None:
    """Write what a command does, if somebody watches."""
    if watched():
        last_line.describe(cut(text))
