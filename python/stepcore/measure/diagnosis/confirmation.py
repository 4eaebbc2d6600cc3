"""Make each cure, and diagnose the motion again: what fails this is not advised.

A search for a change tests the linearised step at the states of the unchanged model. The changed
model moves otherwise, visits other states, and may be limited by something else. Every cure is
therefore made, and its motion is examined as that of any model is (`examination`), under the same
control, with the same delay, for the same horizon. It holds if

- the largest stable dt that is found leaves the margin that is promised;
- at the wanted dt no servo chatters, and the kinetic energy is that of a run at a fine step;
- this stays so for ten horizons and for ten periods of the slowest oscillation (`Judge.agrees`).

A change that leaves less than the margin is searched for again with a larger one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from stepcore._core import SimulationError
from stepcore.experiment.motion import Motion
from stepcore.measure.diagnosis.advice import MARGIN, Advice, Cure, Way, failed, repeats
from stepcore.measure.diagnosis.examination import Examination, examine
from stepcore.measure.diagnosis.limits import LONGEST, Limit
from stepcore.measure.diagnosis.motion_check import Judge
from stepcore.measure.diagnosis.motion_runs import stays_bounded
from stepcore.measure.diagnosis.visited_states import visit
from stepcore.report.units import seconds

# A margin found by runs is known to this fraction.
RESOLVED = 0.97
# The searches for one change, and the surplus of the margin after one that left too little.
SEARCHES, SURPLUS = 3, 1.1
# The most integrators that are confirmed.
INTEGRATORS = 3
# The most changes of the model that are confirmed, the smallest first.
CONFIRMED = 6


@dataclass(frozen=True)
class Confirmation:
    """The same question asked of a changed model.

    before: the examination of the unchanged model.
    motion, horizon: the motion and its length [s].
    """

    before: Examination
    motion: Motion
    horizon: float

    @property
    def wanted(self) -> float:
        """The wanted step [s]."""
        return self.before.wanted

    def integrators(self) -> Iterator[Advice]:
        """Yield other integrators whose limit is not below the wanted dt, the largest first.

        The explicit integrator, which adds energy at every dt, is tried last.
        """
        own = self.before.model.settings.integrator
        others = [limit for limit in self.before.limits.values() if limit.integrator != own]
        others.sort(key=lambda limit: (limit.integrator == "explicit", -limit.dt))
        left = INTEGRATORS
        for limit in others:
            if limit.dt < self.wanted or left == 0:
                continue
            name = limit.integrator
            met = self._leaves_margin(limit) and self._agrees(self.before, name)
            left -= met
            text = f"use integrator {name}, {stable(limit)}" if met else f"integrator {name}"
            found = limit.dt if met else None
            yield Advice("integrator", (), {"integrator": name}, met, text, 0.0, found)

    def advice(self, ways: Iterable[Way]) -> Iterator[Advice]:
        """Yield the least change of each way that holds, the smallest first, or that it fails."""
        cures: list[tuple[Way, Cure]] = []
        for way in ways:
            cure = way(MARGIN)
            if isinstance(cure, Cure):
                cures.append((way, cure))
            elif cure is not None:
                yield cure
        met: list[Advice] = []
        for way, cure in sorted(cures, key=lambda pair: pair[1].advice.rank):
            if len(met) < CONFIRMED and not repeats(cure.advice, met):
                result = self._confirmed(way, cure)
                met += [result] * result.met
                yield result

    def _confirmed(self, way: Way, cure: Cure) -> Advice:
        """Return the advice of a cure, made large enough, or the advice that it fails."""
        margin = MARGIN
        for _ in range(SEARCHES):
            limit, agrees = self._examined(cure)
            if agrees and self._leaves_margin(limit):
                text = f"{cure.advice.text}: {stable(limit)}"
                return replace(cure.advice, text=text, limit=limit.dt)
            if limit.dt > 0 and self._leaves_margin(limit):
                # A larger margin would not change what fails.
                break
            margin *= max(SURPLUS, min(2.0, SURPLUS * MARGIN * self.wanted / max(limit.dt, 1e-12)))
            following = way(margin)
            if not isinstance(following, Cure):
                break
            cure = following
        return failed(cure.advice.what)

    def _leaves_margin(self, limit: Limit) -> bool:
        return min(limit.dt, limit.longest) >= RESOLVED * MARGIN * self.wanted

    def _examined(self, cure: Cure) -> tuple[Limit, bool]:
        """Return the limit of a cured model, and whether its motion agrees with a fine run."""
        own, motion = cure.model.settings.integrator, cure.motion or self.motion
        try:
            visited = visit(cure.model, motion, self.horizon)
            after = examine(cure.model, visited, self.horizon, self.wanted, (own,))
        except (SimulationError, ValueError, ArithmeticError):
            return Limit(own, 0.0, -1), False
        return after.limits[own], self._agrees(after, own)

    def _agrees(self, after: Examination, integrator: str) -> bool:
        """Return whether runs at the wanted step end as runs at a fine one do."""
        if not isinstance(after.check, Judge):
            return after.check is None and self._bounded(after, integrator)
        if self.wanted > after.check.longest:
            return False
        seen = after.observed(integrator)
        known = {servo.element for servo in self.before.seen.saturations if servo.severe}
        worse = [s for s in seen.saturations if s.reached or (s.severe and s.element not in known)]
        return (
            seen.limit.dt >= self.wanted
            and not worse
            and seen.lasting is None
            and after.check.agrees(integrator, self.wanted, after.slowest)
        )

    def _bounded(self, after: Examination, integrator: str) -> bool:
        """Return whether runs from the first and the worst state stay bounded."""
        here, worst = after.visited.here, max(after.limits[integrator].state, 0)
        starts = [here.states[k] for k in dict.fromkeys((0, worst))]
        span = self.horizon
        return all(stays_bounded(here.model, s, integrator, self.wanted, span) for s in starts)


def stable(limit: Limit) -> str:
    """Return up to which dt a changed model is stable."""
    if not math.isinf(limit.dt):
        return f"stable up to {seconds(limit.dt)}"
    if limit.longest < LONGEST:
        return f"stable at every dt tried, up to {seconds(limit.longest)}"
    return "stable at any dt"
