"""How fast geoms that overlap at the start of a run separate."""

from __future__ import annotations

import numpy as np

from stepcore.engine.sim import Sim
from stepcore.measure.monitors.readings import Contact


class Separation:
    """A record of how fast geoms that overlap at the start separate.

    The speed is that of the centres of mass of free trees: a leg that straightens moves its foot,
    and does not throw the robot.
    """

    def __init__(self, sim: Sim, contacts: np.ndarray, movable: list[bool], time: float) -> None:
        model = sim.model
        owner = model.geom_body
        self.pairs, self.movable = contacts["index"].tolist(), movable
        self.depth, self.normal = -contacts["dist"], np.array(contacts["normal"])
        self.bodies = [owner[contacts[name]] for name in ("geom1", "geom2")]
        # The contact point in the frame of each body.
        self.points = [
            np.einsum("cji,cj->ci", sim.xmat[body], contacts["pos"] - sim.xpos[body])
            for body in self.bodies
        ]
        roots = [np.array([model.root(int(body)) for body in side]) for side in self.bodies]
        free = [int(body) for k, body in enumerate(model.jnt_body) if model.jnt_type[k] == "free"]
        self.trees = [(root, np.isin(root, free)[:, None]) for root in roots]
        self.time, self.rose = time, self._apart(sim)[1]
        self.speed, self.left = np.zeros(len(contacts)), np.zeros(len(contacts), bool)

    def look(self, sim: Sim) -> None:
        """Record the speed of geoms that leave their overlap."""
        if self.left.all():
            return
        with np.errstate(over="ignore", invalid="ignore"):
            moved, rose = self._apart(sim)
            if sim.time > self.time:
                # Only the first time: a later one follows another impact.
                leaves = ~self.left & (moved >= self.depth)
                speed = (rose - self.rose) / (sim.time - self.time)
                self.speed, self.left = np.where(leaves, speed, self.speed), self.left | leaves
        self.time, self.rose = sim.time, rose

    def _apart(self, sim: Sim) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances along the normal of the contact points, and of what carries them."""
        place, turn, centre = sim.xpos, sim.xmat, sim.subtree_com
        points = [
            place[body] + np.einsum("cij,cj->ci", turn[body], point)
            for body, point in zip(self.bodies, self.points, strict=True)
        ]
        carried = [
            np.where(free, centre[root], point)
            for point, (root, free) in zip(points, self.trees, strict=True)
        ]
        moved, rose = (
            np.einsum("ci,ci->c", self.normal, second - first)
            for first, second in (points, carried)
        )
        return moved, rose

    def overlaps(self) -> list[Contact]:
        """Return the overlaps with the speeds of separation, deepest first."""
        columns = (self.pairs, self.depth.tolist(), self.speed.tolist(), self.movable)
        overlaps = (
            Contact(pair, depth=depth, speed=speed, movable=movable)
            for pair, depth, speed, movable in zip(*columns, strict=True)
        )
        return sorted(overlaps, key=lambda overlap: -overlap.depth)
