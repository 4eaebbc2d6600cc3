"""One run of the motion under one setting, and the poses it went through."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.checks import one_line
from stepcore.model import Model
from stepcore.sim import Sim
from stepcore.trade.dofs import Dofs, product, turned
from stepcore.trade.motion import Motion

# The state is recorded this often in a period (or every step), contacts are looked at less often.
LOOKS = 32
CONTACTS = 8


@dataclass
class Path:
    """What one run did, at the samples.

    com: centres of mass of the moving bodies [m], (n, bodies, 3). quat: (n, bodies, 4).
    balance: energy, less that at the start, less the work of the motors, plus what the joint
    dampers took [J], (n,). overlap: deepest [m]. residual: worst [m/s]. rows: the most at once.
    failure: why the run ended early, in which case the arrays are short.
    """

    com: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    quat: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 4)))
    balance: np.ndarray = field(default_factory=lambda: np.zeros(0))
    overlap: float = 0.0
    residual: float = 0.0
    row_updates: int = 0
    rows: int = 0
    failure: str | None = None


class Course:
    """The model and the motion: everything that runs under different settings share."""

    def __init__(self, model: Model, dofs: Dofs, motion: Motion) -> None:
        self.model, self.dofs, self.motion = model, dofs, motion
        self.ipos = np.asarray(model.body_ipos, float)[dofs.moving]

    def sim(self, settings: Settings) -> Sim:
        """A Sim of the model under these settings."""
        return Sim(self.model, settings)

    def place(self, sim: Sim, start: int) -> None:
        """Puts a Sim at a start of the motion, at time 0, nothing warm."""
        sim.reset()
        sim.qpos = self.motion.starts[start].qpos
        sim.qvel = self.motion.starts[start].qvel

    def drive(self, start: int) -> Callable[[Sim, int], None]:
        """Sets the controls of a Sim at the beginning of a period."""
        motion = self.motion
        if motion.control is None:
            assert motion.ctrl is not None
            values = motion.ctrl[start]

            def replay(sim: Sim, period: int) -> None:
                sim.ctrl[:] = values[period]

            return replay
        function = motion.control

        def ask(sim: Sim, period: int) -> None:
            sim.ctrl = function(sim.time, sim)

        return ask

    def run(self, settings: Settings, start: int) -> Path:
        """The motion from one start; a failure ends it and says why."""
        path = Path()
        try:
            sim = self.sim(settings)
            looks = _Looks(self, sim, start)
            self._steps(sim, start, looks)
        except (ValueError, SimulationError) as error:
            path.failure = one_line(error)
            return path
        return self.finish(looks, path)

    def _steps(self, sim: Sim, start: int, looks: _Looks) -> None:
        motion = self.motion
        count = motion.steps(sim.settings.dt)
        stride = max(1, count // LOOKS)
        often = max(1, count // stride // CONTACTS)
        drive = self.drive(start)
        for period in range(motion.periods):
            drive(sim, period)
            ctrl = np.array(sim.ctrl)
            for first in range(0, count, stride):
                sim.step(min(stride, count - first))
                looks.look(sim, ctrl)
                if (first // stride) % often == 0:
                    looks.contacts(sim)
            if (period + 1) % motion.every == 0:
                looks.sample(sim)

    def finish(self, looks: _Looks, path: Path) -> Path:
        """The poses and energies at the samples, in double precision whatever the run's."""
        qpos, qvel = np.array(looks.qpos), np.array(looks.qvel)
        at = np.array(looks.samples)
        # Energies before work: a state that is finite in itself can overflow in them.
        with np.errstate(over="ignore", invalid="ignore"):
            com, quat, energy = self.poses(qpos[[0, *at]], qvel[[0, *at]])
            work = np.concatenate([[0.0], np.cumsum(self._work(qpos, qvel, np.array(looks.ctrl)))])
            path.balance = energy[1:] - energy[0] - work[at]
        path.com, path.quat = com[1:], quat[1:]
        path.overlap, path.residual = looks.overlap, looks.residual
        path.row_updates, path.rows = looks.row_updates, looks.rows
        if not np.all(np.isfinite(path.com)):
            path.failure = "positions overflow"
        return path

    def _work(self, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray) -> np.ndarray:
        """Work done on the bodies between two looks by motors and dampers [J].

        A motor's force is held, so force × change of the joint is exact for hinges and slides.
        """
        change = self.dofs.change(qpos[:-1], qpos[1:])
        damped = -self.dofs.damping * (qvel[:-1] + qvel[1:]) / 2
        work: np.ndarray = np.sum((self.dofs.motor_force(ctrl) + damped) * change, axis=-1)
        return work

    def poses(
        self, qpos: np.ndarray, qvel: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Centres of mass, orientations and energies at these states."""
        sim = self.sim(self.model.settings.replace(precision="f64"))
        com, quat, energy = [], [], []
        for q, v in zip(qpos, qvel, strict=True):
            sim.qpos, sim.qvel = q, v
            turn = sim.xquat[self.dofs.moving]
            com.append(sim.xpos[self.dofs.moving] + rotated(turn, self.ipos))
            quat.append(turn)
            energy.append(sim.energy.total)
        return np.array(com), np.array(quat), np.array(energy)


class _Looks:
    """What is seen of a run while it goes on."""

    def __init__(self, course: Course, sim: Sim, start: int) -> None:
        course.place(sim, start)
        self.qpos, self.qvel = [np.array(sim.qpos)], [np.array(sim.qvel)]
        self.ctrl: list[np.ndarray] = []
        self.samples: list[int] = []
        self.meets = bool(course.model.pairs)
        self.overlap = self.residual = 0.0
        self.row_updates = self.rows = 0

    def look(self, sim: Sim, ctrl: np.ndarray) -> None:
        self.qpos.append(np.array(sim.qpos))
        self.qvel.append(np.array(sim.qvel))
        self.ctrl.append(ctrl)

    def contacts(self, sim: Sim) -> None:
        self.residual = max(self.residual, sim.residual)
        if self.meets:
            dist = sim.contacts["dist"]
            self.overlap = max(self.overlap, -float(dist.min(initial=0.0)))

    def sample(self, sim: Sim) -> None:
        self.samples.append(len(self.qpos) - 1)
        self.rows = max(self.rows, len(sim.rows))
        self.row_updates = sim.row_updates


def rotated(quat: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Vectors turned by quaternions, along leading axes."""
    w, x = quat[..., :1], quat[..., 1:]
    cross = np.cross(x, vector)
    result: np.ndarray = vector + 2 * (w * cross + np.cross(x, cross))
    return result


def distance(a: Path, b: Path) -> np.ndarray:
    """How far the bodies of two runs are apart at each sample [m], shape (n, bodies)."""
    with np.errstate(over="ignore"):
        apart: np.ndarray = np.linalg.norm(a.com - b.com, axis=-1)
    return apart


def angle(a: Path, b: Path) -> np.ndarray:
    """How far the bodies of two runs are turned apart at each sample [rad], (n, bodies)."""
    back = b.quat * np.array([1.0, -1.0, -1.0, -1.0])
    apart: np.ndarray = np.linalg.norm(turned(product(back, a.quat)), axis=-1)
    return apart
