"""Contacts with friction: slip speeds, and the direction of friction relative to the slip."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.coordinates import cross

# Slips slower than this share of the fastest are ignored: their direction is too inaccurate.
SLOW = 1e-2
# A contact counts as sliding if friction exceeds this share of μ × normal force. A pyramidal cone
# allows 1/√2 between its tangents.
SLIDES = 0.65


@dataclass(frozen=True)
class Slip:
    """One contact with friction at one sample.

    speed: tangential speed of one surface relative to the other [m/s].
    share: friction force divided by μ × normal force.
    deviation: angle between the friction force and the direction opposite to the slip [rad].
    """

    speed: float
    share: float
    deviation: float


# Slips by (geom 1, geom 2, number of the contact between them).
Slips = dict[tuple[int, int, int], Slip]


class Friction:
    """The contacts with friction of a model. moving: indices of the moving bodies."""

    def __init__(self, model: Model, moving: list[int]) -> None:
        self.model = model
        self._mu: dict[int, float] = {}
        self.body = [int(body) for body in model.geom_body]
        self.moving = set(moving)
        # A heap has too many pairs to check; some are assumed to have friction.
        self.rubs = model.is_heap or any(self.of(index) > 0 for index in range(model.npair))

    def of(self, index: int) -> float:
        """Return the sliding friction coefficient of a pair; 0 if it has a normal row alone."""
        mu = self._mu.get(index)
        if mu is None:
            pair = self.model.contact_pair(index)
            mu = self._mu[index] = pair.friction if pair.condim > 1 else 0.0
        return mu

    def grounded(self, pairs: Iterable[tuple[int, int]]) -> bool:
        """Return whether any contact involves a static body; pairs: the geoms of each contact."""
        return not {self.body[geom] for pair in pairs for geom in pair} <= self.moving

    def slips(self, sim: Sim, contacts: np.ndarray) -> Slips:
        """Return the slips of all contacts with friction and a positive normal force."""
        if not self.rubs or not len(contacts):
            return {}
        pairs = list(zip(contacts["geom1"].tolist(), contacts["geom2"].tolist(), strict=True))
        mu = np.array([self.of(index) for index in contacts["index"].tolist()])
        force, normal = contacts["force"], contacts["normal"]
        pushed = np.einsum("ci,ci->c", force, normal)
        rubs = np.flatnonzero((mu > 0) & (pushed > 0))
        if not len(rubs):
            return {}
        seen: dict[tuple[int, int], int] = {}
        keys = []
        for pair in pairs:
            seen[pair] = seen.get(pair, -1) + 1
            keys.append((*pair, seen[pair]))
        # The velocities of a diverging motion are finite for long, but products can overflow.
        with np.errstate(over="ignore", invalid="ignore"):
            speed = self.passing(sim, contacts[rubs])
            slips = _slips(speed, force[rubs], normal[rubs], mu[rubs] * pushed[rubs])
        return {keys[k]: slip for k, slip in zip(rubs, slips, strict=True)}

    def passing(self, sim: Sim, contacts: np.ndarray) -> np.ndarray:
        """Return the velocity of geom 2 relative to geom 1 at each contact [m/s], (n, 3)."""
        return self.motion(sim, contacts)[0]

    def motion(self, sim: Sim, contacts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the motion of geom 2 relative to geom 1 at each contact.

        The result is the velocity [m/s], (n, 3), and the angular velocity [rad/s], (n, 3).
        """
        first, second = (
            self._motion(sim, contacts["pos"], [self.body[g] for g in contacts[name].tolist()])
            for name in ("geom1", "geom2")
        )
        return second[0] - first[0], second[1] - first[1]

    def movable(self, sim: Sim, contacts: np.ndarray) -> list[bool]:
        """Return for each contact whether any dof changes the gap along the normal."""
        place, result = sim.xpos, []
        for contact in contacts:
            point = np.zeros((3, len(sim.qvel)))
            for geom, sign in (("geom1", -1.0), ("geom2", 1.0)):
                body = self.body[int(contact[geom])]
                if body in self.moving:
                    jacobian = sim.jacobian(body)
                    arm = contact["pos"] - place[body]
                    point += sign * (jacobian[:3] + np.cross(jacobian[3:].T, arm).T)
            along = np.abs(contact["normal"] @ point).max(initial=0.0)
            result.append(bool(along > 1e-9 * np.abs(point).max(initial=0.0)))
        return result

    def _motion(
        self, sim: Sim, points: np.ndarray, bodies: list[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the velocities [m/s] and angular velocities [rad/s] of points fixed to bodies."""
        qvel, place = np.array(sim.qvel), sim.xpos
        still = np.zeros(6)
        twists = {
            body: sim.jacobian(body) @ qvel if body in self.moving else still
            for body in set(bodies)
        }
        twist = np.array([twists[body] for body in bodies])
        speed: np.ndarray = twist[:, :3] + cross(twist[:, 3:], points - place[bodies])
        return speed, twist[:, 3:]


def _slips(
    speed: np.ndarray, force: np.ndarray, normal: np.ndarray, most: np.ndarray
) -> list[Slip]:
    """Compute the slips of contacts.

    speed: velocity of geom 2 relative to geom 1 [m/s], (n, 3). force: on geom 2 [N], (n, 3).
    normal: unit normals, (n, 3). most: μ × normal force [N], (n,).
    """

    def tangent(vector: np.ndarray) -> np.ndarray:
        along: np.ndarray = vector - np.einsum("ci,ci->c", vector, normal)[:, None] * normal
        return along

    along, rubbed = tangent(speed), tangent(force)
    fast, strong = np.linalg.norm(along, axis=1), np.linalg.norm(rubbed, axis=1)
    both = fast * strong
    against = -np.einsum("ci,ci->c", along, rubbed) / np.where(both > 0, both, 1.0)
    deviation = np.arccos(np.clip(np.where(both > 0, against, 1.0), -1.0, 1.0))
    parts = (fast.tolist(), (strong / most).tolist(), deviation.tolist())
    return [Slip(*numbers) for numbers in zip(*parts, strict=True)]


def creep(slips: list[Slips], truth: list[Slips], mask: np.ndarray, sticks: float) -> float | None:
    """Return the fastest slip in contacts that stick in the reference [m/s]; None without any.

    A contact sticks in the reference if its friction is below the share `sticks` of μ × normal
    force, at this sample and at the previous one.

    slips: of one run, truth: of the reference; both at the samples. mask: the samples that count.
    """
    speeds = []
    for k in range(1, min(len(slips), len(truth))):
        if not mask[k]:
            continue
        for key, slip in slips[k].items():
            both = [truth[i].get(key) for i in (k - 1, k)]
            if all(true is not None and true.share < sticks for true in both):
                speeds.append(slip.speed)
    return max(speeds, default=None)


def anisotropy(slips: list[Slips]) -> float | None:
    """Return the largest deviation of friction over all sliding contacts [rad]; None without any.

    The deviation is the angle between friction and the direction opposite to the slip.
    """
    # A contact that comes to rest within a step can slip along its friction; it does not slide.
    every = [slip for sample in slips for slip in sample.values()]
    sliding = [slip for slip in every if slip.share > SLIDES and slip.deviation < np.pi / 2]
    fastest = max((slip.speed for slip in sliding), default=0.0)
    wide = [slip.deviation for slip in sliding if slip.speed > SLOW * fastest]
    return max(wide, default=None)
