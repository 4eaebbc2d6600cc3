"""The moving bodies of a model, and what they do at given states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.coordinates import Coordinates, rotated
from stepcore.experiment.joints import Joints
from stepcore.experiment.momentum import Balance
from stepcore.experiment.path import Path
from stepcore.experiment.slip import Friction
from stepcore.scene.layout import Layout


@dataclass(frozen=True)
class States:
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


class Bodies:
    """The moving bodies of a model. gyration: radii of gyration [m]; mass [kg]; (bodies,)."""

    def __init__(self, model: Model, coordinates: Coordinates) -> None:
        scene, layout = model.scene, Layout(model.scene)
        self.model, self.coordinates, self.moving = model, coordinates, coordinates.moving
        self.ipos = np.asarray(model.body_ipos, float)[self.moving]
        self.mass = np.asarray(model.body_mass, float)[self.moving]
        inertia = np.asarray(model.body_inertia, float)[self.moving]
        spread = np.trace(inertia, axis1=1, axis2=2) / 2 / np.maximum(self.mass, 1e-300)
        self.gyration = np.sqrt(spread)
        self.gravity = np.asarray(scene.gravity if scene.features.gravity else (0.0, 0.0, 0.0))
        size = float(np.linalg.norm(self.gravity))
        self.up = -self.gravity / size if size > 0 else np.array([0.0, 0.0, 1.0])
        self.friction = Friction(model, self.moving)
        self.joints = Joints(model, layout, coordinates)
        self.conserved = Balance(model, layout, self.gravity, self.mass)

    def states(self, qpos: np.ndarray, qvel: np.ndarray) -> States:
        """What the bodies do at these states, in double precision."""
        sim = Sim(self.model, self.model.settings.replace(precision="f64"))
        moving = self.moving
        xpos, quat, kinetic, energy, momenta, frames = [], [], [], [], [], []
        for q, v in zip(qpos, qvel, strict=True):
            sim.qpos, sim.qvel = q, v
            place, turn = sim.xpos, sim.xquat
            xpos.append(place[moving])
            quat.append(turn[moving])
            both = sim.energy
            kinetic.append(both.kinetic)
            energy.append(both.total)
            if self.conserved.known:
                momenta.append(np.concatenate(sim.momentum))
            if self.joints.connected:
                frames.append(np.concatenate([place, turn], axis=-1))
        turns = np.array(quat)
        com = self.centres(np.array(xpos), turns)
        return States(com, turns, *map(np.array, (kinetic, energy, momenta, frames)))

    def centres(self, xpos: np.ndarray, xquat: np.ndarray) -> np.ndarray:
        """Centres of mass [m] of the moving bodies, from their frames."""
        return xpos + rotated(xquat, self.ipos)

    def height(self, com: np.ndarray) -> np.ndarray:
        """Of the centre of mass of all that moves, against gravity [m]; com: (n, bodies, 3)."""
        height: np.ndarray = com @ self.up @ self.mass / max(self.mass.sum(), 1e-300)
        return height

    def path(self, qpos: np.ndarray, qvel: np.ndarray) -> Path:
        """The path of states that are known at time 0 and at the samples, and meet nothing."""
        seen = self.states(qpos, qvel)
        n = len(qpos) - 1
        path = Path(seen.com[1:], seen.quat[1:], np.zeros(n), seen.kinetic[1:])
        path.height, path.touching = self.height(path.com), np.zeros(n)
        path.slips, path.gyration = [{} for _ in range(n)], self.gyration
        return path
