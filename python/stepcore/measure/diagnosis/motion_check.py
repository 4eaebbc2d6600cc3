"""Judge runs of the motion, where the linearised step does not decide.

The motion is run with the real step (`motion_runs`) and compared with a run at a fine step:

- it explodes if it does not stay finite, or if its kinetic energy exceeds `LARGE` times the
  largest of the fine run (and of a fall for one step: bodies that a contact holds may move so);
- a body passes through another one, and does not in the fine run;
- it chatters if a servo's force repeatedly jumps from one end of its force range to the other
  within a step, and does not in the fine run.

`motion_limit` searches for the step at which a motion begins to fail.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.experiment.failure import LARGE
from stepcore.measure.diagnosis.linear_motion import linear_motion
from stepcore.measure.diagnosis.motion_runs import FEWEST, MotionRun, MotionRuns
from stepcore.measure.diagnosis.shares import growing_shares

# The share of the steps in which a chattering servo's force goes from one end of its range to the
# other (half of the steps in a cycle of four). `RARE` is enough in a run with large energy, because
# chatter may die out by chance (for Panda at 4.6 ms, but not at 3.2 ms). A fine run has fewer such
# steps.
CHATTER, RARE = 0.3, 0.01
# The fine runs to try until two successive runs agree: integrator, and step over that of the
# states' run. `REFINED` is the largest ratio of energies that agree.
FINER = (
    ("implicitfast", 0.5),
    ("rk4", 0.5),
    ("implicitfast", 0.125),
    ("implicitfast", 0.03),
    ("implicitfast", 0.008),
)
REFINED = 1.5
# The energy, over that of a slow motion, above which a motion has blown up at any step; and the
# largest ratio of two blow-up times that agree.
RUNAWAY, ALIKE = 1e16, 1.2
# A factor of the explosion energy for a changed model, whose masses may differ.
CHANGED = 1e3
# The energy, over the first that exceeds the bound, that a saturated servo may cause: such a run
# may stay finite.
THROWN = 1e9
# Horizons over which slow growth is searched for, and the divisor of the step for comparison.
LONGER, SHORTER = 10, 4
# Slow periods for which a cure must hold.
PERIODS = 10


@dataclass(frozen=True)
class Outcome:
    """The outcome of the motion at a step.

    kind: "holds", "explodes", "passes" or "chatters".
    time: when the motion failed, or how far the run went [s].
    energy: the largest kinetic energy over that of the fine run.
    element: the servo that chatters, or the contact through which a body passes.
    jumps: the largest share of the steps in which a servo's force goes from end to end, unless it
        does in the fine run.
    """

    kind: str
    time: float
    energy: float
    element: Element | None = None
    jumps: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether the motion agrees with the fine run in energy and without chatter."""
        return self.kind == "holds"


@dataclass(frozen=True)
class Runaway:
    """A motion that blows up at every step that was tried.

    times: when the motion blows up, at the two shortest steps [s].
    dts: these two steps [s].
    alike: whether both times agree. If they do, the motion itself grows, and no dt changes that.
    element: the element that makes the motion grow, if a single one does.
    """

    times: tuple[float, float]
    dts: tuple[float, float]
    alike: bool
    element: Element | None = None

    @property
    def confirmed(self) -> bool:
        """Whether two fine runs agree, as for a `Judge`."""
        return self.alike


