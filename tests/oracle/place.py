"""Stage 1, place: where everything is, how it can move, and the forces that are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .model import Model
from .rotation import Array, cross, from_vector, matrix, multiply, to_vector, unit
from .world import World


@dataclass
class Placed:
    """World poses of bodies, and the axis and anchor of each dof, at one qpos."""

    xpos: Array  # [m], shape (nbody, 3)
    xquat: Array  # shape (nbody, 4)
    xmat: Array  # shape (nbody, 3, 3)
    com: Array  # centre of mass of each body [m], shape (nbody, 3)
    axis: Array  # unit axis of each dof, shape (nv, 3)
    anchor: Array  # a point on the axis of each turning dof [m], shape (nv, 3)


def place(model: Model, qpos: Array) -> Placed:
    """Forward kinematics: joints applied one after another, from the root outwards."""
    bodies = model.scene["bodies"]
    n = len(bodies)
    placed = Placed(
        np.zeros((n, 3)), np.tile([1.0, 0, 0, 0], (n, 1)), np.tile(np.eye(3), (n, 1, 1)),
        np.zeros((n, 3)), np.zeros((model.nv, 3)), np.zeros((model.nv, 3)),
    )  # fmt: skip
    for b in range(1, n):
        up = bodies[b]["parent"]
        pos = placed.xpos[up] + placed.xmat[up] @ bodies[b]["pos"]
        quat = multiply(placed.xquat[up], unit(bodies[b]["quat"]))
        for joint in model.joints:
            if joint["body"] == b:
                pos, quat = apply_joint(placed, joint, qpos, pos, quat)
        quat = unit(quat)
        placed.xpos[b], placed.xquat[b], placed.xmat[b] = pos, quat, matrix(quat)
        placed.com[b] = pos + placed.xmat[b] @ model.ipos[b]
    return placed


def apply_joint(
    placed: Placed, joint: dict[str, Any], qpos: Array, pos: Array, quat: Array
) -> tuple[Array, Array]:
    """Move a body's frame by one joint, and note the joint's axes on the way."""
    at, dof = joint["qpos"], joint["dof"]
    if joint["kind"] == "free":
        pos, quat = qpos[at : at + 3].copy(), unit(qpos[at + 3 : at + 7])
        placed.axis[dof : dof + 3] = np.eye(3)  # linear: world axes
        placed.axis[dof + 3 : dof + 6] = matrix(quat).T  # angular: body axes
        placed.anchor[dof : dof + 6] = pos
        return pos, quat
    turn = matrix(quat)
    anchor = pos + turn @ joint["pos"]
    if joint["kind"] == "ball":
        quat = multiply(quat, unit(qpos[at : at + 4]))
        placed.axis[dof : dof + 3] = matrix(quat).T
        placed.anchor[dof : dof + 3] = anchor
    else:
        local = unit(joint["axis"])
        placed.axis[dof], placed.anchor[dof] = turn @ local, anchor
        moved = qpos[at] - joint["reference"]
        if joint["kind"] == "slide":
            return pos + moved * placed.axis[dof], quat
        quat = multiply(quat, from_vector(moved * local))
    return anchor - matrix(quat) @ joint["pos"], quat


def jacobians(
    model: Model, placed: Placed, body: int | np.integer[Any], point: Array
) -> tuple[Array, Array]:
    """Velocity of a world point of a body, and the body's spin, per qvel: two (3, nv) arrays."""
    moves = model.moves[body][:, None]
    turning = (model.angular & model.moves[body])[:, None]
    spin = np.where(turning, placed.axis, 0.0)
    linear = np.where(turning, cross(placed.axis, point - placed.anchor), placed.axis)
    return np.where(moves, linear, 0.0).T, spin.T


def mass_matrix(model: Model, placed: Placed) -> Array:
    """M(q), shape (nv, nv): the sum over bodies of J^T (mass or inertia) J, and the armature."""
    M = np.diag(model.armature)
    for b in np.flatnonzero(model.mass):
        linear, spin = jacobians(model, placed, b, placed.com[b])
        inertia = placed.xmat[b] @ model.inertia[b] @ placed.xmat[b].T
        M = M + model.mass[b] * linear.T @ linear + spin.T @ inertia @ spin
    return M


def bias(model: Model, placed: Placed, v: Array) -> Array:
    """Coriolis, centrifugal, gyroscopic and gravity terms, shape (nv,): M a + bias = force.

    With no joint acceleration a body still accelerates, because the axes turn:
    the time derivative of each column of the Jacobian, times its velocity.
    """
    out = np.zeros(model.nv)
    axis_rate, anchor_rate = rates(model, placed, v)
    for b in np.flatnonzero(model.mass):
        linear, spin = jacobians(model, placed, b, placed.com[b])
        omega = spin @ v
        acceleration = curving(model, placed, (axis_rate, anchor_rate), b, placed.com[b], v)
        acceleration = acceleration - model.gravity
        spin_rate = (model.moves[b] * model.angular * v) @ axis_rate
        inertia = placed.xmat[b] @ model.inertia[b] @ placed.xmat[b].T
        torque = inertia @ spin_rate + cross(omega, inertia @ omega)
        out += model.mass[b] * acceleration @ linear + torque @ spin
    return out


