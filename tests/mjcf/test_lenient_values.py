"""Values that MuJoCo reads in files of users, and what they mean there."""

import mujoco
import numpy as np

import stepcore as sc

LOAD = """<mujoco><worldbody><geom type="plane" size="-1 -1 .1"/>
<body pos="0 0 1"><joint axis="1 0 0"/><geom size=".1"/>
<body pos="0 .1 -.3"><inertial pos="0 0 0" mass="2"/></body></body></worldbody></mujoco>"""


def test_a_point_without_joints_and_a_plane_of_negative_size() -> None:
    theirs, ours = mujoco.MjModel.from_xml_string(LOAD), sc.loads(LOAD).compile()
    data, sim = mujoco.MjData(theirs), sc.Sim(ours)
    data.qpos[:] = sim.qpos[:] = 0.3
    mujoco.mj_forward(theirs, data)
    sim.forward()
    np.testing.assert_allclose(sim.qacc, data.qacc, rtol=1e-12)
