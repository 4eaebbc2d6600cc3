"""The moving bodies of a model: poses, energies, momenta, gaps and limit violations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.coordinates import Coordinates, rotated, turned
from stepcore.experiment.friction import Friction
from stepcore.experiment.run import Run
from stepcore.scene.elements import Equality
from stepcore.scene.layout import QPOS, Layout


@dataclass(frozen=True)
class States:
    """Poses, energies and momenta of the moving bodies at n states.

    com: centres of mass [m], (n, bodies, 3). quat: orientations, (n, bodies, 4).
    kinetic, energy: kinetic and total energy [J], (n,).
    momenta: linear [kg·m/s] and angular momentum about the world's origin [kg·m²/s], (n, 6); empty
        if `Balance` does not need them.
    frames: position and quaternion of every body, (n, nbody, 7); empty if `Joints` does not need
        them.
    """

    com: np.ndarray
    quat: np.ndarray
    kinetic: np.ndarray
    energy: np.ndarray
    momenta: np.ndarray
    frames: np.ndarray


class Bodies:
    """The moving bodies of a model.

    moving: the indices of these bodies. mass [kg], gyration: radii of gyration [m]; (bodies,).
    ipos: centres of mass in the bodies' frames [m], (bodies, 3). gravity: [m/s²], (3,).
    up: unit vector against gravity, (3,).
    """

    def __init__(self, model: Model, coordinates: Coordinates) -> None:
        scene, layout = model.scene, Layout(model.scene)
        self.model, self.coordinates, self.moving = model, coordinates, coordinates.moving
        self.ipos = np.asarray(model.body_ipos, float)[self.moving]
        self.mass = np.asarray(model.body_mass, float)[self.moving]
        inertia = np.trace(np.asarray(model.body_inertia, float)[self.moving], axis1=1, axis2=2)
        self.gyration = np.sqrt(inertia / 2 / np.maximum(self.mass, 1e-300))
        self.gravity = np.asarray(scene.gravity if scene.features.gravity else (0.0, 0.0, 0.0))
        size = float(np.linalg.norm(self.gravity))
        self.up = -self.gravity / size if size > 0 else np.array([0.0, 0.0, 1.0])
        self.friction = Friction(model, self.moving)
        self.joints = Joints(model, layout, coordinates)
        self.conserved = Balance(model, layout, self.gravity, self.mass)

    def states(self, qpos: np.ndarray, qvel: np.ndarray) -> States:
        """Compute the bodies' poses, energies and momenta, in double precision.

        qpos: (n, nq). qvel: (n, nv).
        """
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
        """Compute the centres of mass of the moving bodies [m] from the bodies' frames."""
        return xpos + rotated(xquat, self.ipos)

    def height(self, com: np.ndarray) -> np.ndarray:
        """Compute the height of the common centre of mass [m], (n,); com: (n, bodies, 3)."""
        height: np.ndarray = com @ self.up @ self.mass / max(self.mass.sum(), 1e-300)
        return height

    def run(self, qpos: np.ndarray, qvel: np.ndarray) -> Run:
        """Return the run with given states at time 0 and at the samples, and without contacts.

        qpos: (n + 1, nq). qvel: (n + 1, nv).
        """
        seen = self.states(qpos, qvel)
        n = len(qpos) - 1
        run = Run(seen.com[1:], seen.quat[1:], np.zeros(n), seen.kinetic[1:])
        run.height, run.touching = self.height(run.com), np.zeros(n)
        run.slips, run.gyration = [{} for _ in range(n)], self.gyration
        return run


