"""What bodies weigh once the scene is compiled, for the compiler options that move bodies by it."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stepcore import _core
from stepcore.scene import frames
from stepcore.scene.contents import Contents
from stepcore.scene.elements import Body, MassRules
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout
from stepcore.scene.plain import plain


@dataclass(frozen=True)
class Weight:
    """A body's mass [kg], centre [m] and inertia about it [kg·m²], (3, 3), in the body's frame.

    iquat: its principal axes; None: not known.
    """

    mass: float
    ipos: NDArray[np.float64]
    inertia: NDArray[np.float64]
    iquat: Vec | None = None

    def seen_from(self, pos: Vec, quat: Vec) -> Weight:
        """The same in the frame in which the body has this pose."""
        turn = np.array(frames.matrix(quat))
        return Weight(self.mass, np.array(pos) + turn @ self.ipos, turn @ self.inertia @ turn.T)

    def __add__(self, other: Weight) -> Weight:
        mass = self.mass + other.mass
        if mass == 0.0:
            return self
        ipos = (self.mass * self.ipos + other.mass * other.ipos) / mass
        inertia = np.zeros((3, 3))
        for one in (self, other):
            d = one.ipos - ipos
            inertia += one.inertia + one.mass * (d @ d * np.eye(3) - np.outer(d, d))
        return Weight(mass, ipos, inertia)


def weights(scene: Contents) -> dict[int, Weight]:
    """The weight of each body, by its ``id``, without the scaling to a total mass."""
    total = scene.mass_rules.settotalmass
    scene.mass_rules.settotalmass = -1.0
    try:
        layout = Layout(scene)
        known = _weighed(layout)
    finally:
        scene.mass_rules.settotalmass = total
    return {id(body): weight for body, weight in zip(layout.bodies, known, strict=True)}


def weights_under(rules: MassRules, scene: Contents, bodies: Iterable[Body]) -> dict[int, Weight]:
    """The weights of some bodies of a scene under other rules than its own, by their ``id``."""
    part = Contents()
    part.mass_rules = MassRules(**(rules.values() | {"settotalmass": -1.0}))
    part.meshes, part.hfields = scene.meshes, scene.hfields
    twins: dict[int, Body] = {}
    for body in bodies:
        twins[id(body)] = twin = copy.copy(body)
        twin.parent = part.world
        part.bodies.append(twin)
    for geom in scene.geoms:
        if id(geom.body) in twins:
            part.geoms.append(copy.copy(geom))
            part.geoms[-1].body = twins[id(geom.body)]
    # Bodies of one parent keep their order.
    return dict(zip(twins, _weighed(Layout(part))[1:], strict=True))


def _weighed(layout: Layout) -> list[Weight]:
    """The weight of each body, in the order of the compiled model."""
    tables = _core.compile(plain(layout)).tables()
    columns = (tables[f"body_{name}"] for name in ("mass", "ipos", "inertia", "iquat"))
    return [
        Weight(float(mass), np.array(ipos), np.array(inertia), tuple(map(float, iquat)))
        for mass, ipos, inertia, iquat in zip(*columns, strict=True)
    ]


def give(body: Body, weight: Weight) -> None:
    """Makes this weight the body's own."""
    body.mass, body.inertia, body.iquat = weight.mass, six(weight.inertia), weight.iquat
    x, y, z = map(float, weight.ipos)
    body.ipos = (x, y, z)


def six(inertia: NDArray[np.float64]) -> Vec:
    """An inertia tensor as xx yy zz xy xz yz."""
    return tuple(float(inertia[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
