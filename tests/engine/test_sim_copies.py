"""`Sim.copy` and `Batch.copy`, and the readouts under MuJoCo's names."""

import copy
import pickle

import numpy as np
import pytest

import stepcore as sc

NAMES = {
    "M": "mass_matrix",
    "qfrc_bias": "bias",
    "qfrc_passive": "passive",
    "qfrc_constraint": "constraint_force",
}


@pytest.fixture(scope="module")
def model():
    return sc.load("gymnasium:hopper").compile()


def started(world):
    world.qvel[:] = 0.3
    world.ctrl[:] = 0.5
    world.qfrc_applied[..., 1] = 2.0
    world.xfrc_applied[..., 2, 0] = 5.0
    world.step(40)
    return world


@pytest.mark.parametrize("make", [sc.Sim, lambda model: sc.Batch(model, 3)], ids=["Sim", "Batch"])
def test_a_copy_goes_on_with_the_same_bits_and_by_itself(model, make):
    world = started(make(model))
    other = world.copy()
    before = world.state()
    other.step(25)
    assert world.state() == before and other.state() != before
    world.step(25)
    assert world.state() == other.state()
    assert type(other) is type(world) and other.model is not None
    assert other.settings == world.settings and repr(other) == repr(world)
    other.ctrl[:] = 0.0
    assert np.all(world.ctrl == 0.5)


@pytest.mark.parametrize("make", [sc.Sim, lambda model: sc.Batch(model, 3)], ids=["Sim", "Batch"])
@pytest.mark.parametrize("mujoco, own", NAMES.items())
def test_mujocos_names_read_the_same_numbers(model, make, mujoco, own):
    world = started(make(model))
    ours = getattr(world, own)
    np.testing.assert_array_equal(getattr(world, mujoco), ours() if callable(ours) else ours)
    with pytest.raises(AttributeError, match=f"{mujoco} of a .* is read-only"):
        setattr(world, mujoco, 0)


@pytest.mark.parametrize(
    "name, text",
    [
        ("bodymass", 'a Model has no "bodymass"; nearest: "body_mass"'),
        ("npair", "npair of a Model is read-only"),
        ("body_mass", "body_mass of a Model is read-only"),
    ],
)
def test_a_model_is_not_written_to(model, name, text):
    with pytest.raises(AttributeError, match=text):
        setattr(model, name, 1)


@pytest.mark.parametrize("name", ["qfrc_bias", "qfrc_passive", "qfrc_constraint"])
def test_mujocos_names_are_recorded_with_their_dofs(model, name):
    run = sc.Sim(model).run(0.02, record=(name, NAMES[name]))
    np.testing.assert_array_equal(run[name], run[NAMES[name]])
    assert run.axes(name) == run.axes(NAMES[name])


def test_a_clock_tells_the_time_of_the_last_solve_in_every_copy():
    """It is no number of the state; once it read 0 in copies."""
    scene = sc.loads("""<mujoco><worldbody><body><joint/><geom size=".1"/></body></worldbody>
      <sensor><clock/></sensor></mujoco>""")
    sim = sc.Sim(scene, dt=0.01)
    sim.step(5)
    assert sim.sensordata == pytest.approx(0.04)
    for made in (sim.copy(), pickle.loads(pickle.dumps(sim)), copy.deepcopy(sim)):
        assert made.sensordata == sim.sensordata
    batch = sc.Batch(scene, 3, dt=0.01)
    batch.step(5)
    for made in (batch.copy(), pickle.loads(pickle.dumps(batch))):
        assert np.array_equal(made.sensordata, batch.sensordata)
