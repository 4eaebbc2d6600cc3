"""`Deadline`: the time limit of a measurement, and the work left out when the time is over.

A measurement opens its deadline with `in_time`. Long work calls `check` from time to time, between
runs and within them (`stepcore.executors.checkpoint`), which raises OutOfTime once the time is
over. Work that an answer can do without is done in a `stage`: the deadline ends only the stage,
and the result lists its work as not done. Without the work outside of stages there is no answer,
and OutOfTime reaches the caller.

>>> from stepcore import deadline
>>> times = iter(range(100))
>>> now, deadline.clock = deadline.clock, lambda: next(times)
>>> with Deadline(5.0).opened() as limit:
...     with limit.stage("the last of ten counts"):
...         for count in range(10):
...             check()
>>> limit.left_out
['the last of ten counts']
>>> deadline.clock = now
"""

from __future__ import annotations

import functools
import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Any, TypeVar

from stepcore import checks

# The limits of the measuring commands of the command line [s]. Functions in Python have none unless
# `seconds` is given, so that their results are the same on every machine.
SECONDS = {
    "check": 15.0,
    "diagnose": 15.0,
    "trade": 60.0,
    "predict": 60.0,
    "ablate": 60.0,
    "compare": 60.0,
    "converge": 60.0,
    "stability-map": 60.0,
    "tune": 60.0,
    "identify": 60.0,
}
# The time in which an answer is completed from the runs made, after the deadline or Ctrl-C [s].
CLOSING = 3.0
# The shares of the time at which a search ends, and at which the test of its choice ends.
SEARCHED, PROVEN = 0.7, 0.9

F = TypeVar("F", bound=Callable[..., Any])
clock = monotonic
# Called with the preliminary answer of a long measurement; the command line sets it. Below, the
# time of the first such report and the interval between reports [s].
listener: Callable[[str], object] | None = None
pace = (10.0, 20.0)
_thread = threading.local()


class OutOfTime(RuntimeError):
    """The time of a measurement is over before there is an answer.

    interrupted: whether Ctrl-C ended the measurement.
    """

    interrupted = False


