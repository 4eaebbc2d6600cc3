"""Runs of a motion at any time step, each with a perturbed run: they judge the step.

A run makes the motion, then holds its last control, for at least `LEAST` steps in all. A perturbed
run makes the same motion from a start that is moved by 1e-6 of the scene's size. A step fails if

- a run does not stay finite, or has `LARGE` times the kinetic energy of the converged motion;
- the perturbation grows without end: towards the end of the run it is `GROWN` times as large as it
  ever was in the converged motion. Growth of the motion itself (chaos, a fall) is in the
  converged motion, too, and is no limit;
- it chatters: forces of actuators jump between their bounds, unlike in the converged motion, or
  saturate where the converged motion rests. Bounds set the size of chatter, and no perturbation
  grows in it.

The converged motion is such a pair of runs at a short step, which a shorter one confirms. If a run
is longer, energy and perturbation of the converged motion are continued by a power of time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.checks import one_line
from stepcore.engine.arrays import Floats
from stepcore.engine.control import Control, ControlError, evaluate_control, new_control
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.element import Element
from stepcore.engine.follow import Followed, follow
from stepcore.engine.model import Model
from stepcore.engine.pitfalls import unwarned
from stepcore.engine.run_settings import converged_settings
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.change import Change
from stepcore.experiment.control_table import ControlLog, Controls
from stepcore.experiment.price import OVERHEAD
from stepcore.experiment.schedule import SPEED, SPIN, Schedule
from stepcore.report.units import seconds

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
# A run that grew by less than GROWN² is made this many times as long, to see if the growth ends.
LONGER = 4
# The part of a run after which growth counts, and after which motion should rest.
CALM = 0.75
# The largest ratio of the kinetic energy to the converged motion's. A step below its limit makes
# the energy of a swinging spring at most 1/(1 − 0.98²) = 25 times as large.
LARGE = 50.0
# The integrator of the converged motion, and the parts of a short step that are tried for it; the
# largest ratios of two kinetic energies, and of two perturbations, that agree.
FINE, FINER = Change(integrator="implicitfast"), (1.0, 0.5, 0.125, 0.03, 0.008)
SAME, ALIKE = 1.5, 10.0
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


def with_converged_rows(model: Model) -> Model:
    """Return the model in double precision, with rows solved to rounding, and without sleep.

    The limit then belongs to the integrator alone, without the effects of an unfinished solve.
    """
    s = model.settings
    count = 200 if s.sweeps == "auto" else max(s.sweeps, 200)
    converged = converged_settings(s, sweeps=count, tolerance=1e-14)
    if s.sweeps == "auto":
        converged = converged.replace(sweeps="auto")
    return model.with_settings(converged.replace(sleep=False))


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
            asked = np.array(self.inner(self.last[0], sim), float)
        if self.usual is None:
            return asked
        usual = self.usual[min(int(time / self.period + 1e-9), len(self.usual) - 1)]
        asked = usual + self.gain * (asked - usual)
        asked[list(self.frozen)] = usual[list(self.frozen)]
        return asked


@dataclass(frozen=True)
class Loop:
    """A change of a user's control function: gain, period [s] (0: every step), frozen controls."""

    gain: float = 1.0
    period: float | None = None
    frozen: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class State:
    """A state of the motion, at which the step is linearised.

    label: its place in the motion. time: [s]. qpos, qvel, ctrl, act: as in a Sim.
    rows: the elements whose rows act there, and under the law `penalty` the contacts that overlap.
    """

    label: str
    time: float
    qpos: Floats
    qvel: Floats
    ctrl: Floats
    act: Floats
    rows: tuple[Element, ...] = ()

    @classmethod
    def of(cls, label: str, time: float, arrays: Iterable[Any]) -> State:
        qpos, qvel, ctrl, act = (np.array(array) for array in arrays)
        return cls(label, time, qpos, qvel, ctrl, act)

    def sim(self, model: Model) -> Sim:
        sim = unwatched(Sim(unwarned(model)))
        sim.qpos[:], sim.qvel[:], sim.ctrl[:] = self.qpos, self.qvel, self.ctrl
        sim.act[:] = self.act
        return sim


