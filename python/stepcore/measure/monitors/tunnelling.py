"""Geoms that pass through others in a run, and leave on the other side.

Contacts keep the centre of a geom outside of every geom that it collides with. A step that moves a
geom by more than its thickness may carry the centre across a surface, and so may a contact that
sinks too deep. A ray along the centre's way since the last reading, seen from the other geom, finds
the crossed surface. If the centre is beyond the middle, seen from that surface, when the contact
has ended, the geom has passed. A geom below a plane stays in contact with it, and has not.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.measure.monitors.cures import PARTS, finer, shorter
from stepcore.measure.monitors.finding import FEW, HALF, Finding, Remedy, named, others
from stepcore.measure.monitors.recording import FEWEST, Recording
from stepcore.measure.monitors.soft_rows import hardest
from stepcore.report.units import metres, seconds, speed

# The largest number of pairs that are looked at, those of the thinnest geoms: all of the 24
# pairs of cubedrop.xml, a tenth of warehouse.xml's.
MOST = 2000


class Passage(NamedTuple):
    """A geom that passed through another one.

    mover, wall: the geoms. pair: their index. speed: along the normal of the surface [m/s].
    room: half of both thicknesses [m]. time: [s].
    """

    mover: int
    wall: int
    pair: int
    speed: float
    room: float
    time: float


def passages(run: Recording) -> list[Passage]:
    """Return the geoms that passed through others, in order of time; the smaller of two passed."""
    model, features = run.model, run.model.scene.features
    watched = model.npair and features.contact and features.constraint and not model.is_heap
    found = _Crossings(run).found if watched and len(run) > 1 else {}
    passed = {}
    for both in sorted(found, key=lambda both: run.sizes.reach[both[0]], reverse=True):
        same = (np.sort(model.pair_geoms, axis=1) == np.sort(both)).all(axis=1)
        pair = int(np.flatnonzero(same)[0])
        passed[pair] = Passage(*both, pair, *found[both])
    return sorted(passed.values(), key=lambda entry: entry.time)


class _Crossings:
    """The crossings of surfaces in a run.

    found: how a geom passed another one: the speed, half of both thicknesses, and the time.
    """

    def __init__(self, run: Recording) -> None:
        model, self.run = run.model, run
        self.found: dict[tuple[int, int], tuple[float, float, float]] = {}
        # The place of entry and the outward normal there, in the other geom's frame.
        self.inside: dict[int, tuple[Floats, Floats, tuple[float, float, float]]] = {}
        self.thick = np.array(run.sizes.thick)
        self.centres, self.axes = run.geoms
        # The other geom bounds where a centre can enter it. A plane is left by nothing below it.
        geoms = np.concatenate([model.pair_geoms, model.pair_geoms[:, ::-1]])
        flat = np.array([kind == "plane" for kind in model.geom_type], bool)
        able = geoms[np.isfinite(self.thick[geoms[:, 0]]) & ~flat[geoms[:, 1]]]
        # Geoms of one tree are kept on their sides by its joints.
        tree = run.roots[model.geom_body][able]
        able = able[tree[:, 0] != tree[:, 1]]
        able = able[np.argsort(self.thick[able].sum(axis=1), kind="stable")[:MOST]]
        self.mover, self.other = able.T
        if not len(able):
            return
        self.index = {(a, b): k for k, (a, b) in enumerate(able.tolist())}
        touching, deep = self._touching()
        ways = self._ways(deep)
        last: dict[int, int] = {}
        for reading in range(1, len(run)):
            for k in [k for k in self.inside if (k, reading) not in touching]:
                self._leave(k, reading)
            # In a deep contact, after a way of the centre that is worth a ray.
            last = {k: last.get(k, reading - 1) for k in deep[reading]}
            for k, since in last.items():
                way = self._seen(k, reading) - self._seen(k, since)
                if float(way @ way) > (FEW * float(self.thick[self.mover[k]])) ** 2:
                    last[k] = reading
                    self._meet(k, since, reading)
            for k in ways[reading]:
                self._meet(k, reading - 1, reading)

    def _touching(self) -> tuple[set[tuple[int, int]], dict[int, list[int]]]:
        """Return the pairs and readings of contacts, and by reading the pairs that are deep."""
        touching, deepest = set[tuple[int, int]](), defaultdict[int, dict[int, bool]](dict)
        for pair, reading, depth in self.run.contacts.overlaps:
            a, b = self.run.model.pair_geoms[pair].tolist()
            far = depth > HALF * float(min(self.thick[a], self.thick[b]))
            for k in (self.index.get((a, b)), self.index.get((b, a))):
                if k is not None:
                    touching.add((k, reading))
                    deepest[reading][k] = deepest[reading].get(k, False) or far
        deep = {r: [k for k, far in found.items() if far] for r, found in deepest.items()}
        return touching, defaultdict(list, deep)

    def _ways(self, deep: dict[int, list[int]]) -> dict[int, list[int]]:
        """Return by reading the pairs whose centre may have crossed a surface on its way to it."""
        mover, other, centres, axes = self.mover, self.other, self.centres, self.axes
        least = HALF * self.thick[mover]
        moved = np.linalg.norm(np.diff(centres, axis=0), axis=2)
        turned = np.linalg.norm(np.diff(axes, axis=0), axis=(2, 3))
        found = defaultdict[int, list[int]](list)
        # Somewhat wider, as the middle of a mesh is its centre of mass.
        box = (1 + HALF) * np.array(self.run.sizes.halves)[other] + self.thick[mover, None]
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            for reading in range(1, len(centres)):
                # A bound of the ways, by which most pairs are left out.
                before, now = centres[reading - 1], centres[reading]
                far = moved[reading - 1][mover] + moved[reading - 1][other]
                reach = np.linalg.norm(before[mover] - before[other], axis=1)
                fast = far + turned[reading - 1][other] * reach > least
                fast[deep[reading]] = False
                some = np.flatnonzero(fast)
                if not len(some):
                    continue
                a, b = mover[some], other[some]
                start = np.einsum("nji,nj->ni", axes[reading - 1][b], before[a] - before[b])
                way = np.einsum("nji,nj->ni", axes[reading][b], now[a] - now[b]) - start
                ends = (-box[some] - start) / way, (box[some] - start) / way
                enters, leaves = np.minimum(*ends).max(axis=1), np.maximum(*ends).min(axis=1)
                meets = (enters <= leaves) & (leaves >= 0) & (enters <= 1)
                meets &= np.sum(way * way, axis=1) > least[some] ** 2
                found[reading] = some[meets].tolist()
        return found

    def _seen(self, k: int, reading: int) -> Floats:
        """Return the centre of the moving geom in the other geom's frame."""
        turn, centres = self.axes[reading, self.other[k]], self.centres[reading]
        seen: Floats = turn.T @ (centres[self.mover[k]] - centres[self.other[k]])
        return seen

    def _meet(self, k: int, since: int, reading: int) -> None:
        """Keep where a centre enters the other geom on its way since a reading."""
        geom, other = int(self.mover[k]), int(self.other[k])
        sim, turn = self.run.at(reading), self.axes[reading, other]
        start = self.centres[reading, other] + turn @ self._seen(k, since)
        way = self.centres[reading, geom] - start
        body = int(self.run.model.geom_body[geom])
        hit = sim.ray(start, way, exclude=body)
        closing = -float(hit.normal @ way)
        if int(hit.geom) != other or closing <= 0 or hit.distance > 1:
            return
        at = start + float(hit.distance) * way
        # From within the ray hits the other side; a way through a corner is short.
        beyond = float(sim.ray(at + 1e-9 * way, way, exclude=body).distance)
        room = float(self.thick[geom] + max(beyond * closing / 2, self.thick[other]))
        normal, entry = turn.T @ hit.normal, turn.T @ (at - self.centres[reading, other])
        # Soft contact slows it down.
        first = max(0, since - FEWEST)
        places = np.array([self._seen(k, r) for r in range(first, reading + 1)])
        fastest = float((-np.diff(places @ normal)).max()) / self.run.spacing
        if (geom, other) not in self.found:
            when = fastest, room, float(self.run.times[reading])
            self.inside.setdefault(k, (entry, normal, when))

    def _leave(self, k: int, reading: int) -> None:
        """Keep the passage of a centre beyond the other's middle, where the contact has ended."""
        entry, normal, crossing = self.inside.pop(k)
        thick = float(self.thick[self.mover[k]])
        if float(normal @ (entry - self._seen(k, reading))) > crossing[1] - thick:
            self.found[int(self.mover[k]), int(self.other[k])] = crossing


