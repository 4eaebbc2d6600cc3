"""Findings about contacts: numbers against closed forms, each fix made and measured.

A row of solref at rest under a force f yields by r with R f = k r (MuJoCo's documentation,
"Computation"): r = f Â (1 − d)/d² dmax² (tc ζ)², with the impedance d = d(r).
"""

import math
import re

import pytest

import stepcore as sc
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import home, scheduled
from stepcore.measure.monitors import monitored, shown, verified
from stepcore.measure.monitors.contacts import overlaps, resting
from stepcore.measure.monitors.creep import creeps
from stepcore.measure.monitors.recording import followed
from stepcore.measure.monitors.servos import stronger
from stepcore.measure.monitors.soft_rows import impedance, yielding

G = 9.81
SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)


def watched(scene, time=1.0, key=None, control=None, depth=None, **settings):
    """A recorded run of a scene, and its findings with the fixes that hold in the same run."""

    def run(model, share=1.0):
        start, held = home(model, key)
        how = {"control": control, "hold": round(0.002 / model.settings.dt)}
        if control is None:
            how = {"ctrl": held[None, None]}
        return followed(model, start, round(share * time / model.settings.dt), **how)

    model = scene.compile().with_settings(**settings)
    seen = run(model)
    return seen, verified(shown(seen, depth), model, run, round(time / model.settings.dt))


def the(findings, kind):
    """The only finding of a kind."""
    (one,) = (finding for finding in findings if finding.kind == kind)
    return one


def pair(text, name="solref"):
    """The two numbers for an attribute in a sentence, where it is last named."""
    return tuple(map(float, re.findall(rf'{name}="(\S+) (\S+)"', text)[-1]))


def ball(radius, solref="0.02 1", solimp="0.9 0.95 0.001", mass=1.0, height=None):
    return sc.loads(
        f"""<mujoco><default><geom solref="{solref}" solimp="{solimp}"/></default><worldbody>
        <geom name="floor" type="plane" size="1 1 1"/><body name="ball"
        pos="0 0 {radius if height is None else height}"><freejoint/>
        <geom name="ball" size="{radius}" mass="{mass}"/></body></worldbody></mujoco>"""
    )


# Depth at rest.


@pytest.mark.parametrize(
    ("solref", "solimp", "mass"),
    [
        ("0.02 1", "0.9 0.95 0.001", 1.0),
        ("0.05 1", "0.9 0.95 0.001", 1.0),
        ("0.05 0.7", "0.3 0.8 0.01", 3.0),
        ("-2000 -100", "0.9 0.95 0.001", 0.1),
    ],
)
def test_the_depth_of_a_ball_at_rest(solref, solimp, mass):
    """The load of a free ball is g, whatever its mass."""
    watch, _ = watched(ball(0.002, solref, solimp, mass), time=2.0)
    (rest,) = resting(watch)
    values = (*map(float, solimp.split()), 0.5, 2.0)
    predicted = yielding(tuple(map(float, solref.split())), values, G, dt=0.002)
    assert rest.depth == pytest.approx(predicted, rel=1e-6)
    assert rest.force == pytest.approx(mass * G, rel=1e-6)
    # From the equation itself, not from the iteration that solves it.
    d, (tc, ratio) = impedance(values, rest.depth), map(float, solref.split())
    square = (tc * ratio) ** 2 if tc > 0 else -1 / tc
    assert rest.depth == pytest.approx(G * (1 - d) / d**2 * values[1] ** 2 * square, rel=1e-6)


@pytest.mark.parametrize("solref", ["0.02 1", "-3000 -100"])
def test_the_solref_of_a_wanted_depth_gives_it(solref):
    scene = ball(0.05, solref)
    assert watched(scene)[1] == []
    _, wanted = watched(scene, depth=1e-4)
    one = the(wanted, "depth at rest")
    assert one.severity == "remark" and " on both geoms leaves " in one.text
    new = pair(one.text)
    dt = 0.002 if new[0] < 0 else min(0.002, new[0] / 2)
    again, _ = watched(ball(0.05, f"{new[0]} {new[1]}"), dt=dt)
    assert next(resting(again)).depth == pytest.approx(1e-4, rel=0.02)


