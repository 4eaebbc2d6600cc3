"""Printing for commands: error stream, and terminals without some characters."""

from __future__ import annotations

import codecs
import os
import sys
from typing import TextIO

from stepcore.checks import one_line
from stepcore.escapes import printable
from stepcore.report.terminal import last_line

# The exit status that shells report for a program interrupted by Ctrl-C.
INTERRUPTED = 130
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


def say(text: str, end: str = "\n") -> None:
    """Write a line to the error stream."""
    put(f"stepcore: {text}", end, sys.stderr)


def put(text: str, end: str = "\n", stream: TextIO | None = None) -> None:
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
