"""`implicit` and `discrete` against MuJoCo's steps of that name, which are other programs.

Where rows act, `discrete` differs: MuJoCo evaluates a row's spring at the end of the step too, and
leaves tendons and actuators out of the metric under PGS. Without rows both are the same step.
"""

import mujoco
import numpy as np
import peers
import pytest
from covering import every_pair

import stepcore as sc

ARM = """<mujoco><option timestep="{dt}" integrator="{integrator}">
 <flag constraint="disable"/></option>
<worldbody><body name="base" pos="0 0 1">
 <joint name="yaw" axis="0 0 1" stiffness="40" springref="20" damping="2"/>
 <geom size=".1" pos=".1 0 0" mass="2"/>
 <body name="upper" pos=".3 0 0"><joint name="lift" axis="0 1 0" damping=".4" stiffness="3 2 5"/>
  <geom type="capsule" size=".05" fromto="0 0 0 .3 0 .1" mass="1"/>
  <body name="wrist" pos=".3 0 .1"><joint name="ball" type="ball" damping=".05" stiffness=".7"/>
   <geom type="box" size=".1 .05 .02" pos=".05 0 0" mass=".5"/></body></body>
 <body name="side" pos="0 .3 0"><joint name="slide" type="slide" axis="0 1 .3" damping="1 .3"/>
  <joint name="roll" axis="1 0 0" stiffness="9"/>
  <geom type="box" size=".1 .1 .05" pos="0 .1 .1" mass=".7"/></body></body>
 <body name="free" pos="0 0 3"><freejoint/><geom type="box" size=".1 .2 .3" pos=".05 0 0"/></body>
 <body name="other" pos="2 0 0"><joint name="far" axis="0 1 0"/>
  <geom type="capsule" size=".05" fromto="0 0 0 .3 0 0" mass="1"/></body></worldbody>
<tendon>{tendons}</tendon>
<actuator><position joint="yaw" kp="300" kv="20"/><velocity joint="lift" kv="3"/>
 <general joint="roll" gainprm="50" biastype="affine" biasprm="1 -50 -4" gear="1.7"
  forcelimited="true" forcerange="-20 20"/>{actuators}</actuator></mujoco>"""
TENDONS = """
 <fixed name="branches" stiffness="70" damping="5"><joint joint="lift" coef="1"/>
  <joint joint="slide" coef="-.8"/><joint joint="roll" coef=".3"/></fixed>
 <fixed name="trees" stiffness="20 3" damping="2 .5" springlength="0 .1">
  <joint joint="far" coef="1.5"/><joint joint="yaw" coef="-1"/></fixed>
 <fixed name="chain" damping="3"><joint joint="yaw" coef="1"/>
  <joint joint="lift" coef="2"/></fixed>"""


def step_errors(tendons, integrator, dt, speed=3.0, actuators="", count=20):
    """The largest difference of qvel and qpos after one step, beside the largest velocity."""
    text = ARM.format(dt=dt, integrator=integrator, tendons=tendons, actuators=actuators)
    theirs = peers.strict(mujoco.MjModel.from_xml_string(text))
    data, rng = mujoco.MjData(theirs), np.random.default_rng(5)
    sim = sc.Sim(sc.loads(text).compile(), **peers.EXACT)
    worst = 0.0
    for _ in range(count):
        mujoco.mj_resetData(theirs, data)
        peers.nudge(theirs, data.qpos, rng, 0.5)
        data.qvel[:] = speed * rng.normal(size=theirs.nv)
        data.ctrl[:] = 0.3 * rng.normal(size=theirs.nu)
        sim.reset()
        sim.qpos[:], sim.qvel[:], sim.ctrl[:] = data.qpos, data.qvel, data.ctrl
        mujoco.mj_step(theirs, data)
        sim.step()
        scale = max(1.0, np.abs(data.qvel).max())
        worst = max(worst, np.abs(sim.qvel - data.qvel).max() / scale)
        worst = max(worst, np.abs(sim.qpos - data.qpos).max())
    return worst


