"""Findings about connections, limits and actuators; contacts: `test_findings`."""

import math
import re

import numpy as np
import pytest
import stiff
from test_findings import GRIPPER, SOLIMP, G, pair, the, watched

import stepcore as sc
from stepcore.measure.monitors.joints import excesses, gapes, overpowered
from stepcore.measure.monitors.servos import at_rest
from stepcore.measure.monitors.soft_rows import yielding

# Connections.


def hung(solref, mass=2.0):
    return sc.loads(
        f"""<mujoco><worldbody><body name="bob" pos="0 0 1"><freejoint/>
        <geom size=".05" mass="{mass}" contype="0" conaffinity="0"/></body></worldbody><equality>
        <connect name="hook" body1="bob" anchor="0 0 0" solref="{solref}"/></equality></mujoco>"""
    )


@pytest.mark.parametrize("solref", ["0.1 1", "-100 -20"])
def test_the_gap_of_a_hung_mass(solref):
    """Its load is g: the gap is the same as for a contact with this solref."""
    numbers = tuple(map(float, solref.split()))
    _, findings = watched(hung(solref), time=4.0)
    one = the(findings, "gap")
    assert one.element == "connect `hook`"
    assert one.value == pytest.approx(yielding(numbers, SOLIMP, G, 0.002), rel=1e-3)
    new = pair(one.text)
    watch, findings = watched(hung(f"{new[0]} {new[1]}"), dt=min(0.002, abs(new[0]) / 2))
    assert findings == []
    (gape,) = gapes(watch)
    assert gape.rest == pytest.approx(0.05 * 0.01 * 0.1, rel=0.02)


def test_a_connection_that_holds_is_not_told():
    assert watched(hung("0.02 1"))[1] == []


# Limits.


def stop(torque, solref="0.02 1", gravity=0.0):
    return sc.loads(
        f"""<mujoco><option gravity="0 0 {-gravity}"/><worldbody><body name="arm">
        <joint name="elbow" axis="0 1 0" range="-60 60" solreflimit="{solref}" damping=".01"/>
        <inertial pos=".1 0 0" mass="1" diaginertia=".001 .001 .001"/></body></worldbody>
        <actuator><motor name="drive" joint="elbow" gear="{torque}" ctrlrange="-1 1"/></actuator>
        </mujoco>"""
    )


def test_how_far_a_motor_pushes_beyond_a_limit():
    """Its load is torque × dof_invweight0, in a tree of one dof torque / I."""

    def push(time, sim):
        return [1.0]

    watch, findings = watched(stop(5.0, "0.1 1"), time=3.0, control=push)
    one, (beyond,) = the(findings, "limit"), overpowered(watch)
    assert beyond.rest == pytest.approx(yielding((0.1, 1), SOLIMP, 5 / 0.011, 0.002), rel=1e-3)
    assert one.value == pytest.approx(beyond.rest, rel=0.05)
    assert beyond.forces[0] == (("actuator", 0), pytest.approx(5))
    assert beyond.limit == pytest.approx(5, rel=1e-3)
    assert one.text.startswith("Motor `drive` pushes joint `elbow` ")
    assert "with 5 N·m" in one.text and "ctrlrange of motor `drive`" in one.text
    new = pair(one.text, "solreflimit")
    harder = stop(5.0, f"{new[0]} {new[1]}")
    harder.joint("elbow").solimplimit = pair_of_three(one.text) or SOLIMP
    again, findings = watched(harder, time=3.0, control=push, dt=min(0.002, new[0] / 2))
    # The proposed value leaves a tenth of the threshold of 5 % of the range.
    ((beyond, _),) = excesses(again)
    assert beyond.rest == pytest.approx(0.005 * math.radians(120), rel=0.05)
    assert findings == []


def pair_of_three(text):
    written = re.findall(r'solimplimit="(\S+) (\S+) (\S+)"', text)
    return tuple(map(float, written[-1])) if written else None


def test_gravity_is_named_where_it_pushes():
    scene = stop(1.0, solref="0.3 1", gravity=G)
    one = the(watched(scene, time=6.0)[1], "limit")
    assert one.text.startswith("Gravity pushes joint `elbow` ")


