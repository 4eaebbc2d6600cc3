"""MuJoCo's side: a motion to repeat, and how far its solver is from the solution."""

from __future__ import annotations

from dataclasses import dataclass

import c_loop
import mujoco
import numpy as np

INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
}
SOLVERS = {
    "pgs": mujoco.mjtSolver.mjSOL_PGS,
    "newton": mujoco.mjtSolver.mjSOL_NEWTON,
    "cg": mujoco.mjtSolver.mjSOL_CG,
}
# What a start consists of, by the name that both engines give it.
STARTED = ("qpos", "qvel", "ctrl", "act", "mocap_pos", "mocap_quat")
# MuJoCo would write its warnings to a file in the working directory.
mujoco.set_mju_user_warning(lambda text: None)


@dataclass(frozen=True)
class Motion:
    """What both sides repeat: from each start, blocks of `hold` steps with constant control.

    states: MuJoCo's, shape (starts, size). starts, before: `STARTED` at these and one step earlier,
    each of shape (starts, …). ctrl: shape (starts, blocks, nu).
    """

    states: np.ndarray
    starts: dict[str, np.ndarray]
    before: dict[str, np.ndarray]
    ctrl: np.ndarray
    hold: int

    @property
    def steps(self) -> int:
        return self.ctrl.shape[0] * self.ctrl.shape[1] * self.hold


def shipped_integrator(model: mujoco.MjModel) -> str:
    """Our name of the integrator that the model's file asks for."""
    return next(name for name, value in INTEGRATORS.items() if value == model.opt.integrator)


def configure(model: mujoco.MjModel, integrator: str, solver: str) -> None:
    """The named integrator and solver; iterations and tolerance as shipped."""
    model.opt.integrator = INTEGRATORS[integrator]
    model.opt.solver = SOLVERS[solver]


def record(
    model: mujoco.MjModel,
    starts: int,
    blocks: int,
    hold: int,
    settle: int = 0,
    seed: int = 7,
    noise: float | None = None,
) -> Motion:
    """A run with seeded controls from the first keyframe or a seeded pose, cut into starts.

    settle: steps before the first start, so that a body that falls has landed. noise: the controls
    are the keyframe's, give or take this share of their range; by default they fill the range.
    """
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    elif settle:
        hinges = model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE]
        data.qpos[hinges] += rng.normal(0.0, 0.02, len(hinges))
    limited = model.actuator_ctrllimited.astype(bool)
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -1.0)
    high = np.where(limited, model.actuator_ctrlrange[:, 1], 1.0)
    if noise is not None:
        low, high = data.ctrl - noise * (high - low), data.ctrl + noise * (high - low)
    for _ in range(-(-settle // hold)):
        data.ctrl[:] = rng.uniform(low, high)
        mujoco.mj_step(model, data, nstep=hold)
    states, at_start, before = [], [], []
    ctrl = rng.uniform(low, high, (starts, blocks, model.nu))
    earlier = _start(data)
    for own in ctrl:
        states.append(np.empty(mujoco.mj_stateSize(model, c_loop.STATE)))
        mujoco.mj_getState(model, data, states[-1], c_loop.STATE)
        at_start.append(_start(data))
        before.append(earlier)
        for u in own:
            data.ctrl[:] = u
            mujoco.mj_step(model, data, nstep=hold - 1)
            earlier = _start(data)
            mujoco.mj_step(model, data)
    if data.warning.number.any():
        warned = [mujoco.mjtWarning(k).name for k in np.flatnonzero(data.warning.number)]
        raise ValueError(f"no motion to compare: MuJoCo warned of {', '.join(warned)}")
    return Motion(np.array(states), _stacked(at_start), _stacked(before), ctrl, hold)


def _start(data: mujoco.MjData) -> dict[str, np.ndarray]:
    return {name: getattr(data, name).copy() for name in STARTED}


def _stacked(starts: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.array([start[name] for start in starts]) for name in STARTED}


def walk(model: mujoco.MjModel, data: mujoco.MjData, motion: Motion):
    """Steps the motion one step at a time; yields (start, step in it) after each."""
    for start, (state, own) in enumerate(zip(motion.states, motion.ctrl, strict=True)):
        mujoco.mj_setState(model, data, state, c_loop.STATE)
        for block, u in enumerate(own):
            data.ctrl[:] = u
            for step in range(motion.hold):
                mujoco.mj_step(model, data)
                yield start, block * motion.hold + step


def residual(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """`Sim.residual` for the rows of MuJoCo's last solve [m/s].

    MuJoCo's problem as velocities: impulse λ = h f, slack w = h (J (a_smooth + M⁻¹Jᵀf) + R f −
    a_ref), step s = A + R with A the diagonal of J M⁻¹ Jᵀ, and δ = λ − clamp(λ − w/s). The
    scalar is max |δ| √(A/m), m the mass of the trees that a row touches. Taken from MuJoCo's own
    rows: of two edges that are copies of one another each counts by itself, where stepcore has
    folded them into one row. Frictionless and pyramidal rows only.
    """
    if data.nefc == 0:
        return 0.0
    kinds = mujoco.mjtConstraint
    if (data.efc_type == kinds.mjCNSTR_CONTACT_ELLIPTIC).any():
        raise ValueError("cone 'elliptic': this residual is for pyramids")
    h = model.opt.timestep
    jacobian = rows(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    moved = np.linalg.solve(mass, jacobian.T)  # M⁻¹Jᵀ
    diagonal = np.einsum("ij,ji->i", jacobian, moved)
    impulse = h * data.efc_force
    after = data.qacc_smooth + moved @ data.efc_force
    slack = h * (jacobian @ after + data.efc_R * data.efc_force - data.efc_aref)
    low = np.zeros(data.nefc)
    high = np.full(data.nefc, np.inf)
    low[data.efc_type == kinds.mjCNSTR_EQUALITY] = -np.inf
    loss = data.efc_type == kinds.mjCNSTR_FRICTION_DOF
    high[loss] = h * data.efc_frictionloss[loss]
    low[loss] = -high[loss]
    delta = impulse - np.clip(impulse - slack / (diagonal + data.efc_R), low, high)
    return float((np.abs(delta) * np.sqrt(diagonal / _masses(model, jacobian))).max())


def rows(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """The rows' Jacobian, dense, shape (nefc, nv)."""
    if not mujoco.mj_isSparse(model):
        return data.efc_J.reshape(-1, model.nv)[: data.nefc]
    full = np.zeros((data.nefc, model.nv))
    layout = (data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    mujoco.mju_sparse2dense(full, data.efc_J.ravel(), *layout)
    return full


def _masses(model: mujoco.MjModel, jacobian: np.ndarray) -> np.ndarray:
    """Mass of the trees that each row touches [kg]."""
    bodies = model.body_treeid >= 0
    of_tree = np.bincount(model.body_treeid[bodies], model.body_mass[bodies], model.ntree)
    touched = np.zeros((len(jacobian), model.ntree), dtype=bool)
    for tree in range(model.ntree):
        touched[:, tree] = (jacobian[:, model.dof_treeid == tree] != 0.0).any(axis=1)
    return touched @ of_tree