@dataclass(frozen=True)
class Judge:
    """A comparison of runs of the real step with a fine run.

    real: the motion.
    fine: its run at a fine step.
    confirmed: whether a finer step gave the same motion.
    floor: the kinetic energy of a slow motion [J].
    """

    real: MotionRuns
    fine: MotionRun
    confirmed: bool
    floor: float

    @property
    def bound(self) -> float:
        """The kinetic energy [J] above which a run at short steps explodes."""
        return LARGE * max(self.fine.peak, self.floor)

    def bound_at(self, dt: float) -> float:
        """Return the kinetic energy [J] above which a run at steps of dt [s] explodes."""
        return max(self.bound, LARGE * self.real.falling_energy(dt))

    @property
    def longest(self) -> float:
        """The longest step whose run has enough steps to judge [s]."""
        return self.fine.reached / FEWEST

    @property
    def rests(self) -> bool:
        """Whether the motion moves nothing faster than slowly."""
        return self.fine.peak <= self.floor

    def gained(self, run: MotionRun) -> float:
        """Return the energy that a run gains and the fine run does not, over the fine peak.

        The result is 0 for a motion that actuators drive: their work is no error.
        """
        model = self.real.model
        if model.nu and model.scene.features.actuation:
            return 0.0
        gained = run.gained - max(self.fine.gained, 0.0)
        return max(gained, 0.0) / max(self.fine.peak, self.floor)

    def run(self, integrator: str, dt: float, more: float = 1.0) -> MotionRun:
        """Return the run of the motion at a step, over the time of the fine run.

        integrator, dt: the integrator and its step [s].
        more: a factor of the bound.
        """
        horizon, bound = self.fine.reached, more * self.bound_at(dt)
        run = self.real.run(integrator, dt, horizon=horizon, beyond=bound)
        if run.finite and run.peak > bound and bool(run.saturated.any()):
            return self.real.run(integrator, dt, horizon=horizon, beyond=THROWN * run.peak)
        return run

    def outcome(self, integrator: str, dt: float, more: float = 1.0) -> Outcome:
        """Return the outcome of the motion at a step.

        integrator, dt: the integrator and its step [s].
        more: a factor of the energy of an explosion.
        """
        return self.judged(self.run(integrator, dt, more), more)

    def judged(self, run: MotionRun, more: float = 1.0) -> Outcome:
        """Return the outcome of a run.

        more: as in `outcome`.
        """
        energy = run.peak / max(self.fine.peak, self.floor)
        often = (run.jumps > CHATTER) | (run.swings > CHATTER)
        bound = self.bound_at(run.dt)
        if run.peak > bound:
            often |= run.swings > RARE
        usual = self.fine.swings < CHATTER / 2
        jumping, most = np.flatnonzero(often & usual), float(run.swings[usual].max(initial=0.0))
        if run.finite and len(jumping):
            servo = Element.of(self.real.model, "actuator", int(jumping[0]))
            return Outcome("chatters", run.reached, energy, servo, most)
        passage, when = self._passage(run)
        large = run.times[run.energies > bound]
        if passage is not None and when < float(large.min(initial=math.inf)):
            return Outcome("passes", when, energy, passage)
        if not run.finite or run.peak > more * bound:
            return Outcome("explodes", run.reached, energy)
        return Outcome("holds", run.reached, energy, jumps=most)

    def _passage(self, run: MotionRun) -> tuple[Element | None, float]:
        """Return the first contact through which a body passes in a run alone, and when [s]."""
        model, passed = self.real.model, {frozenset(pair) for pair in self.fine.passages}
        for pair, when in run.passages.items():
            if frozenset(pair) not in passed:
                both = np.sort(model.pair_geoms, axis=1) == np.sort(pair)
                index = int(np.flatnonzero(both.all(axis=1))[0])
                return Element.of(model, "contact", index), when
        return None, math.inf

    def holds(self, model: Model, integrator: str, dt: float) -> bool:
        """Return whether a model's motion neither explodes nor chatters at a step.

        A step longer than `longest` makes too few steps to judge, and passes.

        model: the model of the runs, or a changed one.
        integrator, dt: the integrator and its step [s].
        """
        if dt > self.longest:
            return True
        changed = replace(self, real=replace(self.real, model=model))
        return changed.outcome(integrator, dt, CHANGED).holds

    def lasting(self, integrator: str, dt: float) -> float | None:
        """Return the time [s] at which growth by the integrator exceeds the bound, or None.

        The time lies after the horizon. The result is None if there is no such growth in `LONGER`
        horizons, or if a quarter of the step does the same. It is None with a control function,
        which may be undefined after the horizon.
        """
        if dt > self.longest or self.real.schedule.calls_user:
            return None
        far = self.real.run(integrator, dt, horizon=LONGER * self.fine.reached, beyond=self.bound)
        if far.finite and far.peak <= self.bound:
            return None
        finer = self.real.run(integrator, dt / SHORTER, horizon=far.reached)
        alike = not finer.finite or finer.peak > self.bound / 2
        return None if alike or finer.reached < 0.9 * far.reached else far.reached

    def agrees(self, integrator: str, dt: float, slowest: float) -> bool:
        """Return whether the kinetic energy at a step stays that of shorter steps.

        It may exceed the fine run's by `REFINED`, for `LONGER` horizons and for `PERIODS` slow
        periods, or else that of a quarter of the step. With a control function, which may be
        undefined after the horizon, it is compared over the horizon.

        integrator, dt: the integrator and its step [s].
        slowest: the period of the slowest oscillation [s]; 0 for none.
        """
        # A contact may bounce by as much as a body falls in a step, up and down.
        floor, span = max(self.floor, 2 * self.real.falling_energy(dt)), self.real.horizon
        if self.real.schedule.control is None:
            span = max(LONGER * span, PERIODS * slowest)
        run = self.real.run(integrator, dt, horizon=span, beyond=RUNAWAY * floor)
        if not run.finite or run.peak <= REFINED * max(self.fine.peak, floor):
            return run.finite
        finer = self.real.run(integrator, dt / SHORTER, horizon=run.reached)
        if not finer.finite:
            return False
        within = run.times <= finer.reached * (1 + 1e-9)
        peak = float(run.energies[within].max())
        # The shorter steps may not last as long.
        return peak <= REFINED * max(finer.peak, floor) and run.peak <= LARGE * max(peak, floor)