def test_a_ball_that_sinks_in_is_told_without_being_asked():
    _, findings = watched(ball(0.05, "0.2 1"), time=4.0)
    one = the(findings, "depth at rest")
    assert one.severity == "warning" and one.element == "contact `floor`/`ball`"
    assert one.value == pytest.approx(yielding((0.2, 1), SOLIMP, G, 0.002), rel=1e-3)
    new = pair(one.text)
    again, rest = watched(ball(0.05, f"{new[0]} {new[1]}"))
    assert rest == []
    assert next(resting(again)).depth == pytest.approx(0.05 * 0.01, rel=0.02)


def test_a_ball_that_an_impact_presses_into_the_floor_is_told():
    """At 4 m/s and 30 ms, a critically damped contact yields by 4 × 0.03 / e; the fix is run."""
    scene = ball(0.05, "0.03 1", height=0.15)
    scene.add_key("fast", qvel=(0, 0, -4, 0, 0, 0))
    one = the(watched(scene, time=1.0)[1], "depth under load")
    assert one.severity == "remark" and 0.025 < one.value < 0.08
    left = float(re.search(r"leaves ([\d.]+) mm", one.text)[1]) * 1e-3
    solref = " ".join(map(str, pair(one.text)))
    cured = ball(0.05, solref, "0.99 0.99 0.001", height=0.15)
    cured.add_key("fast", qvel=(0, 0, -4, 0, 0, 0))
    sim = sc.Sim(cured)
    sim.reset(0)
    depths = []
    for _ in range(50):
        sim.step()
        depths.append(sim.overlap)
    assert max(depths) == pytest.approx(left, rel=0.02)


def test_a_body_that_stands_without_friction_is_told():
    scene = ball(0.05)
    for geom in scene.geoms:
        geom.condim = 1
    one = the(watched(scene)[1], "no friction")
    assert one.severity == "remark" and one.value == pytest.approx(G, rel=1e-3)
    assert "so a slight push lets the body slide or topple: condim=" in one.text


# Creep.


def incline(degrees, cone="elliptic", impratio=1.0, solref="0.02 1"):
    """A ball that slides in a plane and does not turn, on an incline."""
    return sc.loads(
        f"""<mujoco><option cone="{cone}" impratio="{impratio}"/>
        <default><geom solref="{solref}"/></default><worldbody>
        <geom name="slope" type="plane" size="5 5 1" euler="0 {degrees} 0"/>
        <body name="b" pos="0 0 {0.1 / math.cos(math.radians(degrees))}">
        <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
        <geom name="ball" size=".1" mass="2"/></body></worldbody></mujoco>"""
    )


def creep_speed(degrees, impratio=1.0):
    """A friction row pulls back with R f = b v; f = m g sin, b = 2/(dmax tc), R = R_n/impratio."""
    angle = math.radians(degrees)
    weight = 2 * G * incline(degrees).compile().contact_pair(0).invweight0
    d = impedance(SOLIMP, yielding((0.02, 1), SOLIMP, weight * math.cos(angle), 0.002))
    return (1 - d) / d / impratio * weight * math.sin(angle) * 0.95 * 0.02 / 2


@pytest.mark.parametrize(("degrees", "impratio"), [(10, 1.0), (30, 1.0), (30, 5.0)])
def test_creep_on_an_incline(degrees, impratio):
    scene = incline(degrees, impratio=impratio)
    watch, findings = watched(scene)
    (creep,) = creeps(watch)
    angle, speed = math.radians(degrees), creep_speed(degrees, impratio)
    assert creep.speed == pytest.approx(speed, rel=1e-3)
    assert creep.share == pytest.approx(math.tan(angle), rel=1e-3)
    if speed > 1e-3:
        assert the(findings, "creep").value == pytest.approx(speed, rel=1e-3)


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_the_impratio_that_is_named_leaves_what_is_said(cone):
    one = the(watched(incline(30, cone))[1], "creep")
    assert one.severity == "warning" and one.element == "contact `slope`/`ball`"
    assert ", or stiction=True leaves " in one.text
    impratio = float(re.search(r'impratio="(\S+)"', one.text)[1])
    left, unit = re.search(r"leaves ([\d.]+) (\S+), or", one.text).groups()
    watch, findings = watched(incline(30, impratio=impratio))
    (creep,) = creeps(watch)
    assert unit == "µm/s" and creep.speed == pytest.approx(float(left) * 1e-6, rel=0.02)
    assert findings == []
    settings = {"law": "rigid", "solver": "pgs", "integrator": "semi-implicit", "sweeps": 200}
    watch, findings = watched(incline(30), **settings)
    assert findings == [] and sc.Sim(incline(30)).model.nv == 2
    assert all(abs(creep.speed) < 1e-12 for creep in creeps(watch))


