"""`Motions`: runs of one motion at any time step, each with a perturbed run.

A run makes the motion, then holds its last control, for at least `LEAST` steps in all. A perturbed
run makes the same motion from a start that is moved by 1e-6 of the scene's size. A `Pair` has the
energies, the growth of the perturbation, and the forces of the actuators of both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.checks import one_line
from stepcore.engine.arrays import Floats
from stepcore.engine.control import Control, ControlError, evaluate_control, new_control
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.change import Change
from stepcore.experiment.control_table import ControlLog, Controls
from stepcore.experiment.engines import Course, Engine, Recording
from stepcore.experiment.price import OVERHEAD
from stepcore.experiment.schedule import SPEED, SPIN, Schedule

# The longest and the shortest step that is tried [s]. If the runs of a scene are costly, no step is
# longer than `AMPLE` times the wanted one: from this stability margin on, accuracy limits dt.
LONGEST, SHORTEST, AMPLE = 1.0, 1e-6, 10.0
# The perturbation of the start, relative to the scene's size or in radians.
NUDGE = 1e-6
# The least number of steps of a run, and the number of its samples. The converged motion is sampled
# at every step, because a contact may last a single step.
LEAST, SAMPLES = 1000, 100
# The largest ratio of the perturbation to the converged motion's. A step below its limit makes the
# swing of a spring at most 1/√(1 − 0.98²) = 5 times as wide; above it, 1000 steps make it grow by
# orders of magnitude, until contacts open or servos saturate.
GROWN = 30.0
# The part of a run after which growth counts, and after which motion should rest.
CALM = 0.75
# A motion has blown up at BLOWN times the kinetic energy of a slow one, or if a body is further
# away than FAR times the size plus FAR m/s² times time²: its steps take long.
BLOWN, FAR = 1e16, 1e4
# Growth by a power of time above this is exponential: it does not end within a longer run.
BALLISTIC = 2.5
# The cost of a call of a user's function, in operations.
CALL = 50_000
# The most operations of one pair of runs, half a second of a core. A motion that would take more is
# cut short.
WORK = 2e9


@dataclass(frozen=True, eq=False)
class UntilTheEnd:
    """A user's control function; after the motion it gets the time of its last call.

    gain: multiplies the difference of the controls from the converged motion's (`usual`).
    frozen: the controls that are taken from the converged motion.
    """

    inner: Control
    end: float
    gain: float = 1.0
    frozen: tuple[int, ...] = ()
    usual: Floats | None = None
    period: float = 1.0
    last: list[float] = field(default_factory=lambda: [0.0])

    def __call__(self, time: float, sim: Any) -> Any:
        if time <= self.end * (1 + 1e-9):
            self.last[0] = time
        # In a run that blows up, a user's numbers overflow.
        with np.errstate(over="ignore", invalid="ignore"):
            ctrl = np.array(self.inner(self.last[0], sim), float)
        if self.usual is None:
            return ctrl
        usual = self.usual[min(int(time / self.period + 1e-9), len(self.usual) - 1)]
        ctrl = usual + self.gain * (ctrl - usual)
        ctrl[list(self.frozen)] = usual[list(self.frozen)]
        return ctrl


@dataclass(frozen=True)
class Loop:
    """A change of a user's control function: gain, period [s] (0: every step), frozen controls."""

    gain: float = 1.0
    period: float | None = None
    frozen: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Pair:
    """A run and its perturbed run.

    dt: the step [s]. times: the times of the samples [s]. apart: for each dof, the root of the
    kinetic energy of their difference; the largest [√J]. energy: the larger kinetic energy [J];
    gained: the larger gain of kinetic and potential energy since the start [J].
    failure: why the run ended early, "" if it did not. reached: the simulated time [s].
    ran: the recorded run; None if it was refused. force_ranges: of the actuators, (nu, 2).
    slow: the kinetic energy of a slow motion [J]. sampled: the period of a user's function [s].
    """

    dt: float
    times: Floats
    apart: Floats
    energy: Floats
    gained: Floats
    failure: str
    reached: float
    ran: Recording | None
    force_ranges: Floats
    slow: float = 0.0
    sampled: float = 0.0

    @property
    def late(self) -> np.ndarray:
        """The samples of motion that should rest."""
        mask: np.ndarray = self.times >= CALM * self.times[-1]
        return mask

    def blows_up(self) -> float:
        """Return when the run has blown up [s]; inf if never."""
        over = self.times[self.energy > BLOWN * self.slow]
        if len(over):
            return float(over[0])
        return self.reached if self.failure else math.inf

    def grows(self) -> bool:
        """Return whether the energy still grows exponentially at the end."""
        return power(self.times, self.energy) > BALLISTIC

    # --- chatter: forces of actuators that jump or saturate ---------------------------------------

    @property
    def rests(self) -> bool:
        """Whether the run fails, or comes to rest: near its end it is slow throughout."""
        return bool(self.failure) or bool(self.energy[self.late].max() < self.slow / GROWN**2)

    @property
    def jumps(self) -> bool:
        """Whether forces of actuators that jump between bounds move the run at its end."""
        return bool(self.jumping()[1].any())

    def jumping(self, apart: float = 0.0) -> tuple[Floats, np.ndarray]:
        """Return how much forces of actuators change at the end of the run, and which of them jump.

        A force jumps if it changes by a quarter of its span from sample to sample, or from call to
        call of a user's function, and is often at an end of its span. The force of a spring that
        swings without a damper changes as much, but has no bound.

        apart: the least time between samples [s].
        """
        if self.rests or self.ran is None or len(self.times) < 2:
            count = len(self.force_ranges)
            return np.zeros(count), np.zeros(count, bool)
        force, between = self.ran["actuator_force"], max(self.sampled, apart)
        late = force[self.late][:: max(1, round(between / self.times[1]))]
        changes = np.abs(np.diff(late, axis=0)).sum(axis=0) / max(1, len(late) - 1)
        low, high, span = force.min(axis=0), force.max(axis=0), np.ptp(force, axis=0)
        bound = np.minimum(late - low, high - late) <= np.finfo(float).eps * span
        return changes, (changes > span / 4) & _often(bound)

    @property
    def presses(self) -> bool:
        """Whether the run still moves at its end, where actuators saturate."""
        if self.rests or self.ran is None:
            return False
        return bool(self._full(self.ran["actuator_force"][self.late]).any())

    @property
    def saturated(self) -> np.ndarray:
        """Which actuators saturate in more than a tenth of the run, (nu,)."""
        if self.ran is None:
            return np.zeros(len(self.force_ranges), bool)
        return _often(self._full(self.ran["actuator_force"]))

    def _full(self, force: Floats) -> np.ndarray:
        low, high = self.force_ranges.T
        with np.errstate(invalid="ignore"):
            full: np.ndarray = (force <= low) | (force >= high)
        return full