@dataclass(frozen=True, eq=False)
class Pair:
    """A run and its perturbed run.

    dt: the step [s]. times: the times of the samples [s]. apart: for each dof, the root of the
    kinetic energy of their difference; the largest [√J]. energy: the larger kinetic energy [J];
    gained: the larger gain of kinetic and potential energy since the start [J].
    failure: why the run ended early, "" if it did not. reached: the simulated time [s].
    ran: the recorded run; None if it was refused.
    """

    dt: float
    times: Floats
    apart: Floats
    energy: Floats
    gained: Floats
    failure: str
    reached: float
    ran: Followed | None

    @property
    def late(self) -> np.ndarray:
        """The samples of motion that should rest."""
        mask: np.ndarray = self.times >= CALM * self.times[-1]
        return mask

    def blows_up(self, floor: float) -> float:
        """Return when the run has blown up [s]; inf if never. floor: the energy of slow motion."""
        over = self.times[self.energy > BLOWN * floor]
        if len(over):
            return float(over[0])
        return self.reached if self.failure else math.inf

    def grows(self) -> bool:
        """Return whether the energy still grows exponentially at the end."""
        return power(self.times, self.energy) > BALLISTIC


def power(times: Floats, values: Floats) -> float:
    """Return the power of time by which the largest value grows in the second half."""
    half, whole = (np.nanmax(values[times <= part * times[-1]], initial=0.0) for part in (0.5, 1.0))
    return math.log2(whole / half) if half > 0 else 0.0


def continued(times: Floats, values: Floats, until: Floats) -> Floats:
    """Return the largest value up to each time, continued beyond the last one by its growth."""
    largest = np.maximum.accumulate(np.nan_to_num(values, nan=0.0))
    known = np.interp(until, times, largest)
    beyond, grown = until > times[-1], power(times, values)
    if grown > BALLISTIC:
        known[beyond] = np.inf
    elif grown > 0:
        with np.errstate(over="ignore"):
            known[beyond] *= (until[beyond] / times[-1]) ** grown
    return known


@dataclass(frozen=True)
class Outcome:
    """The outcome of a motion at a step.

    kind: "holds", "diverges" (not finite), "gains energy", "grows" (the perturbation), "chatters".
    time: the time of the failure, or the simulated time [s].
    energy, growth: the largest kinetic energy, and the perturbation towards the end, relative to
        the converged motion. early: `energy` in the first half. brief: whether the growth may be a
        pulse.
    """

    kind: str
    time: float
    energy: float = 0.0
    growth: float = 0.0
    early: float = 0.0
    brief: bool = False

    @property
    def holds(self) -> bool:
        return self.kind == "holds"


@dataclass(frozen=True)
class Runaway:
    """A motion that blows up at every step: the times, at the two shortest steps, `dts` [s]."""

    times: tuple[float, float]
    dts: tuple[float, float]

    @property
    def alike(self) -> bool:
        """Whether both times agree: the motion itself then grows, and no dt changes that."""
        return max(self.times) <= 1.2 * min(self.times)


