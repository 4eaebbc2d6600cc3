"""A scene without a joint: it compiles, steps and can be read; there is nothing to measure."""

import pickle

import numpy as np
import pytest

import stepcore as sc

XML = '<mujoco><worldbody><geom name="rock" type="box" size="1 2 3"/></worldbody></mujoco>'


@pytest.mark.parametrize("integrator", ["explicit", "euler", "implicitfast", "rk4", "midpoint"])
@pytest.mark.parametrize("solver", ["pgs", "newton"])
def test_it_steps(integrator, solver):
    sim = sc.Sim(sc.loads(XML), integrator=integrator, solver=solver)
    sim.step(5)
    assert sim.time == pytest.approx(0.01)
    assert sim.qpos.shape == (0,) and len(sim.contacts) == len(sim.rows) == 0
    assert sim.energy.total == 0.0 and sim.residual == 0.0


def test_it_can_be_read_and_restored():
    sim = sc.Sim(sc.loads(XML), precision="f32")
    sim.step()
    assert sim.mass_matrix().shape == (0, 0)
    copy = pickle.loads(pickle.dumps(sim))
    copy.step()
    assert copy.time == pytest.approx(2 * sim.time)
    assert sim.geom_xpos == pytest.approx(np.zeros((1, 3)))


def test_batch():
    batch = sc.Batch(sc.loads(XML), 10)
    batch.step(3)
    assert batch.qpos.shape == (10, 0)


@pytest.mark.parametrize("measure", [sc.check, sc.trade, sc.diagnose, sc.ablate, sc.converge])
def test_measurements_say_so(measure):
    with pytest.raises(ValueError, match="nothing in it can move"):
        measure(sc.loads(XML))
