"""The probes that fill a `Run`: `Recorder` fills all fields, `Positions` and `Means` some.

A search makes hundreds of runs with `Positions`; the errors in a table come from `Recorder`.
"""

from __future__ import annotations

import numpy as np

from stepcore.engine.sim import Sim, touches
from stepcore.experiment.bodies import Bodies
from stepcore.experiment.friction import Slips
from stepcore.experiment.run import Probe, Run
from stepcore.experiment.schedule import Schedule

# The largest number of recorded states in a period and in a run. The limit for a run is four times
# larger if the work of actuators and dampers is integrated over the states.
STATES, ALL_STATES = 32, 1000
# The largest number of observations of the contacts in a period and in a run.
CONTACTS, ALL_CONTACTS = 8, 500


class Positions(Probe):
    """A probe that records the poses of the bodies at the samples, and nothing else."""

    def __init__(self, bodies: Bodies) -> None:
        self.bodies = bodies
        self.xpos: list[np.ndarray] = []
        self.xquat: list[np.ndarray] = []

    def sample(self, sim: Sim) -> None:
        self.xpos.append(sim.xpos[self.bodies.moving])
        self.xquat.append(sim.xquat[self.bodies.moving])

    def end(self, sim: Sim, run: Run) -> None:
        self.place(run)

    def place(self, run: Run) -> None:
        """Write the recorded poses into a run."""
        run.quat, run.gyration = np.array(self.xquat), self.bodies.gyration
        with np.errstate(over="ignore", invalid="ignore"):
            run.com = self.bodies.centres(np.array(self.xpos), run.quat)


class Means(Probe):
    """A probe that records heights, kinetic energies and touching contacts at the samples."""

    def __init__(self, bodies: Bodies) -> None:
        self.bodies, self.meets = bodies, bodies.model.npair > 0
        self.qpos: list[np.ndarray] = []
        self.qvel: list[np.ndarray] = []
        self.touching: list[int] = []

    def sample(self, sim: Sim) -> None:
        self.qpos.append(np.array(sim.qpos))
        self.qvel.append(np.array(sim.qvel))
        self.touching.append(_touching(touches(sim)[1]) if self.meets else 0)

    def end(self, sim: Sim, run: Run) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            seen = self.bodies.states(np.array(self.qpos), np.array(self.qvel))
            run.height = self.bodies.height(seen.com)
        run.com, run.kinetic, run.touching = seen.com, seen.kinetic, np.array(self.touching)


class Recorder(Probe):
    """A probe that records all fields of a `Run`.

    States are recorded every few steps, contacts less often, and slips at the samples.
    """

    def __init__(self, bodies: Bodies, schedule: Schedule) -> None:
        self.bodies, self.schedule = bodies, schedule
        self.qpos: list[np.ndarray] = []
        self.qvel: list[np.ndarray] = []
        self.act: list[np.ndarray] = []
        self.ctrl: list[np.ndarray] = []
        self.samples: list[int] = []
        self.slips: list[Slips] = []
        self.touching: list[int] = []
        self.meets = bodies.model.npair > 0
        self.works = bool(bodies.model.nu) or any(
            np.any(j.damping) for j in bodies.model.scene.joints
        )
        self.grounded = False
        self.overlap = self.residual = 0.0

    def stride(self, steps: int) -> int:
        most = ALL_STATES * (4 if self.works else 1) // self.schedule.periods
        return max(1, steps // min(STATES, max(1, most)))

    def begin(self, sim: Sim) -> None:
        steps = self.schedule.steps(sim.settings.dt)
        states = max(1, steps // self.stride(steps))
        looks = ALL_CONTACTS / self.schedule.periods
        self.often = max(1, round(states / min(CONTACTS, looks)))
        self.calls = 0
        self.updates, self.rowless = sim.row_updates, sim.settings.law != "penalty"
        self._state(sim)

    def step(self, sim: Sim) -> None:
        self._state(sim)
        self.ctrl.append(np.array(sim.ctrl))
        if self.calls % self.often == 0:
            self._contacts(sim)
        self.calls += 1

    def sample(self, sim: Sim) -> None:
        self.samples.append(len(self.qpos) - 1)
        contacts = sim.contacts if self.meets else None
        self.touching.append(0 if contacts is None else _touching(contacts["dist"]))
        self.slips.append({} if contacts is None else self.bodies.friction.slips(sim, contacts))

    def _state(self, sim: Sim) -> None:
        self.qpos.append(np.array(sim.qpos))
        self.qvel.append(np.array(sim.qvel))
        self.act.append(np.array(sim.act))

    def _contacts(self, sim: Sim) -> None:
        # Without new row updates nothing touches, except under the law penalty, which has no rows.
        if self.rowless and sim.row_updates == self.updates:
            return
        self.updates = sim.row_updates
        self.residual = max(self.residual, sim.residual)
        if self.meets:
            pairs, dist = touches(sim)
            self.overlap = max(self.overlap, -float(dist.min(initial=0.0)))
            self.grounded = self.grounded or self.bodies.friction.grounded(pairs)

    def end(self, sim: Sim, run: Run) -> None:
        """Compute the poses and energies at the samples, always in double precision."""
        bodies = self.bodies
        qpos, qvel = np.array(self.qpos), np.array(self.qvel)
        at = np.array(self.samples)
        # The energies of a finite state can overflow.
        with np.errstate(over="ignore", invalid="ignore"):
            seen = bodies.states(qpos[[0, *at]], qvel[[0, *at]])
            work = np.concatenate([[0.0], np.cumsum(self._work(qpos, qvel))])
            run.balance = seen.energy[1:] - seen.energy[0] - work[at]
            run.height = bodies.height(seen.com[1:])
            if bodies.conserved.known and not self.grounded:
                times = np.concatenate([[0.0], self.schedule.times])
                run.momentum, run.spin = bodies.conserved.lost(seen.momenta, seen.com, times)
            run.joint, run.limit = bodies.joints.apart(seen.frames), bodies.joints.beyond(qpos)
        run.com, run.quat, run.kinetic = seen.com[1:], seen.quat[1:], seen.kinetic[1:]
        run.gyration = bodies.gyration
        run.touching, run.slips = np.array(self.touching), self.slips
        run.overlap, run.residual = self.overlap, self.residual
        run.row_updates, run.rows = sim.row_updates, sim.most_rows

    def _work(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Compute the work of actuators and dampers between consecutive states [J].

        The force of a motor is constant, so force × displacement is exact for hinges and slides.
        The force of a servo is averaged over both states, which is exact for the stiffness term.
        """
        model, ctrl, act = self.bodies.model, np.array(self.ctrl), np.array(self.act)
        change = self.bodies.coordinates.change(qpos[:-1], qpos[1:])
        mean = (qvel[:-1] + qvel[1:]) / 2
        damped = model.element_force("damper", ctrl, act[:-1], qpos[:-1], mean)
        before = model.element_force("actuator", ctrl, act[:-1], qpos[:-1], qvel[:-1])
        after = model.element_force("actuator", ctrl, act[1:], qpos[1:], qvel[1:])
        work: np.ndarray = np.sum(((before + after) / 2 + damped) * change, axis=-1)
        return work


def _touching(dist: np.ndarray) -> int:
    return int((dist <= 0).sum())
