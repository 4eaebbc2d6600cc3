"""Geoms that pass through thin ones in a run, and geoms so fast that they may.

A contact pushes a geom out on the side on which its centre is. So a geom passes through a flat one
(a box, a disc, a flat ellipsoid) as its centre crosses the middle plane: in one step, if it moves
by more than half of both thicknesses, or slowly, if the contact is too soft to stop it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.sizes import Sizes
from stepcore.measure.monitors.cures import finer
from stepcore.measure.monitors.finding import Cure, Finding, Remedy, named, others
from stepcore.measure.monitors.soft_rows import hardest
from stepcore.report.units import metres, seconds, speed

# Largest number of pairs that are watched, the thinnest first: 0.1 ms a reading.
MOST = 1000
# A geom that will arrive within this number of steps or readings is about to.
SOON, READINGS = 10, 2
# Arrivals are not recorded below this share of half of both thicknesses in a step.
SLOW = 0.1
# A step should be this share of half of both thicknesses at most, or one of these parts of dt.
SHORT, PARTS = 0.5, (1, 2, 4)


@dataclass(frozen=True)
class Passage:
    """A geom that passed through a flat one, or that may.

    mover, wall: the geoms. pair: their index. speed: across the middle plane [m/s].
    room: half of both thicknesses [m]. time: [s].
    """

    mover: int
    wall: int
    pair: int
    speed: float
    room: float
    time: float


class Places(NamedTuple):
    """The geoms at one reading.

    apart: of each mover from the middle plane of its wall [m]. centres, turns: of all geoms.
    """

    time: float
    apart: np.ndarray
    centres: np.ndarray
    turns: np.ndarray


class TunnellingMonitor:
    """A record of the geoms that cross thin ones in one run."""

    def __init__(self, model: Model, sizes: Sizes, moving: list[int]) -> None:
        self.model, self.dt = model, model.settings.dt
        features, pairs = model.scene.features, []
        if features.contact and features.constraint and not model.is_heap:
            pairs = list(_pairs(model, sizes, set(moving)))
        pairs = sorted(pairs, key=lambda entry: entry[3])[:MOST]
        columns = list(zip(*pairs, strict=True)) or [()] * 6
        self.mover, self.wall, self.pair = (np.array(column, int) for column in columns[:3])
        self.thin, self.round = (np.array(column, float) for column in columns[3:5])
        # The half sizes of the wall; inf along its thin axis.
        self.face = np.array(columns[5], float).reshape(-1, 3)
        self.axis = np.isinf(self.face).argmax(axis=1) if len(self.face) else self.pair
        self.watches = bool(len(self.pair))
        self.before: Places | None = None
        n = len(self.pair)
        # The side on which each pair ends up after a crossing; speed and time of the crossing, and
        # of the fastest arrival.
        self.side, self.crossed = np.zeros(n), np.zeros((n, 2))
        self.through, self.risk = np.zeros(n, bool), np.zeros((n, 2))

    def begin(self, sim: Sim) -> None:
        """Record the places at the start."""
        if self.watches:
            self.before = self._places(sim)

    def _places(self, sim: Sim) -> Places:
        centres, turns = sim.geom_xpos, sim.geom_xmat.reshape(-1, 3, 3)
        normals = turns[self.wall, :, self.axis]
        apart = np.einsum("ni,ni->n", normals, centres[self.mover] - centres[self.wall])
        return Places(sim.time, apart, centres, turns)

    def look(self, sim: Sim) -> None:
        """Record crossings since the last reading, and the speeds of geoms that arrive."""
        if self.before is None:
            return
        before, now = self.before, self._places(sim)
        self.before = now
        time = now.time - before.time
        if time <= 0:
            return
        with np.errstate(over="ignore", invalid="ignore"):
            moved = np.abs(now.apart - before.apart)
            # Through: out of the wall on the side on which it did not come.
            self.through |= self.side * now.apart >= self.thin
            ahead = np.abs(now.apart) - self.thin - self.round
            near = ahead * time <= moved * max(SOON * self.dt, READINGS * time)
            near &= np.abs(now.apart) < np.abs(before.apart)
            near &= moved * self.dt > SLOW * time * (self.thin + self.round)
            for k in np.flatnonzero(near | (now.apart * before.apart < 0)):
                self._arrives(int(k), before, now, float(moved[k]), float(ahead[k]))

    def _arrives(self, k: int, before: Places, now: Places, moved: float, ahead: float) -> None:
        """Record one pair that crosses, or is about to arrive; its motion is continued straight."""
        crosses = now.apart[k] * before.apart[k] < 0
        speed = moved / (now.time - before.time)
        if not moved > 0 or (not crosses and speed <= self.risk[k, 0]):
            return
        old, new = (self._in_wall(k, places) for places in (before, now))
        share = abs(before.apart[k]) / moved if crosses else 1 + max(ahead, 0.0) / moved
        if (np.abs(old + share * (new - old)) > self.face[k]).any():
            return
        if crosses:
            self.side[k] = np.sign(now.apart[k])
            # Soft contact has slowed it down on the way in.
            self.crossed[k] = max(speed, self.risk[k, 0]), now.time
        else:
            self.risk[k] = speed, now.time

    def _in_wall(self, k: int, places: Places) -> np.ndarray:
        """Return the centre of a mover in the frame of its wall [m]."""
        apart = places.centres[self.mover[k]] - places.centres[self.wall[k]]
        place: np.ndarray = places.turns[self.wall[k]].T @ apart
        return place

    def passed(self) -> list[Passage]:
        """Return the geoms that passed through thin ones, in order of time."""
        return self._passages(self.through, self.crossed)

    def risks(self) -> list[Passage]:
        """Return the geoms that moved too far in a step just before a thin one."""
        far = self.risk[:, 0] * self.dt > self.thin + self.round
        return self._passages(far & ~self.through, self.risk)

    def _passages(self, which: np.ndarray, records: np.ndarray) -> list[Passage]:
        room = self.thin + self.round
        columns = (self.mover, self.wall, self.pair, records[:, 0], room, records[:, 1])
        every = zip(*(column[which].tolist() for column in columns), strict=True)
        return sorted((Passage(*entry) for entry in every), key=lambda entry: entry.time)

    def furthest(self) -> float:
        """Return the largest motion in a step just before a thin geom, in thicknesses."""
        speeds = np.where(self.through, self.crossed[:, 0], self.risk[:, 0])
        return float((speeds * self.dt / (self.thin + self.round)).max(initial=0.0))

    # Findings.

    def findings(self) -> Iterator[Finding]:
        """Yield what passed, or else what may."""
        passed, risks = self.passed(), self.risks()
        if passed:
            yield self._through(passed)
        elif risks:
            yield self._risky(risks)

    def _through(self, passed: list[Passage]) -> Finding:
        model, first = self.model, passed[0]
        movers = named(model, "geom", [entry.mover for entry in passed])
        wall = model.element_name("geom", first.wall)
        also = others([of.name for of in movers[1:]], "geoms")
        verb = "pass" if also else "passes"
        problem = (
            f"{movers[0].name}{also} {verb} through {wall} at {seconds(first.time)}: "
            f"it arrives at {speed(first.speed)}, {metres(first.speed * self.dt)} in a step, and "
            f"half of both thicknesses is {metres(first.room)}"
        )
        contacts = named(model, "contact", [entry.pair for entry in passed])
        fast = max(passed, key=lambda entry: entry.speed / entry.room)
        steps = self._shorter(fast)
        # A geom's contacts with all that it can touch, because another wall is next.
        ids = {entry.mover for entry in passed}
        touching = np.flatnonzero(np.isin(model.pair_geoms, list(ids)).any(axis=1)).tolist()
        hard = tuple(hardest(model, touching, dt) for dt in dict.fromkeys((self.dt, *steps)))
        remedy = Remedy(
            (self._steps(steps), hard),
            lambda m: float(len(m.tunnelling.passed())),
            0.0,
            lambda count: f"{count:g} that pass" if count else "none that passes",
            now=float(len(passed)),
        )
        elements = (*movers, *contacts)
        return Finding(
            "tunnelling", "error", problem, "", elements, first.speed, "m/s", remedy=remedy
        )

    def _risky(self, risks: list[Passage]) -> Finding:
        model = self.model
        worst = max(risks, key=lambda entry: entry.speed / entry.room)
        geoms = named(model, "geom", [worst.mover, worst.wall])
        problem = (
            f"{geoms[0].name} may pass through {geoms[1].name}: at {speed(worst.speed)} it moves "
            f"{metres(worst.speed * self.dt)} in a step, and half of both thicknesses is "
            f"{metres(worst.room)}"
        )
        remedy = Remedy(
            (self._steps(self._shorter(worst)),),
            lambda m: m.tunnelling.furthest(),
            1.0,
            lambda ratio: f"{metres(ratio * worst.room)} a step",
            now=worst.speed * self.dt / worst.room,
        )
        # A thicker geom would do, too.
        cure = f"make {geoms[1].name} thicker"
        value = worst.speed
        return Finding("tunnelling", "warning", problem, cure, geoms, value, "m/s", remedy=remedy)

    def _shorter(self, fast: Passage) -> list[float]:
        """Return the time steps to try [s], the longest first."""
        settings = self.model.settings
        most = min(self.dt / 2, SHORT * fast.room / fast.speed)
        return list(dict.fromkeys(finer(settings, most / part) for part in PARTS))

    def _steps(self, steps: list[float]) -> tuple[Cure, ...]:
        return tuple(Cure(f"a dt of {seconds(dt)}", settings={"dt": dt}) for dt in steps)


def _pairs(
    model: Model, sizes: Sizes, moving: set[int]
) -> Iterator[tuple[int, int, int, float, float, tuple[float, float, float]]]:
    """Yield mover, wall, index, half thicknesses of wall and mover, and face of each pair."""
    for index, geoms in enumerate(model.pair_geoms.tolist()):
        bodies = [int(model.geom_body[geom]) for geom in geoms]
        trees = [model.root(body) for body in bodies]
        # The joints of a tree keep its geoms on their sides.
        if not moving.intersection(bodies) or trees[0] == trees[1]:
            continue
        for wall, mover in (geoms, geoms[::-1]):
            face, thin = _face(model.geom_type[wall], model.geom_size[wall].tolist())
            if face is not None and np.isfinite(sizes.thick[mover]):
                yield mover, wall, index, thin, sizes.thick[mover], face


def _face(kind: str, size: list[float]) -> tuple[tuple[float, float, float] | None, float]:
    """Return the half sizes of a flat geom, inf along its thin axis, and its half thickness."""
    if kind == "cylinder":
        # A square within the disc.
        side = size[0] / 2**0.5
        return ((side, side, np.inf), size[1]) if size[1] < size[0] else (None, 0.0)
    if kind not in ("box", "ellipsoid"):
        return None, 0.0
    thin = min(size)
    inner = 1.0 if kind == "box" else 2**-0.5
    axis = size.index(thin)
    if sum(side == thin for side in size) == 3:
        return None, 0.0
    face = [inner * side for side in size]
    face[axis] = np.inf
    return (face[0], face[1], face[2]), thin
