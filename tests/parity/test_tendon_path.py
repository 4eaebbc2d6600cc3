"""The way of a spatial tendon, against MuJoCo's points, its length, and the surface of the geom."""

import mujoco
import numpy as np
import pytest

import stepcore as sc

MODEL = """
<mujoco><worldbody>
<site name="a" pos="-1 0 1"/><site name="d" pos="1 .3 .9"/>
<body name="wheel" pos="0 0 1"><joint axis="0 1 0"/><geom name="wheel" type="{kind}"
  size=".3 .5" euler="90 0 0" contype="0" conaffinity="0" mass="1"/>
  <site name="s" pos="{side}"/></body>
<body name="load" pos=".8 .1 .8"><joint type="slide" axis="1 0 0"/>
  <joint type="slide" axis="0 0 1"/><geom size=".05" mass="1"/><site name="b"/></body>
</worldbody><tendon><spatial name="rope"><site site="a"/><geom geom="wheel"{uses}/><site site="b"/>
<pulley divisor="2"/><site site="b"/><site site="d"/></spatial></tendon></mujoco>"""
USES = ' sidesite="s"'
CASES = [("cylinder", "0 0 .6", USES), ("sphere", "0 0 .6", USES), ("sphere", "0 0 -.6", USES)]
CASES += [("cylinder", "0 0 .6", ""), ("cylinder", "0 0 .1", USES), ("sphere", "0 0 .1", USES)]


@pytest.mark.parametrize(("kind", "side", "uses"), CASES)
def test_the_way_is_mujocos(kind, side, uses):
    text = MODEL.format(kind=kind, side=side, uses=uses)
    sim, model = sc.Sim(sc.loads(text)), mujoco.MjModel.from_xml_string(text)
    data, random, touched = mujoco.MjData(model), np.random.default_rng(7), 0
    for _ in range(40):
        data.qpos[:] = sim.qpos[:] = random.normal(0, 0.4, 3)
        mujoco.mj_forward(model, data)
        first, second = sim.tendon_path("rope")
        lengths = [np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for way in (first, second)]
        # An arc of eight pieces is at most 3 % shorter than its circle, for half a turn.
        assert lengths[0] + lengths[1] / 2 == pytest.approx(data.ten_length[0], rel=0.03)
        points = data.wrap_xpos.reshape(-1, 3)
        assert np.allclose(first[[0, -1]], [data.site("a").xpos, data.site("b").xpos], atol=1e-12)
        assert np.allclose(second, [data.site("b").xpos, data.site("d").xpos], atol=1e-12)
        if data.ten_wrapnum[0] > 5:
            touched += 1
            assert np.allclose(first[[1, -2]], points[1:3], atol=1e-9)
            away = first[1:-1] - data.geom("wheel").xpos
            if kind == "cylinder":
                axis = data.geom("wheel").xmat.reshape(3, 3)[:, 2]
                away -= np.outer(away @ axis, axis)
            assert np.linalg.norm(away, axis=1) == pytest.approx(0.3)
    assert touched > 3


def test_a_fixed_tendon_has_no_way():
    text = '<mujoco><worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody>'
    text += '<tendon><fixed name="f"><joint joint="j" coef="1"/></fixed></tendon></mujoco>'
    sim = sc.Sim(sc.loads(text))
    assert sim.tendon_path("f") == []
    with pytest.raises(ValueError, match="no tendon"):
        sim.tendon_path("g")
