"""Real arms under servos are predictable, as plain loops in both engines show, and scored whole."""

import math

import menagerie
import mujoco
import numpy as np
import pytest

import stepcore as sc

pytestmark = menagerie.needed

ARMS = [menagerie.UR5E, menagerie.PANDA, menagerie.SO101]
HORIZON, APART = 0.4, 1e-8


def waved(model):
    """Return controls that wave around those of the keyframe, or around 0."""
    held = np.array(model.keys[0].ctrl) if model.keys else np.zeros(model.nu)
    low, high = model.actuator_ctrlrange.T
    wide = np.where(np.isfinite(high - low), 0.05 * (high - low), 0.05)
    return lambda time, sim=None: held + wide * np.sin(5 * time + np.arange(model.nu))


def grown(step, qpos, period):
    """Return the largest growth of a difference between two runs, each a function of time."""
    most = 0.0
    for time in np.arange(0.0, HORIZON, period):
        for run in step:
            run(time)
        most = max(most, float(np.abs(qpos[0] - qpos[1]).max()) / APART)
    return most


def grown_in_stepcore(model, control):
    period = model.settings.dt
    sims = [sc.Sim(model, dt=period / 16, integrator="implicitfast") for _ in "ab"]
    for sim in sims:
        sim.reset(0 if model.keys else None)
    sims[1].qpos[:] += APART

    def step(sim, time):
        sim.ctrl[:] = control(time)
        sim.step(16)

    return grown([lambda t, s=s: step(s, t) for s in sims], [sim.qpos for sim in sims], period)


def grown_in_mujoco(path, control):
    model = mujoco.MjModel.from_xml_path(str(path))
    period = model.opt.timestep
    model.opt.timestep, model.opt.integrator = period / 16, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    both = [mujoco.MjData(model) for _ in "ab"]
    for data in both:
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, data, 0)
    both[1].qpos[:] += APART

    def step(data, time):
        data.ctrl[:] = control(time)
        mujoco.mj_step(model, data, 16)

    return grown([lambda t, d=d: step(d, t) for d in both], [data.qpos for data in both], period)


@pytest.mark.parametrize("path", ARMS, ids=lambda path: path.stem)
def test_an_arm_is_predictable_and_scored_to_the_end(path):
    model = sc.load(path).compile()
    control = waved(model)
    assert grown_in_stepcore(model, control) < 100 and grown_in_mujoco(path, control) < 100
    how = {"control": control, "control_dt": model.settings.dt}
    how |= {"horizon": HORIZON, "progress": False}
    found = sc.predict(model, starts=2, **how)
    assert math.isinf(found.time) and found.growth.factor.max() < 100
    traded = sc.trade(model, starts=2, further=0, error=1e-3, by="flops", **how)
    assert traded.reference.scored.all() and "over 400 ms" in traded.text()