def _often(mask: np.ndarray) -> np.ndarray:
    often: np.ndarray = mask.mean(axis=0) > 0.1
    return often


def power(times: Floats, values: Floats) -> float:
    """Return the power of time by which the largest value grows in the second half."""
    half, end = (np.nanmax(values[times <= part * times[-1]], initial=0.0) for part in (0.5, 1.0))
    return math.log2(end / half) if half > 0 else 0.0


def continued(times: Floats, values: Floats, until: Floats) -> Floats:
    """Return the largest value up to each time, continued beyond the last one by its growth."""
    largest = np.maximum.accumulate(np.nan_to_num(values, nan=0.0))
    peaks = np.interp(until, times, largest)
    beyond, growth = until > times[-1], power(times, values)
    if growth > BALLISTIC:
        peaks[beyond] = np.inf
    elif growth > 0:
        with np.errstate(over="ignore"):
            peaks[beyond] *= (until[beyond] / times[-1]) ** growth
    return peaks


class Motions:
    """Runs of one motion of a scene and of its changes, at any step.

    engine: runs them; its rows are solved to rounding (`Engine.converged`). schedule: the motion.
    size: the scene's [m]. wanted: the step in question [s]. period: the user's control period [s];
    None for a control at every step.
    """

    def __init__(
        self,
        engine: Engine,
        schedule: Schedule,
        size: float,
        wanted: float,
        period: float | None = None,
    ) -> None:
        self.schedule, self.size, self.period = schedule, size, period
        self.wanted, self.horizon, self.users = wanted, schedule.horizon, schedule.control
        self.undriven, self.engine = engine, engine.driven(schedule)
        places, rng = engine.coordinates, np.random.default_rng(0)
        start, signs = schedule.starts[0], rng.choice([-1.0, 1.0], (2, engine.nv))
        nudge = NUDGE * places.scaled(signs[0], size, 1.0)
        push = NUDGE / self.horizon * places.scaled(signs[1], size, 1.0)
        self.starts = (
            start,
            replace(start, qpos=places.moved(start.qpos, nudge), qvel=start.qvel + push),
        )
        inertia = self.engine.inertia(start)
        self.weights = np.sqrt(inertia)
        # The kinetic energy of a slow motion of every dof: less is no explosion.
        slow = places.scaled(np.ones(engine.nv), SPEED, SPIN)
        self.floor = 0.5 * float(slow**2 @ inertia)
        self.flops = OVERHEAD + self.engine.operations_at(start) + CALL * (self.users is not None)
        self.usual: tuple[float, Floats] | None = None
        self.fine = self.engine.finest(schedule)

    @property
    def most(self) -> int:
        return max(2 * LEAST, int(WORK / 2 / self.flops))

    @property
    def costly(self) -> bool:
        """Whether a pair of runs takes more than a fiftieth of the most operations."""
        return 2 * LEAST * self.flops > WORK / 50

    def cheap(self, dt: float) -> bool:
        """Whether a pair of runs at a step takes no more than a fiftieth of the most operations."""
        return 2 * self.steps(dt) * self.flops <= WORK / 50

    @property
    def longest(self) -> float:
        return min(LONGEST, AMPLE * self.wanted) if self.costly else LONGEST

    def count(self, pair: Pair) -> None:
        """Count the operations of a step at the end of a run, too: contacts may act there."""
        if pair.ran is not None and not pair.failure:
            counted = self.engine.operations_at(pair.ran.last, pair.ran["ctrl"][-1])
            self.flops = max(self.flops, OVERHEAD + counted)

    @property
    def model(self) -> Model:
        """stepcore's model, without the servos that the motion needs."""
        return self.undriven.model

    def of(self, change: Change) -> Model:
        """Return stepcore's changed model, with the servos that the motion needs."""
        return self.engine.of(change)

    def first_ctrl(self) -> Floats:
        """Return the first controls of the motion, (nu,)."""
        sim = unwatched(Sim(self.of(Change())))
        self.starts[0].put(sim)
        rows, _ = self.schedule.controls.rows([0], self.engine.dt, 1)
        if self.users is not None:
            sim.ctrl = evaluate_control(new_control(self.users), sim)
        elif rows is not None:
            sim.ctrl[:] = rows[0, 0]
        return np.array(sim.ctrl)

    def without_control(self) -> Motions:
        """Return the motion with the controls of its start instead of the function."""
        log = ControlLog(np.zeros(1), self.first_ctrl()[None])
        schedule = replace(self.schedule, controls=Controls(log))
        return Motions(self.undriven, schedule, self.size, self.wanted)

    def keep_usual(self, fine: Pair) -> None:
        """Keep the controls of the converged motion as the values of frozen controls."""
        if self.users is not None and fine.ran is not None and len(fine.times) > 1:
            self.usual = float(fine.times[1]), np.array(fine.ran["ctrl"][1:])

    def changed(self, change: Change) -> Motions:
        """Return the same motion of the changed scene."""
        engine = self.undriven.changed(change)
        return Motions(engine, self.schedule, self.size, self.wanted, self.period)

    def steps(self, dt: float, least: int = LEAST) -> int:
        return max(least, math.ceil(self.horizon / dt * (1 - 1e-9)))

    def pair(
        self,
        change: Change,
        dt: float,
        steps: int | None = None,
        loop: Loop | None = None,
        samples: int = SAMPLES,
    ) -> Pair:
        """Run the motion and its perturbed run under a change.

        steps: by default the motion and the time after it. loop: a change of the user's control.
        """
        length = min(steps or self.steps(dt), self.most)
        # The stride is odd, so that samples show a force that jumps from step to step.
        every = max(1, length // samples) | 1
        count = every * math.ceil(length / every)
        ranges, sampled = self.engine.force_ranges, self.period or 0.0
        try:
            far, runs = FAR * (self.size + (count * dt) ** 2), list[Recording]()
            course = self._driven(Course(count, every, far), dt, loop)
            for start in self.starts:
                # Run one by one: two worlds in lanes take more time, and one failure is enough.
                at = change.also(Change(dt=dt))
                runs.append(self.engine.record(at, start, course))
                if runs[-1].failure:
                    break
        except ControlError:
            raise
        except (SimulationError, ValueError, ArithmeticError) as error:
            none, why = np.full(1, np.nan), one_line(error)
            return Pair(dt, np.zeros(1), none, none, none, why, 0.0, None, ranges, self.floor)
        with np.errstate(all="ignore"):
            difference = np.abs(runs[0]["qvel"] - runs[-1]["qvel"])
            apart = (self.weights * difference).max(axis=-1)
            energies = np.array([ran["energy"] for ran in runs])
            kinetic, total = energies[..., 0].max(axis=0), energies.sum(axis=-1)
            gained = (total - total[:, :1]).max(axis=0)
        ran, last = runs[0], runs[-1]
        of_runs = ran.times, apart, kinetic, gained, last.failure, last.reached, ran
        return Pair(dt, *of_runs, ranges, self.floor, sampled)

    def _driven(self, course: Course, dt: float, loop: Loop | None) -> Course:
        """Return a run under the controls of the motion, which then holds the last ones."""
        if self.users is None:
            steps = min(course.steps, max(1, math.ceil(self.horizon / dt * (1 - 1e-9))))
            rows, hold = self.schedule.controls.rows([0], dt, steps)
            # The motion ends with its horizon, even if a table is longer.
            rows = rows if rows is None else rows[:, : -(-steps // hold)]
            return replace(course, ctrl=rows, hold=hold)
        loop = loop or Loop()
        period = self.period if loop.period is None else loop.period
        hold = 1 if period is None else max(1, round(period / dt))
        usual = self.usual or (1.0, None)
        end = max(self.horizon - self.engine.dt, 0.0)
        control = UntilTheEnd(self.users, end, loop.gain, loop.frozen, usual[1], usual[0])
        control.__dict__["__wrapped__"] = self.users
        return replace(course, control=control, hold=hold)

    def falling(self, dt: float) -> float:
        """Return the kinetic energy that gravity gives all bodies in one step [J].

        Bodies at rest gain this much in a step before a contact can hold them.
        """
        engine = self.engine
        return 0.5 * float(np.sum(engine.matter.mass)) * engine.gravity**2 * dt**2
