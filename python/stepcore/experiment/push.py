"""`Push`: a force on a body for some time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from stepcore import checks
from stepcore.engine.model import Model
from stepcore.report.units import time_of

# The default duration of a push [s], and the text form of a push.
PUSH = 0.1
PUSH_FORM = "BODY:FX,FY,FZ@T or BODY:FX,FY,FZ@T+DURATION, in N and s"


@dataclass(frozen=True)
class Push:
    """A force on a body's centre of mass for some time.

    body: the name or index of the body.
    force: the force in world axes [N], shape (3,).
    start: the time since the beginning of the run [s].
    duration: how long the force acts [s]; at least one time step.

    >>> Push.of("torso:50,0,0@1+0.2")
    Push(body='torso', force=(50.0, 0.0, 0.0), start=1.0, duration=0.2)
    """

    body: str | int
    force: tuple[float, float, float]
    start: float = 0.0
    duration: float = PUSH

    def __post_init__(self) -> None:
        force = checks.vector(3)("push", "force", self.force)
        object.__setattr__(self, "force", force)
        for name in ("start", "duration"):
            object.__setattr__(self, name, checks.real(low=0.0)("push", name, getattr(self, name)))

    @classmethod
    def of(cls, push: Push | str | Sequence[Any]) -> Push:
        """Return a Push from a Push, its fields, or "BODY:FX,FY,FZ@START[+DURATION]".

        Raises ValueError for any other argument.
        """
        if isinstance(push, Push):
            return push
        if not isinstance(push, str):
            fields = checks.listed(push)
            if fields is None or not 2 <= len(fields) <= 4:
                limit = "(body, force, start, duration)"
                raise ValueError(f"push = {checks.shown(push)}: must be {limit} or {PUSH_FORM}")
            return cls(*fields)
        body, colon, rest = push.rpartition(":")
        force, at, when = rest.partition("@")
        parts = force.split(",")
        if not colon or not at or len(parts) != 3:
            raise ValueError(f"push {push}: must be {PUSH_FORM}")
        # The "+" may belong to an exponent, as in "1e+0".
        start, plus, length = when.partition("+") if "e+" not in when else (when, "", "")
        x, y, z = (_finite(push, part) for part in parts)
        times = _finite(push, start, time_of), _finite(push, length, time_of) if plus else PUSH
        if min(times) < 0:
            raise ValueError(f"push {push}: its times must be >= 0 s")
        return cls(body, (x, y, z), *times)

    def on(self, model: Model) -> int:
        """Return the index of the body in a model.

        Raises ValueError for an unknown body and for the world.
        """
        if isinstance(self.body, str) and self.body not in model.body_names[1:]:
            near = checks.nearest(self.body, model.body_names[1:])
            raise ValueError(f"push {self}: no body is named '{self.body}'{near}")
        index = model.index("body", self.body)
        if not index:
            raise ValueError(f"push {self}: the world cannot be pushed")
        return index

    def span(self, dt: float) -> range:
        """Return the time steps during which the force acts."""
        first = round(self.start / dt)
        return range(first, first + max(1, round(self.duration / dt)))

    def __str__(self) -> str:
        lasting = "" if self.duration == PUSH else f"+{self.duration:g}"
        return f"{self.body}:{','.join(f'{x:g}' for x in self.force)}@{self.start:g}{lasting}"


def _finite(push: str, part: str, read: Callable[[str], float | None] = float) -> float:
    try:
        value = read(part)
    except ValueError:
        value = None
    if value is None or not math.isfinite(value):
        raise ValueError(f"push {push}: '{part}' must be a finite number")
    return value