class Motions:
    """Runs of one motion of a model and of its changes, at any step.

    model: it has converged rows. schedule: the motion. size: the scene's [m]. wanted: the step in
    question [s]. period: the user's control period [s]; None for a control at every step.
    """

    def __init__(
        self,
        model: Model,
        schedule: Schedule,
        size: float,
        wanted: float,
        period: float | None = None,
    ) -> None:
        self.model, self.schedule, self.size, self.period = model, schedule, size, period
        self.wanted = wanted
        self.horizon = schedule.horizon
        moved, rng = Coordinates(model), np.random.default_rng(0)
        start, signs = schedule.starts[0], rng.choice([-1.0, 1.0], (2, model.nv))
        nudge = NUDGE * moved.scaled(signs[0], size, 1.0)
        push = NUDGE / self.horizon * moved.scaled(signs[1], size, 1.0)
        self.starts = (
            start,
            replace(start, qpos=moved.moved(start.qpos, nudge), qvel=start.qvel + push),
        )
        self.driven, self.users = schedule.driven_model(model), schedule.control
        # Motors that the default motion drives as servos.
        self.ours = frozenset(
            model.index("actuator", servo.actuator) for servo in schedule.controls.servos
        )
        sim = unwatched(Sim(self.driven))
        start.put(sim)
        mass = np.array(sim.mass_matrix())
        self.weights = np.sqrt(np.diag(mass))
        # The kinetic energy of a slow motion of every dof: less is no explosion.
        slow = moved.scaled(np.ones(model.nv), SPEED, SPIN)
        self.floor = 0.5 * float(slow**2 @ np.diag(mass))
        self.flops = _counted(sim) + CALL * (self.users is not None)
        self.usual: tuple[float, Floats] | None = None
        self._models: dict[Change, Model] = {}

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
            sim = unwatched(Sim(self.of(Change())))
            for name in ("qpos", "qvel", "act", "ctrl"):
                getattr(sim, name)[:] = pair.ran[name][0, -1]
            self.flops = max(self.flops, _counted(sim))

    def of(self, change: Change) -> Model:
        """Return the changed model, with the servos that the motion needs."""
        physics = change.physics
        if physics not in self._models:
            self._models[physics] = physics.of(self.driven)
        return change.with_settings(self._models[physics])

    def first(self) -> State:
        """Return the start of the motion, under its first controls."""
        start, sim = self.schedule.starts[0], unwatched(Sim(self.driven))
        start.put(sim)
        rows, _ = self.schedule.controls.rows([0], self.model.settings.dt, 1)
        if self.users is not None:
            sim.ctrl = evaluate_control(new_control(self.users), sim)
        elif rows is not None:
            sim.ctrl[:] = rows[0, 0]
        return State.of("the start", 0.0, (sim.qpos, sim.qvel, sim.ctrl, sim.act))

    def without_control(self) -> Motions:
        """Return the motion with the controls of its start instead of the function."""
        log = ControlLog(np.zeros(1), self.first().ctrl[None])
        schedule = replace(self.schedule, controls=Controls(log))
        return Motions(self.model, schedule, self.size, self.wanted)

    def keep_usual(self, fine: Pair) -> None:
        """Keep the controls of the converged motion as the values of frozen controls."""
        if self.users is not None and fine.ran is not None and len(fine.times) > 1:
            self.usual = float(fine.times[1]), np.array(fine.ran["ctrl"][0, 1:])

    def saturated(self, change: Change, dt: float) -> np.ndarray:
        """Return which actuators saturate in more than a tenth of a run, (nu,)."""
        ran = self.pair(change, dt).ran
        if ran is None:
            return np.zeros(self.driven.nu, bool)
        return _often(self.ends(ran["actuator_force"][0]))

    def ends(self, force: Floats) -> np.ndarray:
        """Return where forces of actuators saturate."""
        low, high = self.driven.actuator_forcerange.T
        with np.errstate(invalid="ignore"):
            full: np.ndarray = (force <= low) | (force >= high)
        return full

    def jumps(self, pair: Pair, apart: float = 0.0) -> bool:
        """Return whether forces of actuators that jump between bounds move a run at its end."""
        return bool(self.jumping(pair, apart)[1].any())

    def jumping(self, pair: Pair, apart: float = 0.0) -> tuple[Floats, np.ndarray]:
        """Return how much forces of actuators change at the end of a run, and which of them jump.

        A force jumps if it changes by a quarter of its span from sample to sample, or from call to
        call of a user's function, and is often at an end of its span. The force of a spring that
        swings without a damper changes as much, but has no bound.

        apart: the least time between samples [s].
        """
        if self.rests(pair) or pair.ran is None or len(pair.times) < 2:
            return np.zeros(self.driven.nu), np.zeros(self.driven.nu, bool)
        force, between = pair.ran["actuator_force"][0], max(self.period or 0.0, apart)
        late = force[pair.late][:: max(1, round(between / pair.times[1]))]
        changes = np.abs(np.diff(late, axis=0)).sum(axis=0) / max(1, len(late) - 1)
        low, high, span = force.min(axis=0), force.max(axis=0), np.ptp(force, axis=0)
        bound = np.minimum(late - low, high - late) <= np.finfo(float).eps * span
        return changes, (changes > span / 4) & _often(bound)

    def presses(self, pair: Pair) -> bool:
        """Return whether a run still moves at its end, where actuators saturate."""
        if self.rests(pair) or pair.ran is None:
            return False
        return bool(self.ends(pair.ran["actuator_force"][0, pair.late]).any())

    def rests(self, pair: Pair) -> bool:
        """Return whether a run fails, or comes to rest: near its end it is slow throughout."""
        return bool(pair.failure) or bool(pair.energy[pair.late].max() < self.floor / GROWN**2)

    def changed(self, change: Change) -> Motions:
        model = change.of(self.model)
        return Motions(model, self.schedule, self.size, self.wanted, self.period)

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
        wanted = min(steps or self.steps(dt), self.most)
        # The stride is odd, so that samples show a force that jumps from step to step.
        every = max(1, wanted // samples) | 1
        count = every * math.ceil(wanted / every)
        names = ("qpos", "qvel", "act", "ctrl", "energy", "actuator_force")
        try:
            model = self.of(change).with_settings(dt=dt, **dict(change.settings))
            how = self._driven(dt, count, loop)
            far, runs = FAR * (self.size + (count * dt) ** 2), list[Followed]()
            for start in self.starts:
                # Run one by one: two worlds in lanes take more time, and one failure is enough.
                ran = follow(model, [start], count, every, record=names, bound=far, **how)
                runs.append(ran)
                if ran.failures:
                    break
        except ControlError:
            raise
        except (SimulationError, ValueError, ArithmeticError) as error:
            nothing = np.full(1, np.nan)
            return Pair(dt, np.zeros(1), nothing, nothing, nothing, one_line(error), 0.0, None)
        with np.errstate(all="ignore"):
            difference = np.abs(runs[0]["qvel"][0] - runs[-1]["qvel"][0])
            apart = (self.weights * difference).max(axis=-1)
            energies = np.array([ran["energy"][0] for ran in runs])
            kinetic, total = energies[..., 0].max(axis=0), energies.sum(axis=-1)
            gained = (total - total[:, :1]).max(axis=0)
        ended = ran.failures.get(0)
        reached = float(ran.times[-1]) if ended is None else float(ended.time)
        # The text of the error itself would need an analysis of the last steps.
        why = "" if ended is None else f"diverged in step {ended.step} at {seconds(reached)}"
        return Pair(dt, ran.times, apart, kinetic, gained, why, reached, runs[0])

    def _driven(self, dt: float, count: int, loop: Loop | None) -> dict[str, Any]:
        if self.users is None:
            steps = min(count, max(1, math.ceil(self.horizon / dt * (1 - 1e-9))))
            rows, held = self.schedule.controls.rows([0], dt, steps)
            # The motion ends with its horizon, even if a table is longer.
            return {"ctrl": rows if rows is None else rows[:, : -(-steps // held)], "hold": held}
        loop = loop or Loop()
        period = self.period if loop.period is None else loop.period
        hold = 1 if period is None else max(1, round(period / dt))
        usual = self.usual or (1.0, None)
        end = self.horizon - self.model.settings.dt
        how = UntilTheEnd(self.users, max(end, 0.0), loop.gain, loop.frozen, usual[1], usual[0])
        how.__dict__["__wrapped__"] = self.users
        return {"control": how, "hold": hold}

    def falling(self, dt: float) -> float:
        """Return the kinetic energy that gravity gives all bodies in one step [J].

        Bodies at rest gain this much in a step before a contact can hold them.
        """
        if not self.model.scene.features.gravity:
            return 0.0
        gravity = float(np.square(self.model.scene.gravity).sum())
        return 0.5 * float(np.sum(self.model.body_mass)) * gravity * dt**2


def _often(mask: np.ndarray) -> np.ndarray:
    often: np.ndarray = mask.mean(axis=0) > 0.1
    return often


def _counted(sim: Sim) -> float:
    try:
        return OVERHEAD + sim.count_flops()
    except (SimulationError, ValueError):
        return OVERHEAD


@dataclass
class Judge:
    """The converged motion of a model, and the outcomes of other runs compared with it.

    motions: the runs. fine: the converged pair. confirmed: whether two steps agreed. long: a longer
    converged pair, if other runs fail later. runaway: how the motion blows up by itself.
    loop: how the converged motion samples a user's control; None if as the other runs do.
    """

    motions: Motions
    fine: Pair
    confirmed: bool
    long: Pair | None = None
    runaway: Runaway | None = None
    loop: Loop | None = None
    _known: dict[tuple[Change, float, Loop | None], Outcome] = field(default_factory=dict)
    _lasting: set[tuple[Change, float, Loop | None]] = field(default_factory=set)

    @classmethod
    def of(cls, motions: Motions, dt: float, loop: Loop | None = None) -> Judge:
        """Return the judge of a motion, whose converged run has a step of at most `dt` [s]."""
        runs, floor = list[Pair](), motions.floor
        for part in FINER:
            if runs and part * dt * motions.most < runs[-1].reached / 2 and not runs[-1].failure:
                break
            runs.append(motions.pair(FINE, part * dt, loop=loop, samples=LEAST))
            motions.count(runs[-1])
            alike = len(runs) > 1 and motions.jumps(runs[-2]) == motions.jumps(runs[-1])
            if alike and _same(runs[-2], runs[-1], floor):
                longer = max(runs[-2:], key=lambda run: round(run.reached, 9))
                return cls(motions, longer, True, loop=loop)._ended()
        usable = [run for run in runs if math.isinf(run.blows_up(floor))]
        judge = cls(motions, (usable or runs)[-1], False, loop=loop)
        if len(runs) > 1:
            judge.runaway = _runaway(runs[-2], runs[-1], floor)
            judge.fine = judge.fine if judge.runaway is None else runs[-1]
        return judge

    @classmethod
    def calm(cls, motions: Motions, dt: float) -> Judge:
        """Return the judge of a motion, without its control period if that makes it flutter."""
        own = cls.of(motions, dt)
        if motions.period is None or motions.users is None:
            return own
        closed = cls.of(motions, dt, Loop(period=0.0))
        if closed.runaway is not None:
            return own
        most = LARGE * max(float(np.nanmax(closed.fine.energy)), motions.floor)
        flutters = own.runaway is not None or float(np.nanmax(own.fine.energy)) > most
        flutters |= motions.jumps(own.fine) and not motions.jumps(closed.fine)
        return closed if flutters else own

    def _ended(self) -> Judge:
        """Extend a motion that grows at its end, until it is calm or blows up by itself."""
        motions, run, steps = self.motions, self.fine, round(self.fine.reached / self.fine.dt)
        while run.grows() and LONGER * steps <= motions.most:
            steps *= LONGER
            run = motions.pair(FINE, run.dt, steps, self.loop, LEAST)
            if math.isfinite(run.blows_up(motions.floor)):
                break
            self.long = run
        while math.isfinite(run.blows_up(motions.floor)) and 2 * steps <= motions.most:
            steps *= 2
            finer = motions.pair(FINE, run.dt / 2, steps, self.loop, LEAST)
            self.runaway = _runaway(run, finer, motions.floor)
            if self.runaway is None or self.runaway.alike:
                break
            run = finer
        return self

    def outcome(self, change: Change, dt: float, loop: Loop | None = None) -> Outcome:
        """Return the outcome of a step under a change; each is run once."""
        # Steps that differ by rounding are one: a chaotic motion may be stable at only one of them.
        key = change, float(f"{dt:.12g}"), loop
        if key not in self._known:
            pair = self.motions.pair(change, dt, loop=loop)
            found = self._longer(self.judged(pair), pair)
            gains = found.holds and found.energy > SAME * max(found.early, SAME)
            unclear = found.brief or found.growth < self.clear
            if gains or (found.kind == "grows" and unclear):
                # Growth without end goes on; the effects of contacts die out.
                pair = self.motions.pair(change, dt, LONGER * self.motions.steps(dt), loop)
                self._cover(float(pair.times[-1]))
                longer = self.judged(pair)
                if gains and longer.holds and longer.energy > SAME * max(found.energy, SAME):
                    longer = replace(longer, kind="gains energy")
                found = longer
            if found.holds and self._chatters(change, loop, pair):
                found = replace(found, kind="chatters")
            self._known[key] = found
        return self._known[key]

    def lasts(self, change: Change, dt: float, loop: Loop | None = None) -> bool:
        """Return whether a step is stable; for a sensitive motion, in a longer run as well.

        Steps of a sensitive motion hold by luck. A longer run that fails replaces the outcome.
        """
        key = change, float(f"{dt:.12g}"), loop
        if self.outcome(change, dt, loop).holds and key not in self._lasting:
            self._lasting.add(key)
            if self.sensitive and self.motions.cheap(dt):
                pair = self.motions.pair(change, dt, LONGER * self.motions.steps(dt), loop)
                found = self._longer(self.judged(pair), pair)
                self._known[key] = self._known[key] if found.holds else found
        return self._known[key].holds

    @property
    def sensitive(self) -> bool:
        """Whether perturbations grow by orders of magnitude in the converged motion."""
        apart = self.fine.apart
        return float(np.nanmax(apart)) > GROWN**2 * float(apart[0])

    def tried(self, change: Change) -> dict[float, bool]:
        """Return the steps that were run under a change, and whether each is stable."""
        known = self._known.items()
        return {dt: found.holds for (own, dt, loop), found in known if own == change and not loop}

    def _longer(self, found: Outcome, pair: Pair) -> Outcome:
        """Judge a run that fails after the end of the converged motion again, with a longer one."""
        known = (self.long or self.fine).times[-1]
        late = found.kind in ("gains energy", "grows") and found.time > known
        return self.judged(pair) if late and self._cover(found.time) else found

    def _cover(self, time: float) -> bool:
        """Extend the converged motion to a time [s], within `WORK`; return whether it is longer."""
        dt, known = self.fine.dt, self.long or self.fine
        steps = min(math.ceil(1.1 * time / dt), self.motions.most)
        if steps <= 1.05 * known.times[-1] / dt:
            return False
        longer = self.motions.pair(FINE, dt, steps, self.loop, LEAST)
        if not longer.failure:
            self.long = longer
        return not longer.failure

    def usual(self, name: str, times: Floats) -> Floats:
        """Return the largest `energy` or `apart` of the converged motion up to some times."""
        fine, long = self.fine, self.long
        known = continued(fine.times, getattr(fine, name), times)
        if long is not None:
            # Its samples may be far apart: each counts from the one before.
            later = times > fine.times[-1]
            ahead = times[later] + long.times[1]
            known[later] = np.maximum(
                np.nanmax(getattr(fine, name)), continued(long.times, getattr(long, name), ahead)
            )
        return known

    @property
    def clear(self) -> float:
        """The growth from which no longer run is needed: more if the motion itself grows."""
        apart = self.fine.apart
        return max(GROWN**2, GROWN * float(np.nanmax(apart)) / max(float(apart[0]), 1e-300))

    def judged(self, pair: Pair) -> Outcome:
        if pair.failure:
            return Outcome("diverges", pair.reached, math.inf, math.inf)
        times, usual = pair.times, self.usual("energy", pair.times)
        least = max(self.motions.floor, 4 * self.motions.falling(pair.dt))
        with np.errstate(all="ignore"):
            known = self.usual("apart", times)
            # If the converged pair has grown apart by then, a body may fall earlier: there only a
            # gain of total energy counts.
            lost = known > GROWN**2 * self.fine.apart[0]
            energy = np.where(lost, np.minimum(pair.energy, pair.gained), pair.energy)
            energy /= np.maximum(usual, least)
            growth = pair.apart / known
        # NaN: two runs that stay equal, or a motion whose growth has no bound.
        growth[np.isnan(growth)] = 0.0
        late, most = float(growth[pair.late].max()), float(energy.max())
        over = times[energy > LARGE]
        if len(over):
            return Outcome("gains energy", float(over[0]), most, late)
        if late > GROWN:
            wide = growth > GROWN
            # Two runs that pass a kink in different steps differ for a moment.
            brief = not all(half.any() for half in np.array_split(wide[pair.late], 2))
            return Outcome("grows", float(times[wide][0]), most, late, brief=brief)
        early = float(energy[times <= 0.5 * times[-1]].max())
        return Outcome("holds", pair.reached, most, late, early)

    def _chatters(self, change: Change, loop: Loop | None, pair: Pair) -> bool:
        """Return whether forces of actuators keep a run moving, unlike the converged motion.

        They jump, or saturate where the converged motion rests, for as long as the motion took.
        """
        motions, dt = self.motions, pair.dt
        steps = math.ceil(2 * motions.horizon / dt)
        if (motions.jumps(pair) or motions.presses(pair)) and steps > motions.steps(dt):
            pair = motions.pair(change, dt, steps, loop)
        (changes, jumping), presses = motions.jumping(pair), motions.presses(pair)
        if not (jumping.any() or presses):
            return False
        self._cover(float(pair.times[-1]))
        known = self.long or self.fine
        usual, jumped = motions.jumping(known, float(pair.times[1]))
        # An undamped servo that saturates swings between its bounds in the converged motion, too.
        if not jumped.any() and (jumping & (changes > SAME * usual)).any():
            return True
        calm = known.times >= CALM * min(known.times[-1], pair.times[-1])
        return float(pair.energy[pair.late].min()) > GROWN * float(known.energy[calm].max())


def _runaway(coarse: Pair, fine: Pair, floor: float) -> Runaway | None:
    times = coarse.blows_up(floor), fine.blows_up(floor)
    return Runaway(times, (coarse.dt, fine.dt)) if math.isfinite(max(times)) else None


def _same(coarse: Pair, fine: Pair, floor: float) -> bool:
    if not math.isinf(min(coarse.blows_up(floor), fine.blows_up(floor))):
        return False
    until = min(coarse.reached, fine.reached) * (1 + 1e-9)

    def peaks(name: str) -> list[float]:
        return [float(getattr(run, name)[run.times <= until].max()) for run in (coarse, fine)]

    energies, apart = [max(peak, floor) for peak in peaks("energy")], peaks("apart")
    return max(energies) <= SAME * min(energies) and max(apart) <= ALIKE * min(apart)
