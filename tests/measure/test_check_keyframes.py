"""`check` on keyframes beyond limits."""

import numpy as np
import pytest
from test_check import kinds, the

HELD = """<mujoco><worldbody><body><joint name="j" {}/><geom size=".1"/></body></worldbody>
<actuator>{}</actuator><keyframe><key name="a" qpos="{}" ctrl="{}"/></keyframe></mujoco>"""
SERVO, RANGE = '<position name="p" joint="j" kp="10" kv="1"/>', 'range="-90 90"'


@pytest.mark.parametrize(
    ("joint", "motor", "qpos", "ctrl", "kind", "value"),
    [
        (RANGE, SERVO, "1.6", "1.5", "outside a limit", 1.6),
        ('type="ball" range="0 60"', "", "0 1 0 0", "", "outside a limit", np.pi),
        (RANGE, SERVO, "1.4", "2", "control beyond a limit", 2.0),
    ],
)
def test_a_keyframe_beyond_its_limits_is_told(joint, motor, qpos, ctrl, kind, value):
    text = HELD.format(joint, motor, qpos, ctrl)
    one = the(text.replace('ctrl=""', ""), kind, horizon=0.05)
    assert one.value == pytest.approx(value) and "eyframe `a`" in one.text


@pytest.mark.parametrize(("qpos", "ctrl"), [("1.5708", "1.5708"), ("-1.571", "-1.57"), ("0", "0")])
def test_a_keyframe_that_is_rounded_is_not_told(qpos, ctrl):
    assert kinds(HELD.format(RANGE, SERVO, qpos, ctrl), horizon=0.05) == []
