"""Random poses near a start that keep its contacts and its distance from limits."""

from __future__ import annotations

import copy
from collections.abc import Collection, Sequence

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.drives import MOTOR, RATE, SERVO, Drives

# Two bodies in contact, and the place [m].
Point = tuple[int, int, np.ndarray]
# How far a joint goes: this share of its range, and at most this far [rad], [m].
SHARE, TURN, SLIDE = 0.1, 0.5, 0.05
# How far a base that stands on contacts goes [m], [rad].
BASE, LEAN = 0.03, 0.1
# The share of a joint's range, at each end, into which no target leads.
MARGIN = 0.05


class Poses:
    """Poses near one start.

    joints: the hinges and slides that actuators drive. reach: how far each goes, (joints,).
    dofs, at: the dof and the coordinate of each. start: the start.
    """

    def __init__(self, model: Model, drives: Drives, start: Start) -> None:
        self.model, self.drives, self.start = model, drives, start
        self.coordinates = Coordinates(model)
        moved = drives.of(SERVO, RATE, MOTOR)
        self.joints = sorted({j for k in moved if (j := drives.joint(k)) is not None})
        self.trees = {model.root(int(model.jnt_body[joint])) for joint in self.joints}
        self.at, self.dofs = model.jnt_qposadr[self.joints], model.jnt_dofadr[self.joints]
        self.reach = np.array([self._reach(joint) for joint in self.joints])
        # Servos on tendons, sites and balls are drawn by their length.
        self.others = [k for k in drives.of(SERVO, RATE) if drives.joint(k) is None]
        sim = Sim(model)
        start.put(sim)
        sim.forward()
        self.kept = contact_jacobian(model, self.trees, start, touching(sim))

    def standing(self, stands: Start, points: Sequence[Point]) -> Poses:
        """Return the poses that keep these contacts; stands: the state in which they are."""
        poses = copy.copy(self)
        poses.kept = contact_jacobian(self.model, self.trees, stands, points)
        return poses

    @property
    def stance(self) -> np.ndarray:
        """Which joints, and which other servos, move the contacts on which the machine stands."""
        count = len(self.joints) + len(self.others)
        stance = np.zeros(count, bool)
        stance[: len(self.joints)] = np.abs(self.kept[:, self.dofs]).max(axis=0, initial=0.0) > 1e-9
        return stance & self.drives.moves_about

    def _spread(self, change: np.ndarray, weights: np.ndarray, share: float) -> np.ndarray:
        """Return a change in which the joints that move contacts go as far as a share allows.

        A random change has little in common with those that keep contacts.
        """
        moved = (np.abs(self.kept).max(axis=0) > 1e-9) & (weights > 0)
        most = float((np.abs(change[moved]) / weights[moved]).max(initial=0.0))
        if most > 1e-6:
            change = np.where(moved, change * share / most, change)
        return change

    @property
    def at_limit(self) -> set[int]:
        """Return the joints that start at a limit or near one."""
        q, low, high = self._room()
        near = (q < low) | (q > high)
        return {joint for joint, at_end in zip(self.joints, near, strict=True) if at_end}

    def between(self, pair: tuple[int, int]) -> set[int]:
        """Return the joints that move two geoms relative to each other."""
        first, second = (self._carried(int(self.model.geom_body[geom])) for geom in pair)
        return first ^ second

    def trees_of(self, pair: tuple[int, int]) -> frozenset[int]:
        """Return the roots of the bodies of two geoms; 0 for the world."""
        return frozenset(self.model.root(int(self.model.geom_body[geom])) for geom in pair)

    def _carried(self, body: int) -> set[int]:
        """Return the joints between the world and a body."""
        joints = set[int]()
        while body:
            joints.update(np.flatnonzero(self.model.jnt_body == body).tolist())
            body = int(self.model.body_parent[body])
        return joints

    def _reach(self, joint: int) -> float:
        low, high = self.model.jnt_range[joint]
        far = TURN if self.model.jnt_type[joint] == "hinge" else SLIDE
        return float(min(far, SHARE * (high - low)))

    def span(self, actuator: int) -> float:
        """Return how far the length of a servo goes that drives no hinge or slide."""
        low, high = self.model.actuator_ctrlrange[actuator]
        wide = float(high - low) * self.drives.lengths[actuator]
        return SHARE * wide if np.isfinite(wide) else SLIDE

    def _weights(self) -> np.ndarray:
        """Return how far each dof may go, (nv,)."""
        weights = np.zeros(self.model.nv)
        for kind, _, v, _ in self.coordinates.joints if len(self.kept) else ():
            if kind == "free":
                weights[v : v + 3], weights[v + 3 : v + 6] = BASE, LEAN
        weights[self.dofs] = self.reach
        return weights

    def drawn(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Draw a change of the pose, (nv,), and of the lengths of the other servos, (others,).

        Where the start has contacts, the change keeps their places, to first order.
        """
        change = rng.uniform(0.5, 1.0, self.model.nv) * rng.choice([-1.0, 1.0], self.model.nv)
        weights = self._weights()
        change *= weights
        if len(self.kept):
            spread = (self.kept * weights**2).T
            back = np.linalg.pinv(self.kept @ spread, 1e-6) @ self.kept @ change
            change = self._spread(change - spread @ back, weights, rng.uniform(0.5, 1.0))
        # Away from limits: a joint near one turns round.
        q, low, high = self._room()
        low, high = np.minimum(q, low), np.maximum(q, high)
        d = change[self.dofs]
        if not len(self.kept):
            d = np.where((q + d < low) | (q + d > high), -d, d)
        change[self.dofs] = np.clip(q + d, low, high) - q
        others = rng.uniform(0.5, 1.0, len(self.others)) * rng.choice([-1.0, 1.0], len(self.others))
        return change, others

    def _room(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the coordinates of the joints, and their ranges without the margins."""
        q = self.start.qpos[self.at]
        low, high = self.model.jnt_range[self.joints].reshape(-1, 2).T
        with np.errstate(invalid="ignore"):
            short = np.where(np.isfinite(high - low), MARGIN * (high - low), 0.0)
        return q, low + short, high - short

    def lengths(self, change: np.ndarray) -> np.ndarray:
        """Return the change of the actuators' lengths if the joints make a change, (nu,)."""
        joints = np.zeros(self.model.nv)
        joints[self.dofs] = change[self.dofs]
        after = self.lengths_at(self.coordinates.moved(self.start.qpos, joints))
        return after - self.lengths_at(self.start.qpos)

    def lengths_at(self, qpos: np.ndarray) -> np.ndarray:
        """Return the lengths of the actuators at a pose, (nu,)."""
        sim = Sim(self.model)
        self.start.put(sim)
        sim.qpos[:] = qpos
        return np.array(sim.actuator_length)


def touching(sim: Sim) -> list[Point]:
    """Return the contacts of the last solve: both bodies, and the place."""
    body, table = sim.model.geom_body, sim.contacts
    table = table[table["dist"] < 0]
    return [(int(body[c["geom1"]]), int(body[c["geom2"]]), np.array(c["pos"])) for c in table]


def contact_jacobian(
    model: Model, trees: Collection[int], state: Start, points: Sequence[Point]
) -> np.ndarray:
    """Return the Jacobian of the contacts of some trees at a state, (3 contacts, nv).

    trees: the root bodies of the trees.
    """
    sim = Sim(model)
    state.put(sim)
    rows = [np.zeros((0, model.nv))]
    for first, second, place in points:
        if model.root(first) in trees or model.root(second) in trees:
            ends = [sim.jacobian(body, place)[:3] for body in (second, first) if body]
            rows.append(ends[0] - ends[1] if len(ends) == 2 else ends[0])
    return np.vstack(rows)
