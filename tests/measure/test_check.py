"""`check`: every kind of finding on a scene made for it, and none on the same scene made right."""

import dataclasses
import math
import re
import warnings
from unittest import mock

import pytest

import stepcore as sc
from stepcore.measure.check import AS_SHIPPED, TIME_STEP
from stepcore.measure.monitors.soft_rows import yielding

G = 9.81


def checked(text, **options):
    options = {"horizon": 0.2, "threads": 1, "progress": False} | options
    with warnings.catch_warnings():
        # The warning at load is the diagnosis.
        warnings.simplefilter("ignore", sc.StiffnessWarning)
        scene = sc.loads(text)
    return sc.check(scene, **options)


def findings(text, **options):
    """The findings of the scene and its run; the time step is not diagnosed."""
    with mock.patch("stepcore.measure.check._diagnosis", return_value=(None, [])):
        return checked(text, **options).findings


def kinds(text, **options):
    return [finding.kind for finding in findings(text, **options)]


def the(text, kind, **options):
    """The only finding of a scene, which has this kind."""
    (finding,) = findings(text, **options)
    assert finding.kind == kind, finding
    return finding


def arm(joint="", geom='size=".1"', rest="", body="", option="", compiler=""):
    """One hinge without a load."""
    return f"""<mujoco><compiler {compiler}/><option {option}/><worldbody><body name="arm" {body}>
    <joint name="knee" axis="0 0 1" {joint}/><geom {geom}/></body></worldbody>{rest}</mujoco>"""


def key(qpos, ctrl=""):
    given = f'ctrl="{ctrl}"' if ctrl else ""
    return f'<keyframe><key name="home" qpos="{qpos}" {given}/></keyframe>'


def servo(more="", kp=10):
    return f"""<actuator><position name="servo" joint="knee" kp="{kp}" {more}/></actuator>"""


# Nothing.


EXAMINED = {
    "lesson:spring": " inertia and 500 ms of free motion.",
    "lesson:drop": " geometry, inertia and 500 ms of free motion.",
    "gymnasium:hopper": ", limits, motors and 500 ms of motion with constant controls.",
    "gymnasium:reacher": ", limits, motors and 500 ms of motion with constant controls.",
}


@pytest.mark.parametrize("name", EXAMINED)
def test_nothing_is_found_in_a_healthy_scene(name):
    result = sc.check(name, horizon=0.5, threads=1, progress=False)
    assert result.findings == [] and result.sentences[0].startswith("No problems found in ")
    assert result.sentences[0].endswith(EXAMINED[name])
    assert result.diagnosis.sentences[0].startswith(result.sentences[1])
    commands = [command for command, _ in result.commands]
    assert commands[0] == f"stepcore trade {name} --error 1mm --horizon 0.5" and len(commands) == 3


def test_a_step_that_explodes_is_not_nothing():
    def pd(time, sim):
        return [-800 * sim.qpos[0] - 6 * sim.qvel[0]]

    body = '<body><joint name="knee" axis="0 1 0"/><geom type="capsule" size=".02" mass=".2"'
    body += ' fromto="0 0 0 0 0 -.3" contype="0" conaffinity="0"/></body>'
    motor = '<actuator><motor joint="knee"/></actuator>'
    scene = sc.loads(f"<mujoco><worldbody>{body}</worldbody>{motor}</mujoco>")
    result = sc.check(scene, control=pd, horizon=0.2, threads=1, progress=False)
    assert [finding.kind for finding in result.findings] == ["time step"]
    assert result.sentences[0] == f"Error: {result.diagnosis.sentences[0]}"
    assert result.diagnosis.sentences[0] not in result.sentences


@pytest.mark.parametrize(
    ("options", "motion"),
    [
        ({"motion": "move"}, "point-to-point motion"),
        ({"motion": "random"}, "random motion"),
        ({"control": lambda time, sim: [0.0]}, "the given motion"),
    ],
)
def test_the_motion_that_was_examined_is_named(options, motion):
    text = arm('damping="1" range="-60 60"', rest=servo('kv="1"'))
    (said,) = [one for one in checked(text, **options).sentences if "No problems" in one]
    parts = "geometry, inertia, limits, servos"
    assert said == f"No problems found in {parts} and 200 ms of {motion}."


def test_what_did_not_run_was_not_examined():
    """The time ends before the run; the file alone was read."""
    result = checked(arm('damping="1"'))
    result = dataclasses.replace(result, examined=("geometry", "inertia"), diagnosis=None)
    object.__setattr__(result, "not_done", (AS_SHIPPED, TIME_STEP))
    unknown, said, *_ = result.sentences
    assert unknown == f"Not known yet: {AS_SHIPPED} and {TIME_STEP}."
    assert said == "No problems found in geometry and inertia."


