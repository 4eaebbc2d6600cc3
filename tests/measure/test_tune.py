"""Proposals of `tune` do what they promise when they are pasted into the file and run."""

import functools
import re
from pathlib import Path

import numpy as np
import pytest

import stepcore as sc
from stepcore.cli import main
from stepcore.experiment.schedule import home
from stepcore.measure.tune.goal import At, Goal
from stepcore.measure.tune.ground import asking, ground_of
from stepcore.report.units import length

ARM = """<mujoco model="arm"><option timestep="0.002"/><worldbody>
<body><joint name="hip" axis="0 1 0"/>
<geom type="capsule" size=".03" fromto="0 0 0 0 0 -.5" mass="1"/>
<body pos="0 0 -.5"><joint name="knee" axis="0 1 0" damping="0.2"/>
<geom type="capsule" size=".03" fromto="0 0 0 0 0 -.5" mass="1"/></body></body></worldbody>
<actuator><position name="hip" joint="hip" forcerange="-100 100"/>
<position name="knee" joint="knee" gear="2"/></actuator>
<keyframe><key name="out" qpos="0.7 0.5" ctrl="0.7 1"/></keyframe></mujoco>"""
RESTING = """<mujoco><option timestep="0.002" cone="{}"/><worldbody>
<geom name="floor" type="plane" size="1 1 1" friction="0.7"/>
<body pos="0 0 .1"><freejoint/><geom name="box" type="box" size=".1 .1 .1" mass="1"/></body>
<body pos="0 1 .1"><freejoint/><geom name="ball" size=".1" mass="3"/></body>
</worldbody></mujoco>"""


def pasted(xml, tuning):
    """The scene with the printed attributes instead of the file's."""
    for line in tuning.mjcf.splitlines():
        tag, name, values = re.fullmatch(r'<(\w+) name="(\w+)" (.*)/>', line).groups()
        for attribute in values.split('" '):
            key = attribute.partition("=")[0]
            xml = re.sub(rf'(<{tag} name="{name}"[^>]*?) {key}="[^"]*"', r"\1", xml)
        xml = xml.replace(f'<{tag} name="{name}"', f'<{tag} name="{name}" {values}')
    return sc.loads(xml)


def held(scene, steps=1500):
    sim = sc.Sim(scene)
    sim.reset(key=0 if scene.keys else None)
    sim.step(steps)
    return sim


def stepped(scene, servo, size=0.02, steps=1500):
    """The response of a servo to a step of its target, as a share of its end, over time [s]."""
    sim = held(scene)
    k = sim.model.actuator_names.index(servo)
    before = float(sim.actuator_length[k])
    sim.ctrl[k] += size
    run = sim.run(steps * sim.settings.dt, record=("actuator_length",))
    path = run.actuator_length[:, k] - before
    return run.time - run.time[0], path / path[-1]


HINGE = """<mujoco><option integrator="implicitfast" timestep=".001"/><worldbody><body>
<joint name="h" axis="0 0 1" {}/><geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass="1"/>
</body></worldbody><actuator><position name="servo" joint="h" kp="20"/></actuator></mujoco>"""


def test_a_joint_of_a_narrow_range_is_not_pushed_against_its_ends():
    """Gains are tried by a tenth of a range of 0.02 rad, not by 0.1 rad."""
    xml = HINGE.format('limited="true" range="-.5 .6"')
    tuning = sc.tune(sc.loads(xml), bandwidth=8.0)
    sim, path, size = sc.Sim(pasted(xml, tuning)), [], 0.001
    assert tuning.found[0].reached
    for n in range(2000):
        sim.ctrl[0] = size * np.sin(2 * np.pi * 8.0 * (n + 0.5) * sim.settings.dt)
        sim.step()
        path.append(float(sim.qpos[0]))
    assert np.std(path[1000:]) / size == pytest.approx(0.5, rel=0.1)


def test_a_spring_that_bears_much_of_a_target_is_told():
    """kp/(kp + k) of the way: a response that falls to 1/√2 at 8 Hz need not start near 1."""
    tuned = sc.tune(sc.loads(HINGE.format('stiffness="50"')), bandwidth=8.0).found[0]
    kp = float(re.search(r'kp="([\d.]+)"', tuned.lines[0])[1])
    way = f"the joint's spring lets it come {kp / (kp + 50):.0%} of the way"
    assert tuned.reached and way in tuned.sentence
    assert "spring" not in sc.tune(sc.loads(HINGE.format("")), bandwidth=8.0).text()