# --- the fine run ---------------------------------------------------------------------------------


def judge(real: MotionRuns, dt: float) -> Judge | Runaway | None:
    """Return a judge with a fine run, at a part of `dt` [s], that another fine run confirms.

    The result is a Runaway if the finest runs blow up, and None if only the last does.
    """
    floor = real.least_energy()
    runs: list[MotionRun] = []
    for integrator, part in FINER:
        runs.append(real.run(integrator, part * dt, beyond=RUNAWAY * floor))
        if len(runs) > 1 and _same(runs[-2], runs[-1], floor):
            # Both runs are fine enough, and the longer run is used.
            chosen = max(runs[-2:], key=lambda run: round(run.reached, 9))
            return Judge(real, chosen, True, floor)
        runaway = _runaway(real.model, runs[-2:], floor)
        if len(runs) > 2 and runaway is not None and runaway.alike:
            break
    if runaway is not None:
        return runaway
    return None if _blown(runs[-1], floor) else Judge(real, runs[-1], False, floor)


def _blown(run: MotionRun, floor: float) -> bool:
    return not run.finite or run.peak > RUNAWAY * floor


def _runaway(model: Model, runs: Sequence[MotionRun], floor: float) -> Runaway | None:
    """Return the Runaway of the last two runs if both blow up, or None."""
    if len(runs) < 2 or not all(_blown(run, floor) for run in runs):
        return None
    times, calm = [run.reached for run in runs], runs[-1].calm
    alike = max(times) <= ALIKE * min(times)
    element = None
    if alike and calm is not None:
        # The element has the largest share in the fastest growth of the motion itself.
        motion = linear_motion(model, calm, None)
        shares = {} if motion is None else growing_shares(motion)
        element = max(shares, key=lambda element: shares[element], default=None)
        if element is not None and not shares[element] > 0:
            element = None
    return Runaway((times[0], times[1]), (runs[0].dt, runs[1].dt), alike, element)


def _same(coarse: MotionRun, fine: MotionRun, floor: float) -> bool:
    """Return whether two runs agree in kinetic energy while both last, and do not chatter."""
    if _blown(coarse, floor) or _blown(fine, floor):
        return False
    if bool((np.maximum(coarse.swings, fine.swings) > RARE).any()):
        return False
    until = min(coarse.reached, fine.reached) * (1 + 1e-9)
    peaks = [max(float(r.energies[r.times <= until].max()), floor) for r in (coarse, fine)]
    return max(peaks) <= REFINED * min(peaks)
