"""Find bodies that pass through each other and leave on the other side.

Contacts keep the centre of a geom outside of every geom that it collides with. A step that moves a
geom by more than its thickness may carry the centre across a surface, and so may a contact that
sinks too deep. A ray along the centre's way since the last observation finds the crossed surface.
If the centre is still behind that surface when the contact has ended, the geom has passed. A geom
below a plane stays in contact with it, and has not.
"""

from __future__ import annotations

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.sim import Sim, touches
from stepcore.experiment.sizes import Sizes

# The depth of a contact, and the way of a geom between two observations, over the smallest half
# size from which a centre may have crossed a surface.
NEAR = 0.5
# The distance from the middle of a geom within which a way may meet it, over its reach: the middle
# of a mesh is its centre of mass.
WIDE = 1.5

# A geom, and the geom whose surface its centre has crossed.
Passage = tuple[int, int]


class Passages:
    """The passages of one run, observed every few steps.

    found: the passages up to now, with the time at which the surface was crossed [s].
    """

    def __init__(self, sim: Sim) -> None:
        model = sim.model
        self.found: dict[Passage, float] = {}
        # Where and when a centre has entered the other geom, and the outward normal there.
        self.inside: dict[Passage, tuple[Floats, Floats, float]] = {}
        self.watches = model.npair > 0 and not model.is_heap
        if not self.watches:
            return
        sizes, geoms = Sizes(model), model.pair_geoms
        self.thick, self.body = np.array(sizes.thick), model.geom_body
        # The other geom bounds where a centre can enter it. A plane is left by nothing below it.
        both = np.concatenate([geoms, geoms[:, ::-1]])
        flat = np.array([kind == "plane" for kind in model.geom_type], bool)
        self.able = both[np.isfinite(self.thick[both[:, 0]]) & ~flat[both[:, 1]]]
        self.pairs = {(a, b) for a, b in self.able.tolist()}
        self.reach = WIDE * np.array(sizes.reach)[self.able[:, 1]]
        self.watches = len(self.able) > 0
        self._keep(sim)

    def observe(self, sim: Sim) -> None:
        """Observe the present state; a way between two states counts as straight."""
        if not self.watches:
            return
        before, turned = self.centres, self.axes
        self._keep(sim)
        if not np.isfinite(self.centres).all():
            return
        touching = self._touching(sim)
        for passage in [passage for passage in self.inside if passage not in touching]:
            self._leave(passage)
        for (geom, other), deep in touching.items():
            if deep and (geom, other) in self.pairs:
                # The way of the centre seen from the other geom.
                turn = self.axes[other] @ turned[other].T
                start = self.centres[other] + turn @ (before[geom] - before[other])
                self._cross(sim, geom, start)
        for geom in self._fast(before):
            self._cross(sim, geom, before[geom])

    def _fast(self, before: Floats) -> list[int]:
        """Return the geoms that have moved far, on a way near a geom that they collide with."""
        ways = self.centres - before
        length = np.linalg.norm(ways, axis=1)
        far = length[self.able[:, 0]] > NEAR * self.thick[self.able[:, 0]]
        if not far.any():
            return []
        (geoms, others), reach = self.able[far].T, self.reach[far]
        way, apart = ways[geoms], self.centres[others] - before[geoms]
        part = np.clip(np.sum(way * apart, axis=1) / length[geoms] ** 2, 0.0, 1.0)
        near = np.linalg.norm(apart - part[:, None] * way, axis=1) < reach
        return sorted(set(geoms[near].tolist()))

    def _keep(self, sim: Sim) -> None:
        self.centres, self.axes = np.array(sim.geom_xpos), np.array(sim.geom_xmat)
        self.axes = self.axes.reshape(-1, 3, 3)

    def _touching(self, sim: Sim) -> dict[Passage, bool]:
        """Return whether the last contact of each pair was deep, for both orders of its geoms."""
        deep: dict[Passage, bool] = {}
        pairs, distances = touches(sim)
        for pair, distance in zip(pairs, distances.tolist(), strict=True):
            if distance < 0:
                far = -distance > NEAR * float(self.thick[list(pair)].min())
                deep[pair] = deep.get(pair, False) or far
        return deep | {(b, a): far for (a, b), far in deep.items()}

    def _cross(self, sim: Sim, geom: int, start: Floats) -> None:
        """Keep where a geom's centre enters another geom on its way to its present place."""
        way = self.centres[geom] - start
        if not way.any():
            return
        hit = sim.ray(start, way, exclude=int(self.body[geom]))
        passage = geom, int(hit.geom)
        enters = 0 <= float(hit.distance) <= 1 and float(hit.normal @ way) < 0
        if enters and passage in self.pairs and passage not in self.found:
            axes, centre = self.axes[passage[1]], self.centres[passage[1]]
            entry = axes.T @ (start + float(hit.distance) * way - centre)
            self.inside.setdefault(passage, (entry, axes.T @ hit.normal, sim.time))

    def _leave(self, passage: Passage) -> None:
        """Keep the passage of a centre behind the surface, where the contact has ended."""
        geom, other = passage
        entry, normal, time = self.inside.pop(passage)
        now = self.axes[other].T @ (self.centres[geom] - self.centres[other])
        if float(normal @ (now - entry)) < 0:
            self.found[passage] = time