GRIPPER = """<mujoco><option cone="{cone}"/><default><geom solref="{solref}"/></default><worldbody>
<body pos="0 .06 .3"><joint name="l" type="slide" axis="0 -1 0" damping="5"/>
<geom name="left" type="capsule" size=".01" fromto="-.03 0 0 .03 0 0" mass=".1"/></body>
<body pos="0 -.06 .3"><joint name="r" type="slide" axis="0 1 0" damping="5"/>
<geom name="right" type="capsule" size=".01" fromto="-.03 0 0 .03 0 0" mass=".1"/></body>
<body pos="0 0 .3"><freejoint/><geom name="ball" size=".03" mass=".2"/></body></worldbody>
<actuator><motor joint="l"/><motor joint="r"/></actuator>
<keyframe><key qpos=".0202 .0202 0 0 .3 1 0 0 0" ctrl="6 6"/></keyframe></mujoco>"""


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_a_ball_creeps_out_of_a_gripper(cone):
    """Faster and faster, as the pads come onto its upper half, until it falls."""
    watch, findings = watched(sc.loads(GRIPPER.format(cone=cone, solref="0.02 1")))
    one = the(findings, "creep")
    # Both pads hold it equally.
    assert one.element in ("contact `ball`/`left`", "contact `ball`/`right`")
    assert 5e-3 < one.value < 5e-2
    impratio = float(re.search(r'impratio="(\S+)"', one.text)[1])
    still = GRIPPER.format(cone="elliptic", solref="0.02 1")
    watch, findings = watched(sc.loads(still), impratio=impratio)
    assert findings == [] and all(
        len(places) == len(watch) for places in watch.contacts.groups.values()
    )


def test_what_slides_or_rolls_does_not_creep():
    for scene in (incline(50), ball(0.1)):
        if scene.joints[0].type == "free":
            scene.add_key("roll", qvel=(1, 0, 0, 0, 10, 0))
        assert not [f for f in watched(scene)[1] if f.kind == "creep"]


TOP = """<mujoco><option cone="pyramidal"/><worldbody><geom name="floor" type="plane" size="2 2 1"/>
<body name="top" pos="0 0 .1" euler="20 0 0"><freejoint/><geom name="tip" size=".01" pos="0 0 -.09"
mass=".01"/><geom name="disc" type="cylinder" size=".08 .01" mass=".2"/></body></worldbody>
<keyframe><key qpos="0 0 .0955 .98481 .17365 0 0" qvel="0 0 0 0 0 80"/></keyframe></mujoco>"""


def test_a_top_does_not_creep():
    """Its tip turns on the floor by far more than it slips."""
    watch, findings = watched(sc.loads(TOP), time=2.0)
    assert len(watch.contacts.groups[0, 0]) > 0.9 * len(watch)
    assert not [one for one in findings if one.kind == "creep"]


def test_sliding_without_friction_is_told_with_the_reason():
    scene = incline(30)
    for geom in scene.geoms:
        geom.condim = 1
    one = the(watched(scene)[1], "no friction")
    assert one.severity == "remark" and "condim is 1" in one.text
    # v = g sin t, on average g sin T/2.
    assert one.value == pytest.approx(G * 0.5 / 2, rel=0.05)
    for geom in scene.geoms:
        geom.condim, geom.friction = 3, 0
    assert "its friction is 0" in the(watched(scene)[1], "no friction").text


FAST = {"threads": 1, "progress": False, "starts": 1, "horizon": 0.4}


@pytest.mark.parametrize(
    "measured",
    [
        lambda scene: sc.trade(scene, dts=[0.002], further=0, by="flops", **FAST),
        lambda scene: sc.converge(scene, **FAST),
        lambda scene: sc.check(scene, threads=1, progress=False, horizon=0.4),
    ],
)
def test_every_measurement_says_what_its_run_showed(measured):
    result = measured(incline(30))
    (finding,) = result.findings
    assert finding.kind == "creep" and any(finding.text in said for said in result.sentences)
    (data,) = result.to_dict()["rows" if result.kind == "check" else "findings"]
    assert data["value"] == pytest.approx(creep_speed(30), rel=1e-3)