@pytest.mark.parametrize("tag", ("position", "motor"))
def test_a_pasted_bandwidth_is_the_gain_at_this_frequency(tag):
    """A sine of 3 Hz comes out at 1/√2 of its amplitude: another measure than the step of tune.

    Motors get the servo of a PD controller, with their bounds, which is pasted instead of them.
    """
    scene = sc.loads(ARM.replace("<position", f"<{tag}"))
    tuning = sc.tune(scene, bandwidth=3.0)
    assert all(tuned.reached for tuned in tuning.found) and len(tuning.found) == 2
    assert ("in place of 2 motors" in tuning.text()) == (tag == "motor")
    assert all(tuned.sentence.startswith("Servo `") for tuned in tuning.found)
    text = ARM
    for line in tuning.mjcf.splitlines() if tag == "motor" else ():
        name = re.search(r'name="(\w+)"', line)[1]
        text = re.sub(rf'<position name="{name}"[^>]*/>', line, text)
    sim = held(sc.loads(text) if tag == "motor" else pasted(ARM, tuning))
    changed = tuning.found[0].change.of(scene.compile())
    assert changed.actuator_bias == pytest.approx(sim.model.actuator_bias, rel=1e-3)
    assert np.array_equal(
        sim.model.actuator_forcerange, sc.loads(ARM).compile().actuator_forcerange
    )
    rest, start, dt = np.array(sim.ctrl), np.array(sim.actuator_length), sim.settings.dt
    for k, size in ((0, 0.02), (1, 0.04)):
        sim.ctrl, path = rest, []
        for n in range(2000):
            sim.ctrl[k] = rest[k] + size * np.sin(2 * np.pi * 3.0 * (n + 0.5) * dt)
            sim.step()
            path.append(float(sim.actuator_length[k]) - start[k])
        late = np.array(path[1000:])
        assert np.sqrt(2) * np.std(late) / size == pytest.approx(1 / np.sqrt(2), rel=0.1)


def test_a_pasted_settling_time_settles():
    scene = pasted(ARM, sc.tune(sc.loads(ARM), settling="150ms"))
    for servo in ("hip", "knee"):
        time, share = stepped(scene, servo)
        settled = time[np.flatnonzero(np.abs(share - 1) > 0.02)[-1] + 1]
        assert settled == pytest.approx(0.15, rel=0.1)


@pytest.mark.parametrize("sag", [0.01, 0.001])
def test_a_pasted_sag_sags(sag):
    """5.6 N·m and more: 10 mrad each, though the knee's gear of 2 counts twice; and for 40 s."""
    fast = ARM.replace("<option", '<option integrator="implicitfast"')
    tuning = sc.tune(sc.loads(fast), sag=sag)
    sim = held(pasted(fast, tuning), 20000)
    assert np.abs(sim.qpos - [0.7, 0.5]) == pytest.approx([sag, sag], rel=0.1)
    for tuned in tuning.found:
        assert tuned.expected == pytest.approx(tuned.measured, rel=0.05)


def test_what_rests_far_from_its_target_is_not_reached():
    """A servo of 0.5 Hz has its bandwidth, and hangs a fifth of a radian below its target."""
    (hip, _) = sc.tune(sc.loads(ARM), bandwidth=0.5).found
    assert not hip.reached and hip.measured == pytest.approx(0.5, rel=0.1)
    load = 9.81 * (0.75 * np.sin(0.7) + 0.25 * np.sin(1.2))
    off = float(re.search(r"it rests ([\d.]+) mrad from its target", hip.sentence)[1])
    assert off * dict(hip.change.values)["actuator/#0/kp"] == pytest.approx(1e3 * load, rel=0.5)


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("depth", ["0.05mm", "1um"])
def test_pasted_contacts_are_as_deep(cone, depth):
    xml = RESTING.format(cone)
    tuning = sc.tune(sc.loads(xml), depth=depth)
    assert [tuned.name for tuned in tuning.found] == ["box", "ball"]
    contacts = held(pasted(xml, tuning), 2500).contacts
    for name, weight in (("box", 9.81), ("ball", 3 * 9.81)):
        own = contacts[contacts["name2"] == name]
        measured = -float(own["dist"].mean())
        assert own["force"][:, 2].sum() == pytest.approx(weight, rel=1e-3)
        assert measured == pytest.approx(length("", "depth", depth, 1.0), rel=0.05)
    for tuned in tuning.found:
        assert tuned.expected == pytest.approx(tuned.measured, rel=0.05)


