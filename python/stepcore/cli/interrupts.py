"""What a measurement says before its end: what is known so far, and at Ctrl-C.

The first Ctrl-C ends a measurement with what is known, the second at once.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from stepcore import deadline
from stepcore.cli.terminal import say
from stepcore.report.terminal import watched

# On a terminal, when a measurement that still runs says what it knows, and how often again [s].
OFTEN = (1.0, 0.5)


def stop(number: int, frame: FrameType | None) -> None:
    """Handle Ctrl-C: stop the measurement that runs, or raise KeyboardInterrupt."""
    measurement = deadline.current()
    if measurement is None or measurement.interrupted:
        raise KeyboardInterrupt
    measurement.stop()
    say("interrupted; what is known follows (Ctrl-C again ends at once)")


@contextmanager
def tells_so_far(json: bool) -> Iterator[None]:
    """Print to the error stream what long measurements know so far; with JSON on terminals only."""
    seldom = deadline.pace
    if watched():
        deadline.listener, deadline.pace = say, OFTEN
    elif not json:
        deadline.listener = say
    try:
        yield
    finally:
        deadline.listener, deadline.pace = None, seldom


@contextmanager
def ends_early_on_ctrl_c() -> Iterator[None]:
    """Handle Ctrl-C with `stop`, where Python's own handler is in place."""
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