@every_pair(
    tendons=["", TENDONS],
    dt=(0.001, 0.02),
    integrator=("implicit", "implicitfast", "discrete"),
)
def test_step(integrator, dt, tendons):
    """Law: the same step to rounding, whatever the tendons couple."""
    assert step_errors(tendons, integrator, dt) < 1e-11


@pytest.mark.parametrize("speed", (30.0, 150.0))
def test_fast_turns(speed):
    """Law: Coriolis and centrifugal forces are implicit under `implicit`, as in MuJoCo."""
    assert step_errors("", "implicit", 0.002, speed) < 1e-9
    assert step_errors("", "discrete", 0.002, speed) < 1e-9


OFFSET = """<mujoco><option timestep=".005" integrator="discrete"/><worldbody><site name="o"/>
<body pos=".1 .2 .3">{free}<geom type="box" size=".1 .2 .15" pos="{com}" mass="2"/>
<site name="a" pos=".1 .1 0"/></body>
<body pos="1 2 3"><freejoint/><geom type="box" size=".1 .2 .3" pos=".1 0 0"/><site name="b"/></body>
</worldbody><tendon><spatial name="t" {tendon}><site site="o"/><site site="a"/></spatial>
<spatial name="u" {other}><site site="b"/><site site="a"/></spatial></tendon>
<actuator>{drive}</actuator></mujoco>"""
DRIVES = (
    "",
    '<motor site="a" gear="1 2 0 0 0 1"/>',
    '<position kp="{kp}" kv="1" site="a" refsite="o" gear="1 .3 .2 0 0 0"/>',
    '<position kp="{kp}" site="a" gear="1 .3 .2 .1 0 0"/>',
    '<position kp="{kp}" kv="1" cranksite="a" slidersite="o" cranklength=".8"/>',
    '<position kp="{kp}" kv="1" joint="f" gear="1 0 0 0 .5 0"/>',
    '<position kp="{kp}" site="a" refsite="o" gear="1 0 0 0 0 0" forcerange="-.1 .1"/>',
    '<velocity kv="3" site="b" gear="1 0 0 0 0 0"/>',
    '<general gaintype="affine" gainprm="3 -2 -3" site="a" refsite="o" gear="0 1 0 0 0 0"/>',
    '<general biastype="affine" biasprm="0 90 0" site="a" refsite="o" gear="0 1 0 0 0 0"/>',
)


@every_pair(
    drive=DRIVES,
    kp=(1, 2000),
    com=("0 0 0", ".02 .03 .04"),
    tendon=("", 'stiffness="50" springlength=".1"', 'stiffness="50" springlength="0 9"'),
    other=("", 'damping="5"', 'stiffness="50" springlength="0 9"'),
    free=('<freejoint name="f"/>', '<joint name="f" type="free" damping=".3" stiffness="9"/>'),
)
def test_a_free_body_turns_as_in_mujoco(drive, kp, com, tendon, other, free):
    """Law: the same acceleration and step, whatever holds the body in this step."""
    drive = drive.format(kp=kp)
    text = OFFSET.format(free=free, com=com, tendon=tendon, other=other, drive=drive)
    theirs = peers.strict(mujoco.MjModel.from_xml_string(text))
    data, sim, rng = mujoco.MjData(theirs), sc.Sim(sc.loads(text)), np.random.default_rng(3)
    for _ in range(4):
        data.qvel[:] = sim.qvel[:] = rng.normal(size=theirs.nv)
        data.ctrl[:] = sim.ctrl[:] = rng.normal(size=theirs.nu)
        mujoco.mj_forward(theirs, data)
        sim.forward()
        assert peers.apart(sim.qacc, data.qacc) < 1e-10
        mujoco.mj_step(theirs, data)
        sim.step()
        assert peers.apart(sim.qvel, data.qvel) < 1e-11
        assert peers.apart(sim.qacc, data.qacc) < 1e-10
