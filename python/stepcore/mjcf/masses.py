"""What bodies weigh once the scene is compiled, for the compiler options that move bodies by it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stepcore import _core
from stepcore.scene import frames
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout
from stepcore.scene.plain import plain

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents


@dataclass(frozen=True)
class Weight:
    """A body's mass [kg], centre [m] and inertia about it [kg·m²], (3, 3), in the body's frame."""

    mass: float
    ipos: NDArray[np.float64]
    inertia: NDArray[np.float64]

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
    layout = Layout(scene)
    try:
        core = _core.compile(plain(layout))
    finally:
        scene.mass_rules.settotalmass = total
    tables = core.tables()
    mass, ipos, inertia = (tables[f"body_{name}"] for name in ("mass", "ipos", "inertia"))
    return {
        id(body): Weight(float(mass[i]), np.array(ipos[i]), np.array(inertia[i]))
        for i, body in enumerate(layout.bodies)
    }


def six(inertia: NDArray[np.float64]) -> Vec:
    """An inertia tensor as xx yy zz xy xz yz."""
    return tuple(float(inertia[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
