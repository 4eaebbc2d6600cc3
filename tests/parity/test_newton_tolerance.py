"""The tolerance of a file's Newton: as near to the solution as MuJoCo's, over pyramids as soon."""

from __future__ import annotations

import mujoco
import numpy as np
import peers
import pytest

import stepcore as sc
from stepcore.loading import find_asset

# Settled on the floor, then driven: rows come, go and slide. Each with both cones.
ROBOTS = (
    *(("gymnasium", name) for name in ("ant", "half_cheetah", "hopper", "humanoid", "walker2d")),
    *(("dm_control", name) for name in ("cheetah", "humanoid", "humanoid_CMU", "quadruped")),
)
STEPS, SETTLED = 60, 500
ROUNDING = 1e-9  # of the largest acceleration: what tiny regularisers leave


def apart(found, exact) -> float:
    return np.abs(np.asarray(found) - exact).max() / np.abs(exact).max()


def drives(nu: int) -> np.ndarray:
    """Controls that change every sixth step."""
    return np.repeat(np.random.default_rng(3).uniform(-0.5, 0.5, (STEPS // 6, nu)), 6, axis=0)


def mujocos(model: mujoco.MjModel, exact: mujoco.MjModel):
    """States of a driven run, and MuJoCo's errors and iterations there."""
    data, there = mujoco.MjData(model), mujoco.MjData(exact)
    mujoco.mj_step(model, data, SETTLED)
    states, errors, iterations = [], [], []
    for data.ctrl[:] in drives(model.nu):
        states.append((data.qpos.copy(), data.qvel.copy(), data.act.copy(), data.ctrl.copy()))
        there.qpos[:], there.qvel[:], there.act[:], there.ctrl[:] = states[-1]
        mujoco.mj_forward(exact, there)
        mujoco.mj_step(model, data)
        errors.append(apart(data.qacc, there.qacc))
        iterations.append(data.solver_niter[: max(data.nisland, 1)].max())
    return states, errors, iterations


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize(("package", "name"), ROBOTS)
def test_no_larger_errors_and_no_more_iterations_than_mujocos(package, name, cone) -> None:
    path = str(find_asset(package, name))
    models = [mujoco.MjModel.from_xml_path(path) for _ in range(2)]
    for model in models:
        model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        model.opt.cone = peers.CONES[cone]
    states, their_errors, their_iterations = mujocos(models[0], peers.strict(models[1]))
    compiled = sc.load(path).compile()
    asked = {"solver": "newton", "integrator": "euler", "cone": cone}
    sim = sc.Sim(compiled, **asked, cost_tolerance=models[0].opt.tolerance)
    exact = sc.Sim(compiled, **{**asked, **peers.EXACT})
    errors, iterations = [], []
    for state in states:
        for one in (sim, exact):
            one.qpos, one.qvel, one.act, one.ctrl = state
        exact.forward()
        sim.step(1)
        errors.append(apart(sim.qacc, exact.qacc))
        iterations.append(sim.sweeps_done)
    for share in (0.5, 0.9, 1.0):
        assert np.quantile(errors, share) <= max(np.quantile(their_errors, share), ROUNDING)
    if cone == "pyramidal":
        assert np.mean(iterations) <= np.mean(their_iterations)


@pytest.mark.parametrize(("said", "tolerance"), [("", 0.0), ('tolerance="1e-5"', 1e-5)])
def test_what_a_file_and_a_user_say(said: str, tolerance: float) -> None:
    scene = sc.loads(f"<mujoco><option {said}/></mujoco>")
    assert scene.settings.cost_tolerance == tolerance
    assert not any("tolerance" in note for note in scene.notes)
    # A residual that somebody asks for takes its place.
    assert scene.settings.replace(tolerance=1e-6).cost_tolerance == 0.0
    assert scene.with_settings(tolerance=1e-6).settings.cost_tolerance == 0.0
    assert scene.settings.replace(tolerance=1e-6, cost_tolerance=1e-3).cost_tolerance == 1e-3
    assert sc.Settings().cost_tolerance == 0.0