def tunnelling_findings(run: Recording, passed: list[Passage]) -> Iterator[Finding]:
    """Yield a finding on what passed; passed: what `passages` returns."""
    if not passed:
        return
    model, first, dt = run.model, passed[0], run.model.settings.dt
    movers = named(model, "geom", [entry.mover for entry in passed])
    wall, also = model.element_name("geom", first.wall), others(movers[1:], "geom")
    problem = (
        f"{movers[0].name}{also} {'pass' if also else 'passes'} through {wall} at "
        f"{seconds(first.time)}: it arrives at {speed(first.speed)}, "
        f"{metres(first.speed * dt)} in a step, and half of both thicknesses is "
        f"{metres(first.room)}"
    )
    contacts = named(model, "contact", [entry.pair for entry in passed])
    fast = max(passed, key=lambda entry: entry.speed / entry.room)
    # A step should go half of both thicknesses at most.
    most = min(dt / 2, HALF * fast.room / fast.speed)
    steps = list(dict.fromkeys(finer(model.settings, most / part) for part in PARTS))
    # A geom's contacts with all that it can touch, because another wall is next.
    ids = {entry.mover for entry in passed}
    touching = np.flatnonzero(np.isin(model.pair_geoms, list(ids)).any(axis=1)).tolist()
    hard = tuple(hardest(model, touching, step) for step in dict.fromkeys((dt, *steps)))
    remedy = Remedy(
        (shorter(steps), hard),
        lambda other: float(len(passages(other))),
        0.0,
        lambda count: f"{count:g} that pass" if count else "none that passes",
        now=float(len(passed)),
    )
    elements, value = (*movers, *contacts), first.speed
    yield Finding("tunnelling", "error", problem, "", elements, value, "m/s", remedy=remedy)