def test_a_soft_contact_is_given_the_time_to_come_to_rest():
    """It falls in by 9 mm and comes back over 10 s: after 2 s it is not at rest."""
    xml = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .04">
    <freejoint/><geom name="rod" type="capsule" size=".04" fromto="0 -.1 0 0 .1 0" condim="6"
    friction=".12 .01 .001"/></body></worldbody></mujoco>"""
    tuning = sc.tune(sc.loads(xml), depth="1mm", geom="rod")
    depths = -held(pasted(xml, tuning), 15_000).contacts["dist"]
    assert tuning.found[0].reached and depths == pytest.approx(1e-3, rel=0.1)


def test_a_pasted_contact_settles():
    """After a push on the ball that is let go: 2 % of the way is left after 50 ms."""
    xml = RESTING.format("pyramidal")
    tuning = sc.tune(sc.loads(xml), settling=0.05, geom="ball")
    sim = held(pasted(xml, tuning), 1500)
    z = sim.qpos[9]
    sim.xfrc_applied[2, 2] = -3.0
    sim.step(400)
    pressed = z - sim.qpos[9]
    sim.xfrc_applied[2, 2] = 0.0
    left = []
    for _ in range(100):
        sim.step()
        left.append(abs(z - sim.qpos[9]) / pressed)
    assert 0.002 * (1 + np.flatnonzero(np.array(left) > 0.02)[-1]) == pytest.approx(0.05, rel=0.15)


def test_what_a_step_cannot_hold_is_said_with_the_least_that_it_can():
    """0.9999 and 16 ms at 8 ms: a stiffness of S / (1e-4 · 0.016²) with S = 4 rows' 1/T."""
    xml = RESTING.format("elliptic")
    scene = sc.loads(xml)
    tuning = sc.tune(scene, depth=1e-9, dt="8ms", geom="ball")
    (tuned,) = tuning.found
    least = 3 * 9.81 * 1e-4 * 0.016**2 / 3.0
    assert not tuned.reached and tuning.mjcf == ""
    said = re.search(r"8 ms allows ([\d.]+) nm at the least", tuned.sentence)
    assert float(said[1]) == pytest.approx(least * 1e9, rel=0.01)
    with_least = sc.tune(scene, depth=least / 0.9, dt="8ms", geom="ball").found[0]
    assert with_least.reached


@pytest.mark.parametrize("goal, wanted, unit", [("bandwidth", 60.0, "Hz"), ("sag", 1e-3, "mrad")])
def test_beyond_the_step_its_limit_and_an_integrator_are_said(goal, wanted, unit):
    (hip, _) = sc.tune(sc.loads(ARM), **{goal: wanted}).found
    assert not hip.reached and "implicitfast holds it" in hip.sentence
    limit = float(re.search(rf"2 ms under euler holds about ([\d.]+) {unit}", hip.sentence)[1])
    easier = 0.8 * limit if goal == "bandwidth" else 1.25e-3 * limit
    assert all(t.reached for t in sc.tune(sc.loads(ARM), **{goal: easier}).found)
    fast = sc.loads(ARM.replace("<option", '<option integrator="implicitfast"'))
    assert all(t.reached for t in sc.tune(fast, **{goal: wanted}).found)