def test_a_run_that_fails_tells_only_what_it_began_with():
    scene = two(0.17, False)
    spring = scene.joints[0]
    spring.type, spring.stiffness = "slide", 1e8
    model = scene.compile()
    findings, failure = monitored(model, scheduled(Motion(horizon=1.0, starts=1), model, 0.01))
    assert failure and {one.kind for one in findings} == {"overlap at the start"}


# Overlaps.


def two(apart, tree):
    """Balls of 0.1 m; tree: the second one hangs on the first by a body between them."""
    inner = f'<body name="b" pos="{apart} 0 0">{{}}<geom name="b" size=".1"/></body>'
    hinge = '<joint axis="0 1 0" stiffness="10" damping="1"/>'
    rod = f'<body><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{hinge}{inner}</body>'
    first = '<body name="a"><freejoint/><geom name="a" size=".1"/>{}</body>'
    bodies = first.format(rod.format(hinge)) if tree else first.format("")
    bodies += "" if tree else inner.format("<freejoint/>")
    return sc.loads(f'<mujoco><option gravity="0 0 0"/><worldbody>{bodies}</worldbody></mujoco>')


def test_an_overlap_at_the_start_is_told_with_its_depth():
    one = the(watched(two(0.17, False))[1], "overlap at the start")
    assert one.severity == "error" and one.value == pytest.approx(0.03)
    assert (
        "Geoms `a` and `b` overlap by 30 mm" in one.text and "move body `b` 30 mm away" in one.text
    )
    assert watched(two(0.201, False))[1] == []


def test_a_slash_in_a_name_is_part_of_it():
    """Attached models have such names."""
    scene = two(0.17, False)
    scene.geoms[0].name = "walker/left_foot"
    one = the(watched(scene)[1], "overlap at the start")
    assert one.text.startswith("Geoms `walker/left_foot` and `b` overlap by 30 mm")
    scene.geoms[0].name = ""
    one = the(watched(scene)[1], "overlap at the start")
    assert one.text.startswith("Geom 0 of body `a` and geom `b` overlap by 30 mm")


@pytest.mark.parametrize(("stiffness", "thrown"), [("-10000 -1", True), ("0.02 1", False)])
def test_geoms_are_thrown_apart_only_if_they_were(stiffness, thrown):
    """A ball 30 mm in the floor: a spring throws it up, a critically damped contact lifts it."""
    one = the(watched(ball(0.1, stiffness, height=0.07))[1], "overlap at the start")
    assert one.value == pytest.approx(0.03)
    assert ("thrown apart at" in one.text) == thrown
    assert one.severity == ("error" if thrown else "warning")


