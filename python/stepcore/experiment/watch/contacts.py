"""What a run's contacts did: overlaps at its start, creep while friction held, depths at rest."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.errors import STICKS
from stepcore.experiment.friction import Friction

# The part of a run, at its end, in which something may have come to rest.
REST = 0.25
# At rest a quantity varies by less than this share of its mean.
STEADY = 0.2
# The velocity of a creep differs by less than this share from its mean, over so many time
# constants; it is under a load, of more than this share of what friction could be.
UNSTEADY, WINDOW, RUBS = 0.5, 10.0, 0.05
# Fewer looks say nothing of rest or of creep.
FEWEST = 8
# An edge of a friction pyramid that pushes with less than this share of the strongest does not.
EDGE = 1e-6

Key = tuple[int, int]
Look = tuple[int, float, float, float, bool, np.ndarray]


@dataclass(frozen=True)
class Overlap:
    """Two geoms that overlap at the start.

    pair: see `Creep`; depth: [m]. movable: whether some joint moves them apart.
    """

    pair: int
    depth: float
    movable: bool = True


@dataclass(frozen=True)
class Creep:
    """A contact that moves although its friction holds it.

    pair: of geoms, part: which of its contacts. speed: mean of the tangential velocity [m/s] over
    the time `held` [s]. share: friction over μ × normal force.
    """

    pair: int
    part: int
    speed: float
    held: float
    share: float


@dataclass(frozen=True)
class Slide:
    """A contact without friction that slides. speed: mean [m/s]."""

    pair: int
    part: int
    speed: float


@dataclass(frozen=True)
class Resting:
    """A contact at rest at the end of a run. depth: [m]; force: normal [N]."""

    pair: int
    part: int
    depth: float
    force: float


class ContactWatch:
    """The contacts of one run."""

    def __init__(self, model: Model, friction: Friction) -> None:
        self.model, self.friction = model, friction
        self.starts: list[Overlap] = []
        self.seen: dict[Key, list[Look]] = {}
        self.looks = 0

    def begin(self, sim: Sim) -> None:
        """The overlaps of the start, by a Sim aside: this one keeps its warm impulses."""
        if not self.model.npair:
            return
        aside = Sim(self.model, sim.settings)
        aside.qpos[:] = sim.qpos
        aside.forward()
        contacts = aside.contacts[aside.contacts["dist"] < 0]
        for contact, movable in zip(contacts, self.friction.movable(aside, contacts), strict=True):
            self.starts.append(Overlap(int(contact["index"]), -float(contact["dist"]), movable))
        self.starts.sort(key=lambda overlap: -overlap.depth)

    def look(self, sim: Sim) -> None:
        """Every contact now."""
        if not self.model.npair:
            return
        look, self.looks = self.looks, self.looks + 1
        contacts = sim.contacts
        if not len(contacts):
            return
        # What diverges may be too large to multiply.
        with np.errstate(over="ignore", invalid="ignore"):
            force, normal = contacts["force"], contacts["normal"]
            pushed = np.einsum("ci,ci->c", force, normal)
            rubbed = np.linalg.norm(force - pushed[:, None] * normal, axis=1)
            past = self.friction.passing(sim, contacts)
            past = past - np.einsum("ci,ci->c", past, normal)[:, None] * normal
        sticks = self._sticks(sim)
        for k in np.flatnonzero(pushed > 0):
            key = int(contacts["index"][k]), int(contacts["part"][k])
            most = self.friction.of(key[0]) * pushed[k]
            share = rubbed[k] / most if most > 0 else 0.0
            held = share < STICKS[sim.settings.cone] or sticks.get(key, False)
            depth = -float(contacts["dist"][k])
            seen = (look, depth, float(pushed[k]), float(share), bool(held), past[k])
            self.seen.setdefault(key, []).append(seen)

    def _sticks(self, sim: Sim) -> dict[Key, bool]:
        """Contacts whose friction is within its pyramid, because every edge pushes.

        Between its edges a pyramid yields at less friction than along them.
        """
        settings = sim.settings
        if settings.law != "solref" or settings.cone != "pyramidal":
            return {}
        rows = sim.rows
        rows = rows[rows["kind"] == "contact"]
        forces: dict[Key, list[float]] = {}
        for index, part, force in zip(rows["index"], rows["part"], rows["force"], strict=True):
            forces.setdefault((int(index), int(part)), []).append(float(force))
        return {key: min(edges) > EDGE * max(edges) for key, edges in forces.items()}

    def creeps(self, times: list[float]) -> Iterator[Creep]:
        """Contacts that move steadily for a while although friction holds them.

        Soft friction is a damper: what a contact has of speed when it begins dies away within its
        time constant, and under a load a speed remains. Of windows of `WINDOW` time constants, and
        of a tenth of the run, the one with the fastest steady speed. times: of the looks [s].
        """
        spacing = (times[-1] - times[0]) / max(1, len(times) - 1) if len(times) > 1 else 0.0
        for (pair, part), seen in self.seen.items():
            if self.friction.of(pair) <= 0 or not spacing:
                continue
            constant = self.model.contact_pair(pair).solref[0]
            least = WINDOW * constant / spacing if constant > 0 else 0.0
            count = math.ceil(max(FEWEST, least, 0.1 * self.looks))
            best: Creep | None = None
            for held in _runs(seen):
                for first in range(0, len(held) - count + 1, max(1, count // 2)):
                    one = _steady(pair, part, held[first : first + count], times)
                    if one and (best is None or one.speed > best.speed):
                        best = one
            if best is not None:
                yield best

    def slides(self) -> Iterator[Slide]:
        """Contacts without friction that were there for a fifth of the run or more."""
        for (pair, part), seen in self.seen.items():
            if self.friction.of(pair) > 0 or len(seen) < max(FEWEST, 0.2 * self.looks):
                continue
            speed = float(np.mean([np.linalg.norm(one[5]) for one in seen]))
            yield Slide(pair, part, speed)

    def resting(self) -> Iterator[Resting]:
        """Contacts that keep their depth to the end of the run."""
        for (pair, part), seen in self.seen.items():
            first = self.looks - max(FEWEST, int(REST * self.looks))
            late = [one for one in seen if one[0] >= first]
            depth = np.array([one[1] for one in late])
            if len(late) < self.looks - first or depth.min() <= 0:
                continue
            if np.ptp(depth) < STEADY * depth.mean():
                force = float(np.mean([one[2] for one in late]))
                yield Resting(pair, part, float(depth.mean()), force)


def _runs(seen: list[Look]) -> Iterator[list[Look]]:
    """Runs of looks, one after the other, in which friction held."""
    now: list[Look] = []
    for one in seen:
        if now and (not one[4] or one[0] != now[-1][0] + 1):
            yield now
            now = []
        if one[4]:
            now.append(one)
    if now:
        yield now


def _steady(pair: int, part: int, held: list[Look], times: list[float]) -> Creep | None:
    """The creep in a window; None where its speed changes, or nothing rubs."""
    past = np.array([one[5] for one in held])
    drift, share = past.mean(axis=0), float(np.mean([one[3] for one in held]))
    speed = float(np.linalg.norm(drift))
    if share < RUBS or np.linalg.norm(past - drift, axis=1).max() > UNSTEADY * speed:
        return None
    return Creep(pair, part, speed, times[held[-1][0]] - times[held[0][0]], share)