def test_a_joint_that_only_runs_into_its_limit_is_not_told():
    scene = stop(1.0)
    scene.add_key("fast", qvel=[30.0])
    watch, findings = watched(scene, time=1.0)
    assert next(excesses(watch))[1].max() > 0 and findings == []


def test_an_equality_that_aims_within_the_range_is_not_what_pushes():
    """It holds the joint at 0, in the middle; its damping points outwards as the joint returns."""
    scene = stop(5.0, "0.1 1")
    scene.add_equality("joint", joint1="elbow", solref=(0.5, 3), solimp=(0.1, 0.2, 1, 0.5, 2))
    watch, findings = watched(scene, time=3.0, control=lambda t, s: [math.sin(4 * t)])
    assert next(excesses(watch))[1].max() > 0
    pushing = [of for at in overpowered(watch) for of, _ in at.forces]
    assert "joint equality" not in {kind for kind, _ in pushing}
    assert not [one for one in findings if one.text.startswith("Joint equality")]


def test_a_limit_and_what_pushes_are_elements_of_their_finding():
    one = the(watched(stop(5.0, "0.1 1"), time=3.0, control=lambda t, s: [1.0])[1], "limit")
    assert [(e.kind, e.index, e.name) for e in one.elements] == [
        ("limit", 0, "limit of joint `elbow`")
    ]


# Actuators.


def lift(kp, mass=2.0, force=None):
    ranged = f'forcerange="{-force} {force}"' if force else ""
    return sc.loads(
        f"""<mujoco><worldbody><body name="load" pos="0 0 1">
        <joint name="rail" type="slide" axis="0 0 1" range="-.5 .5"/>
        <geom size=".05" mass="{mass}"/></body></worldbody><actuator>
        <position name="hoist" joint="rail" kp="{kp}" kv="{kp / 10}" {ranged}/>
        </actuator></mujoco>"""
    )


def test_how_far_a_servo_sags():
    """m g / kp; with the proposed kp, a tenth of the threshold."""
    one = the(watched(lift(80), time=6.0)[1], "servo sags")
    assert one.value == pytest.approx(2 * G / 80, rel=1e-3) and one.element == "servo `hoist`"
    assert "load of 19.6 N" in one.text
    kp, left = re.search(r"kp (\S+) leaves (\S+) mm", one.text).groups()
    watch, findings = watched(lift(float(kp)), time=3.0)
    assert findings == []
    (servo,) = at_rest(watch)
    assert abs(servo.error) == pytest.approx(2 * G / float(kp), rel=0.01)
    assert abs(servo.error) == pytest.approx(float(left) * 1e-3, rel=0.01)


def test_a_sag_is_told_on_the_scale_of_the_range_with_the_kp_that_mends_it():
    """An arm of two links sags by 40 mrad and less, together; IsaacLab's issue 2614 in small."""
    text = """<mujoco><option integrator="implicitfast"/><worldbody><body name="a">
    <joint name="a" axis="0 1 0" range="-100 100"/><geom type="capsule" fromto="0 0 0 .3 0 0"
    size=".02" mass="1"/><body name="b" pos=".3 0 0"><joint name="b" axis="0 1 0" range="-100 100"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".5"/></body></body></worldbody>
    <actuator><position name="a" joint="a" kp="{}" kv="10"/>
    <position name="b" joint="b" kp="{}" kv="5"/></actuator></mujoco>"""
    one = the(watched(sc.loads(text.format(80, 18)), time=4.0)[1], "servo sags")
    assert one.severity == "remark" and [of.label for of in one.elements] == ["`a`", "`b`"]
    assert one.value == pytest.approx(G * (0.15 + 0.225) / 80, rel=0.02)
    kps = re.search(r"kp (\S+) \(servo `b` (\S+)\) leaves ([\d.]+) mrad", one.text).groups()
    watch, findings = watched(sc.loads(text.format(*kps[:2])), time=4.0)
    assert findings == []
    worst = max(abs(servo.error) for servo in at_rest(watch))
    assert worst == pytest.approx(float(kps[2]) * 1e-3, rel=0.01) and worst < 0.011


