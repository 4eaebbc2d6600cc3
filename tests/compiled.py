"""A compiled model beside MuJoCo's: what exists, in which order, where, and how heavy."""

import mujoco
import numpy as np
import pytest

import stepcore as sc

KINDS = {
    "body": (mujoco.mjtObj.mjOBJ_BODY, "nbody"),
    "joint": (mujoco.mjtObj.mjOBJ_JOINT, "njnt"),
    "geom": (mujoco.mjtObj.mjOBJ_GEOM, "ngeom"),
    "site": (mujoco.mjtObj.mjOBJ_SITE, "nsite"),
    "actuator": (mujoco.mjtObj.mjOBJ_ACTUATOR, "nu"),
}


def names(model: mujoco.MjModel, kind: str) -> list[str]:
    """MuJoCo's names of this kind, in its order; "" for none."""
    objtype, count = KINDS[kind]
    found = (mujoco.mj_id2name(model, objtype, i) for i in range(getattr(model, count)))
    return [name or "" for name in found]


def inertias(model: mujoco.MjModel) -> np.ndarray:
    """MuJoCo's inertia tensors in body axes, (nbody, 3, 3)."""
    result = []
    for diagonal, quat in zip(model.body_inertia, model.body_iquat, strict=True):
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, quat)
        turn = turn.reshape(3, 3)
        result.append(turn @ np.diag(diagonal) @ turn.T)
    return np.array(result)


def compare(scene: sc.Scene, theirs: mujoco.MjModel) -> sc.Model:
    """Asserts that a scene compiles to MuJoCo's model; returns the model."""
    ours = scene.compile()
    for kind in KINDS:
        assert list(ours.names[kind]) == names(theirs, kind), kind
    assert list(ours.body_parent[1:]) == list(theirs.body_parentid[1:])
    assert list(ours.jnt_body) == list(theirs.jnt_bodyid)
    assert list(ours.geom_body) == list(theirs.geom_bodyid)
    close = {"rel": 1e-10, "abs": 1e-12}
    assert ours.qpos0 == pytest.approx(theirs.qpos0, **close)
    assert ours.body_mass == pytest.approx(theirs.body_mass, **close)
    moving = theirs.body_weldid != 0
    # A body without mass, beside children that have some, has no centre of mass.
    heavy = moving & (theirs.body_mass > 0)
    assert ours.body_ipos[heavy] == pytest.approx(theirs.body_ipos[heavy], **close)
    scale = np.abs(theirs.body_inertia).max(initial=1e-300)
    assert ours.body_inertia[moving] == pytest.approx(
        inertias(theirs)[moving], rel=1e-9, abs=1e-11 * scale
    )
    data = mujoco.MjData(theirs)
    mujoco.mj_kinematics(theirs, data)
    sim = sc.Sim(ours)
    sim.forward()
    assert sim.xpos == pytest.approx(data.xpos, **close)
    assert sim.xmat.reshape(-1, 9) == pytest.approx(data.xmat, **close)
    assert sim.geom_xpos == pytest.approx(data.geom_xpos, **close)
    assert sim.site_xpos == pytest.approx(data.site_xpos, **close)
    limited = theirs.jnt_limited.astype(bool)
    assert ours.jnt_range[limited] == pytest.approx(theirs.jnt_range[limited], **close)
    assert np.isinf(ours.jnt_range[~limited]).all()
    keys = [mujoco.mj_id2name(theirs, mujoco.mjtObj.mjOBJ_KEY, i) for i in range(theirs.nkey)]
    assert [key.name for key in scene.keys] == [name or "" for name in keys]
    for index in range(theirs.nkey):
        sim.reset(key=index)
        mujoco.mj_resetDataKeyframe(theirs, data, index)
        for field in ("qpos", "qvel", "ctrl"):
            assert getattr(sim, field) == pytest.approx(getattr(data, field), **close), field
    assert scene.settings.dt == theirs.opt.timestep
    assert scene.gravity == pytest.approx(theirs.opt.gravity)
    return ours
