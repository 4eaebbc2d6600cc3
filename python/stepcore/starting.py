"""Ctrl-C while a command is still being read in: it ends without a word, with status 130.

The package itself is most of what is read in, so this is its first import. Elsewhere than at the
start of a command nothing is done.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from pathlib import PurePath


def _leave(*_: object) -> None:
    os._exit(130)


def restore() -> None:
    """From here on Ctrl-C is a KeyboardInterrupt, as everywhere in Python."""
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _is_command() -> bool:
    """Whether this is `stepcore …`, or `python -m stepcore …` before it has found its module."""
    first = sys.argv[0] if getattr(sys, "argv", None) else ""
    if first == "-m":
        # Another package may import this one on the way to its own module.
        asked = (part.removeprefix("-m").partition(".")[0] for part in sys.orig_argv[1:])
        return "stepcore" in asked
    return PurePath(first).name in ("stepcore", "stepcore.exe")


if _is_command() and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    # Refused outside of the main thread.
    with contextlib.suppress(ValueError):
        signal.signal(signal.SIGINT, _leave)
