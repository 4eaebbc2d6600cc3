"""Find bodies that pass through each other and leave on the other side, and those that soon may.

Contacts keep the centre of a geom outside of every geom that it collides with. A step that moves a
geom by more than its thickness may carry the centre across a surface, and so may a contact that
sinks too deep. A ray along the centre's way since the last observation, seen from the other geom,
finds the crossed surface. If the centre is beyond the middle, seen from that surface, when the
contact has ended, the geom has passed. A geom below a plane stays in contact with it, and has not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.sim import Sim, touches
from stepcore.experiment.sizes import Sizes

# The depth of a contact, and the way of a geom between two observations, over the smallest half
# size from which a centre may have crossed a surface.
NEAR = 0.5
# The box around the middle of a geom in which a way may meet it, over its half sizes: the middle of
# a mesh is its centre of mass.
WIDE = 1.5
# A geom that will arrive within this number of steps or observations is about to, if a step moves
# it by this share of half of both thicknesses.
SOON, OBSERVATIONS, SLOW = 10, 2, 0.1
# The way in a deep contact after which a surface is looked for, over the smallest half size.
CREEPS = 0.05
# The largest number of pairs that are observed, those of the thinnest geoms.
MOST = 2000

# The share of a way by which a point lies behind a surface that it meets.
INSIDE = 1e-9

# A geom, and the geom whose surface its centre has crossed.
Passage = tuple[int, int]


class Crossing(NamedTuple):
    """How a geom meets the surface of another one.

    time: [s]. speed: along the surface's normal [m/s]. room: half of both thicknesses [m].
    """

    time: float
    speed: float
    room: float


class Passages:
    """The passages of one run, observed every few steps.

    ahead: whether arrivals are observed, too, and no geoms of one tree, which its joints keep on
        their sides.
    found: the passages up to now. arrivals: the fastest arrival of each geom at another one, in
        which no surface was crossed.
    """

    def __init__(self, sim: Sim, ahead: bool = False) -> None:
        model, self.ahead = sim.model, ahead
        self.found: dict[Passage, Crossing] = {}
        self.arrivals: dict[Passage, Crossing] = {}
        # Of pairs in deep contact: the centre in the other geom's frame at the last ray, and when.
        self.sunk: dict[int, tuple[Floats, float]] = {}
        # Where a centre has entered the other geom, the outward normal there, and how.
        self.inside: dict[Passage, tuple[Floats, Floats, Crossing]] = {}
        features = model.scene.features
        self.watches = bool(model.npair and features.contact and features.constraint)
        self.watches = self.watches and not model.is_heap
        if not self.watches:
            return
        sizes, geoms = Sizes(model), model.pair_geoms
        self.thick = np.array(sizes.thick)
        self.body = model.geom_body
        # The other geom bounds where a centre can enter it. A plane is left by nothing below it.
        both = np.concatenate([geoms, geoms[:, ::-1]])
        flat = np.array([kind == "plane" for kind in model.geom_type], bool)
        able = both[np.isfinite(self.thick[both[:, 0]]) & ~flat[both[:, 1]]]
        if ahead:
            tree = np.array([model.root(int(body)) for body in self.body])[able]
            able = able[tree[:, 0] != tree[:, 1]]
        able = able[np.argsort(self.thick[able].sum(axis=1), kind="stable")[:MOST]]
        self.mover, self.other = able.T
        self.index = {(a, b): k for k, (a, b) in enumerate(able.tolist())}
        # The least way to a crossing, and the least way in a step of an arrival.
        self.way, self.step = NEAR * self.thick[self.mover], SLOW * self.thick[able].sum(axis=1)
        # The centre of a geom that arrives is beyond the surface by its own thickness.
        self.box = WIDE * np.array(sizes.halves)[self.other] + self.thick[self.mover, None]
        self.watches = len(able) > 0
        self._keep(sim)

    def observe(self, sim: Sim) -> None:
        """Observe the present state; a way between two states counts as straight."""
        if not self.watches:
            return
        before, turned, since = self.centres, self.axes, self.time
        self._keep(sim)
        if not np.isfinite(self.centres).all() or self.time <= since:
            return
        touching = self._touching(sim)
        for passage in [passage for passage in self.inside if passage not in touching]:
            self._leave(passage)
        deep = [self.index[p] for p, sunk in touching.items() if sunk and p in self.index]
        time = self.time - since
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            # A bound of the ways, by which most pairs are left out.
            far = self.way
            if self.ahead:
                far = np.minimum(far, self.step * time / sim.settings.dt)
            moved = np.linalg.norm(self.centres - before, axis=1)
            angle = np.linalg.norm(self.axes - turned, axis=(1, 2))[self.other]
            reached = np.linalg.norm(before[self.mover] - before[self.other], axis=1)
            fast = moved[self.mover] + moved[self.other] + angle * reached > far
            fast[deep] = False
            some = np.flatnonzero(fast)
            mover, other = self.mover[some], self.other[some]
            # The ways of the centres seen from the other geoms.
            turn = np.einsum("nij,nkj->nik", self.axes[other], turned[other])
            starts = np.einsum("nij,nj->ni", turn, before[mover] - before[other])
            starts += self.centres[other]
            ways, apart = self.centres[mover] - starts, self.centres[other] - starts
            squares = np.sum(ways * ways, axis=1)
            soon = max(SOON * sim.settings.dt / time, OBSERVATIONS) if self.ahead else 0.0
            place, way = (np.einsum("nji,nj->ni", self.axes[other], v) for v in (-apart, ways))
            ends = (-self.box[some] - place) / way, (self.box[some] - place) / way
            enters, leaves = np.minimum(*ends).max(axis=1), np.maximum(*ends).min(axis=1)
            meets = (enters <= leaves) & (leaves >= 0) & (enters <= 1 + soon)
            meets &= squares > far[some] ** 2
        self._sink(sim, deep, before, turned, since)
        for k in np.flatnonzero(meets & (squares > 0) & np.isfinite(squares)):
            self._meet(sim, (int(mover[k]), int(other[k])), starts[k], ways[k], time, soon)

    def _sink(
        self, sim: Sim, deep: list[int], before: Floats, turned: Floats, since: float
    ) -> None:
        """Observe the pairs in deep contact, each after a way of its centre that is worth a ray."""
        kept, self.sunk = self.sunk, {}
        for k in deep:
            mover, other = int(self.mover[k]), int(self.other[k])
            turn, centre = self.axes[other], self.centres[other]
            now = turn.T @ (self.centres[mover] - centre)
            was = kept.get(k) or (turned[other].T @ (before[mover] - before[other]), since)
            way, self.sunk[k] = now - was[0], was
            if float(way @ way) > (CREEPS * float(self.thick[mover])) ** 2:
                self.sunk[k] = now, self.time
                start, time = centre + turn @ was[0], self.time - was[1]
                self._meet(sim, (mover, other), start, turn @ way, time, 0.0)

    def _keep(self, sim: Sim) -> None:
        self.time, self.centres = sim.time, np.array(sim.geom_xpos)
        self.axes = np.array(sim.geom_xmat).reshape(-1, 3, 3)

    def _touching(self, sim: Sim) -> dict[Passage, bool]:
        """Return whether the last contact of each pair was deep, for both orders of its geoms."""
        deep: dict[Passage, bool] = {}
        pairs, distances = touches(sim)
        for pair, distance in zip(pairs, distances.tolist(), strict=True):
            if distance < 0:
                far = -distance > NEAR * float(self.thick[list(pair)].min())
                deep[pair] = deep.get(pair, False) or far
        return deep | {(b, a): far for (a, b), far in deep.items()}

    def _meet(
        self, sim: Sim, passage: Passage, start: Floats, way: Floats, time: float, soon: float
    ) -> None:
        """Keep where a centre enters the other geom on its way to its present place, or will soon.

        time: that the way took [s]. soon: how much longer a way ahead is kept, over this one.
        """
        geom, other = passage
        hit = sim.ray(start, way, exclude=int(self.body[geom]))
        closing = -float(hit.normal @ way)
        if int(hit.geom) != other or closing <= 0:
            return
        at = start + float(hit.distance) * way
        # From within the ray hits the other side; a way through a corner is short.
        beyond = float(sim.ray(at + INSIDE * way, way, exclude=int(self.body[geom])).distance)
        room = float(self.thick[geom] + max(beyond * closing / 2, self.thick[other]))
        speed, risk = closing / time, self.arrivals.get(passage)
        if hit.distance <= 1:
            # Soft contact has slowed it down on the way in.
            crossing = Crossing(self.time, max(speed, risk.speed if risk else 0.0), room)
            axes = self.axes[other].T
            entry = axes @ (at - self.centres[other]), axes @ hit.normal, crossing
            if passage not in self.found:
                self.inside.setdefault(passage, entry)
        elif (
            self.ahead
            and (hit.distance - 1) * closing - self.thick[geom] <= closing * soon
            and (risk is None or speed > risk.speed)
        ):
            self.arrivals[passage] = Crossing(self.time, speed, room)

    def _leave(self, passage: Passage) -> None:
        """Keep the passage of a centre beyond the other's middle, where the contact has ended."""
        geom, other = passage
        entry, normal, crossing = self.inside.pop(passage)
        now = self.axes[other].T @ (self.centres[geom] - self.centres[other])
        if float(normal @ (entry - now)) > crossing.room - float(self.thick[geom]):
            self.found[passage] = crossing
