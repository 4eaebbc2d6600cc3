"""Reading and compiling leave Python's garbage collector as they found it."""

import gc

import pytest

import stepcore as sc
from stepcore.scene import gc_pause


@pytest.mark.parametrize("searches", [True, False])
def test_the_collector_is_as_before(searches):
    before = gc.isenabled()
    (gc.enable if searches else gc.disable)()
    try:
        with gc_pause.paused():
            assert not gc.isenabled()
        assert gc.isenabled() == searches
        scene = sc.loads("<mujoco><worldbody><geom size='.1'/></worldbody></mujoco>")
        scene.compile()
        for wrong in ("<mujoco", "<mujoco><worldbody><geom size='x'/></worldbody></mujoco>"):
            with pytest.raises(ValueError):
                sc.loads(wrong)
        scene.add_geom("world", "sphere", 0.1, name="a", mass=1.0)
        scene.geoms[0].type = "mesh"
        with pytest.raises(ValueError):
            scene.compile()
        assert gc.isenabled() == searches
    finally:
        (gc.enable if before else gc.disable)()