LEG = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/>
<body name="trunk" pos="0 0 .405"><freejoint/><geom name="trunk" size=".1" mass="5"/>
<body name="shank" pos="0 0 -.3"><joint name="knee" type="slide" axis="0 0 1" stiffness="4000"
damping="30" springref=".05"/><geom name="foot" type="box" size=".1 .1 .02" mass=".05"/></body>
<geom name="guard" type="box" size=".02 .02 .02" pos=".3 0 0"/></body></worldbody></mujoco>"""


def test_a_foot_that_a_leg_pulls_out_of_the_floor_is_not_thrown():
    """The spring lifts the foot of 50 g by 5 cm; the trunk of 5 kg does not rise."""
    scene = sc.loads(LEG.replace(".405", ".31"))
    watch, findings = watched(scene, time=0.2)
    (overlap,) = {one.pair: one for one in overlaps(watch)}.values()
    assert overlap.depth == pytest.approx(0.01)
    assert overlap.speed < (2 * G * 0.01) ** 0.5
    assert not [one for one in findings if "thrown" in one.text]


def test_what_moves_out_of_the_floor_is_the_robot_and_not_its_foot():
    one = the(watched(sc.loads(LEG.replace(".405", ".31")), time=0.2)[1], "overlap at the start")
    assert "move body `trunk` 10 mm away" in one.text


STOOL = """<mujoco><worldbody><geom name="base" type="box" size=".05 .05 .05"/>
<body name="turret"><joint axis="0 0 1" damping="1"/><geom name="turret" size=".06" mass="1"/>
</body></worldbody></mujoco>"""


def test_parts_of_a_machine_that_is_fixed_to_the_world_are_left_out():
    """The base of a URDF is part of the world, whose contacts with its child are not left out."""
    found = watched(sc.loads(STOOL))[1]
    (one,) = [one for one in found if "`base`" in one.text]
    assert '<exclude body1="turret" body2="world"/>' in one.text
    out = '<contact><exclude body1="world" body2="turret"/></contact></mujoco>'
    assert not watched(sc.loads(STOOL.replace("</mujoco>", out)))[1]


HIP = """<mujoco><worldbody><geom name="base" type="box" size=".1 .05 .05"/>
<body name="hip" pos="0 .08 0"><joint axis="1 0 0" range="-30 30" damping="1"/>
<geom name="motor" type="cylinder" size=".04 .05" zaxis="1 0 0" mass="1"/></body>
</worldbody></mujoco>"""


def test_a_link_that_its_hinge_cannot_move_out_of_the_base_is_left_out():
    """A quarter deep, as DeepRobotics' Lite3: no softness helps; one that swings out is pressed."""
    one = the(watched(sc.loads(HIP))[1], "overlap")
    assert '<exclude body1="hip" body2="world"/>' in one.text
    swings = HIP.replace("<joint", '<joint pos="0 0 .2"')
    assert not [one for one in watched(sc.loads(swings))[1] if one.kind == "overlap"]


LIMBS = """<mujoco><worldbody>
<body name="left" pos="-.1 0 0"><joint axis="0 0 1"/><geom name="l" size=".12" mass="1"/>
<geom pos="0 1 0" size=".1" mass="1"/></body><body name="right" pos=".1 0 0"><joint axis="0 0 1"/>
<geom name="r" pos="0 .05 0" size=".12" mass="1"/></body></worldbody></mujoco>"""


def test_limbs_of_a_machine_have_another_pose_and_no_other_places():
    one = the(watched(sc.loads(LIMBS), time=0.2)[1], "overlap at the start")
    cure = 'start from another pose, or leave them out with <exclude body1="left" body2="right"/>'
    assert cure in one.text


WHEEL = """<mujoco><option cone="elliptic"/><worldbody>
<geom name="floor" type="plane" size="1 1 1"/>
<body name="wheel" pos="0 0 .099"><joint axis="0 1 0" name="axle"/>
<geom name="rim" size=".1" mass="1"/></body></worldbody></mujoco>"""


def test_a_wheel_on_a_fixed_axle_cannot_leave_the_floor():
    one = the(watched(sc.loads(WHEEL))[1], "overlap at the start")
    assert one.severity == "warning" and one.value == pytest.approx(1e-3)
    assert "no joint can move them apart: move body `wheel` 1 mm away" in one.text
    # However deep, a wheel is meant to touch the floor.
    one = the(watched(sc.loads(WHEEL.replace(".099", ".08")))[1], "overlap at the start")
    assert "move body `wheel` 20 mm away" in one.text


def test_geoms_that_joints_hold_in_each_other_are_to_be_left_out():
    one = the(watched(two(0.1, True))[1], "overlap")
    assert '<exclude body1="a" body2="b"/>' in one.text


HUB = """<mujoco><worldbody><geom name="base" type="box" size=".1 .1 .1"/><body name="wheel"
pos=".05 0 0"><joint/><geom name="rim" size=".06" pos="0 1e-8 0" mass="1"/></body>
</worldbody></mujoco>"""


def test_a_force_without_end_is_no_number():
    """A wheel that the rounding of a file alone lets move is pushed with 1e15 N."""
    one = the(watched(sc.loads(HUB))[1], "overlap")
    assert "as their joints hold them, and no joint can move them apart" in one.text


def test_what_leaves_out_two_bodies_is_told_once_for_all_of_their_geoms():
    also = '<geom size=".065" pos=".11 0 0" mass="1"/></body>'
    found = watched(sc.loads(HUB.replace("</body>", also)))[1]
    assert len([one for one in found if "overlap" in one.text]) == 1


