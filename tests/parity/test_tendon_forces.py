"""What spatial tendons do to bodies, and equalities of what cannot move, against MuJoCo.

Law: cfrc_ext, cfrc_int and sensors of force and torque are MuJoCo's to 1e-9 of the largest.
"""

import mujoco
import numpy as np
import peers
import pytest

import stepcore as sc

SCENE = """
<mujoco>
  <option timestep=".002" iterations="200" tolerance="1e-14"/>
  <worldbody>
    <site name="wall" pos="0 .1 1"/>
    <body name="a" pos="0 0 .5"><freejoint/><geom size=".1" mass="1"/>
      <site name="s1" pos=".05 0 0"/>
      <body name="b" pos=".3 0 0"><joint axis="0 1 0"/>
        <geom type="capsule" size=".05 .2" mass=".5"/>
        <site name="s2" pos="0 0 .2"/><site name="side" pos=".15 0 .2"/>
        <geom name="drum" type="cylinder" size=".04 .1" pos=".1 0 .1" euler="90 0 0" mass=".1"/>
        <geom name="ball" size=".06" pos=".1 0 .1" mass=".1"/></body></body>
    <body name="c" pos="0 1 .5"><freejoint/><geom size=".1" mass="2"/>
      <site name="s3" pos="0 0 .1"/></body>
  </worldbody>
  <tendon>
    <spatial name="rope" {rope}><site site="wall"/><site site="s1"/>{way}<site site="s3"/></spatial>
    <spatial name="line"><site site="wall"/><site site="s1"/><pulley divisor="2"/>
      <site site="s2"/><site site="s3"/>
    </spatial>
  </tendon>
  {more}
  <sensor><force site="s1"/><torque site="s2"/><torque site="s3"/></sensor>
</mujoco>
"""
WAYS = {
    "sites": '<site site="s2"/>',
    "drum": '<geom geom="drum"/>',
    "side": '<geom geom="drum" sidesite="side"/>',
    "ball": '<geom geom="ball" sidesite="side"/><site site="s2"/>',
}
ROPES = {
    "spring": ('stiffness="100 20" springlength="1"', ""),
    "damper": ('damping="30 2"', ""),
    "motor": ("", '<actuator><motor tendon="rope" gear="3"/></actuator>'),
    "limit": ('limited="true" range="0 .5"', ""),
    "friction": ('frictionloss="3"', ""),
    "equality": (
        "",
        '<equality><tendon tendon1="rope" tendon2="line" polycoef=".1 .5 2"/></equality>',
    ),
}
ARMATURE = {"armature": ('armature="3" stiffness="10"', "")}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("rope", ROPES)
def test_forces(rope, way):
    check(*ROPES[rope], WAYS[way])


def test_armature():
    check(*ARMATURE["armature"], WAYS["sites"])


def check(rope, more, way):
    text = SCENE.format(rope=rope, more=more, way=way)
    theirs = mujoco.MjModel.from_xml_string(text)
    data, sim = mujoco.MjData(theirs), sc.Sim(sc.loads(text), **peers.EXACT)
    rng = np.random.default_rng(1)
    for _ in range(20):
        mujoco.mj_resetData(theirs, data)
        peers.nudge(theirs, data.qpos, rng, 0.2)
        data.qvel[:] = rng.normal(size=theirs.nv)
        data.ctrl[:] = rng.normal(size=theirs.nu)
        for field in ("qpos", "qvel", "ctrl"):
            getattr(sim, field)[:] = getattr(data, field)
        mujoco.mj_forward(theirs, data)
        mujoco.mj_rnePostConstraint(theirs, data)
        sim.forward()
        assert sim.sensordata == peers_approx(data.sensordata)
        for field in ("cfrc_ext", "cfrc_int"):
            assert getattr(sim, field)[1:] == peers_approx(getattr(data, field)[1:]), field


def peers_approx(want):
    return pytest.approx(want, abs=1e-9 * max(1.0, np.abs(want).max()))


def test_equalities_of_what_cannot_move_have_no_rows():
    text = """<mujoco><worldbody>
        <body name="a" pos="1 0 0"><geom size=".1"/></body><body name="b"><geom size=".1"/></body>
        <body><joint name="j" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/></body></worldbody>
      <equality><connect body1="a" body2="b" anchor="0 0 0"/><weld body1="a" body2="b"/>
        <joint joint1="j"/></equality></mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(theirs)
    batch = sc.Batch(sc.loads(text), 9, **peers.EXACT)
    for _ in range(20):
        mujoco.mj_step(theirs, data)
    batch.step(20)
    assert data.nefc == 1 and len(batch.rows[0]) == 1
    assert batch.qpos == pytest.approx(np.repeat(data.qpos[None], 9, axis=0), abs=1e-9)


def test_actuators_without_actuation_have_no_velocity():
    text = """<mujoco><option><flag actuation="disable"/></option><worldbody>
        <body><joint name="j" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/></body></worldbody>
      <actuator><position name="p" joint="j" gear="2"/></actuator>
      <sensor><actuatorpos actuator="p"/><actuatorvel actuator="p"/></sensor></mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(text)
    data, sim = mujoco.MjData(theirs), sc.Sim(sc.loads(text))
    for one in (data, sim):
        one.qpos[0], one.qvel[0] = 0.3, 0.7
    mujoco.mj_forward(theirs, data)
    sim.forward()
    assert sim.actuator_length == pytest.approx(data.actuator_length)
    assert sim.actuator_velocity[0] == data.actuator_velocity[0] == 0
    assert sim.sensordata == pytest.approx(data.sensordata)
