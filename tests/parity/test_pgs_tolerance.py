"""The tolerance of a file's PGS: as few sweeps as MuJoCo's, and as near to the solution."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import stepcore as sc
from stepcore.loading import find_asset

FALLEN = ("humanoidstandup", "humanoid")


def apart(found, exact) -> float:
    return np.abs(np.asarray(found) - exact).max() / np.abs(exact).max()


def mujocos(path: str, ctrl: np.ndarray):
    """A state on the floor, and MuJoCo's errors and sweeps in steps under these controls."""
    model = mujoco.MjModel.from_xml_path(path)
    exact = mujoco.MjModel.from_xml_path(path)
    exact.opt.solver, exact.opt.tolerance = mujoco.mjtSolver.mjSOL_NEWTON, 0
    data, there = mujoco.MjData(model), mujoco.MjData(exact)
    mujoco.mj_step(model, data, 500)
    start, errors, sweeps = (data.qpos.copy(), data.qvel.copy()), [], []
    for data.ctrl[:] in ctrl:
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        sweeps.append(data.solver_niter[0])
        there.qpos[:], there.qvel[:], there.ctrl[:] = data.qpos, data.qvel, data.ctrl
        mujoco.mj_forward(exact, there)
        errors.append(apart(data.qacc, there.qacc))
    return start, errors, sweeps


@pytest.mark.parametrize("name", FALLEN)
def test_no_more_sweeps_and_no_larger_errors_than_mujocos(name: str) -> None:
    path = str(find_asset("gymnasium", name))
    model = sc.load(path).compile()
    ctrl = np.random.default_rng(0).uniform(-0.1, 0.1, (100, model.nu))
    (qpos, qvel), their_errors, their_sweeps = mujocos(path, ctrl)
    assert model.settings.cost_tolerance == 1e-8
    sim, exact = sc.Sim(model), sc.Sim(model, solver="newton", tolerance=1e-13, sweeps=200)
    sim.qpos, sim.qvel = qpos, qvel
    errors, sweeps = [], []
    for sim.ctrl[:] in ctrl:
        sim.step(1)
        sim.forward()
        sweeps.append(sim.sweeps_done)
        exact.qpos, exact.qvel, exact.ctrl = sim.qpos, sim.qvel, sim.ctrl
        exact.forward()
        errors.append(apart(sim.qacc, exact.qacc))
    assert np.mean(sweeps) <= np.mean(their_sweeps)
    for share in (0.5, 0.9):
        assert np.quantile(errors, share) <= np.quantile(their_errors, share)
    # A tolerance of 0 takes every sweep.
    every = sc.Sim(model, cost_tolerance=0.0, tolerance=0.0)
    every.qpos, every.qvel = qpos, qvel
    every.forward()
    assert every.sweeps_done == 50


@pytest.mark.parametrize(("said", "tolerance"), [("", 1e-8), ('tolerance="1e-5"', 1e-5)])
def test_what_a_file_says(said: str, tolerance: float) -> None:
    scene = sc.loads(f'<mujoco><option solver="PGS" {said}/></mujoco>')
    assert (scene.settings.cost_tolerance, scene.settings.acceleration) == (tolerance, "momentum")
    assert not any("tolerance" in note for note in scene.notes)
    scene = sc.loads(f'<mujoco><option noslip_iterations="4" {said}/></mujoco>')
    assert scene.settings.noslip_tolerance == 1e-6
    with pytest.raises(ValueError, match="tolerance"):
        sc.loads('<mujoco><option tolerance="-1"/></mujoco>')
