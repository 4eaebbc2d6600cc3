"""What is seen of a run while it goes on: its states, its contacts and how they slip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stepcore.engine.sim import Sim

if TYPE_CHECKING:
    from stepcore.experiment.runner import Course

# A slower slip than this share of the fastest seen says little about the direction of friction.
SLOW = 1e-2
# A contact slides with more friction than this share of μ × normal force; 1/√2 is what the
# pyramid reaches between its tangents.
SLIDES = 0.65


@dataclass(frozen=True)
class Slip:
    """One contact with friction at one sample.

    speed: of one surface along the other [m/s]. share: friction over μ × normal force.
    astray: angle between the friction force and the direction against the slip [rad].
    """

    speed: float
    share: float
    astray: float


# The two geoms, and which of their contacts.
Slips = dict[tuple[int, int, int], Slip]


class Looks:
    """What is seen of one run."""

    def __init__(self, course: Course, sim: Sim, start: int) -> None:
        course.place(sim, start)
        self.course = course
        self.qpos, self.qvel = [np.array(sim.qpos)], [np.array(sim.qvel)]
        self.ctrl: list[np.ndarray] = []
        self.samples: list[int] = []
        self.slips: list[Slips] = []
        self.touching: list[int] = []
        self.meets = bool(course.model.pairs)
        self.grounded = False
        self.overlap = self.residual = 0.0
        self.row_updates = self.rows = 0

    def look(self, sim: Sim, ctrl: np.ndarray) -> None:
        """The state, after every few steps."""
        self.qpos.append(np.array(sim.qpos))
        self.qvel.append(np.array(sim.qvel))
        self.ctrl.append(ctrl)

    def contacts(self, sim: Sim) -> None:
        """What overlaps, now and then."""
        self.residual = max(self.residual, sim.residual)
        if self.meets:
            contacts = sim.contacts
            self.overlap = max(self.overlap, -float(contacts["dist"].min(initial=0.0)))
            self.grounded |= bool(self.course.rub.still(contacts))

    def sample(self, sim: Sim) -> None:
        """What the errors are taken from."""
        self.samples.append(len(self.qpos) - 1)
        self.rows = max(self.rows, len(sim.rows))
        self.row_updates = sim.row_updates
        contacts = sim.contacts if self.meets else None
        self.touching.append(0 if contacts is None else int((contacts["dist"] <= 0).sum()))
        self.slips.append({} if contacts is None else self.course.rub.slips(sim, contacts))


class Rub:
    """Which geoms rub on which, and how fast."""

    def __init__(self, course: Course) -> None:
        model = course.model
        geoms = course.layout.geoms
        self.mu = [(g.priority, g.condim, g.friction[0]) for g in geoms]
        self.body = [int(body) for body in model.geom_body]
        self.moving = set(course.dofs.moving)
        self.rubs = any(condim > 1 and mu > 0 for _, condim, mu in self.mu)

    def friction(self, a: int, b: int) -> float:
        """The coefficient of a pair, mixed as the engine does; 0 where there is none."""
        one, other = self.mu[a], self.mu[b]
        if one[0] != other[0]:
            one = other = max(one, other)
        return max(one[2], other[2]) if max(one[1], other[1]) > 1 else 0.0

    def still(self, contacts: np.ndarray) -> bool:
        """Whether something touches what does not move."""
        bodies = {self.body[g] for name in ("geom1", "geom2") for g in contacts[name].tolist()}
        return not bodies <= self.moving

    def slips(self, sim: Sim, contacts: np.ndarray) -> Slips:
        """Every contact that friction acts in."""
        if not self.rubs or not len(contacts):
            return {}
        pairs = list(zip(contacts["geom1"].tolist(), contacts["geom2"].tolist(), strict=True))
        mu = np.array([self.friction(a, b) for a, b in pairs])
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
        some = [pairs[k] for k in rubs]
        # What diverges is finite until the step that it fails in, and may be too large to multiply.
        with np.errstate(over="ignore", invalid="ignore"):
            speed = self._speed(sim, contacts["pos"][rubs], [self.body[b] for _, b in some])
            speed -= self._speed(sim, contacts["pos"][rubs], [self.body[a] for a, _ in some])
            found = _slips(speed, force[rubs], normal[rubs], mu[rubs] * pushed[rubs])
        return {keys[k]: slip for k, slip in zip(rubs, found, strict=True)}

    def _speed(self, sim: Sim, points: np.ndarray, bodies: list[int]) -> np.ndarray:
        """Velocities of points that are fixed to bodies [m/s], (n, 3)."""
        qvel, place = np.array(sim.qvel), sim.xpos
        still = np.zeros(6)
        twists = {
            body: sim.jacobian(body) @ qvel if body in self.moving else still
            for body in set(bodies)
        }
        twist = np.array([twists[body] for body in bodies])
        speed: np.ndarray = twist[:, :3] + np.cross(twist[:, 3:], points - place[bodies])
        return speed


def _slips(
    speed: np.ndarray, force: np.ndarray, normal: np.ndarray, most: np.ndarray
) -> list[Slip]:
    """speed: of geom 2 past geom 1; force: on geom 2, (n, 3) each; most: μ × normal force."""

    def tangent(vector: np.ndarray) -> np.ndarray:
        along: np.ndarray = vector - np.einsum("ci,ci->c", vector, normal)[:, None] * normal
        return along

    along, rubbed = tangent(speed), tangent(force)
    fast, strong = np.linalg.norm(along, axis=1), np.linalg.norm(rubbed, axis=1)
    both = fast * strong
    against = -np.einsum("ci,ci->c", along, rubbed) / np.where(both > 0, both, 1.0)
    astray = np.arccos(np.clip(np.where(both > 0, against, 1.0), -1.0, 1.0))
    parts = (fast.tolist(), (strong / most).tolist(), astray.tolist())
    return [Slip(*one) for one in zip(*parts, strict=True)]


def creep(slips: list[Slips], truth: list[Slips], mask: np.ndarray, sticks: float) -> float | None:
    """The fastest slip in contacts that the reference holds [m/s]; None if it holds none.

    Held: with friction below `sticks` of what the cone allows, at this sample and the last.
    slips: one run's, truth: the reference's, at the samples; mask: samples that count.
    """
    speeds = []
    for k in range(1, min(len(slips), len(truth))):
        if not mask[k]:
            continue
        for key, slip in slips[k].items():
            held = [truth[i].get(key) for i in (k - 1, k)]
            if all(one is not None and one.share < sticks for one in held):
                speeds.append(slip.speed)
    return max(speeds, default=None)


def anisotropy(slips: list[Slips]) -> float | None:
    """The widest angle between friction and the direction against the slip [rad].

    Over contacts that slide; None where none does.
    """
    # A contact that comes to rest within a step may be found moving with its friction: no slide.
    every = [slip for sample in slips for slip in sample.values()]
    sliding = [slip for slip in every if slip.share > SLIDES and slip.astray < np.pi / 2]
    fastest = max((slip.speed for slip in sliding), default=0.0)
    wide = [slip.astray for slip in sliding if slip.speed > SLOW * fastest]
    return max(wide, default=None)
