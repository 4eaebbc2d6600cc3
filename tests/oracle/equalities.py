"""What equalities hold at zero: how far each of their rows is from it, its Jacobian, and J' v."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from . import place
from .model import Frame, Model, Record
from .place import Placed
from .rotation import Array, conjugate, multiply, unit

# What the rows of each kind are called.
KINDS = {"connect": "connect", "weld": "weld", "joint": "joint equality"}


class Tied(NamedTuple):
    """n rows of one equality: n is 3 of a connect, 6 of a weld and 1 of joints."""

    phi: Array  # [m, or as the row has it], shape (n,)
    J: Array  # shape (n, nv)
    dofs: Array  # which dofs they may touch, shape (nv,)


def frames(model: Model, equality: Record) -> tuple[Frame, Frame] | None:
    """What is one on the two bodies at qpos0, positions and quaternions in their frames."""
    given = (equality["frame1"], equality["frame2"])
    if given == (None, None):
        return None
    placed = place.place(model, np.array(model.qpos0, float))
    bodies = (equality["first"], equality["second"])
    world = [
        (placed.xpos[body] + placed.xmat[body] @ np.array(frame["pos"], float),
         multiply(placed.xquat[body], unit(frame["quat"])))
        for body, frame in zip(bodies, given, strict=True) if frame is not None
    ]  # fmt: skip
    # One frame that is given is on both bodies.
    (one, (pos1, quat1)), (two, (pos2, quat2)) = zip(bodies, (world[0], world[-1]), strict=True)
    return (
        (placed.xmat[one].T @ (pos1 - placed.xpos[one]),
         multiply(conjugate(placed.xquat[one]), quat1)),
        (placed.xmat[two].T @ (pos2 - placed.xpos[two]),
         multiply(conjugate(placed.xquat[two]), quat2)),
    )  # fmt: skip


def tied(model: Model, placed: Placed, qpos: Array, index: int) -> Tied:
    """The rows of an equality at the positions at hand."""
    equality = model.scene["equalities"][index]
    if equality["kind"] == "joint":
        return _joints(model, qpos, equality)
    one, two = equality["first"], equality["second"]
    point1, point2 = points(model, placed, index)
    (far1, spin1), (far2, spin2) = (
        place.jacobians(model, placed, body, at) for body, at in ((one, point1), (two, point2))
    )
    phi, J = point1 - point2, far1 - far2
    if equality["kind"] == "weld":
        scale = equality["torquescale"]
        A, B = turns(model, placed, index)
        phi = np.concatenate([phi, scale * multiply(conjugate(B), A)[1:]])
        turning = [_half(B, np.r_[0.0, axis], A) for axis in (spin1 - spin2).T]
        J = np.concatenate([J, scale * np.array(turning).reshape(-1, 3).T])
    return Tied(phi, J, model.moves[one] | model.moves[two])


def _half(B: Array, middle: Array, A: Array) -> Array:
    """The vector part of half the product of B*, `middle` and A."""
    return 0.5 * multiply(multiply(conjugate(B), middle), A)[1:]


def _joints(model: Model, qpos: Array, equality: Record) -> Tied:
    first, second = model.joints[equality["first"]], equality["second"]
    J, dofs = np.zeros((1, model.nv)), np.zeros(model.nv, bool)
    law = Polynomial(equality["polycoef"])
    J[0, first["dof"]] = 1.0
    dofs |= model.moves[first["body"]]
    phi = qpos[first["qpos"]] - first["reference"]
    if second is None:
        return Tied(np.array([phi - law(0.0)]), J, dofs)
    other = model.joints[second]
    x = qpos[other["qpos"]] - other["reference"]
    J[0, other["dof"]] = -law.deriv()(x)
    return Tied(np.array([phi - law(x)]), J, dofs | model.moves[other["body"]])


def curving(model: Model, placed: Placed, qpos: Array, v: Array, index: int) -> Array:
    """How fast the rows' velocities grow when no dof accelerates, J' v, shape (n,)."""
    equality = model.scene["equalities"][index]
    one, two = equality["first"], equality["second"]
    if equality["kind"] == "joint":
        if two is None:
            return np.zeros(1)
        other = model.joints[two]
        x = qpos[other["qpos"]] - other["reference"]
        bend = Polynomial(equality["polycoef"]).deriv(2)(x)
        return np.array([-bend * v[other["dof"]] ** 2])
    moving = place.rates(model, placed, v)
    at1, at2 = points(model, placed, index)
    linear = [
        place.curving(model, placed, moving, body, at, v) for body, at in ((one, at1), (two, at2))
    ]
    out = linear[0] - linear[1]
    if equality["kind"] == "connect":
        return out
    A, B = turns(model, placed, index)
    spins, gains = [], []
    for body, at in ((one, at1), (two, at2)):
        spins.append(np.r_[0.0, place.jacobians(model, placed, body, at)[1] @ v])
        gains.append(np.r_[0.0, (model.moves[body] * model.angular * v) @ moving[0]])
    spin = spins[0] - spins[1]
    # The derivative of half B* w A, as A' = w1 A / 2 and B*' = -B* w2 / 2.
    middle = gains[0] - gains[1] + 0.5 * (multiply(spin, spins[0]) - multiply(spins[1], spin))
    return np.concatenate([out, equality["torquescale"] * _half(B, middle, A)])


def points(model: Model, placed: Placed, index: int) -> tuple[Array, Array]:
    """Where the two points are [m]."""
    (body1, (pos1, _)), (body2, (pos2, _)) = _ends(model, index)
    return (
        placed.xpos[body1] + placed.xmat[body1] @ pos1,
        placed.xpos[body2] + placed.xmat[body2] @ pos2,
    )


def turns(model: Model, placed: Placed, index: int) -> tuple[Array, Array]:
    """How the two frames are turned."""
    (body1, (_, quat1)), (body2, (_, quat2)) = _ends(model, index)
    return multiply(placed.xquat[body1], quat1), multiply(placed.xquat[body2], quat2)


def _ends(model: Model, index: int) -> tuple[tuple[int, Frame], tuple[int, Frame]]:
    equality, own = model.scene["equalities"][index], model.frames[index]
    assert own is not None, "joints have no frames"
    return (equality["first"], own[0]), (equality["second"], own[1])
