"""Run the motion with the real step of an integrator, and record energies and force jumps.

A linearised step decides where a state is steady. It does not show a servo at the end of its force
range, a rotation that turns the state within a few steps, or growth that adds up slowly. In these
cases `Runner.follow` runs the motion with the step in question, and a probe observes:

- its kinetic energy, evenly sampled;
- at every sample, over a few single steps, whether a servo's force jumps from one end of its force
  range to the other within a step.

The budget is in steps, so that the result is the same on every machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.control import ControlError
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.start import Start
from stepcore.experiment.controls import ControlLog, Controls
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.passage import Passage, Passages
from stepcore.experiment.run import Probe
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import SPEED, SPIN, Schedule
from stepcore.measure.diagnosis.control import steps_held
from stepcore.measure.diagnosis.linear_step import State, state_now

# Samples of a run, its most and least budget in steps (a longer run is cut short), and the number
# of dofs above which the budget falls: a step's cost grows with about their square.
SAMPLES, MOST, LEAST, DOFS_AT_MOST = 200, 20_000, 2_000, 8
# Steps that are observed one by one at each sample. Two would miss a cycle of four steps, in which
# a force goes from end to end in every other step.
SINGLE = 4
# The fewest steps that make a run.
FEWEST = 8
# The most steps of a run from a state, and the divisor of the step when a growing run is repeated.
STEPS, SHORTER = 500, 4
# A push of every dof, with alternating signs [m/s or rad/s].
PUSH = 1e-3
# A speed belongs to the motion itself if shorter steps reach this fraction of it.
PART = 0.1


class _Ended(Exception):
    """Raised to end a run early."""


@dataclass(frozen=True)
class MotionRun:
    """The observations of one run of the real step.

    integrator: the integrator.
    dt: its step [s].
    reached: the time that the run reached [s].
    finite: whether the run stayed finite.
    peak: the largest kinetic energy [J].
    gained: the largest rise of the total energy above its start, at the samples [J].
    times: the times of the samples [s].
    energies: the kinetic energies of the samples [J].
    jumps: for each actuator, the share of the steps in the later half of the run in which its force
        went from one end of its range to the other.
    swings: the same share over the whole run.
    saturated: for each actuator, whether its force ever was at an end.
    speeds: the largest |qvel| observed, shape (nv,).
    passages: the geoms that passed through another one, with the time of the sample [s].
    calm: the state at the last sample whose energy was within the bound.
    """

    integrator: str
    dt: float
    reached: float
    finite: bool
    peak: float
    gained: float
    times: Floats = field(repr=False)
    energies: Floats = field(repr=False)
    jumps: Floats = field(repr=False)
    swings: Floats = field(repr=False)
    saturated: Any = field(repr=False)
    speeds: Floats = field(repr=False)
    passages: dict[Passage, float] = field(repr=False)
    calm: State | None = field(repr=False)


@dataclass(frozen=True)
class MotionRuns:
    """A motion, ready to run with the step of any integrator.

    model: the model.
    schedule: the start and the controls of the motion.
    horizon: the length of the motion [s].
    """

    model: Model
    schedule: Schedule
    horizon: float

    def run(
        self,
        integrator: str,
        dt: float,
        *,
        horizon: float | None = None,
        beyond: float = math.inf,
        kick: Floats | None = None,
    ) -> MotionRun:
        """Return the run of the motion at a step.

        integrator, dt: the integrator and its step [s].
        horizon: a length [s] in place of the motion's.
        beyond: a kinetic energy at which the run ends [J].
        kick: velocities to add at the start, shape (nv,).
        """
        count = round((self.horizon if horizon is None else horizon) / dt)
        count = min(max(count, FEWEST), self.most)
        schedule = self.schedule
        if kick is not None:
            kicked = replace(self.start, qvel=self.start.qvel + kick)
            schedule = replace(schedule, starts=(kicked,))
        runner = Runner(self.model, schedule)
        sim = runner.sim(self.model.settings.replace(integrator=integrator, dt=dt, ledger=False))
        watch, finite = _Watch(sim, count, beyond), True
        try:
            runner.follow(sim, 0, [watch], steps=count)
        except _Ended:
            pass
        except ControlError:
            raise
        except (SimulationError, ValueError):
            # Controls that are not finite follow from a motion that is not finite.
            finite = False
        return watch.run(finite)

    @property
    def most(self) -> int:
        """The most steps of a run."""
        if self.schedule.calls_user:
            # Each step calls the user's function.
            return LEAST
        return max(LEAST, min(MOST, round(MOST * (DOFS_AT_MOST / self.model.nv) ** 2)))

    @property
    def start(self) -> Start:
        """The first state of the motion."""
        return self.schedule.starts[0]

    def falling_energy(self, dt: float) -> float:
        """Return the kinetic energy [J] that gravity gives falling bodies in one step of dt [s].

        A step moves bodies at rest by so much before a contact can hold them. A tree whose base is
        fixed and whose joints are driven does not fall.
        """
        model, scene = self.model, self.model.scene
        if not scene.features.gravity:
            return 0.0
        bodies = model.jnt_body.tolist()
        free = {
            model.root(body)
            for body, kind in zip(bodies, model.jnt_type, strict=True)
            if kind == "free"
        }
        joints = [joint for joint in model.actuator_joint.tolist() if joint >= 0]
        held = {model.root(bodies[joint]) for joint in joints} - free
        falling = [b for b in Coordinates(model).moving if model.root(int(b)) not in held]
        speed = float(np.linalg.norm(scene.gravity)) * dt
        return 0.5 * float(np.sum(model.body_mass[falling])) * speed**2

    def least_energy(self) -> float:
        """Return the kinetic energy [J] of a slow motion of every dof; less is no explosion."""
        sim = unwatched(Sim(self.model))
        sim.qpos[:] = self.start.qpos
        slow = Coordinates(self.model).scaled(np.ones(self.model.nv), SPEED, SPIN)
        return 0.5 * float(slow**2 @ np.diag(np.array(sim.mass_matrix())))


class _Watch(Probe):
    """A probe of a run of `count` steps that ends when its energy exceeds `bound` [J].

    edges: the steps at which samples are taken.
    """

    def __init__(self, sim: Sim, count: int, bound: float) -> None:
        self.sim, self.bound, self.done = sim, bound, 0
        samples = min(SAMPLES, max(1, count // 2))
        self.edges = np.linspace(0, count, samples + 1).round().astype(int).tolist()
        self.ends = _ends(sim.model)
        self.saturated = np.zeros(sim.model.nu, bool)
        self.times: list[float] = []
        self.energies: list[float] = []
        self.totals: list[float] = []
        self.seen: list[Any] = []
        self.calm: State | None = None
        # The largest energy in this sample, and the ends at which the forces were one step before.
        self.energy: float = 0.0
        self.before: Any = None
        # Single steps are observed after this step.
        self.looks = 0

    def begin(self, sim: Sim) -> None:
        self.speeds = np.abs(np.array(sim.qvel))
        self.passages = Passages(sim)
        self._sample(_energy(sim))

    def stop(self, done: int, steps: int) -> int:
        return min(steps, done + max(1, self.looks - self.done))

    def step(self, sim: Sim) -> None:
        self.done = round(sim.time / sim.settings.dt)
        if self.done <= self.looks:
            # A control period ended between two samples.
            return
        self.energy = max(self.energy, _energy(sim))
        np.maximum(self.speeds, np.abs(sim.qvel), out=self.speeds)
        if self.ends is not None:
            low, high = self.ends
            force = np.array(sim.actuator_force)
            end = (force >= high).astype(int) - (force <= low)
            self.saturated |= end != 0
            if self.before is not None:
                self.seen.append(end * self.before < 0)
            self.before = end
        if self.done == self.edges[len(self.times)]:
            self._sample(self.energy)

    def _sample(self, energy: float) -> None:
        """End a sample and begin the next one."""
        sim = self.sim
        self.times.append(self.done * sim.settings.dt)
        self.energies.append(energy)
        self.totals.append(float(sim.energy.total))
        self.passages.observe(sim)
        if energy > self.bound:
            raise _Ended
        self.calm = state_now(sim, "", self.times[-1])
        self.energy, self.before = 0.0, None
        following = self.edges[min(len(self.times), len(self.edges) - 1)]
        self.looks = max(following - SINGLE, self.done)

    def run(self, finite: bool) -> MotionRun:
        """Return the observations."""
        settings, nothing = self.sim.settings, np.zeros(self.sim.model.nu)
        later = self.seen[len(self.seen) // 2 :]
        return MotionRun(
            integrator=settings.integrator,
            dt=settings.dt,
            reached=self.done * settings.dt,
            finite=finite,
            peak=max(self.energies),
            gained=max(self.totals) - self.totals[0],
            times=np.array(self.times),
            energies=np.array(self.energies),
            jumps=np.mean(later, axis=0) if later else nothing,
            swings=np.mean(self.seen, axis=0) if later else nothing,
            saturated=self.saturated,
            speeds=self.speeds,
            passages={pair: at.time for pair, at in self.passages.found.items()},
            calm=self.calm,
        )


def _ends(model: Model) -> tuple[Floats, Floats] | None:
    """Return the ends of the actuators' force ranges, shape (nu,) each, or None without ranges."""
    if not model.nu or not model.scene.features.actuation:
        return None
    low, high = np.array(model.actuator_forcerange).reshape(-1, 2).T
    return (low, high) if bool(np.isfinite(low).any() or np.isfinite(high).any()) else None


