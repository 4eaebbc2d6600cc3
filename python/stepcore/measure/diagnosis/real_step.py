"""The motion itself on the real step: what a step of an integrator does over the horizon.

A linearised step decides where a state stays what it is. It says nothing of a servo at the end of
its force range, of a rotation that turns the state within a few steps, or of growth that adds up
slowly. There the motion is run with the step in question and compared with a run at a fine step:

- it explodes if it does not stay finite, or if its kinetic energy exceeds `EXPLODED` times the
  largest of the fine run;
- it chatters if a servo's force jumps from one end of its force range to the other within a step,
  again and again, where the fine run's does not.

The budget is in steps, so that the answer is the same on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.control import ControlError, controls, fresh
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.coordinates import Start
from stepcore.experiment.schedule import SPEED, SPIN, Schedule
from stepcore.measure.diagnosis.linear_step import State, state_now
from stepcore.scene.layout import DOFS

# Kinetic energy over the largest of the fine run that counts as an explosion.
EXPLODED = 10.0
# Samples of a run, its steps at most and at least (a longer run is cut short), and the dofs from
# which a run has fewer: a step takes about the square of them.
SAMPLES, MOST, LEAST, DOFS_AT_MOST = 200, 20_000, 2_000, 8
# A force chatters that goes from one end of its range to the other in so many of the steps (every
# other one in a cycle of four). Of every sample so many steps are looked at one by one: two would
# miss such a cycle.
CHATTER, SINGLE = 0.3, 4
# The fewest steps that make a run.
FEWEST = 8


@dataclass(frozen=True)
class RealRun:
    """What a run of the real step did.

    integrator; dt [s]. reached [s]: how far it came; finite: whether it stayed finite. peak [J]:
    its largest kinetic energy. times [s], energies [J]: of its samples. jumps: of each
    actuator, the share of the steps in the later half in which its force went from one end of its
    range to the other; swings: the same of the whole run. saturated: of each actuator,
    whether its force ever was at an end. speeds: the largest |qvel| seen, shape (nv,).
    calm: the state at the last sample whose energy was within the bound.
    """

    integrator: str
    dt: float
    reached: float
    finite: bool
    peak: float
    times: Floats = field(repr=False)
    energies: Floats = field(repr=False)
    jumps: Floats = field(repr=False)
    swings: Floats = field(repr=False)
    saturated: Any = field(repr=False)
    speeds: Floats = field(repr=False)
    calm: State | None = field(repr=False)


@dataclass(frozen=True)
class RealStep:
    """A motion, ready to be run with the step of any integrator.

    schedule: its start and controls. horizon [s]: how long.
    """

    model: Model
    schedule: Schedule
    horizon: float

    def of(self, model: Model) -> RealStep:
        """The same motion of another model, with a change made."""
        return RealStep(model, self.schedule, self.horizon)

    def run(
        self,
        integrator: str,
        dt: float,
        *,
        horizon: float | None = None,
        beyond: float = math.inf,
        kick: Floats | None = None,
    ) -> RealRun:
        """The motion at this step.

        horizon [s]: in place of the motion's. beyond [J]: a kinetic energy at which the run ends.
        kick: added to the velocities at the start, shape (nv,).
        """
        count = round((self.horizon if horizon is None else horizon) / dt)
        count = min(max(count, FEWEST), self.most)
        model = self.model.with_settings(integrator=integrator, dt=dt, ledger=False)
        sim = unwatched(Sim(model))
        return _Run(sim, self.schedule, count, beyond, kick).made()

    @property
    def most(self) -> int:
        """The most steps of a run."""
        if self.schedule.control is not None:
            # Each step asks the user's function.
            return LEAST
        return max(LEAST, min(MOST, round(MOST * (DOFS_AT_MOST / self.model.nv) ** 2)))

    @property
    def start(self) -> Start:
        """Where the motion begins."""
        return self.schedule.starts[0]

    def least_energy(self) -> float:
        """The kinetic energy [J] of a slow motion of every dof: less is no explosion."""
        model = self.model
        sim = unwatched(Sim(model))
        sim.qpos[:] = self.start.qpos
        slow = np.full(model.nv, SPIN)
        for kind, first in zip(model.jnt_type, model.jnt_dofadr.tolist(), strict=True):
            along = {"free": 3, "slide": 1}.get(kind, 0)
            slow[first : first + min(along, DOFS[kind])] = SPEED
        return 0.5 * float(slow**2 @ np.diag(np.array(sim.mass_matrix())))


class _Run:
    """One run, sampled evenly; at every sample some steps are looked at one by one."""

    def __init__(
        self, sim: Sim, schedule: Schedule, count: int, beyond: float, kick: Floats | None
    ) -> None:
        self.sim, self.schedule, self.count, self.bound = sim, schedule, count, beyond
        first = schedule.starts[0]
        sim.qpos[:], sim.qvel[:] = first.qpos, first.qvel
        if first.act is not None:
            sim.act[:] = first.act
        # What the user's control object remembers belongs to this run.
        self.control = None if schedule.control is None else fresh(schedule.control)
        if kick is not None:
            sim.qvel[:] += kick
        self.times: list[float] = []
        self.energies: list[float] = []
        self.speeds = np.abs(np.array(sim.qvel))
        self.ends = _ends(sim.model)
        self.saturated = np.zeros(sim.model.nu, bool)
        self.seen: list[Any] = []
        self.last = -1
        self.done = 0
        self.calm: State | None = None

    def made(self) -> RealRun:
        """Runs to the end, or to where it explodes."""
        sim, finite = self.sim, True
        self._noted(self._energy())
        try:
            for block in _blocks(self.count):
                if not self._step(block):
                    break
        except ControlError:
            raise
        except (SimulationError, ValueError):
            # Controls that are not finite belong to a motion that no longer is.
            finite = False
        later = self.seen[len(self.seen) // 2 :]
        return RealRun(
            sim.settings.integrator,
            sim.settings.dt,
            self.done * sim.settings.dt,
            finite,
            max(self.energies),
            np.array(self.times),
            np.array(self.energies),
            np.mean(later, axis=0) if later else np.zeros(sim.model.nu),
            np.mean(self.seen, axis=0) if later else np.zeros(sim.model.nu),
            self.saturated,
            self.speeds,
            self.calm,
        )

    def _step(self, count: int) -> bool:
        """Takes some steps, the last ones one by one; False where the run need not go on."""
        single = min(SINGLE, count)
        self._controlled(count - single)
        energy, before = 0.0, None
        for _ in range(single):
            self._controlled(1)
            energy = max(energy, self._energy())
            np.maximum(self.speeds, np.abs(self.sim.qvel), out=self.speeds)
            if self.ends is None:
                continue
            end = self._end()
            self.saturated |= end != 0
            if before is not None:
                self.seen.append(end * before < 0)
            before = end
        return self._noted(energy)

    def _controlled(self, count: int) -> None:
        """Steps, with the controls set wherever a period begins."""
        sim, schedule = self.sim, self.schedule
        if not sim.model.nu:
            self._advance(count)
            return
        dt, period = sim.settings.dt, schedule.period
        while count > 0:
            index = int(self.done * dt / period + 1e-9)
            if index != self.last:
                self.last = index
                if self.control is not None:
                    sim.ctrl = controls(self.control, sim)
                elif schedule.ctrl is not None:
                    sim.ctrl[:] = schedule.ctrl[0, min(index, schedule.periods - 1)]
            following = math.ceil((index + 1) * period / dt - 1e-9)
            block = min(count, max(1, following - self.done))
            self._advance(block)
            count -= block

    def _advance(self, count: int) -> None:
        if count:
            self.sim.step(count)
            self.done += count

    def _end(self) -> Any:
        """Of each actuator's force: 1 at the upper end of its range, -1 at the lower, else 0."""
        low, high = self.ends  # type: ignore[misc]
        force = np.array(self.sim.actuator_force)
        return (force >= high).astype(int) - (force <= low)

    def _energy(self) -> float:
        energy = float(self.sim.energy.kinetic)
        return energy if math.isfinite(energy) else math.inf

    def _noted(self, energy: float) -> bool:
        """Notes a sample; False where the run need not go on."""
        sim = self.sim
        self.times.append(self.done * sim.settings.dt)
        self.energies.append(energy)
        if energy > self.bound:
            return False
        self.calm = state_now(sim, "", self.times[-1])
        return True


def _blocks(count: int) -> Iterator[int]:
    """The steps of each sample: together `count`, and as even as can be."""
    samples = min(SAMPLES, max(1, count // 2))
    edges = np.linspace(0, count, samples + 1).round().astype(int)
    return (int(b - a) for a, b in pairwise(edges) if b > a)


def _ends(model: Model) -> tuple[Floats, Floats] | None:
    """The ends of the actuators' force ranges, each shape (nu,); None where none has any."""
    if not model.nu or not model.scene.features.actuation:
        return None
    low, high = np.array(model.actuator_forcerange).reshape(-1, 2).T
    return (low, high) if bool(np.isfinite(low).any() or np.isfinite(high).any()) else None