# Units.


@pytest.mark.parametrize(("mass", "found"), [(0.5, []), (30, ["density"])])
def test_the_density_of_a_mesh_is_that_of_its_hull(mass, found):
    """A cube of 10 cm, with a dent that only its surface has."""
    corners = " ".join(f"{x} {y} {z}" for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1))
    asset = f'<asset><mesh name="cube" vertex="{corners} .05 .05 .05"/></asset>'
    text = arm(geom=f'type="mesh" mesh="cube" mass="{mass}"', rest=asset)
    result = checked(text)
    assert [one.kind for one in result.findings] == found
    if found:
        assert result.findings[0].value == pytest.approx(30 / 1e-3, rel=1e-9)


@pytest.mark.parametrize(
    ("scale", "gravity", "found"), [(1, G, []), (500, G, ["units"]), (500, 9810, [])]
)
def test_sizes_in_millimetres(scale, gravity, found):
    text = arm(geom=f'size="{0.1 * scale}"', option=f'gravity="0 0 -{gravity}"')
    assert kinds(text) == found


@pytest.mark.parametrize(
    ("unit", "bounds", "said"),
    [
        ("degree", "-1.57 1.57", 'compiler angle="radian"'),
        ("degree", "-90 90", None),
        ("radian", "-1.57 1.57", None),
        ("degree", "-0.1 0.1", None),
    ],
)
def test_ranges_in_the_other_unit(unit, bounds, said):
    text = arm(f'range="{bounds}"', compiler=f'angle="{unit}"')
    if said is None:
        assert kinds(text) == []
    else:
        assert said in the(text, "units").text


def test_a_control_range_in_degrees():
    wrong = servo('ctrlrange="-90 90"')
    one = the(arm('range="-90 90" damping="1"', rest=wrong), "units")
    assert one.element == "servo `servo`" and "-90 to 90 rad" in one.text
    assert kinds(arm('range="-90 90" damping="1"', rest=servo('ctrlrange="-1.5 1.5"'))) == []


# Masses and inertias.


@pytest.mark.parametrize(
    ("mass", "said"),
    [(4.18, None), (130, "31× the density of water"), (1e-4, "air")],
)
def test_densities(mass, said):
    """A ball of 0.1 m has 4.19 litres."""
    if said is None:
        assert kinds(arm(geom=f'size=".1" mass="{mass}"')) == []
        return
    one = the(arm(geom=f'size=".1" mass="{mass}"'), "density")
    assert one.value == pytest.approx(mass / (4 / 3 * math.pi * 1e-3)) and said in one.text
    assert one.severity == "remark"


@pytest.mark.parametrize(("inertia", "found"), [(4e-3, []), (1.0, ["inertia"])])
def test_inertias_that_belong_to_another_body(inertia, found):
    """A ball of 1 kg and 0.1 m has 0.004 kg·m²; 1 kg·m² would need mass 1.2 m away."""
    inertial = f'<inertial pos="0 0 0" mass="1" diaginertia="{inertia} {inertia} {inertia}"/>'
    text = arm().replace("<geom", f"{inertial}<geom")
    assert kinds(text) == found
    if inertia == 1.0:
        one = the(text, "inertia")
        assert one.value == pytest.approx(math.sqrt(1.5)) and "0.004 kg·m²" in one.text


# Limits and ranges.


def test_a_start_outside_of_a_limit():
    one = the(arm('range="20 90"'), "outside a limit")
    assert one.severity == "warning" and "at 0 rad, outside of its range of 349 mrad" in one.text
    assert kinds(arm('range="20 90"', rest=key(0.5))) == []


def test_a_keyframe_outside_of_a_limit():
    one = the(arm('range="-60 60"', rest=key(1.2)), "outside a limit")
    assert one.severity == "error" and "(the nearest is 1.047)" in one.text
    assert "Keyframe `home` has joint `knee` at 1.2 rad" in one.text


def test_a_keyframe_whose_control_is_clamped():
    text = arm(rest=servo('ctrlrange="-1 1"') + key(0.5, 2))
    assert set(kinds(text)) == {"clamped control"}
    assert "Keyframe `home` has a control of 2 for servo `servo`" in str(checked(text))


# Servos.


