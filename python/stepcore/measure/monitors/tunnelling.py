"""Geoms that pass through others in a run, and geoms so fast that they may.

`stepcore.experiment.passage` observes the run.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.passage import Crossing, Passages
from stepcore.experiment.passage import Passage as Geoms
from stepcore.experiment.sizes import Sizes
from stepcore.measure.monitors.cures import finer
from stepcore.measure.monitors.finding import Cure, Finding, Remedy, named, others
from stepcore.measure.monitors.soft_rows import hardest
from stepcore.report.units import metres, seconds, speed

# A step should be this share of half of both thicknesses at most, or one of these parts of dt.
SHORT, PARTS = 0.5, (1, 2, 4)


@dataclass(frozen=True)
class Passage:
    """A geom that passed through another one, or that may.

    mover, wall: the geoms. pair: their index. speed: along the normal of the surface [m/s].
    room: half of both thicknesses [m]. time: [s].
    """

    mover: int
    wall: int
    pair: int
    speed: float
    room: float
    time: float


class TunnellingMonitor:
    """The geoms that pass through others in one run."""

    def __init__(self, model: Model, sizes: Sizes) -> None:
        self.model, self.dt, self.reach = model, model.settings.dt, sizes.reach
        self.passages: Passages | None = None

    def begin(self, sim: Sim) -> None:
        self.passages = Passages(sim, ahead=True)

    def look(self, sim: Sim) -> None:
        if self.passages is not None:
            self.passages.observe(sim)

    def passed(self) -> list[Passage]:
        """Return the geoms that passed through others, in order of time."""
        return self._passages(self.passages.found) if self.passages else []

    def risks(self) -> list[Passage]:
        """Return the geoms that moved too far in a step just before another one."""
        arrivals = self.passages.arrivals if self.passages else {}
        passed = {entry.pair for entry in self.passed()}
        return [
            entry
            for entry in self._passages(arrivals)
            if entry.speed * self.dt > entry.room and entry.pair not in passed
        ]

    def _passages(self, crossings: dict[Geoms, Crossing]) -> list[Passage]:
        """Return the crossings in order of time; of two geoms the smaller passes through the
        larger."""
        model, found = self.model, {}
        for geoms in sorted(crossings, key=lambda geoms: self.reach[geoms[0]], reverse=True):
            both = (np.sort(model.pair_geoms, axis=1) == np.sort(geoms)).all(axis=1)
            pair, (time, speed, room) = int(np.flatnonzero(both)[0]), crossings[geoms]
            found[pair] = Passage(*geoms, pair, speed, room, time)
        return sorted(found.values(), key=lambda entry: entry.time)

    def furthest(self) -> float:
        """Return the largest motion in a step just before another geom, in thicknesses."""
        every = {**(self.passages.arrivals if self.passages else {})}
        every |= self.passages.found if self.passages else {}
        return max((e.speed * self.dt / e.room for e in self._passages(every)), default=0.0)

    # Findings.

    def findings(self) -> Iterator[Finding]:
        """Yield what passed, or else what may."""
        passed, risks = self.passed(), self.risks()
        if passed:
            yield self._through(passed)
        elif risks:
            yield self._risky(risks)

    def _through(self, passed: list[Passage]) -> Finding:
        model, first = self.model, passed[0]
        movers = named(model, "geom", [entry.mover for entry in passed])
        wall = model.element_name("geom", first.wall)
        also = others([of.name for of in movers[1:]], "geoms")
        verb = "pass" if also else "passes"
        problem = (
            f"{movers[0].name}{also} {verb} through {wall} at {seconds(first.time)}: "
            f"it arrives at {speed(first.speed)}, {metres(first.speed * self.dt)} in a step, and "
            f"half of both thicknesses is {metres(first.room)}"
        )
        contacts = named(model, "contact", [entry.pair for entry in passed])
        fast = max(passed, key=lambda entry: entry.speed / entry.room)
        steps = self._shorter(fast)
        # A geom's contacts with all that it can touch, because another wall is next.
        ids = {entry.mover for entry in passed}
        touching = np.flatnonzero(np.isin(model.pair_geoms, list(ids)).any(axis=1)).tolist()
        hard = tuple(hardest(model, touching, dt) for dt in dict.fromkeys((self.dt, *steps)))
        remedy = Remedy(
            (self._steps(steps), hard),
            lambda m: float(len(m.tunnelling.passed())),
            0.0,
            lambda count: f"{count:g} that pass" if count else "none that passes",
            now=float(len(passed)),
        )
        elements = (*movers, *contacts)
        return Finding(
            "tunnelling", "error", problem, "", elements, first.speed, "m/s", remedy=remedy
        )

    def _risky(self, risks: list[Passage]) -> Finding:
        model = self.model
        worst = max(risks, key=lambda entry: entry.speed / entry.room)
        geoms = named(model, "geom", [worst.mover, worst.wall])
        problem = (
            f"{geoms[0].name} may pass through {geoms[1].name}: at {speed(worst.speed)} it moves "
            f"{metres(worst.speed * self.dt)} in a step, and half of both thicknesses is "
            f"{metres(worst.room)}"
        )
        remedy = Remedy(
            (self._steps(self._shorter(worst)),),
            lambda m: m.tunnelling.furthest(),
            1.0,
            lambda ratio: f"{metres(ratio * worst.room)} a step",
            now=worst.speed * self.dt / worst.room,
        )
        # A thicker geom would do, too.
        cure = f"make {geoms[1].name} thicker"
        value = worst.speed
        return Finding("tunnelling", "warning", problem, cure, geoms, value, "m/s", remedy=remedy)

    def _shorter(self, fast: Passage) -> list[float]:
        """Return the time steps to try [s], the longest first."""
        settings = self.model.settings
        most = min(self.dt / 2, SHORT * fast.room / fast.speed)
        return list(dict.fromkeys(finer(settings, most / part) for part in PARTS))

    def _steps(self, steps: list[float]) -> tuple[Cure, ...]:
        return tuple(Cure(f"a dt of {seconds(dt)}", settings={"dt": dt}) for dt in steps)