def test_a_servo_that_its_joint_s_limit_stops_is_not_too_weak():
    scene = lift(1000, force=100)
    scene.add_key("high", ctrl=[0.9])
    watch, findings = watched(scene, time=3.0)
    assert next(at_rest(watch)).error > 0.3
    assert not [one for one in findings if one.kind.startswith("servo")]


def driven(count, force):
    """Servos that are too stiff for their forces, each on a separate flywheel."""
    wheel = (
        """<body pos="{k} 0 0"><joint name="j{k}" axis="0 0 1"/><geom size=".1" mass="1"/></body>"""
    )
    motor = """<position name="s{k}" joint="j{k}" kp="1000" forcerange="-{force} {force}"/>"""
    wheels = "".join(wheel.format(k=k) for k in range(count))
    motors = "".join(motor.format(k=k, force=force * (1 + k // 2)) for k in range(count))
    return sc.loads(
        f"<mujoco><worldbody>{wheels}</worldbody><actuator>{motors}</actuator></mujoco>"
    )


@pytest.mark.parametrize("count", [1, 2, 3])
def test_saturated_servos_are_named_in_one_sentence(count):
    def sines(time, sim):
        return np.full(count, np.sin(9 * time))

    one = the(watched(driven(count, 0.1), control=sines)[1], "servo does not follow")
    # No nearer than a servo at rest, whose error is the sines' RMS.
    assert one.value > 0.7
    force = 100 if count < 3 else 200
    assert f"because its force ends at {force} mN·m for 99" in one.text
    names = {1: "Servo `s0` ", 2: "Servo `s0` (and servo `s1`)", 3: "Servo `s2` (and servo `s0`"}
    assert one.text.startswith(names[count])


LEG = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body>
<joint name="knee" axis="{axis}" range="-120 120"/><geom type="capsule" fromto="0 0 0 .15 0 0"
size=".015" mass=".25"/></body></worldbody><actuator>
<position name="knee" joint="knee" kp="{kp}" kv="{kv}"/></actuator></mujoco>"""


@pytest.mark.parametrize("hertz", [8.0, 8.05])
def test_a_servo_beyond_its_bandwidth_is_told_with_the_share_that_passes(hertz):
    """The closed form of kp / (kp − Iω² + i kv ω) gives share and lag, of any number of periods."""
    kp, kv = 2.0, 0.12
    scene = sc.loads(LEG.format(axis="0 0 1", kp=kp, kv=kv))
    inertia, omega = 1 / float(scene.compile().dof_invweight0[0]), 2 * math.pi * hertz

    def sine(time, sim):
        return [0.2 * math.sin(omega * time)]

    # The motion that the start adds has decayed after some periods.
    one = the(watched(scene, time=10.0, control=sine)[1], "servo does not follow")
    passed = kp / (kp - inertia * omega**2 + 1j * kv * omega)
    told = re.search(rf"{hertz:g} Hz with (\S+) % of the amplitude, (\S+)° late", one.text)
    assert float(told[1]) / 100 == pytest.approx(abs(passed), rel=0.03)
    # The control of a step of 2 ms is held for 6° of 8 Hz.
    assert float(told[2]) == pytest.approx(-math.degrees(np.angle(passed)), abs=6)
    error = 0.2 / math.sqrt(2) * abs(1 - passed)
    assert one.value == pytest.approx(error, rel=0.03) and "because its bandwidth is" in one.text
    new = tuple(map(float, re.search(r"kp (\S+) and kv (\S+) leaves", one.text).groups()))
    left = float(re.search(r"leaves ([\d.]+) mrad RMS", one.text)[1]) / 1e3
    watch, findings = watched(
        sc.loads(LEG.format(axis="0 0 1", kp=new[0], kv=new[1])), time=10.0, control=sine
    )
    asked = 0.2 * np.sin(omega * (watch.times - 0.002))
    assert findings == [] and left == pytest.approx(
        np.sqrt(np.mean((asked - watch["qpos"][:, 0])[1:] ** 2)), rel=0.01
    )


@pytest.mark.parametrize("damping", [1.0, 20.0])
def test_a_servo_on_a_joint_with_much_damping_is_told_and_has_the_gains_of_a_lag(damping):
    """kp / (kp + iωc) is 1/√2 at kp = ωc, with as much error; a quarter of it at 4ωc.

    As shipped, its error is less than for a servo at rest.
    """
    damped = LEG.replace('120"/>', f'120" damping="{damping}"/>').format(axis="0 0 1", kp=2, kv=0)

    def sine(time, sim):
        return [0.2 * math.sin(2 * math.pi * time)]

    (one,) = watched(sc.loads(damped), time=6.0, control=sine)[1]
    assert "because its bandwidth is" in one.text
    kp, kv = map(float, re.search(r"kp (\S+) and kv (\S+) leaves", one.text).groups())
    assert kv == 0 and kp == pytest.approx(4 * 2 * math.pi * damping, rel=0.02)


def test_dry_friction_that_holds_a_servo_is_the_reason_that_it_does_not_follow():
    """Friction never loads the servo by more than its bound, and half of the time by most of it."""
    hard = 'frictionloss="0.3" solreffriction="0.004 1" solimpfriction="0.999 0.999"'
    scene = sc.loads(LEG.replace('120"/>', f'120" {hard}/>').format(axis="0 0 1", kp=2, kv=0.1))

    def sine(time, sim):
        return [0.2 * math.sin(2 * math.pi * time)]

    (one,) = watched(scene, time=6.0, control=sine)[1]
    held = float(re.search(r"dry friction hold it with (\d+) mN·m: kp", one.text)[1])
    assert 200 < held <= 300


@pytest.mark.parametrize("force", [5, 100])
def test_a_servo_that_grips_is_neither_weak_nor_saturated(force):
    """The object between its pads keeps it from its target: so it holds the object."""
    servos = (
        f'<position joint="l" kp="500" kv="20" forcerange="-{force} {force}"/>'
        f'<position joint="r" kp="500" kv="20" forcerange="-{force} {force}"/>'
    )
    text = GRIPPER.format(cone="elliptic", solref="0.02 1")
    text = re.sub(r"<actuator>.*</actuator>", f"<actuator>{servos}</actuator>", text)
    scene = sc.loads(text.replace('ctrl="6 6"', 'ctrl=".03 .03"').replace("<mujoco>", "<mujoco>"))
    watch, findings = watched(scene.with_settings(impratio=1000.0))
    assert len(list(at_rest(watch))) == 2
    assert findings == []


@pytest.mark.parametrize("kv, damping", [(0, 12), (12, 0)])
def test_a_joint_that_damps_its_servo_makes_up_for_a_missing_kv(kv, damping):
    """A servo on its way to its target is neither undamped nor loaded by its damper."""
    scene = sc.loads(
        f"""<mujoco><worldbody><body><joint name="s" type="slide" axis="1 0 0" damping="{damping}"/>
        <geom size=".1" mass=".05"/></body></worldbody>
        <actuator><position joint="s" kp="4" kv="{kv}"/></actuator>
        <keyframe><key ctrl=".1"/></keyframe></mujoco>"""
    )
    assert watched(scene, time=2.0)[1] == []


@pytest.mark.parametrize("press", [0.4, 3.0])
def test_what_slips_out_of_a_grip_is_told_with_the_friction_that_carries_it(press):
    """Two pads press a ball of 0.2 kg: friction 1 carries 2 μ N of its 1.96 N."""
    text = GRIPPER.format(cone="elliptic", solref="0.02 1")
    _, found = watched(sc.loads(text.replace('ctrl="6 6"', f'ctrl="{press} {press}"')))
    told = [finding for finding in found if finding.kind == "slip"]
    assert bool(told) == (2 * press < 0.2 * G)
    for one in told:
        carries, weight = re.search(
            r"carries (\S+) N at most, and it weighs (\S+) N", one.text
        ).groups()
        assert float(weight) == pytest.approx(0.2 * G, rel=1e-2)
        assert one.value == pytest.approx(float(carries), rel=1e-2)
        assert one.value == pytest.approx(2 * press, rel=0.2)
        friction = re.search(r"a friction of (\S+) on both geoms leaves it in the grip", one.text)[
            1
        ]
        harder = text.replace("solref=", f'friction="{friction} .005 .0001" solref=')
        kinds = {f.kind for f in watched(sc.loads(harder.replace("6 6", f"{press} {press}")))[1]}
        assert "slip" not in kinds


def test_a_target_that_moves_by_rounding_is_held():
    """A leg that swings about its held target needs the same gains as one without rounding."""
    scene = sc.loads(LEG.format(axis="0 1 0", kp=0.5, kv=0.001))

    def texts(size):
        return [f.text for f in watched(scene, control=lambda t, sim: [size * math.sin(9 * t)])[1]]

    assert texts(1e-17) == texts(0.0)
    assert float(re.search(r"kp (\S+) and kv", texts(0.0)[0])[1]) < 100


def test_a_servo_of_a_standing_thing_sags_under_its_weight():
    """A body of 5 kg on a foot of 0.1 kg by a telescope: 5 g / kp."""
    scene = sc.loads(
        """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .1"><freejoint/>
        <geom size=".1" mass=".1"/><geom size=".1" pos=".4 .4 0" mass=".1"/>
        <geom size=".1" pos="-.4 .4 0" mass=".1"/><geom size=".1" pos="0 -.4 0" mass=".1"/>
        <body pos="0 0 .5"><joint name="leg" type="slide" axis="0 0 1" range="-.3 .3"/>
        <geom size=".1" mass="5"/></body></body></worldbody>
        <actuator><position joint="leg" kp="500" kv="100"/></actuator></mujoco>"""
    )
    one = the(watched(scene, time=3.0)[1], "servo sags")
    assert one.value == pytest.approx(5 * G / 500, rel=1e-3)


# Chatter.

SERVO = stiff.damped_servo(key='<keyframe><key qvel="1"/></keyframe>')
SPRING = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body><joint name="j"
type="slide" stiffness="{}"/><geom size=".01" mass="1"/></body></worldbody>
<keyframe><key qvel="1"/></keyframe></mujoco>"""


def test_a_joint_that_moves_to_and_fro_from_step_to_step_chatters():
    """Beyond 2/p of the servo's fast pole p; its force throws the joint at 56 N·m · dt / I a step,
    from one side of rest to the other."""
    one = the(watched(sc.loads(SERVO), key=0, dt=0.004)[1], "chatter")
    assert one.value == pytest.approx(56 * 0.004 / 0.1 / 2, rel=0.01) and one.unit == "rad/s"
    assert watched(sc.loads(SERVO), key=0, dt=0.002)[1] == []


def test_settings_that_let_a_joint_chatter_are_not_recommended_without_a_word():
    """An error of positions alone: the servo is at most 10 mrad away."""
    given = {"dts": [0.004], "integrators": ["euler"], "error": 0.1, "by": "flops"}
    result = sc.trade(sc.loads(SERVO), starts=2, progress=False, **given)
    assert result.recommended.dt == 0.004
    assert "Under these settings joint `j` chatters: it moves to and fro" in result.text()
    assert result.to_dict()["chatter"][0]["kind"] == "chatter"


def test_a_vibration_is_no_chatter():
    """Not even where readings, five steps apart, see it at one phase: it has a period of ten."""
    steps = 2 * math.pi / 0.01
    # Semi-implicit steps turn by 2π/10 each here.
    omega = 2 * math.sin(math.pi / 10) / 0.001
    for rate in (steps, omega):
        found = watched(sc.loads(SPRING.format(rate**2)), key=0)[1]
        assert [one for one in found if one.kind == "chatter"] == []


def test_a_ball_that_its_limits_lock_is_looked_at():
    """Its range has no width; the force of the rod's weight opens the limit a little."""
    rod = (
        '<joint type="ball" limited="true"/><geom type="capsule" size=".05" fromto="0 0 0 1 0 0"/>'
    )
    scene = sc.loads(f"<mujoco><worldbody><body>{rod}</body></worldbody></mujoco>")
    run, found = watched(scene)
    assert [at.joint for at, _ in excesses(run)] == [0] and found == []
