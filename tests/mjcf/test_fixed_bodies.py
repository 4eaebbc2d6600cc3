"""A body that cannot move has the mass of all its geoms, so that a joint can set it free."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

import stepcore as sc

# 8 litres of a mesh that only draws, on a base that stands still.
CORNERS = "".join(f"v {x} {y} {z}\n" for x in (0, 0.2) for y in (0, 0.2) for z in (0, 0.2))
MODEL = """<mujoco><asset><mesh name="hull" file="hull.obj"/></asset><worldbody>
<geom type="mesh" mesh="hull" contype="0" conaffinity="0"/>
<body name="base">{free}<geom size=".05"/>
<geom type="mesh" mesh="hull" contype="0" conaffinity="0" group="2"/>
<body name="arm" pos="0 0 .3"><joint/><geom size=".1"/></body></body></worldbody></mujoco>"""


def model(tmp_path: Path, free: str = "") -> Path:
    (tmp_path / "hull.obj").write_text(CORNERS)
    file = tmp_path / "model.xml"
    file.write_text(MODEL.format(free=free))
    return file


def test_meshes_that_only_draw_weigh(tmp_path: Path) -> None:
    file = model(tmp_path)
    theirs, scene = mujoco.MjModel.from_xml_path(str(file)), sc.load(file)
    ours = scene.compile()
    assert ours.body_mass == pytest.approx(theirs.body_mass, rel=1e-6)
    assert ours.body_mass[1] == pytest.approx(8 + 1000 * 4 / 3 * np.pi * 0.05**3)
    # What stands on the world weighs nothing, and is not read.
    assert len(scene.geoms) == 3 and len(scene.ignored) == 1


def test_a_freed_body_moves_as_mujocos(tmp_path: Path) -> None:
    scene = sc.load(model(tmp_path))
    scene.add_joint("base", "free")
    file = model(tmp_path, "<freejoint/>")
    theirs = mujoco.MjModel.from_xml_path(str(file))
    data, sim = mujoco.MjData(theirs), sc.Sim(scene)
    data.qvel[:] = sim.qvel[:] = np.linspace(-1, 2, theirs.nv)
    data.qfrc_applied[:] = sim.qfrc_applied[:] = np.linspace(9, -5, theirs.nv)
    mujoco.mj_forward(theirs, data)
    sim.forward()
    # MuJoCo's corners are single numbers.
    np.testing.assert_allclose(sim.qacc, data.qacc, rtol=1e-5)