def _energy(sim: Sim) -> float:
    energy = float(sim.energy.kinetic)
    return energy if math.isfinite(energy) else math.inf


# --- runs from a state ----------------------------------------------------------------------------


def stays_bounded(model: Model, state: State, integrator: str, dt: float, horizon: float) -> bool:
    """Return whether a slightly pushed run from a state reaches no speed that shorter steps do not.

    integrator, dt: the integrator and its step [s].
    horizon: the time of the run [s], at most `STEPS` steps.
    """
    count = max(1, min(STEPS, round(horizon / dt)))
    push = PUSH * np.where(np.arange(model.nv) % 2, -1.0, 1.0)
    first = np.abs(state.qvel).max(initial=PUSH)
    speeds = largest_speeds(model, state, integrator, dt, count, push)
    if speeds is None:
        return False
    if PART * speeds.max() <= first:
        return True
    finer = largest_speeds(model, state, integrator, dt / SHORTER, count * SHORTER, push)
    # If shorter steps fail as well, they show nothing about this step.
    return finer is None or bool(PART * speeds.max() <= finer.max())


def largest_speeds(
    model: Model, state: State, integrator: str, dt: float, count: int, push: Floats
) -> Floats | None:
    """Return the largest |qvel| of each dof in a run from a pushed state, or None if not finite.

    Controls are constant, or those of the state's control function.

    integrator, dt: the integrator and its step [s].
    count: the number of steps.
    push: velocities to add at the start, shape (nv,).
    """
    start = Start(state.qpos, state.qvel + push, state.act if len(state.act) else None)
    control = None if state.feedback is None else state.feedback.function
    period, controls = count * dt, Controls(ControlLog(np.zeros(1), state.ctrl[None]))
    if control is not None:
        period, controls = steps_held(state, dt)[0] * dt, Controls(function=control)
    schedule = Schedule(period, 1, 1, (start,), controls)
    runner, fastest = Runner(model, schedule), _Fastest(model.nv)
    sim = runner.sim(model.settings.replace(integrator=integrator, dt=dt))
    try:
        runner.follow(sim, 0, [fastest], steps=count)
    except (SimulationError, ValueError):
        return None
    return fastest.speeds


class _Fastest(Probe):
    """A probe of the largest |qvel| after any step."""

    def __init__(self, nv: int) -> None:
        self.speeds = np.zeros(nv)

    def stride(self, steps: int) -> int:
        return 1

    def step(self, sim: Sim) -> None:
        np.maximum(self.speeds, np.abs(sim.qvel), out=self.speeds)
