"""The terminal: its width, and the last line of its error stream, where bars are drawn."""

from __future__ import annotations

import os
import shutil
import sys
import threading
from contextlib import suppress

# The width without a terminal, sufficient for every column of a trade.
WIDE = 160


def window() -> int:
    """Return the number of characters in a line of the terminal."""
    return shutil.get_terminal_size((WIDE, 40)).columns


def watched() -> bool:
    """Return whether the error stream belongs to a terminal or a notebook."""
    stream = sys.stderr
    return stream is not None and (
        stream.isatty() or type(stream).__module__.startswith("ipykernel")
    )


class LastLine:
    """A line that is drawn over. Text goes above it: what prints holds `lock`, and erases first.

    lock: a handler of Ctrl-C may take it again.
    """

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self._drawn = ""

    @property
    def room(self) -> int:
        """The number of characters that can be drawn over; a line that wraps cannot."""
        columns = WIDE
        with suppress(OSError, ValueError):
            # Standard output, which `window` reads, can be a file.
            columns = os.get_terminal_size(sys.stderr.fileno()).columns or WIDE
        return shutil.get_terminal_size((columns, 40)).columns - 1

    def draw(self, text: str) -> None:
        """Draw over the line; "" erases it."""
        with self.lock:
            if text != self._drawn:
                # At Ctrl-C a terminal adds ^C.
                blank = " " * min(len(self._drawn) + 2, self.room) + "\r"
                line = "\r" + (text.ljust(len(self._drawn)) if text else blank)
                # The text that a handler of Ctrl-C has to erase.
                self._drawn = max(text, self._drawn, key=len)
                sys.stderr.write(line)
                sys.stderr.flush()
                self._drawn = text


last_line = LastLine()
