"""Findings about bodies that touch nothing, squeezes, undamped hinges and coupling."""

import math

import numpy as np
import pytest
from test_check import G, findings, kinds, the

# Bodies that touch nothing.


def dropped(cube="", floor="", more="", option="", body="<freejoint/>", pos=0.05):
    return f"""<mujoco><option {option}/><worldbody>
    <geom name="floor" type="plane" size="3 3 .1" {floor}/>
    <body name="cube" pos="0 0 {pos}">{body}<geom name="cube" type="box" size=".04 .04 .04" {cube}/>
    </body></worldbody>{more}</mujoco>"""


NONE, HALF = 'contype="0" conaffinity="0"', 'contype="1" conaffinity="0"'
APART = '<contact><exclude body1="world" body2="cube"/></contact>'
# A geom of the world that excludes do not name collides with nothing else.
FLAG = 'flag contact="disable"'


@pytest.mark.parametrize(
    ("scene", "why"),
    [
        (dropped(cube=HALF, floor=HALF), "(1 and 0) match those of no other geom"),
        (dropped(cube=NONE), "(0 and 0) match those of no other geom"),
        (dropped(cube='contype="2" conaffinity="4"'), "(2 and 4) match those of no other geom"),
        (dropped(more=APART), "its pairs are excluded"),
        (dropped().replace("<worldbody>", f"<option><{FLAG}/></option><worldbody>"), "disabled"),
        (
            dropped(
                cube=NONE + ' mass="0"',
                body='<freejoint/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>',
            ),
            "match",
        ),
    ],
    ids=["bits", "none", "other bits", "excluded", "flag", "no colliding geom"],
)
def test_a_body_that_can_touch_nothing_falls(scene, why):
    """g t²/2, and g dt t/2 by the step of `euler`."""
    one = the(scene, "nothing to touch", horizon=1.0)
    assert one.value == pytest.approx(G * (1 + 0.002) / 2, rel=1e-6)
    assert one.element == "body `cube`" and why in one.text and one.severity == "warning"


def test_the_bits_that_are_named_stop_the_fall():
    scene = dropped(cube=HALF, floor=HALF)
    one = the(scene, "nothing to touch", horizon=1.0)
    bits = 'contype="1" and conaffinity="1"'
    assert f"{bits} on its geoms leaves a fall of 10.1 mm" in one.text
    assert kinds(dropped(floor=HALF), horizon=1.0) == []


@pytest.mark.parametrize(
    "scene",
    [
        dropped(),
        dropped(cube=NONE, option='gravity="0 0 0"'),
        dropped(cube=NONE, body='<joint axis="0 1 0"/>'),
        dropped(cube=NONE, more='<equality><weld body1="cube" body2="world"/></equality>'),
        # Without another geom nothing could be touched.
        dropped(cube=NONE).replace('<geom name="floor" type="plane" size="3 3 .1" />', ""),
        # It misses the geoms that it could touch.
        dropped(floor="", pos=-9).replace('type="plane" size="3 3 .1"', 'type="box" size="1 1 .1"'),
    ],
    ids=["rests", "no gravity", "hinge", "held", "alone", "misses"],
)
def test_bodies_that_do_not_fall_or_could_touch_something(scene):
    assert "nothing to touch" not in kinds(scene, horizon=1.0)


# Squeezes.

PRESS = """<mujoco><option cone="elliptic" timestep=".001"/>
<default><geom solref=".002 1" solimp=".99 .99 .001" friction="2"/></default>
<worldbody><body name="jaw" pos="-.06 0 .05"><joint name="jaw" type="slide" axis="1 0 0"
 damping="5"/><geom name="pad" type="box" size=".02 .03 .03" mass=".2"/></body>
<geom name="wall" type="box" pos=".06 0 .05" size=".02 .03 .03"/>
<body name="cube" pos="0 0 .05"><freejoint/><geom name="cube" type="box" size=".0399 .03 .03"
 mass=".05"/></body></worldbody>
<actuator><motor name="m" joint="jaw" ctrlrange="0 2000"/></actuator>
<keyframe><key qpos="0 0 0 .05 1 0 0 0" ctrl="{}"/></keyframe></mujoco>"""


