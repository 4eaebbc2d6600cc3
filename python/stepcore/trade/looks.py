"""What is seen of a run while it goes on: its states, its contacts and how they slip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stepcore.sim import Sim

if TYPE_CHECKING:
    from stepcore.trade.run import Course

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
        found: Slips = {}
        if not self.rubs or not len(contacts):
            return found
        twists: dict[int, np.ndarray] = {}
        seen: dict[tuple[int, int], int] = {}
        qvel, place = np.array(sim.qvel), sim.xpos
        for contact in contacts:
            a, b = int(contact["geom1"]), int(contact["geom2"])
            seen[a, b] = k = seen.get((a, b), -1) + 1
            force, normal = contact["force"], contact["normal"]
            pushed, mu = float(force @ normal), self.friction(a, b)
            if mu <= 0 or pushed <= 0:
                continue
            speed = np.zeros(3)
            for sign, body in ((-1.0, self.body[a]), (1.0, self.body[b])):
                if body not in self.moving:
                    continue
                if body not in twists:
                    twists[body] = sim.jacobian(body) @ qvel
                arm = contact["pos"] - place[body]
                speed += sign * (twists[body][:3] + np.cross(twists[body][3:], arm))
            with np.errstate(over="ignore", invalid="ignore"):
                found[a, b, k] = _slip(speed, force, normal, mu * pushed)
        return found


def _slip(speed: np.ndarray, force: np.ndarray, normal: np.ndarray, most: float) -> Slip:
    """speed: of geom 2 past geom 1; force: on geom 2; most: μ × normal force."""
    along = speed - (speed @ normal) * normal
    rubbed = force - (force @ normal) * normal
    fast, strong = float(np.linalg.norm(along)), float(np.linalg.norm(rubbed))
    against = -float(along @ rubbed) / (fast * strong) if fast > 0 and strong > 0 else 1.0
    return Slip(fast, strong / most, float(np.arccos(np.clip(against, -1.0, 1.0))))


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
