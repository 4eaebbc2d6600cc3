"""Newton's iterations may be few, as in files for MJX: a motion of one is near that of many.

Velocities from the impulses of an unfinished solve, instead of its own, doubled the speed here and
let several humanoids explode. (Under implicitfast MuJoCo has them from its forces, and explodes.)
"""

import mujoco
import numpy as np
import pytest

import stepcore as sc
from stepcore.loading import find_asset

STEPS = 200


def speeds(sweeps: int, integrator: str) -> tuple[float, float]:
    """The largest speed of the humanoid under sines that throw it about, here and in MuJoCo."""
    model = mujoco.MjModel.from_xml_path(str(find_asset("gymnasium", "humanoid")))
    model.opt.solver, model.opt.iterations = mujoco.mjtSolver.mjSOL_NEWTON, sweeps
    if integrator == "euler":
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    else:
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.timestep = 0.005
    data, sim = mujoco.MjData(model), sc.Sim(sc.load(model).compile())
    assert (sim.settings.solver, sim.settings.sweeps) == ("newton", sweeps)
    rng = np.random.default_rng(0)
    phase, rate = rng.uniform(0, 6, model.nu), rng.uniform(2, 18, model.nu)
    most = [0.0, 0.0]
    for k in range(STEPS):
        sim.ctrl[:] = data.ctrl[:] = 0.4 * np.sin(rate * k * 0.005 + phase)
        mujoco.mj_step(model, data)
        sim.step()
        for side, of in enumerate((sim, data)):
            most[side] = max(most[side], float(np.abs(of.qvel).max()))
    return most[0], most[1]


@pytest.mark.parametrize("integrator", ["euler", "implicitfast"])
def test_a_motion_of_few_iterations_is_near_that_of_many(integrator: str) -> None:
    whole = speeds(100, integrator)
    assert whole[0] == pytest.approx(whole[1], rel=0.05)
    for sweeps in (1, 2, 3):
        assert speeds(sweeps, integrator)[0] == pytest.approx(whole[0], rel=0.15)