class Deadline:
    """The time limit of a measurement.

    seconds: the limit [s]; None for none.
    outer: the deadline of the measurement that makes this one, which applies too.
    left_out: the work that the measurement left out because its time was over.
    """

    def __init__(self, seconds: float | None = None, outer: Deadline | None = None) -> None:
        self.seconds = math.inf if seconds is None else seconds
        self.outer, self.begun = outer, clock()
        if outer is not None:
            self.seconds = min(self.seconds, outer._end - self.begun)
        self.left_out: list[str] = []
        self._end: float = self.begun + self.seconds
        self._stop: threading.Event = threading.Event() if outer is None else outer._stop
        # The time at which the last answer must be complete, of this or an outer measurement.
        # With 15 %, `seconds` holds within 20 %, even though work ends only at its next check.
        self._last = self._end + min(CLOSING, 0.15 * self.seconds)
        self._closing = False
        self._news = self._said = ""
        self._told = -math.inf

    @property
    def spent(self) -> float:
        """The time since the beginning [s]."""
        return clock() - self.begun

    @property
    def left(self) -> float:
        """The time that is left for the present stage [s]; 0 when it is over."""
        if self.interrupted and not self._closing:
            return 0.0
        return self._end if math.isinf(self._end) else max(0.0, self._end - clock())

    @property
    def over(self) -> bool:
        """Whether no time is left for the present stage."""
        return self.left <= 0

    @property
    def interrupted(self) -> bool:
        """Whether `stop` was called."""
        return self._stop.is_set()

    def stop(self) -> None:
        """End this measurement and all measurements around it with the answers they have."""
        self._outermost._last = min(self._outermost._last, clock() + CLOSING)
        self._stop.set()

    @property
    def _outermost(self) -> Deadline:
        return self if self.outer is None else self.outer._outermost

    def so_far(self, words: str) -> None:
        """Set the preliminary answer, which `listener` gets if the work still runs at its time.

        words: the answer; replaces an earlier one that was not yet reported.
        """
        if self.outer is not None:
            self.outer.so_far(words)
        elif listener is not None:
            self._news = "" if words == self._said else words
            self.announce()

    def announce(self) -> None:
        """Report the preliminary answer, if a report is due."""
        if self.outer is not None:
            self.outer.announce()
        elif self._news and listener is not None:
            (first, interval), now = pace, clock()
            if now >= max(self.begun + first, self._told + interval):
                self._said, self._news, self._told = self._news, "", now
                listener(f"so far: {self._said}")

    @contextmanager
    def opened(self) -> Iterator[Deadline]:
        """Make this the deadline of `check` in this thread."""
        before, _thread.deadline = current(), self
        try:
            yield self
        finally:
            _thread.deadline = before

    @contextmanager
    def stage(self, words: str | Callable[[], str], share: float = 1.0) -> Iterator[None]:
        """Do work that the answer can do without; if the time is over, it is left out.

        words: the description of the work, or a function that returns it.
        share: the stage ends at this share of all the time.
        """
        before = self._end
        if not self._closing:
            self._end = min(self._end, self.begun + share * self.seconds)
        try:
            yield
        except OutOfTime:
            text = words if isinstance(words, str) else words()
            if text not in self.left_out:
                self.left_out.append(text)
        finally:
            self._end = before

    @contextmanager
    def closing(self) -> Iterator[None]:
        """Complete the answer from the runs made; all closings share the time kept for them."""
        before, last = (self._end, self._closing), self._outermost._last
        if not self.interrupted:
            last = min(last, max(self._end, clock() + CLOSING))
        self._end, self._closing = last, True
        try:
            yield
        finally:
            self._end, self._closing = before

    @property
    def longer(self) -> int:
        """A longer time to propose [s]."""
        # Work that cannot end between two checks may have exceeded its time.
        base = self.seconds if self.spent < 2 * self.seconds < math.inf else self.spent
        return 2 * math.ceil(max(1.0, base))

    @property
    def sentence(self) -> str:
        """The work that was left out, and how to continue; "" if none was."""
        if not self.left_out:
            return ""
        left_out = "; ".join(self.left_out)
        return f"{self._ended.capitalize()}. Not done: {left_out}. {self._goes_on}."

    @property
    def _ended(self) -> str:
        time = f"{self.spent:.2g}" if self.spent < 100 else f"{self.spent:.0f}"
        return f"{'interrupted' if self.interrupted else 'stopped'} after {time} s"

    @property
    def _goes_on(self) -> str:
        return f"`--seconds {self.longer}` (in Python seconds={self.longer}) goes on further"

    def nothing(self, error: OutOfTime) -> OutOfTime:
        """Return the error of a measurement without any answer."""
        done = ", ".join(getattr(error, "__notes__", ()))
        detail = f" ({done})" if done else ""
        nothing = OutOfTime(f"{self._ended}, too early for any answer{detail}; {self._goes_on}")
        nothing.interrupted = self.interrupted
        return nothing


def current() -> Deadline | None:
    """Return the deadline that this thread works under, or None."""
    deadline: Deadline | None = getattr(_thread, "deadline", None)
    return deadline


def check() -> None:
    """Raise OutOfTime if the time of the present work is over; report if a report is due."""
    deadline = current()
    if deadline is None:
        return
    deadline.announce()
    if deadline.over:
        raise OutOfTime("the time of the measurement is over")


def in_time(measurement: F) -> F:
    """Decorate a measurement: its keyword argument `seconds` is its deadline.

    If the time was over, the result's `unfinished` names the work that was left out. A measurement
    without any answer raises OutOfTime.
    """

    @functools.wraps(measurement)
    def bounded(*args: Any, **keywords: Any) -> Any:
        seconds = keywords.get("seconds")
        if not (seconds is None or (isinstance(seconds, float) and seconds == math.inf)):
            seconds = checks.real(above=0)(measurement.__name__, "seconds", seconds)
        limit = Deadline(seconds, current())
        try:
            with limit.opened():
                result = measurement(*args, **keywords)
        except OutOfTime as error:
            if limit.outer is not None:
                raise
            raise limit.nothing(error) from None
        if limit.left_out:
            # Results are dataclasses, some of them frozen.
            object.__setattr__(result, "not_done", tuple(limit.left_out))
            object.__setattr__(result, "unfinished", limit.sentence)
            object.__setattr__(result, "interrupted", limit.interrupted)
        return result

    return bounded  # type: ignore[return-value]