def test_a_servo_that_is_saturated_at_the_start():
    """kp (ctrl − q) = 1000 × (0 − 0.5)."""
    text = arm('armature="1" damping="5"', rest=servo('forcerange="-52 52"', 1000) + key(0.5))
    one = the(text, "saturation")
    assert one.value == pytest.approx(-500) and "has -52 N·m" in one.text
    assert kinds(text.replace('qpos="0.5"', 'qpos="0.5" ctrl="0.5"')) == []


HUNG = """<mujoco><worldbody><body pos="0 0 1"><joint name="hip" axis="0 1 0" damping=".1"/>
<geom type="capsule" fromto="0 0 0 .4 0 0" size=".02" mass="2"/></body></worldbody>
{tendon}
<actuator><motor name="m" {of} gear="{gear}" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.mark.parametrize(("of", "arm"), [('joint="hip"', 1.0), ('tendon="t"', 0.1)])
def test_a_motor_that_cannot_hold_the_start(of, arm):
    """A load of 2 kg × g × 0.2 m on a joint, driven directly or by a cable of 0.1 m."""
    load, tendon = 2 * G * 0.2, ""
    if arm < 1:
        tendon = '<tendon><fixed name="t"><joint joint="hip" coef=".1"/></fixed></tendon>'
    one = the(HUNG.format(of=of, tendon=tendon, gear=0.9 * load / arm), "balance")
    assert one.value == pytest.approx(0.9 * load) and "cannot hold this pose" in one.text
    assert "1.11× the force" in one.text and one.element == "motor `m`"
    assert "balance" not in kinds(HUNG.format(of=of, tendon=tendon, gear=1.02 * load / arm))


def test_thrusters_lift_a_body_by_as_much_as_they_push():
    """4 N of thrust against 1 kg × g; with the proposed gear, it rises."""
    text = """<mujoco><worldbody><body name="hull" pos="0 0 1"><freejoint/>
    <geom type="box" size=".1 .1 .02" mass="1"/><site name="s" pos=".0 .0 0"/></body></worldbody>
    <actuator><motor name="fan" site="s" gear="0 0 {} 0 0 0" ctrlrange="0 1"/></actuator>
    </mujoco>"""
    one = the(text.format(4), "balance")
    assert one.value == pytest.approx(4) and "4 N of thrust at most against 9.81 N" in one.text
    ratio = float(re.search(r"(\S+)× the gear of each leaves it rising", one.text)[1])
    assert kinds(text.format(4 * ratio)) == [] and 4 * ratio > G


def test_a_limit_that_a_motor_overpowers():
    """A motor of τ pushes beyond by what the softness of the limit yields under τ/I."""
    motor = '<actuator><motor name="m" joint="knee" gear="{}" ctrlrange="-1 1"/></actuator>'
    limits = 'range="-60 60" solreflimit=".05 1"'
    mass = 'size=".1" mass="1"'
    one = the(arm(limits, mass, rest=motor.format(4)), "limit")
    load = 4 / (0.4 * 0.1**2)
    assert one.value == pytest.approx(yielding((0.05, 1), (0.9, 0.95, 0.001, 0.5, 2), load, 0.002))
    assert one.text.startswith("Motor `m` can push joint `knee` ") and "with 4 N·m" in one.text
    assert kinds(arm(limits, mass, rest=motor.format(0.5))) == []
    # It goes there under a full control, and is reported once.
    pushed = checked(arm(limits, mass, rest=motor.format(4)), horizon=2.0, ctrl=[[1.0]])
    (run,) = pushed.findings
    assert run.value == pytest.approx(one.value, rel=0.02) and "pushes" in run.text


def test_a_servo_without_a_control_range_is_not_taken_to_overpower_its_limit():
    assert kinds(arm('range="-60 60"', rest=servo('forcerange="-900 900" kv="1"'))) == []


# The run and the diagnosis.


def test_a_run_that_fails_and_its_diagnosis():
    text = arm('stiffness="1e5"', 'size=".1" mass="1"', option='timestep=".02"', rest=key(0.1))
    result = checked(text, horizon=4.0)
    assert result.findings[0].kind == "failure" and result.findings[0].severity == "error"
    assert "spring of joint `knee`" in result.findings[0].text
    said = str(result)
    assert "explodes after 1.52 s under euler" in said and "Any one of these changes" in said
    assert result.commands[0][0] == "stepcore diagnose FILE --horizon 4.0"
    assert re.fullmatch(r"stepcore run FILE --dt \S+ --horizon 4.0", result.commands[1][0])


def test_what_the_run_shows_is_found():
    """The ball sinks in under its solref, and should sink in less."""
    text = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .05"><freejoint/>
    <geom size=".05" solref="{}" mass="1"/></body></worldbody></mujoco>"""
    assert the(text.format("0.2 1"), "depth at rest", horizon=4.0).severity == "warning"
    soft = text.format("0.02 1")
    assert kinds(soft, horizon=1.0) == []
    asked = the(soft, "depth at rest", horizon=1.0, depth="0.1mm")
    assert asked.severity == "remark" and "leaves 99.9 µm" in asked.text


