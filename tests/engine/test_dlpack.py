"""State arrays are shared with other libraries without a copy: DLPack and Python's buffers."""

import gc

import numpy as np
import pytest

import stepcore as sc

TEXT = """<mujoco><worldbody><body pos="0 0 1"><joint name="turn" damping=".1"/>
<geom type="capsule" size=".05 .2"/></body></worldbody>
<actuator><motor joint="turn"/></actuator></mujoco>"""
WRITTEN = ("qpos", "qvel", "ctrl", "qfrc_applied", "xfrc_applied")


def made(kind):
    scene = sc.loads(TEXT)
    return sc.Sim(scene) if kind == "Sim" else sc.Batch(scene, 7, lanes=kind == "lanes")


@pytest.fixture(params=["Sim", "singly", "lanes"])
def world(request):
    return made(request.param)


@pytest.mark.parametrize("take", [np.from_dlpack, lambda array: np.asarray(memoryview(array))])
def test_a_view_is_the_worlds_own_memory(world, take):
    for name in WRITTEN:
        own = getattr(world, name)
        view = take(own)
        assert view.shape == own.shape and view.dtype == own.dtype
        assert view.__array_interface__["data"][0] == own.__array_interface__["data"][0], name


def test_what_is_written_through_a_view_is_stepped(world):
    qpos, ctrl = np.from_dlpack(world.qpos), np.from_dlpack(world.ctrl)
    before = qpos.copy()
    ctrl[:] = 1.0
    world.step(3)
    assert np.all(qpos > before)
    np.testing.assert_array_equal(qpos, world.qpos)
    world.reset()
    np.testing.assert_array_equal(qpos, before)


def test_a_view_outlives_its_world():
    world = made("lanes")
    view = np.from_dlpack(world.qpos)
    world.step(5)
    kept = view.copy()
    del world
    gc.collect()
    # What else is allocated now does not land in it.
    others = [np.full(7, np.nan) for _ in range(1000)]
    np.testing.assert_array_equal(view, kept)
    assert len(others) == 1000


def test_what_is_only_read_cannot_be_written_through_a_view(world):
    world.forward()
    assert not world.qacc.flags.writeable
    assert memoryview(world.qacc).readonly
    if np.lib.NumpyVersion(np.__version__) < "2.1.0":
        # DLPack before its version 1 cannot say that an array is only read.
        with pytest.raises(BufferError):
            np.from_dlpack(world.qacc)
    else:
        assert not np.from_dlpack(world.qacc).flags.writeable
