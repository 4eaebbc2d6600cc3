"""`Batch.reset(worlds=…)`: some worlds begin anew, the others keep their bits."""

import numpy as np
import pytest

import stepcore as sc

BOX = """<mujoco><worldbody><geom type="plane" size="1 1 1"/>
<body pos="0 0 0.1"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body></worldbody>
<keyframe><key name="high" time="2" qpos="0 0 1 1 0 0 0"/></keyframe></mujoco>"""


def started(n, **how):
    batch = sc.Batch(sc.loads(BOX), n, **how)
    batch.qvel[:, 0] = np.linspace(0.1, 1, n)
    batch.qvel[:, 2] = -1
    batch.step(30)
    return batch


@pytest.mark.parametrize("how", [{}, {"lanes": False}, {"threads": 2}])
def test_reset_worlds_are_new_and_the_others_are_as_without(how):
    n, chosen = 11, [2, 3, 10]
    batch, other = started(n, **how), started(n, **how)
    qvel = np.random.default_rng(0).normal(size=(3, 6))
    batch.reset(worlds=chosen, qvel=qvel)
    assert batch.time == other.time
    batch.step(40)
    other.step(40)
    rest = np.setdiff1d(np.arange(n), chosen)
    assert np.array_equal(batch.qpos[rest], other.qpos[rest])
    for world, velocity in zip(chosen, qvel, strict=True):
        sim = sc.Sim(batch.model)
        sim.qvel = velocity
        sim.step(40)
        assert np.array_equal(batch.qpos[world], sim.qpos)
        assert np.array_equal(batch.qvel[world], sim.qvel)


def test_masks_keys_and_all_worlds():
    batch = started(4)
    batch.ctrl[:], batch.xfrc_applied[:] = 0, 1
    batch.reset("high", worlds=np.array([True, False, False, True]))
    assert batch.qpos[:, 2].round(6).tolist()[::3] == [1, 1]
    assert batch.xfrc_applied[:, 1, 0].tolist() == [0, 1, 1, 0]
    batch.reset(worlds=[])
    assert batch.qpos[1, 2] < 0.2
    batch.reset("high")
    assert (batch.qpos[:, 2] == 1).all()
    assert batch.time == 2
    batch.reset(qpos=[0, 0, 3, 1, 0, 0, 0])
    assert (batch.qpos[:, 2] == 3).all()
    assert batch.time == 0
    assert not batch.qvel.any()


def test_a_failed_world_moves_again_after_its_reset():
    batch = sc.Batch(sc.loads(BOX), 3, on_failure="go on")
    batch.qvel[1, 3] = 1e200
    batch.step(5)
    assert list(batch.failures) == [1]
    batch.reset(worlds=[1])
    assert batch.failures == {}
    batch.step(5)
    sim = sc.Sim(batch.model)
    sim.step(5)
    assert np.array_equal(batch.qpos[1], sim.qpos)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"worlds": [3]}, "worlds = .*indices from 0 to 2"),
        ({"worlds": [1, 1]}, "different indices"),
        ({"worlds": [True, False]}, r"mask of shape \(3,\)"),
        ({"worlds": 1.5}, "worlds = 1.5"),
        ({"worlds": [0], "qpos": np.zeros((2, 7))}, r"qpos has shape \(2, 7\)"),
        ({"qvel": np.zeros(5)}, r"qvel has shape \(5,\)"),
        ({"qvel": [np.nan] * 6}, "qvel: must be finite"),
        ({"key": "low", "worlds": [0]}, 'nearest|known|"high"'),
    ],
)
def test_bad_arguments_change_nothing(given, text):
    batch = started(3)
    before = batch.state()
    with pytest.raises(ValueError, match=text):
        batch.reset(**given)
    assert batch.state() == before
