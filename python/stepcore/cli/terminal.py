"""Output of commands on a terminal: errors, missing characters, preliminary answers, Ctrl-C.

The first Ctrl-C ends a measurement with a preliminary answer, the second at once.
"""

from __future__ import annotations

import codecs
import os
import shlex
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, TextIO

from stepcore import deadline
from stepcore.checks import one_line
from stepcore.escapes import printable
from stepcore.report.terminal import last_line, watched

# The exit statuses of a program interrupted by Ctrl-C, as shells report it, and of a measurement
# whose time ended before an answer.
INTERRUPTED, UNDECIDED = 130, 3
# On a terminal: the time of the first preliminary answer, and the interval between answers [s].
OFTEN = (1.0, 0.5)
ERRORS = "stepcore.plain"
REASONS = {FileNotFoundError: "no such file", IsADirectoryError: "is a folder, not a file"}
# Errors caused by the user's arguments and files, or by failing runs.
EXPECTED = (ValueError, OSError, RuntimeError, ImportError)
# Replacements for characters that cannot be printed.
SPELT = """
µ u ² ^2 ³ ^3 · * × x − - – - … ... ± +- ≤ <= ≥ >= ≈ ~ ∞ inf √ sqrt ° deg → -> “ " ” " ’ '
Δ d ω omega ζ zeta μ mu λ lambda ρ rho
"""
WORDS = SPELT.split()
PLAIN = dict(zip(WORDS[::2], WORDS[1::2], strict=True))


class Usage(ValueError):
    """The arguments of a command are wrong, or contradict each other."""


def _plain(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lost = error.object[error.start : error.end]
    # Non-text bytes of a file name are lone surrogates.
    return "".join(PLAIN.get(character, "?") for character in lost), error.end


def print_what_can_be_printed() -> None:
    """Make the output streams replace characters that cannot be encoded."""
    codecs.register_error(ERRORS, _plain)
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        # Python uses "surrogateescape" in the C locale.
        strict = getattr(stream, "errors", "") in ("strict", "surrogateescape")
        if reconfigure is not None and strict:
            reconfigure(errors=ERRORS)


def print_error(text: str, end: str = "\n") -> None:
    """Write a line to the error stream."""
    print_above(f"stepcore: {text}", end, sys.stderr)


def print_above(text: str, end: str = "\n", stream: TextIO | None = None) -> None:
    """Print a text above a bar; control characters in names are escaped."""
    with last_line.lock:
        last_line.draw("")
        print(printable(text), end=end, file=stream or sys.stdout, flush=stream is not None)


def reason(error: BaseException) -> str:
    """Describe an error in one line."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{os.fspath(error.filename)}: {REASONS.get(type(error)) or error.strerror}"
    if isinstance(error, EXPECTED):
        return one_line(error)
    # Any other error is a bug in stepcore.
    kind = type(error).__name__
    return f"internal error ({kind}: {one_line(error)}); --debug shows the traceback"


def refusal(error: BaseException, file: str) -> str:
    """Describe an error of a command; of a file, the command that works, then a line a reason.

    file: the argument FILE. The lines are joined to one if the output is not a terminal.
    """
    from stepcore.mjcf.nodes import MJCFError, can_be_left_out, runs_in_mujoco

    if not isinstance(error, MJCFError):
        return reason(error)
    lines, kinds = str(error).split("\n"), dict.fromkeys(cause.kind for cause in error.errors)
    if all(kinds) and len(lines) > 1:
        # The last line has the same advice for Python.
        lines.pop()
    if can_be_left_out(kinds):
        words = " ".join(f"--without {shlex.quote(kind)}" for kind in kinds)
        lines.append(f"{words} leaves these things out.")
    if runs_in_mujoco(kinds):
        command = f"stepcore trade {shlex.quote(file)} --engine mujoco"
        lines.insert(0, f"{file} has features that only MuJoCo has; `{command}` works.")
    return ("\n" if watched() else " ").join(lines)


def stop(number: int, frame: FrameType | None) -> None:
    """Handle Ctrl-C: stop the measurement that runs, or raise KeyboardInterrupt."""
    measurement = deadline.current()
    if measurement is None or measurement.interrupted:
        raise KeyboardInterrupt
    measurement.stop()
    print_error("interrupted; what is known follows (Ctrl-C again ends at once)")


@contextmanager
def tells_so_far(json: bool) -> Iterator[None]:
    """Print preliminary answers to the error stream; with JSON on terminals only."""
    seldom = deadline.pace
    if watched():
        deadline.listener, deadline.pace = print_error, OFTEN
    elif not json:
        deadline.listener = print_error
    try:
        yield
    finally:
        deadline.listener, deadline.pace = None, seldom


@contextmanager
def ends_early_on_ctrl_c() -> Iterator[None]:
    """Handle Ctrl-C with `stop`, if Python's default handler is in place."""
    before: Any = signal.getsignal(signal.SIGINT)
    main = threading.current_thread() is threading.main_thread()
    if not main or before is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
