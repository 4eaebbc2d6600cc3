"""The fourth stage of an rk4 step, where it last evaluates its forces.

After mj_step MuJoCo's poses and forces are of that place, while qpos and qvel have moved on; a
step of one stage has it where the step began. The stages are those of the engine's rk4
(commit/rk4.rs): rotations on the group, by Munthe-Kaas.
"""

from __future__ import annotations

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch
from stepcore.engine.coordinates import cross, product
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.scene.layout import DOFS, QPOS

# Where the second, third and fourth stage stand within a step.
REACHES = (0.5, 0.5, 1.0)


def go_to_last_stage(scratch: Sim | Batch, qpos: Floats, qvel: Floats) -> None:
    """Put `scratch` at the last stage of the step from these states, and evaluate it there.

    scratch: a world, or as many as there are states, with the controls of the step.
    """
    settings = scratch.settings
    dt, turns = settings.dt, _turns(scratch.model)
    scratch.qpos[...], scratch.qvel[...] = qpos, qvel
    rate = np.array(qvel)
    for reach in REACHES if settings.integrator == "rk4" else ():
        scratch.forward()
        # A world whose speeds overflow fails in its step; what is read here is not reported.
        with np.errstate(over="ignore", invalid="ignore"):
            turned = dt * reach * rate
            place = _advanced(turns, qpos, turned)
            speed = qvel + dt * reach * scratch.qacc
            scratch.qpos[...], scratch.qvel[...] = _finite(place, qpos), _finite(speed, qvel)
            rate = np.array(scratch.qvel)
            for _, dofs in turns:
                rate[..., dofs] = _dexp_inverse(turned[..., dofs], rate[..., dofs])
    scratch.forward()


def _finite(values: Floats, otherwise: Floats) -> Floats:
    return np.where(np.isfinite(values).all(axis=-1, keepdims=True), values, otherwise)


def _turns(model: Model) -> list[tuple[slice, slice]]:
    """Return the place of each quaternion in qpos and of its rate in qvel."""
    ends = [
        (int(q) + QPOS[kind], int(v) + DOFS[kind])
        for kind, q, v in zip(model.jnt_type, model.jnt_qposadr, model.jnt_dofadr, strict=True)
        if kind in ("ball", "free")
    ]
    return [(slice(q - 4, q), slice(v - 3, v)) for q, v in ends]


def _advanced(turns: list[tuple[slice, slice]], qpos: Floats, move: Floats) -> Floats:
    """Return qpos ⊕ move: shift positions, and rotate quaternions about the axes of the body."""
    lengths = np.ones(qpos.shape[-1], bool), np.ones(move.shape[-1], bool)
    for quat, dofs in turns:
        lengths[0][quat] = lengths[1][dofs] = False
    out = np.array(qpos)
    out[..., lengths[0]] += move[..., lengths[1]]
    for quat, dofs in turns:
        turn = move[..., dofs]
        angle = np.sqrt(np.sum(turn * turn, axis=-1, keepdims=True))
        by = [np.cos(angle / 2), np.sinc(angle / (2 * np.pi)) / 2 * turn]
        turned = product(qpos[..., quat], np.concatenate(by, axis=-1))
        out[..., quat] = turned / np.sqrt(np.sum(turned * turned, axis=-1, keepdims=True))
    return out


def _dexp_inverse(turned: Floats, rate: Floats) -> Floats:
    """dexp⁻¹(u) ω = ω + ½ u×ω + g u×(u×ω), g = (1 − (θ/2) cot(θ/2))/θ², θ = |u| ≤ π."""
    whole = np.sqrt(np.sum(turned * turned, axis=-1, keepdims=True))
    angle = np.abs(np.remainder(whole + np.pi, 2 * np.pi) - np.pi)
    back = np.remainder(whole, 2 * np.pi) > np.pi
    safe = np.where(whole == 0, 1.0, whole)
    u = turned * (np.where(back, -angle, angle) / safe)
    small = angle < 1e-2
    theta = np.where(small, 1.0, angle)
    square = angle * angle
    closed = (1 - theta / 2 / np.tan(theta / 2)) / (theta * theta)
    g = np.where(small, 1 / 12 + square / 720 + square * square / 30240, closed)
    first = cross(u, rate)
    return rate + first / 2 + g * cross(u, first)
