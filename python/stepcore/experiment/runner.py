"""One run of the motion under one setting, and the poses it went through."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.checks import one_line
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.executors import checkpoint
from stepcore.experiment.coordinates import Dofs, product, rotated, turned
from stepcore.experiment.joints import Joints
from stepcore.experiment.momentum import Balance
from stepcore.experiment.motion import Motion
from stepcore.experiment.probes import Looks, Rub, Slips
from stepcore.scene.layout import Layout

# The state is recorded this often in a period (or every step), contacts are looked at less often.
LOOKS = 32
CONTACTS = 8


@dataclass
class Path:
    """What one run did, at the samples.

    com: centres of mass of the moving bodies [m], (n, bodies, 3). quat: (n, bodies, 4).
    gyration: the bodies' radii of gyration [m], (bodies,).
    balance: energy, less that at the start, less the work of the motors, plus what the joint
    dampers took [J], (n,). kinetic: energy [J], height: of the centre of mass against gravity
    [m], touching: contacts that touch; (n,) each. slips: contacts with friction, by sample.
    overlap: deepest [m]. residual: worst [m/s]. rows: the most at once. momentum [kg·m/s], spin
    [kg·m²/s]: see `stepcore.experiment.momentum`. joint [m], limit [rad or m]: see
    `stepcore.experiment.joints`. failure: why the run ended early; the arrays are then short.
    """

    com: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    quat: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 4)))
    balance: np.ndarray = field(default_factory=lambda: np.zeros(0))
    kinetic: np.ndarray = field(default_factory=lambda: np.zeros(0))
    height: np.ndarray = field(default_factory=lambda: np.zeros(0))
    touching: np.ndarray = field(default_factory=lambda: np.zeros(0))
    slips: list[Slips] = field(default_factory=list)
    overlap: float = 0.0
    residual: float = 0.0
    momentum: float | None = None
    spin: float | None = None
    joint: float | None = None
    limit: float | None = None
    row_updates: int = 0
    rows: int = 0
    failure: str | None = None
    gyration: np.ndarray = field(default_factory=lambda: np.zeros(0))


class Course:
    """The model and the motion: everything that runs under different settings share."""

    def __init__(self, model: Model, dofs: Dofs, motion: Motion) -> None:
        self.model, self.dofs, self.motion = model, dofs, motion
        self.layout = Layout(model.scene)
        self.ipos = np.asarray(model.body_ipos, float)[dofs.moving]
        self.mass = np.asarray(model.body_mass, float)[dofs.moving]
        inertia = np.asarray(model.body_inertia, float)[dofs.moving]
        spread = np.trace(inertia, axis1=1, axis2=2) / 2 / np.maximum(self.mass, 1e-300)
        self.gyration = np.sqrt(spread)
        gravity = model.scene.gravity if model.scene.features.gravity else (0.0, 0.0, 0.0)
        self.gravity = np.asarray(gravity, float)
        size = float(np.linalg.norm(self.gravity))
        self.up = -self.gravity / size if size > 0 else np.array([0.0, 0.0, 1.0])
        self.rub = Rub(self)
        self.joints = Joints(self)
        self.conserved = Balance(self)

    def __reduce__(self) -> tuple[type[Course], tuple[Model, Dofs, Motion]]:
        # What is looked up by identity is made anew in another process.
        return Course, (self.model, self.dofs, self.motion)

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
            looks = Looks(self, sim, start)
            self._steps(sim, start, looks)
        except (ValueError, SimulationError) as error:
            path.failure = one_line(error)
            return path
        return self.finish(looks, path)

    def _steps(self, sim: Sim, start: int, looks: Looks) -> None:
        motion = self.motion
        count = motion.steps(sim.settings.dt)
        stride = max(1, count // LOOKS)
        often = max(1, count // stride // CONTACTS)
        drive = self.drive(start)
        for period in range(motion.periods):
            checkpoint()
            drive(sim, period)
            ctrl = np.array(sim.ctrl)
            for first in range(0, count, stride):
                sim.step(min(stride, count - first))
                looks.look(sim, ctrl)
                if (first // stride) % often == 0:
                    looks.contacts(sim)
            if (period + 1) % motion.every == 0:
                looks.sample(sim)

    def finish(self, looks: Looks, path: Path) -> Path:
        """The poses and energies at the samples, in double precision whatever the run's."""
        qpos, qvel = np.array(looks.qpos), np.array(looks.qvel)
        at = np.array(looks.samples)
        # Energies before work: a state that is finite in itself can overflow in them.
        with np.errstate(over="ignore", invalid="ignore"):
            seen = self.poses(qpos[[0, *at]], qvel[[0, *at]])
            work = np.concatenate([[0.0], np.cumsum(self._work(qpos, qvel, np.array(looks.ctrl)))])
            path.balance = seen.energy[1:] - seen.energy[0] - work[at]
            path.height = self._height(seen)
            path.momentum, path.spin = self.conserved.lost(seen, self.motion, looks.grounded)
            path.joint, path.limit = self.joints.apart(seen), self.joints.beyond(qpos)
        path.com, path.quat, path.kinetic = seen.com[1:], seen.quat[1:], seen.kinetic[1:]
        path.gyration = self.gyration
        path.touching, path.slips = np.array(looks.touching), looks.slips
        path.overlap, path.residual = looks.overlap, looks.residual
        path.row_updates, path.rows = looks.row_updates, looks.rows
        if not np.all(np.isfinite(path.com)):
            path.failure = "positions overflow"
        return path

    def drawn(self, qpos: np.ndarray, qvel: np.ndarray) -> Path:
        """The path of states that are known at time 0 and at the samples, and meet nothing."""
        seen = self.poses(qpos, qvel)
        n = len(self.motion.times)
        path = Path(seen.com[1:], seen.quat[1:], np.zeros(n), seen.kinetic[1:])
        path.height, path.touching = self._height(seen), np.zeros(n)
        path.slips, path.gyration = [{} for _ in range(n)], self.gyration
        return path

    def _height(self, seen: Seen) -> np.ndarray:
        """Of the centre of mass of all that moves, against gravity, at the samples [m]."""
        height: np.ndarray = seen.com[1:] @ self.up @ self.mass / max(self.mass.sum(), 1e-300)
        return height

    def _work(self, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray) -> np.ndarray:
        """Work done on the bodies between two looks by motors and dampers [J].

        A motor's force is held, so force × change of the joint is exact for hinges and slides;
        a servo's is the mean of both ends, which is exact for its stiffness.
        """
        change = self.dofs.change(qpos[:-1], qpos[1:])
        damped = -self.dofs.damping * (qvel[:-1] + qvel[1:]) / 2
        force = self.dofs.motor_force(ctrl, qpos[:-1], qvel[:-1])
        force = (force + self.dofs.motor_force(ctrl, qpos[1:], qvel[1:])) / 2
        work: np.ndarray = np.sum((force + damped) * change, axis=-1)
        return work

    def poses(self, qpos: np.ndarray, qvel: np.ndarray) -> Seen:
        """What the bodies do at these states, in double precision."""
        sim = self.sim(self.model.settings.replace(precision="f64"))
        moving = self.dofs.moving
        com, quat, kinetic, energy, momenta, frames = [], [], [], [], [], []
        for q, v in zip(qpos, qvel, strict=True):
            sim.qpos, sim.qvel = q, v
            place, turn = sim.xpos, sim.xquat
            com.append(place[moving] + rotated(turn[moving], self.ipos))
            quat.append(turn[moving])
            both = sim.energy
            kinetic.append(both.kinetic)
            energy.append(both.total)
            if self.conserved.known:
                momenta.append(np.concatenate(sim.momentum))
            if self.joints.connected:
                frames.append(np.concatenate([place, turn], axis=-1))
        return Seen(*map(np.array, (com, quat, kinetic, energy, momenta, frames)))


@dataclass(frozen=True)
class Seen:
    """Bodies at n states: centres of mass [m] and orientations of those that move, energies [J].

    momenta: linear and angular about the world's origin, (n, 6); frames: position and quaternion
    of every body, (n, nbody, 7). Both are empty where the scene has no use for them.
    """

    com: np.ndarray
    quat: np.ndarray
    kinetic: np.ndarray
    energy: np.ndarray
    momenta: np.ndarray
    frames: np.ndarray


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