def test_a_robot_on_a_free_base_hangs_while_its_servos_are_tuned():
    """On the floor it would fall; its gains are the same as for these legs on a fixed base."""
    legs = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="9 9 9"/>
    <body name="trunk" pos="0 0 .45"><freejoint/><geom type="box" size=".2 .1 .05" mass="5"
    contype="0" conaffinity="0"/>
    <body name="thigh"><joint name="hip" axis="0 1 0" damping=".1"/>
    <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.2" mass=".8"/>
    <body name="shank" pos="0 0 -.2"><joint name="knee" axis="0 1 0" range="-150 0"/>
    <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.2" mass=".4"/></body></body></body>
    </worldbody><actuator><position name="hip" joint="hip"/><position name="knee" joint="knee"/>
    </actuator><keyframe><key qpos="0 0 .45 1 0 0 0 .3 -.01"/></keyframe></mujoco>"""
    fixed = legs.replace("<freejoint/>", "").replace("0 0 .45 1 0 0 0 ", "").replace(".45", "9")
    ours, theirs = (sc.tune(sc.loads(text), bandwidth=4.0) for text in (legs, fixed))
    assert "the base held in the air" in ours.text() and "in the air" not in theirs.text()
    for hung, held in zip(ours.found, theirs.found, strict=True):
        assert hung.reached and held.reached
        assert dict(hung.change.values) == pytest.approx(dict(held.change.values), rel=0.02)


def test_what_dry_friction_holds_is_said_of_its_servo_alone():
    """The pose rests; the knee sticks. The hip, damped enough by its joint, needs a kv of 0."""
    hard = 'frictionloss="5" solreffriction="0.004 1" solimpfriction="0.99 0.999"'
    sticky = ARM.replace('damping="0.2"', hard)
    sticky = sticky.replace('name="hip" axis="0 1 0"', 'name="hip" axis="0 1 0" damping="60"')
    hip, knee = sc.tune(sc.loads(sticky), bandwidth=1.0).found
    assert hip.reached and re.search(r'kp="[\d.]+" kv="0"/>', *hip.lines)
    assert not knee.reached and "is no sine, even where ten times less" in knee.why
    knee, hip = sc.tune(sc.loads(ARM.replace('damping="0.2"', hard)), sag=0.01).found
    assert hip.reached and "Dry friction (5 N·m) bears its load" in knee.why and not knee.lines


@pytest.mark.parametrize(
    ("goal", "kp"), [({"bandwidth": 5.0}, 0.1 * 2 * np.pi * 5), ({"settling": 0.2}, 19.56 * 0.1)]
)
def test_servos_on_light_joints_with_much_damping_are_lags(goal, kp):
    """kp/c, where inertia is negligible: -3 dB at kp/c, settled after ln 50 times c/kp."""
    roll = """<mujoco><worldbody><body><joint name="roll" axis="1 0 0" damping="0.1"/>
      <geom type="box" size=".02 .01 .01" mass=".02"/></body></worldbody>
      <actuator><position name="roll" joint="roll" kp="25"/></actuator></mujoco>"""
    (found,) = sc.tune(sc.loads(roll), **goal).found
    assert found.reached and float(re.search(r'kp="([\d.]+)" kv="0"/>', *found.lines)[1]) == (
        pytest.approx(kp, rel=0.03)
    )


def test_of_what_jumps_the_nearest_round_is_taken():
    """Friction lets go between two gains: the near value stays, though the last round is off."""
    rounds = iter([0.14, 0.095, 0.14, 0.096, 0.05])
    shown = functools.cache(lambda asked: next(rounds))
    asked, settled = Goal("settling", 0.1).corrected(1, np.vectorize(shown, otypes=[float]))
    assert settled == 0.096 == shown(asked[0])


@pytest.mark.parametrize("goal", [{"depth": 1e-4}, {"settling": 0.1}])
def test_a_geom_that_bears_nothing_is_said_to(goal):
    """It flies, or a slide carries it while it touches a wall without a force."""
    flies = "<body pos='0 0 5'><freejoint/><geom name='a' size='.1'/></body>"
    slides = """<geom type='plane' size='1 1 1'/><body pos='0 0 .1'>
    <joint type='slide' axis='1 0 0'/><geom name='a' size='.1'/></body>"""
    for body in (flies, slides):
        scene = sc.loads(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
        (tuned,) = sc.tune(scene, geom="a", **goal).found
        assert not tuned.reached and tuned.why.startswith("It does not rest on anything")


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({}, "give one of bandwidth, settling, sag, depth"),
        ({"sag": 0.1, "depth": 0.1}, "give one of"),
        ({"sag": -1.0}, "sag = -1.0: must be"),
        ({"sag": 0.1, "geom": "x"}, "geom and sag do not go together"),
        ({"depth": 0.1, "servo": "hip"}, "servo and depth do not go together"),
        ({"sag": 0.1, "servo": "hop"}, 'nearest: "hip"'),
        ({"depth": 0.1, "geom": "x"}, "x"),
    ],
)
def test_what_cannot_be_tuned_is_refused(fields, said):
    with pytest.raises(ValueError, match=said):
        sc.tune(sc.loads(ARM), **fields)


def test_the_command_prints_what_to_paste(capsys, tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(ARM)
    assert main(["tune", str(file), "--sag", "0.01"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert re.search(r"Servo `hip`, sag of 10 mrad: [\d.]+ mrad in the run, 10 mrad by", said)
    assert re.search(r'<position name="hip" kp="\d+" kv="[\d.]+"/>', said)
    assert main(["tune", str(file), "--depth", "0.1mm"]) == 0
    assert "nothing to tune" in " ".join(capsys.readouterr().out.split())
    assert main(["tune", str(file)]) == 2


RUBBING = """<mujoco><option timestep=".002" gravity="0 0 0"/><worldbody>
<geom name="base" type="cylinder" size=".04 .06" pos="0 0 .06"/><body pos="0 0 .11">
<joint name="j" axis="{}"/><geom name="hub" type="capsule" size=".01" fromto="0 0 0 .3 0 0"
mass="1"/></body></worldbody><actuator><position name="s" joint="j" kp="50"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    "axis, words",
    [
        ("0 0 1", "by the closed form, which leaves out contact `hub`/`base`"),
        ("0 1 0", "try another keyframe; contact `hub`/`base` acts there."),
    ],
)
def test_contacts_that_take_most_of_a_gain_are_named(axis, words):
    """A link turns in its base, 10 mm deep: the run shows half of what the closed form does."""
    scene = RUBBING.format(axis)
    said = " ".join(sc.tune(sc.loads(scene), bandwidth=5.0, progress=False).text().split())
    assert words in said
    free = scene.replace('<geom name="base"', '<geom name="base" contype="0" conaffinity="0"')
    assert "`hub`" not in sc.tune(sc.loads(free), bandwidth=5.0, progress=False).text()