@pytest.mark.parametrize("force", [600, 1240])
def test_a_squeeze_far_above_the_weight(force):
    """At rest the pad passes on the force of the motor; 50 g weigh 0.49 N."""
    found = {one.kind: one for one in findings(PRESS.format(force), horizon=0.5)}
    one = found["contact force"]
    assert one.value == pytest.approx(force, rel=1e-6)
    assert f"{force / (0.05 * G):.4g}×" in one.text.replace(",", "") and "motor `m`" in one.text
    assert {element.name for element in one.elements} == {
        "contact `pad`/`cube`",
        "contact `wall`/`cube`",
    }


def test_the_force_of_a_strong_gripper_and_impacts_are_no_squeeze():
    assert "contact force" not in kinds(PRESS.format(235), horizon=0.5)
    assert "contact force" not in kinds(dropped(pos=2.0), horizon=1.0)


# Hinges without damping.

SWING = """<mujoco><worldbody><body pos="0 0 1"><joint name="base" axis="0 0 1" damping="1"/>
<geom size=".05" mass="1"/></body><body pos="1 0 1"><joint name="swing" axis="0 1 0" {}/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".3"/></body></worldbody>{}</mujoco>"""
MOTOR = '<actuator><motor joint="base"/></actuator>'


def test_a_hinge_without_damping_swings_on():
    """From a quarter turn to the other side: half a turn."""
    one = the(SWING.format("", MOTOR), "no damping", horizon=5.0)
    assert one.element == "joint `swing`" and one.severity == "remark"
    assert one.value == pytest.approx(math.pi, rel=0.01)
    damping = one.fix.split(" leaves")[0]
    assert kinds(SWING.format(damping, MOTOR), horizon=5.0) == []


@pytest.mark.parametrize(
    ("joint", "motor"),
    [('damping=".02"', MOTOR), ('frictionloss=".05"', MOTOR), ("", "")],
    ids=["damped", "dry friction", "no machine"],
)
def test_a_hinge_that_stops_and_a_pendulum_alone(joint, motor):
    assert "no damping" not in kinds(SWING.format(joint, motor), horizon=5.0)


# Coupling.

CART = """<mujoco><option gravity="0 0 0"/><worldbody><body>
<joint name="cart" type="slide" axis="1 0 0"/><geom size=".1" mass="2" contype="0"/><body>
<joint name="block" type="slide" axis="{}" {}/><geom size=".05" mass=".5" conaffinity="0"/>
</body></body></worldbody><actuator><motor joint="cart" ctrlrange="-100 100"/>{}</actuator>
</mujoco>"""
PUSH = {"ctrl": (10 * np.sin(20 * np.arange(0, 1, 0.01)))[:, None], "control_dt": 0.01}


def test_a_joint_that_a_neighbour_accelerates():
    """A free block of m on a cart of M under F: the cart's q̈ is F/M, and drives it by m F/M."""
    one = the(CART.format("1 0 0", "", ""), "coupling", horizon=1.0, **PUSH)
    assert one.value == pytest.approx(0.5 * 10 / 2, rel=1e-3)
    assert [element.name for element in one.elements] == ["joint `block`", "joint `cart`"]


def test_a_servo_that_holds_is_moved_too():
    """Softly, it is moved; a stiff one holds."""
    push = PUSH | {"ctrl": np.hstack([PUSH["ctrl"], 0 * PUSH["ctrl"]])}
    servo = '<position joint="block" kp="{}" kv="{}"/>'
    for kp, kv, found in ((5, 0.5, ["coupling"]), (5000, 50, [])):
        text = CART.format("1 0 0", 'range="-.2 .2" limited="true"', servo.format(kp, kv))
        assert [kind for kind in kinds(text, horizon=1.0, **push) if kind == "coupling"] == found


def test_no_coupling_across_or_without_a_command():
    assert "coupling" not in kinds(CART.format("0 1 0", "", ""), horizon=1.0, **PUSH)
    assert "coupling" not in kinds(CART.format("1 0 0", "", ""), horizon=1.0)
