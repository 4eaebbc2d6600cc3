"""What is read of the last step or `forward`: it is that solve's, and reading changes nothing."""

import numpy as np
import pytest
from zoo import ZOO

import stepcore as sc

READ = ("cfrc_int", "cfrc_ext", "cacc", "sensordata", "actuator_force", "constraint_force", "qacc")


def moving(name, **settings):
    entry = ZOO[name]
    model = sc.loads(entry.text).compile()
    sim = sc.Sim(model, **settings)
    rng = np.random.default_rng(1)
    sim.qvel[:] = 0.3 * rng.normal(size=model.nv)
    return model, sim, rng


@pytest.mark.parametrize("integrator", ["euler", "implicitfast", "implicit", "discrete", "rk4"])
@pytest.mark.parametrize("name", list(ZOO)[::5])
def test_reading_changes_nothing_and_is_of_the_step(name, integrator):
    """A batch solves again for what it reads, and has the same bits."""
    model, sim, rng = moving(name, integrator=integrator)
    unread, batch = sim.copy(), sc.Batch(model, 1, integrator=integrator)
    batch.qvel[:] = sim.qvel
    for _ in range(8):
        ctrl = rng.uniform(-1, 1, model.nu)
        for each in (sim, unread, batch):
            each.ctrl[...] = ctrl
            each.step(1)
        # What is written after the step is none of it.
        sim.ctrl[:] = 7
        first = {field: np.array(getattr(sim, field)) for field in READ}
        for field in READ:
            assert np.array_equal(first[field], getattr(batch, field)[0]), field
        sim.ctrl[:] = ctrl
        assert all(np.array_equal(first[field], getattr(sim, field)) for field in READ)
        assert sim.state() == unread.state()


@pytest.mark.parametrize("between", ["balance", "linearize", "element_slopes", "time", "step 0"])
def test_it_is_still_read_after_something_else_was_computed(between):
    _, sim, _ = moving("all_together")
    sim.step(3)
    wanted = {field: np.array(getattr(sim, field)) for field in READ}
    forces = sim.element_forces()
    sim.ctrl[:] = 0.5
    sim.qpos[:1] += 0.0
    sim.qvel[:] *= 0.5
    if between == "time":
        sim.time = 3.0
    elif between == "step 0":
        sim.step(0)
    else:
        getattr(sim, between)()
    for field, value in wanted.items():
        assert np.array_equal(getattr(sim, field), value), field
    again = sim.element_forces()
    assert forces.keys() == again.keys()
    assert all(np.array_equal(forces[key], again[key]) for key in forces)