def rates(model: Model, placed: Placed, v: Array) -> tuple[Array, Array]:
    """Velocity of each dof's axis and anchor, shapes (nv, 3)."""
    turning = model.angular[:, None]
    # It is carried by the dofs between it and the root.
    spin_of_axis = model.carried_by @ (np.where(turning, placed.axis, 0.0) * v[:, None])
    axis_rate = cross(spin_of_axis, placed.axis)
    arm = placed.anchor[:, None, :] - placed.anchor[None, :, :]
    carry = np.where(turning, cross(placed.axis[None], arm), placed.axis[None])
    return axis_rate, np.einsum("ji,i,jik->jk", model.carried_by, v, carry)


def curving(
    model: Model,
    placed: Placed,
    moving: tuple[Array, Array],
    body: int | np.integer[Any],
    point: Array,
    v: Array,
) -> Array:
    """Acceleration of a body's point while no joint accelerates [m/s²]; moving: `rates`."""
    axis_rate, anchor_rate = moving
    speed = jacobians(model, placed, body, point)[0] @ v
    lever = cross(axis_rate, point - placed.anchor)
    swing = cross(placed.axis, speed - anchor_rate)
    columns = np.where(model.angular[:, None], lever + swing, axis_rate)
    return np.asarray((model.moves[body] * v) @ columns)


def stretch(model: Model, joint: dict[str, Any], qpos: Array) -> Array:
    """How far a joint is from where its spring rests, in the coordinates of qvel."""
    at = joint["qpos"]
    if joint["kind"] in ("slide", "hinge"):
        return qpos[at : at + 1] - float(joint["springref"])
    rest = model.qpos0[at : at + (7 if joint["kind"] == "free" else 4)]
    back = np.array(rest[-4:]) * [1, -1, -1, -1]
    turned = at + joint["width"] - 3
    turn = to_vector(multiply(back, unit(qpos[turned : turned + 4])))
    if joint["kind"] == "ball":
        return turn
    return np.concatenate((qpos[at : at + 3] - rest[:3], turn))


def parts(joint: dict[str, Any]) -> list[slice]:
    """The dofs of a joint over which a spring has one length: a free joint has two."""
    return [slice(3), slice(3, 6)] if joint["kind"] == "free" else [slice(joint["width"])]


def spring_force(joint: dict[str, Any], s: Array) -> Array:
    """-(a + b x + c x²...) s at a stretch s, x its length, of one number with its sign."""
    length = s[0] if len(s) == 1 else np.linalg.norm(s)
    return -sum(k * length**n for n, k in enumerate(joint["stiffness"])) * s


def spring_energy(joint: dict[str, Any], s: Array) -> float:
    """a x²/2 + b x³/3 + c x⁴/4... [J]."""
    length = s[0] if len(s) == 1 else np.linalg.norm(s)
    return float(sum(k * length ** (n + 2) / (n + 2) for n, k in enumerate(joint["stiffness"])))


def damper_force(joint: dict[str, Any], v: Array) -> Array:
    """-(a + b |v| + c v²...) v at velocities v, dof by dof."""
    return -sum(k * abs(v) ** n for n, k in enumerate(joint["damping"])) * v


def known_forces(world: World, placed: Placed, qpos: Array, v: Array) -> Array:
    """Every force that no row decides: applied, actuation, springs, dampers, minus the bias."""
    model, on = world.model, world.model.scene["features"]
    force = world.qfrc_applied - bias(model, placed, v if on["coriolis"] else 0 * v)
    for b in np.flatnonzero(world.xfrc_applied.any(axis=1)):
        linear, spin = jacobians(model, placed, b, placed.com[b])
        force = force + world.xfrc_applied[b, :3] @ linear + world.xfrc_applied[b, 3:] @ spin
    for index, body in enumerate(model.scene["bodies"]):
        if body["gravcomp"] and on["gravity"] and (on["spring"] or on["damper"]):
            linear, _ = jacobians(model, placed, index, placed.com[index])
            force = force - body["gravcomp"] * model.mass[index] * model.gravity @ linear
    for joint in model.joints:
        own = slice(joint["dof"], joint["dof"] + joint["width"])
        if on["damper"]:
            force[own] += damper_force(joint, v[own])
        if any(joint["stiffness"]) and on["spring"]:
            for part in parts(joint):
                force[own][part] += spring_force(joint, stretch(model, joint, qpos)[part])
    for actuator, bias_, signal in zip(
        model.scene["actuators"], model.actuator_bias, world.ctrl, strict=True
    ):
        if on["actuation"]:
            joint = model.joints[actuator["target"]["joint"]]
            if actuator["ctrlrange"] is not None and on["clampctrl"]:
                signal = np.clip(signal, *actuator["ctrlrange"])
            signal = actuator["gain"][0] * signal + bias_[0]
            if bias_[1:].any():  # of hinges and slides only
                gear = actuator["gear"][0]
                signal += gear * (bias_[1] * qpos[joint["qpos"]] + bias_[2] * v[joint["dof"]])
            if actuator["forcerange"] is not None:
                signal = np.clip(signal, *actuator["forcerange"])
            own = slice(joint["dof"], joint["dof"] + joint["width"])
            force[own] += np.array(actuator["gear"][: joint["width"]]) * signal
    return force


class Energy(NamedTuple):
    """Energy [J]."""

    kinetic: float
    potential: float


def energy(model: Model, qpos: Array, v: Array) -> Energy:
    """v M v / 2, and the height of every mass and the stretch of every spring."""
    placed = place(model, qpos)
    potential = -float(model.mass @ (placed.com @ model.gravity))
    for joint in model.joints:
        if any(joint["stiffness"]) and model.scene["features"]["spring"]:
            for part in parts(joint):
                potential += spring_energy(joint, stretch(model, joint, qpos)[part])
    return Energy(0.5 * float(v @ mass_matrix(model, placed) @ v), potential)