@pytest.mark.parametrize(("scale", "told"), [(1.0, ["units"]), (10.0, [])])
def test_a_worm_whose_inertia_is_lost_is_told(scale, told):
    """MuJoCo's issue 1086: segments of 0.4 mm; a worm ten times as long is fine."""
    half = 2e-4 * scale
    text = arm(geom=f'type="box" size="{half} {half} {half}" density="1000"')
    assert kinds(text) == told


def test_the_motion_is_the_users():
    """A servo that follows a sine saturates."""
    text = arm(rest=servo('forcerange="-.1 .1" kv="1"', 100))
    assert kinds(text) == []
    sine = the(text, "servo does not follow", control=lambda time, sim: [math.sin(9 * time)])
    assert sine.element == "servo `servo`"


@pytest.mark.parametrize(("dt", "horizon"), [(2.0, 2.0), (1e-3, 1.0), (1e-300, None)])
def test_the_run_takes_seconds_whatever_the_step(dt, horizon):
    result = checked(arm('damping="1"', option=f'timestep="{dt}"'), horizon=None)
    if horizon is None:
        assert result.motion.horizon <= 200_000 * dt
    else:
        assert result.motion.horizon == pytest.approx(horizon)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"depth": -1}, "depth = -1"),
        ({"depth": "1 furlong"}, "must be a length"),
        ({"starts": 3}, 'no argument "starts"'),
        ({"horizon": -1}, "horizon = -1"),
        ({"key": "away"}, "away"),
    ],
)
def test_bad_arguments(options, said):
    with pytest.raises((ValueError, TypeError), match=re.escape(said)):
        checked(arm(), **options)


def test_a_heap_is_checked():
    """It has too many pairs to list; the balls rest on each other's floor."""
    ball = '<body pos="{} {} .0996"><freejoint/><geom size=".1" mass="1"/></body>'
    balls = "".join(ball.format(0.3 * (k % 9), 0.3 * (k // 9)) for k in range(81))
    text = f'<mujoco><worldbody><geom type="plane" size="9 9 1"/>{balls}</worldbody></mujoco>'
    assert sc.loads(text).compile().is_heap
    assert kinds(text, horizon=0.05) == []
    lower = text.replace("0.0 0.0 .0996", "0.0 0.0 .09")
    assert the(lower, "overlap at the start", horizon=0.05).value == pytest.approx(0.01)


def test_nothing_moves():
    with pytest.raises(ValueError, match="nothing in it can move"):
        sc.check(sc.loads('<mujoco><worldbody><geom size="1"/></worldbody></mujoco>'))


# Tendons.


def strung(tendon, rest="", key=""):
    """A slide of 0.1 m, and a tendon from the world to it."""
    return f"""<mujoco><option gravity="0 0 0"/><worldbody><site name="a"/><body pos=".5 0 0">
    <joint name="rail" type="slide" axis="1 0 0" armature="1"/><geom size=".05"/><site name="b"/>
    </body></worldbody><tendon><spatial name="cord" {tendon}><site site="a"/><site site="b"/>
    </spatial></tendon>{rest}{key}</mujoco>"""


def test_a_tendon_whose_start_is_beyond_its_range():
    found = the(strung('range="0 .4"'), "outside a limit")
    assert found.severity == "warning" and found.element == "tendon `cord`"
    assert found.value == pytest.approx(0.5) and found.unit == "m"
    assert "500 mm, outside of its range of 0 m to 400 mm" in found.text
    assert kinds(strung('range="0 .6"')) == []


def test_a_tendon_whose_keyframe_is_beyond_its_range():
    home = '<keyframe><key name="home" qpos="-.2"/></keyframe>'
    found = the(strung('range=".4 .6"', key=home), "outside a limit")
    assert found.severity == "error" and found.text.startswith("Keyframe `home`")
    assert found.value == pytest.approx(0.3)


def test_a_fixed_tendon_s_length_has_no_unit():
    text = strung('range="0 .6"').replace(
        "</tendon>",
        '<fixed name="sum" range=".1 .3"><joint joint="rail" coef="2"/></fixed></tendon>',
    )
    found = the(text, "outside a limit")
    assert found.unit == "" and "a length of 0, outside of its range of 0.1 to 0.3" in found.text
