"""A scene as arrays that stay constant: masses, joints, dofs, pairs of geoms."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .rotation import Array

Record = dict[str, Any]  # one element of the scene


@dataclass
class Pair:
    """Two geoms that can meet; geom1's type comes first in `compile.ORDER`."""

    geom1: int
    geom2: int
    friction: tuple[float, ...]  # of tangents, torsion [m], rolling [m]; as many as condim has

    def ways(self) -> list[int]:
        """Those that have friction: 0 and 1 tangents, 2 torsion, 3 and 4 rolling."""
        return [way for way, mu in enumerate(self.friction) if mu > 0]


Frame = tuple[Array, Array]


@dataclass
class Model:
    """Everything about the scene that no step changes. Built by `compile_scene`."""

    scene: Record
    gravity: Array
    nq: int = 0
    nv: int = 0
    qpos0: list[float] = field(default_factory=list)
    joints: list[Record] = field(default_factory=list)  # the scene's, plus their addresses
    root: list[int] = field(default_factory=list)  # the first moving ancestor of each body
    mass: Array = field(init=False)  # [kg], shape (nbody,)
    ipos: Array = field(init=False)  # centre of mass in body axes [m], shape (nbody, 3)
    inertia: Array = field(init=False)  # about the centre, body axes [kg m^2], shape (nbody, 3, 3)
    moves: Array = field(init=False)  # [b, j]: dof j moves body b, shape (nbody, nv)
    carried_by: Array = field(
        init=False
    )  # carried_by[j, i]: dof i moves the axis of dof j, shape (nv, nv)
    angular: Array = field(init=False)  # dof j turns, shape (nv,)
    armature: Array = field(init=False)
    tree: Array = field(init=False)  # the root body of each dof's tree, shape (nv,)
    tree_mass: dict[int, float] = field(default_factory=dict)  # of all that hangs on a root [kg]
    pairs: list[Pair] = field(default_factory=list)
    actuator_bias: list[Array] = field(default_factory=list)  # constant, per length, per velocity
    # Of each equality, None of joints: a position and a quaternion on each of its bodies.
    frames: list[tuple[Frame, Frame] | None] = field(default_factory=list)

    def mass_of(self, dofs: Array) -> float:
        """Mass of the trees that a set of dofs (mask) belongs to [kg]."""
        return sum((self.tree_mass[root] for root in np.unique(self.tree[dofs])), 0.0)
