"""Robots that fall over: a column with a servo, which leans or is upright."""

import math
from unittest import mock

import pytest

import stepcore as sc

COLUMN = """<mujoco><worldbody><geom name="floor" type="plane" size="5 5 .1"/>
<body name="column" pos="0 0 .5"><freejoint/><geom type="box" size=".05 .05 .5" mass="5"/>
  <body name="arm" pos="0 0 .5"><joint name="arm" axis="0 0 1" damping="1"/>
  <geom type="capsule" size=".02" fromto="0 0 .05 .1 0 .05" mass=".1"/></body></body></worldbody>
<actuator>{actuator}</actuator>
<keyframe><key qpos="0 0 {height} {w} 0 {y} 0 0"/></keyframe></mujoco>"""


def column(lean, actuator='<position joint="arm" kp="10"/>'):
    """lean: of the column about y [rad]; a corner of its foot stays on the floor."""
    height = 0.5 * math.cos(lean) + 0.05 * math.sin(lean)
    half = {"w": math.cos(lean / 2), "y": math.sin(lean / 2), "height": height}
    return sc.loads(COLUMN.format(actuator=actuator, **half))


def falls(scene, **motion):
    # The time step is not diagnosed.
    with mock.patch("stepcore.measure.check._diagnosis", return_value=(None, [])):
        check = sc.check(scene, progress=False, **motion)
    return [finding for finding in check.findings if finding.kind == "fall"]


def test_a_robot_that_its_servos_do_not_balance_falls():
    """Closed form: beyond atan(0.05/0.5) the column falls; its lean grows as cosh(k t)."""
    lean = 0.15
    (finding,) = falls(column(lean), horizon=3.0)
    assert finding.element == "body `column`" and finding.severity == "warning"
    # About the corner of a rod of this height: θ'' = m g l (θ − θ₀) / I, to a further 0.35 rad.
    far = math.hypot(0.5, 0.05)
    inertia = 5 * ((0.1**2 + 1.0**2) / 12 + far**2)
    rate = math.sqrt(5 * 9.81 * far / inertia)
    expected = math.acosh(1 + 0.35 / (lean - math.atan(0.1))) / rate
    assert finding.value == pytest.approx(expected, rel=0.1)
    assert "falls over within" in finding.text and "--control" in finding.text


def test_what_stands_and_what_only_has_motors_is_not_said_to_fall():
    assert not falls(column(0.0), horizon=3.0)
    assert not falls(column(0.15, '<motor joint="arm"/>'), horizon=3.0)