QUAD, LEGS = Path(__file__).with_name("quad.xml"), ("FR", "FL", "RR", "RL")


def stood(scene):
    """The height at which a robot rests after 10 s under its keyframe, over the keyframe's."""
    sim = sc.Sim(scene)
    sim.reset(key=0)
    sim.step(round(10.0 / sim.settings.dt))
    return float(sim.qpos[2] / scene.keys[0].qpos[2])


@pytest.mark.parametrize("goal", [{"sag": 0.05}, {"sag": 0.2}, {"bandwidth": 5.0}])
def test_a_robot_stands_with_gains_that_are_reached(goal):
    """A quadruped falls with the shipped kp of 20, and with gains for its legs in the air."""
    tuning, xml = sc.tune(QUAD, **goal), QUAD.read_text()
    assert stood(sc.loads(xml)) < 0.3 and all(tuned.reached for tuned in tuning.found)
    assert stood(pasted(xml, tuning)) > 0.8
    most = goal.get("sag", np.inf)
    assert all(tuned.measured <= 1.1 * most for tuned in tuning.found)


def test_gains_with_which_the_robot_falls_are_not_reached():
    tuning = sc.tune(QUAD, bandwidth=2.0)
    assert not tuning.mjcf and "falls within" in tuning.found[0].why
    assert all(tuned.measured == pytest.approx(2.0, rel=0.1) for tuned in tuning.found)


def test_the_load_of_a_pose_that_cannot_stand_is_not_known():
    text = QUAD.read_text()
    leaning = text.replace(
        'key name="stand" qpos="0 0 .335 1 0 0 0 0 .8', 'key qpos="0 0 .5 1 0 0 0 0 2'
    )
    tuning = sc.tune(sc.loads(leaning), sag=0.05)
    assert not any(tuned.reached for tuned in tuning.found)
    assert "even with rigid joints" in tuning.found[0].why


def test_the_servos_of_legs_carry_the_contact_forces():
    """With the base's weight on four feet: the sum over legs of lever arms times m g."""
    model = sc.load(QUAD).compile()
    at = asking(model, At(*home(model, None)))
    ground, _, _ = ground_of(model, at, "sag")
    dofs = [int(model.jnt_dofadr[model.index("joint", f"{leg}_calf")]) for leg in LEGS]
    sim = sc.Sim(model)
    sim.qpos[:] = ground.end.qpos
    sim.forward()
    feet = [sim.geom_xpos[model.index("geom", leg)][0] for leg in LEGS]
    knees = [sim.xpos[model.index("body", f"{leg}_calf")][0] for leg in LEGS]
    weight = 9.81 * float(model.body_mass.sum()) / 4
    # The shank's weight, 0.19 kg, hangs between both.
    lever = weight * np.subtract(feet, knees)
    assert np.abs(ground.load(dofs)) == pytest.approx(np.abs(lever), rel=0.25)