def test_two_bodies_are_left_out_once_whichever_geom_comes_first():
    """The simpler type is the first of a pair of geoms; its body may be either."""
    other = '<geom name="hub" type="capsule" size=".05 .1" pos=".02 0 0"/><body name="wheel"'
    also = '<geom type="box" size=".06 .06 .06" pos=".02 .05 0" mass="1"/></body>'
    scene = HUB.replace('<body name="wheel"', other).replace("</body>", also)
    one = the(watched(sc.loads(scene))[1], "overlap")
    assert '<exclude body1="wheel" body2="world"/>' in one.text and not one.lines


def test_a_start_at_the_depth_of_rest_is_not_told():
    depth = yielding((0.05, 1), SOLIMP, G, 0.002)
    scene = ball(0.03, "0.05 1", height=0.03 - depth)
    assert depth > 0.01 * 0.03
    assert watched(scene)[1] == []


WELD = """<mujoco><option><flag contact="disable"/></option><compiler angle="radian"/><worldbody>
<body name="arm1"><joint name="pivot" axis="1 0 0" damping=".001"/>
<geom type="capsule" fromto="0 0 0 0 .5 0" size=".05" mass="1"/>
<body name="ballA" pos="0 .5 0"><geom size=".06" mass="1"/></body></body>
<body name="arm2" pos="0 .5 0"><joint name="slide2" type="slide" axis="0 0 1" damping="0.001"/>
<joint name="hang2" axis="1 0 0" damping=".001"/><geom size=".06" mass="1"/>
<body pos="0 0 -.5"><geom size=".1" mass="50"/></body></body></worldbody>
<equality><weld name="w" body1="ballA" body2="arm2"{}/></equality>
<actuator><position name="hold" joint="pivot" kp="20000" kv="500"/></actuator></mujoco>"""


@pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")
def test_the_gap_that_a_weld_s_cure_leaves_is_that_of_a_run():
    """Rotation leaks in over 0.5 m, which the closed form neglects (60 µm)."""
    text = the(watched(sc.loads(WELD.format("")), time=4.0)[1], "gap").text
    solref, solimp = (re.search(rf'{name}="([^"]+)"', text)[1] for name in ("solref", "solimp"))
    solref = re.findall(r'solref="([^"]+)"', text)[-1]
    left = float(re.search(r"leaves ([\d.]+) µm", text)[1]) * 1e-6
    cured = sc.loads(WELD.format(f' solref="{solref}" solimp="{solimp}"')).compile()
    sim = sc.Sim(cured)
    sim.step(2000)
    arm, ball = (sim.xpos[cured.index("body", name)] for name in ("arm2", "ballA"))
    assert math.dist(arm, ball) == pytest.approx(left, rel=0.01) and left > 65e-6


# Healthy scenes.


@pytest.mark.parametrize(
    "name",
    [
        *("lesson:spring", "lesson:drop", "lesson:grasp"),
        *("gymnasium:ant", "gymnasium:hopper", "gymnasium:reacher", "gymnasium:walker2d"),
        *("gymnasium:inverted_double_pendulum", "dm_control:suite/acrobot"),
        *("dm_control:suite/cartpole", "dm_control:suite/hopper", "dm_control:suite/pendulum"),
    ],
)
def test_nothing_is_told_of_a_healthy_scene(name):
    assert watched(sc.load(name))[1] == []


@pytest.mark.parametrize("law", ["gaintype='fixed'", "gaintype='affine'"])
def test_a_general_servo_that_sags_gets_a_stronger_gain(law):
    """Its gain and bias change by the same factor: the fixed actuator is still a servo."""
    model = sc.loads(f"""<mujoco><worldbody><body><joint name="a" axis="0 1 0"/>
     <geom size=".05" pos=".5 0 0" mass="1"/></body></worldbody><actuator>
     <general name="hold" joint="a" {law} biastype="affine" gainprm="20" biasprm="0 -20 -8"/>
     </actuator></mujoco>""").compile()
    gain, bias = stronger(model, {0: 4.0}, damped=True).values()
    # The damping ratio is kept: kv grows by the root.
    assert (gain[0] if isinstance(gain, tuple) else gain, *bias[:3]) == (80, 0, -80, -16)
    found = sc.run(model, horizon=3, progress=False)
    assert "Servo `hold` sags by 238 mrad" in str(found)
