"""Limits of `diagnose` on scenes of many kinds, against the motion on the real step itself."""

from functools import partial

import numpy as np
import pytest
import stiff

import stepcore as sc

pytestmark = [
    pytest.mark.long,
    # Steps beyond a limit are run on purpose.
    pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning"),
    pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning"),
]

FREE = 'contype="0" conaffinity="0"'
LINK = f'<geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="{{}}" {FREE}/>'


def scene(body, option, rest=""):
    return sc.loads(f"<mujoco><option {option}/><worldbody>{body}</worldbody>{rest}</mujoco>")


def dropped(stiffness, damping):
    solref = f'solref="-{stiffness} -{damping}" condim="1"'
    body = f"""<geom type="plane" size="1 1 1" {solref}/><body pos="0 0 .4">
    <joint type="slide" axis="0 0 1"/><geom size=".1" mass="1" {solref}/></body>"""
    return scene(body, 'timestep=".002" integrator="implicitfast"')


def stopped(stiffness, damping):
    body = f"""<body><joint axis="0 1 0" range="-30 180" limited="true"
    solreflimit="-{stiffness} -{damping}"/>
    <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3" mass="1" {FREE}/></body>"""
    key = '<keyframe><key qpos="0.6" qvel="-6"/></keyframe>'
    return scene(body, 'timestep=".001" integrator="Euler"', key)


def pushed_limit():
    body = f"""<body><joint name="x" type="slide" axis="1 0 0" range="-1 .5" limited="true"
    solreflimit="-1e5 -200"/><geom size=".1" mass="1" {FREE}/></body>"""
    motor = '<actuator><motor joint="x" gear="100"/></actuator>'
    key = '<keyframe><key ctrl="1"/></keyframe>'
    return scene(body, 'timestep=".002" integrator="Euler" gravity="0 0 0"', motor + key)


def whip():
    body = f'<body pos="0 0 2"><joint axis="0 1 0" damping=".01"/>{LINK.format(0.5)}'
    for i in range(4):
        body += f"""<body pos="{0.15 if i else 0.3} 0 0">
        <joint axis="0 1 0" stiffness="2" damping=".0005"/>
        <geom type="capsule" size=".01" fromto="0 0 0 .15 0 0" mass="{0.05 * 0.5**i}" {FREE}/>"""
    return scene(body + "</body>" * 5, 'timestep=".002" integrator="Euler"')


def double_pendulum():
    body = f"""<body><joint axis="0 1 0"/>{LINK.format(1)}
    <body pos=".3 0 0"><joint axis="0 1 0"/>{LINK.format(0.2)}</body></body>"""
    key = '<keyframe><key qvel="20 -30"/></keyframe>'
    return scene(body, 'timestep=".002" integrator="Euler"', key)


def damper():
    body = f"""<body><joint type="slide" axis="1 0 0" damping="50"/>
    <geom size=".1" mass=".05" {FREE}/></body>"""
    key = '<keyframe><key qvel="1"/></keyframe>'
    return scene(body, 'timestep=".002" integrator="RK4" gravity="0 0 0"', key)


def top():
    body = f"""<body pos="0 0 1"><joint type="ball"/>
    <geom type="cylinder" size=".1 .01" pos="0 0 .2" mass="1" {FREE}/></body>"""
    key = '<keyframe><key qpos="0.98 0.199 0 0" qvel="0 0 40"/></keyframe>'
    return scene(body, 'timestep=".002" integrator="RK4"', key)


def leg():
    body = f"""<geom type="plane" size="1 1 1"/><body pos="0 0 .62">
    <joint type="slide" axis="0 0 1"/><geom size=".05" mass="5" {FREE}/>
    <body><joint name="hip" axis="0 1 0"/>
      <geom type="capsule" size=".03" fromto="0 0 0 .1 0 -.3" mass="1" {FREE}/>
      <body pos=".1 0 -.3"><joint name="knee" axis="0 1 0"/>
        <geom type="capsule" size=".02" fromto="0 0 0 -.1 0 -.3" mass=".4" {FREE}/>
        <geom size=".02" pos="-.1 0 -.3" mass=".1"/></body></body></body>"""
    servos = "".join(f'<position joint="{joint}" kp="500" kv="10"/>' for joint in ("hip", "knee"))
    option = 'timestep=".002" integrator="implicitfast"'
    return scene(body, option, f"<actuator>{servos}</actuator>")


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (partial(dropped, 1e6, 200), "contact"),
        (partial(dropped, 3e5, 60), "contact"),
        (partial(stopped, 1e6, 500), "limit"),
        (partial(stopped, 1e5, 1000), "limit"),
        (pushed_limit, "limit"),
        (whip, "spring"),
        (double_pendulum, "inertial forces"),
        (damper, "damper"),
        (top, "spin"),
        # A softer contact lifts its limit, and so does a softer servo of the knee.
        (leg, ("contact", "servo")),
    ],
    ids=["drop", "bouncy", "stop", "soft", "pushed", "whip", "pendulum", "damper", "top", "leg"],
)
def test_the_limit_is_where_the_motion_goes_wrong(make, name):
    """Law: the limit is where a plain loop, in the time that the limit took, goes wrong at one
    step, and at two steps 5 % apart, to 20 %: at contacts one fails by luck. The element that
    limits dt is of the kind that was made stiff."""
    made = make()
    model, integrator = made.compile(), made.settings.integrator
    ctrl = made.keys[0].ctrl if made.keys else np.zeros(model.nu)
    held = {"ctrl": np.tile(ctrl, (2, 1))} if model.nu else {}
    d = sc.diagnose(made, **held, threads=1, progress=False)
    limit = d.limits[integrator]
    time = max(1.0, 1000 * limit.dt, limit.time)
    true = stiff.twins(model, "rk4", d.covered.dt / 2, time)
    tried = np.geomspace(limit.dt / 2, 2 * limit.dt, 29)
    wrong = np.array([stiff.goes_wrong(model, integrator, dt, true, time) for dt in tried])
    once, twice = tried[wrong][0], tried[:-1][wrong[:-1] & wrong[1:]][0]
    assert 0.8 * once <= limit.dt <= 1.2 * twice
    assert d.stiffest().startswith(name)


SLACK = """<mujoco><option timestep="0.006" gravity="0 0 0"/><worldbody>
<body><joint type="slide" axis="1 0 0"/><geom size=".05" mass="1"/><site name="o"/></body>
<body pos="1 0 0"><joint type="slide" axis="{}"/><geom size=".05" mass="1"/><site name="s"/></body>
</worldbody><tendon><spatial name="rope" stiffness="1000" springlength="0 .9"><site site="o"/>
<site site="s"/></spatial></tendon><keyframe><key qpos=".3 .1" qvel="1 -.5"/></keyframe></mujoco>"""


@pytest.mark.parametrize("axis", ["1 0 0", "0 1 0"])
def test_a_rope_that_is_slack_at_first_is_what_limits(axis):
    """Pulled taut in the motion, or by a longer step alone."""
    d = sc.diagnose(sc.loads(SLACK.format(axis)))
    assert d.stiffest("euler") == "tendon spring `rope`"