class Joints:
    """The connections (connects and welds) and the joint limits of a scene.

    connected: whether the scene has an active connection.
    tied: the indices of the active connections, in the order of the columns of `gaps`.
    limited: the indices of the joints with a range, in the order of the columns of `violations`.
    """

    def __init__(self, model: Model, layout: Layout, coordinates: Coordinates) -> None:
        scene = model.scene
        self.ranges = [(kind, q, limits) for kind, q, _, limits in coordinates.joints if limits]
        self.limited = [k for k, joint in enumerate(coordinates.joints) if joint[3]]
        works = scene.features.equality and scene.features.constraint
        ties = {
            k: e.plain(layout)
            for k, e in enumerate(scene.equalities)
            if works and e.active and e.type in ("connect", "weld")
        }
        self.tied, self.connected = list(ties), bool(ties)
        # (body 1, the point in its frame, body 2, the point in its frame).
        self.ties: list[tuple[int, np.ndarray, int, np.ndarray]] = []
        if ties:
            sim = Sim(model, model.settings.replace(precision="f64"))
            self.ties = [_ends(tie, sim.xpos, sim.xmat) for tie in ties.values()]

    def apart(self, frames: np.ndarray) -> float | None:
        """Return the widest gap of a connection [m], or None without one; frames: see `States`."""
        return float(self.gaps(frames).max()) if self.connected else None

    def gaps(self, frames: np.ndarray) -> np.ndarray:
        """Compute the gap of each connection [m], (n, connections); frames: see `States`."""
        gaps = []
        for a, near, b, far in self.ties:
            here = frames[:, a, :3] + rotated(frames[:, a, 3:], near)
            there = frames[:, b, :3] + rotated(frames[:, b, 3:], far)
            gaps.append(np.linalg.norm(here - there, axis=1))
        return np.array(gaps).T.reshape(len(frames), len(gaps))

    def beyond(self, qpos: np.ndarray) -> float | None:
        """Return the largest violation of a joint's range [rad or m], or None without ranges."""
        return float(self.violations(qpos).max(initial=0.0)) if self.ranges else None

    def violations(self, qpos: np.ndarray) -> np.ndarray:
        """Compute the violation of each joint range [rad or m], 0 within, (n, ranges)."""
        beyond = []
        for kind, q, (low, high) in self.ranges:
            if kind in ("hinge", "slide"):
                value = qpos[:, q]
            else:
                quat = qpos[:, q + QPOS[kind] - 4 : q + QPOS[kind]]
                value = np.linalg.norm(turned(quat), axis=1)
            beyond.append(np.maximum(0.0, np.maximum(low - value, value - high)))
        return np.array(beyond).T.reshape(len(qpos), len(beyond))


def _ends(
    tie: dict[str, Any], place: np.ndarray, turn: np.ndarray
) -> tuple[int, np.ndarray, int, np.ndarray]:
    """Return the two bodies of a connection and the connected point of each, in body frames [m].

    A point that is not given follows from the pose of the bodies.

    place, turn: positions [m] and rotation matrices of all bodies.
    """
    a, b = tie["first"], tie["second"]
    near, far = (frame and np.array(frame["pos"]) for frame in (tie["frame1"], tie["frame2"]))
    if near is None:
        near = turn[a].T @ (place[b] + turn[b] @ far - place[a])
    if far is None:
        far = turn[b].T @ (place[a] + turn[a] @ near - place[b])
    return a, near, b, far


def _inside(layout: Layout, equality: Equality) -> bool:
    """Return whether an equality acts among moving bodies only, and not on the world."""
    moving = all(layout.moving(body) for body in equality.bodies)
    return moving and (equality.ties_lengths or len(equality.bodies) == 2)


class Balance:
    """The momentum balance of a scene.

    known: whether the momentum can be predicted. This requires that every kinematic tree is
        attached to the world by a free joint on which only gravity acts. Internal forces, such as
        actuator forces and contacts among the bodies, then cancel: p = p₀ + m g t, and the angular
        momentum about the centre of mass is constant. External forces and contacts with static
        bodies make the momentum unpredictable.
    """

    def __init__(self, model: Model, layout: Layout, gravity: np.ndarray, mass: np.ndarray) -> None:
        scene = model.scene
        roots = [
            joint
            for joint in layout.joints
            if joint.body.parent is None or not layout.moving(joint.body.parent)
        ]
        driven = {id(actuator.target[1]) for actuator in scene.actuators}
        # A jet exerts an external force.
        jets = any(a.site is not None and a.refsite is None for a in scene.actuators)
        tied = any(e.active and not _inside(layout, e) for e in scene.equalities)
        self.gravity, self.mass = gravity, mass
        held = scene.density > 0 or scene.viscosity > 0 or any(b.gravcomp for b in scene.bodies)
        self.known = not (tied or held or jets) and all(
            joint.type == "free"
            and not (joint.damped or joint.sprung or joint.armature or joint.frictionloss)
            and id(joint) not in driven
            for joint in roots
        )

    def lost(self, momenta: np.ndarray, com: np.ndarray, times: np.ndarray) -> tuple[float, float]:
        """Return the largest unexplained linear [kg·m/s] and angular momentum [kg·m²/s].

        momenta, com: at the start and at the samples; see `States`. times: of these states [s].
        """
        linear, total = momenta[:, :3], self.mass.sum()
        centre = np.einsum("b,nbi->ni", self.mass, com) / total
        spin = momenta[:, 3:] - np.cross(centre, linear)
        pushed = linear - linear[0] - total * times[: len(momenta), None] * self.gravity
        return (
            float(np.linalg.norm(pushed, axis=1).max()),
            float(np.linalg.norm(spin - spin[0], axis=1).max()),
        )
