"""`diagnose`: fixes by bisection on the real step, names, and a warning that never fails a load."""

import copy
import math
import re
import warnings

import pytest
import stiff
from covering import every_pair, every_value, first

import stepcore as sc
from stepcore.engine.stiffness import estimate

# Runs beyond their limits are what these tests make.
pytestmark = pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")


def diagnosed(scene, **options):
    options = {"horizon": 0.1, "threads": 1, "progress": False} | options
    return sc.diagnose(scene, **options)


def series(count, k, mass=1.0, **options):
    """Equal masses in a row, an equal spring between neighbours: the last is free.

    The fastest mode is ω = 2 √(k/m) cos(π / (2 n + 1)), √2 times the frequency of one spring.
    """
    scene = sc.Scene(gravity=(0, 0, 0), name="series").with_settings(**options)
    parent = scene.world
    for i in range(count):
        parent = scene.add_body(f"mass{i}", parent=parent, pos=(1, 0, 0))
        scene.add_joint(parent, "slide", name=f"h{i}", axis=(1, 0, 0), stiffness=k)
        scene.add_geom(parent, "sphere", 0.1, mass=mass, **stiff.INERT)
    return scene


# --- gains that are not given -------------------------------------------------------------------


@first(2, kind=["position", "orientation", "intvelocity", "pid"])
def test_a_gain_that_is_not_given_is_advised_from_the_default_of_its_type(kind):
    """Law: kp = 1 and kv = 0 by default, so on 1e-6 kg or kg·m² it has ω = 1000/s and a limit of
    2 ms; only a smaller kp makes 5 ms stable."""
    joint = "ball" if kind == "orientation" else "slide"
    scene = sc.loads(f"""<mujoco><option gravity="0 0 0"/><worldbody><body>
      <joint name="knee" type="{joint}"/>
      <inertial pos="0 0 0" mass="1e-6" diaginertia="1e-6 1e-6 1e-6"/></body></worldbody>
      <actuator>{'<orientation name="drive" joint="knee"/>' * (kind == "orientation")}</actuator>
      </mujoco>""")
    if kind == "orientation":
        scene.actuator("drive").kp = scene.actuator("drive").kv = None
    else:
        scene.add_actuator("knee", kind, name="drive", input="pos" if kind == "pid" else None)
    scene = scene.with_settings(dt=0.005, integrator="semi-implicit")
    d = diagnosed(scene, ctrl=[[0.0] * sc.Model(scene).nu])
    assert d.limit() == pytest.approx(2e-3, rel=0.02) and "`drive`" in d.stiffest()
    met = {advice.what: advice for advice in d.advice if advice.met}
    (value,) = met["kp"].values
    assert value.field == "kp" and value.before == (1.0,) and value.after[0] < 0.2
    assert all(v.before == (0.0,) for a in d.advice for v in a.values if v.field == "kv")


# --- the warning at load ------------------------------------------------------------------------


HUGE = (
    'stiffness="1e308"',
    'damping="1e154"',
    'damping="1e308"',
    'stiffness="1" armature="1e154"',
    'stiffness="1" damping="1" armature="1e308"',
    'stiffness="1e-308" damping="1e-308"',
    'frictionloss="1e308" solreffriction="-1e300 -1e300"',
    'range="-1 1" limited="true" solreflimit="-1e300 -1e300"',
    'range="-1 1" limited="true" solreflimit="1e-200 1e-200" stiffness="1"',
)


@every_pair(attributes=HUGE, integrator=["Euler", "RK4", "implicitfast"])
def test_a_warning_never_fails_a_load(integrator, attributes):
    text = f"""<mujoco><option integrator="{integrator}"><flag refsafe="disable"/></option>
    <worldbody><body><joint name="k" type="slide" {attributes}/><geom size=".1" mass="1"/></body>
    </worldbody></mujoco>"""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", sc.StiffnessWarning)
        assert sc.loads(text).joints[0].name == "k"


def test_a_limit_too_short_to_ask_for_is_not_printed():
    """Law: k = 1e20 on 1 kg has ω = 1e10 and a limit of 0.2 ns: no step of use comes near."""
    text = estimate(stiff.slider(1e20, dt=0.01, integrator="euler"))
    assert "alone makes every step unstable, down to 1 µs" in text and " ns" not in text
    d = diagnosed(stiff.slider(1e20, dt=0.01, integrator="euler"))
    assert d.limit() == 0.0 and d.stiffest() == "spring of joint `slide`"
    assert "every step tried unstable, down to 1 µs" in d.sentences[0]
    assert " ns" not in d.text(full=True)


# --- names --------------------------------------------------------------------------------------


def planar(kp, kv, **options):
    """Links of 0.3 m and 0.5 kg in a plane, a position servo on each hinge."""
    scene = sc.Scene(gravity=(0, 0, 0), name="planar").with_settings(**options)
    parent = scene.world
    for i, (gain, damping) in enumerate(zip(kp, kv, strict=True)):
        parent = scene.add_body(f"link{i}", parent=parent, pos=(0.3 * (i > 0), 0, 0))
        scene.add_joint(parent, "hinge", name=f"j{i}", axis=(0, 1, 0))
        ends = (0, 0, 0, 0.3, 0, 0)
        scene.add_geom(parent, "capsule", 0.03, fromto=ends, mass=0.5, **stiff.INERT)
        servo = {"type": "position", "kp": gain, "kv": damping}
        scene.add_actuator(f"j{i}", name=f"servo{i}", **servo)
    return scene


def real_limit(scene, integrator, near, steps=1000):
    """The largest stable dt of the real step [s], around the pose at rest."""
    model = scene.compile()
    return stiff.bisected(
        lambda dt: stiff.stays(model, integrator, dt, steps), near / 3, 12 * near, fine=5e-3
    )


def test_the_servo_is_named_whose_softening_raises_the_real_limit_most():
    """Law: of an arm under rk4, servo4 has the largest share in the mode, but servo3 is what limits
    dt: a tenth of its gains raises the bisected limit of the real step by 32 %, a tenth of
    servo4's by 10 %."""
    kp, kv = [3157, 14, 3039, 2743, 5915, 984], [0.25, 1.27, 1.25, 3.81, 0.9, 4.89]
    d = diagnosed(planar(kp, kv, dt=1e-3, integrator="rk4"))
    assert d.stiffest() == "servo `servo3`"
    real = real_limit(planar(kp, kv), "rk4", d.limit())
    assert d.limit() == pytest.approx(real, rel=0.05)
    rises = []
    for i in (4, 3):
        softer = [[g * (0.1 if k == i else 1) for k, g in enumerate(gains)] for gains in (kp, kv)]
        rises.append(real_limit(planar(*softer), "rk4", d.limit()) / real)
    assert rises[0] < 1.15 and rises[1] > 1.25


def test_ten_equal_springs_are_named_together():
    """Law: no spring of ten in a row limits dt by itself; all do, at ω = 2 √(k/m) cos(π/21)."""
    d = diagnosed(series(10, 1e4, dt=0.005, integrator="semi-implicit"))
    assert d.together() == [f"spring of joint `h{i}`" for i in range(10)]
    assert d.limit() == pytest.approx(1 / (100 * math.cos(math.pi / 21)), rel=2e-3)
    together = "the 10 springs of joints `h0`, `h1`, `h2`, `h3` and 6 more together"
    assert d.stiffest() == together and f"{together} (" in d.sentences[0]
    assert " limit dt to 10.1 ms" in d.sentences[0]
    # A spring that is stiffer than the others is named by itself.
    scene = series(10, 1e4, dt=0.005, integrator="semi-implicit")
    scene.joints[4].stiffness = 1e5
    assert diagnosed(scene).together() == ["spring of joint `h4`"]


# --- fixes --------------------------------------------------------------------------------------

MARGIN = 1.5


def cured(scene, advice):
    """A copy of the scene with a piece of advice made by hand, from its text."""
    scene = copy.deepcopy(scene).with_settings(**advice.settings)
    for value in advice.values:
        names = value.owner.split("`")[1::2]
        after = value.after if value.field.startswith(("sol", "bias")) else value.after[0]
        if value.owner.startswith("servo"):
            setattr(scene.actuator(names[0]), value.field, after)
        elif value.owner.startswith("both geoms"):
            for name in names:
                setattr(scene.geom(name), value.field, after)
        else:
            setattr(scene.joint(names[0]), value.field, after)
    return scene


def check_cures(scene, whats, within=0.2, wanted=5e-3, least=True):
    """Every fix is bisected on the real step: its limit is the margin times the wanted dt, and
    not much beyond where the least change was searched for."""
    d = diagnosed(scene, dt=wanted)
    met = [a for a in d.advice if a.met]
    assert set(whats) <= {a.what for a in met}, [a.text for a in d.advice]
    ranks = [(a.hardware, a.size) for a in met]
    assert ranks == sorted(ranks)
    for advice in met:
        changed = cured(scene, advice)
        integrator = changed.settings.integrator
        model = changed.compile()
        assert stiff.stays(model, integrator, wanted, 1000), advice.text
        near = (1 - within) * MARGIN * wanted
        assert stiff.stays(model, integrator, near, 1000), advice.text
        if least and advice.values:
            far = (1 + within) * MARGIN * wanted
            steps = 20_000 if model.nv == 1 else 2000
            assert not stiff.stays(model, integrator, far, steps, grown=10), advice.text
    return d


def servo(kp, kv, integrator, **joint):
    """A wheel of 1 kg m² on a position servo."""
    scene = sc.Scene(gravity=(0, 0, 0), name="wheel").with_settings(integrator=integrator, dt=5e-3)
    wheel = scene.add_body("wheel")
    scene.add_joint(wheel, "hinge", name="axle", axis=(0, 0, 1), **joint)
    wheel.mass, wheel.inertia = 1.0, (1.0, 1.0, 1.0)
    scene.add_actuator("axle", type="position", name="drive", kp=kp, kv=kv)
    return scene


def test_a_lower_kv_cures_where_none_at_all_would_not():
    """Law: explicit, ω = 10: damped by c h < 2 and c > ω² h. kv 1000 is to be 2/(1.5 h) = 266."""
    d = check_cures(servo(100.0, 1000.0, "explicit"), {"kv", "armature"})
    kv = next(a for a in d.advice if a.what == "kv")
    assert kv.met and kv.values[0].after[0] == pytest.approx(2 / 7.5e-3, rel=0.03)


def test_a_higher_kv_cures_where_a_lower_one_does_not():
    """Law: the same with too little damping: kv 1 is to be ω² 1.5 h = 75; and from none."""
    d = check_cures(servo(1e4, 1.0, "explicit"), {"kv", "kp"})
    kv = next(a for a in d.advice if a.what == "kv")
    assert kv.values[0].after[0] == pytest.approx(1e4 * 7.5e-3, rel=0.03)
    d = check_cures(servo(4e4, 0.0, "explicit"), {"kv"}, wanted=2e-3)
    kv = next(a for a in d.advice if a.what == "kv")
    assert kv.values[0].before == (0.0,)
    assert kv.values[0].after[0] == pytest.approx(4e4 * 3e-3, rel=0.03)


@first(2, integrator=["implicitfast", "rk4", "semi-implicit"])
def test_cures_of_a_stiff_servo(integrator):
    """kp 4e5 on 1 kg m² at 5 ms, under three integrators; verified fixes, the least first."""
    whats = {"kp", "armature", "integrator"}
    check_cures(servo(4e5, 20.0, integrator, damping=0.1), whats)


def test_cures_of_an_arm_of_equal_servos():
    """Six servos too strongly damped for an explicit rule: changed together."""
    d = check_cures(planar([100] * 6, [3] * 6, dt=5e-3, integrator="rk4"), {"kv", "armature"})
    assert len(d.together()) == 6 and len(next(a for a in d.advice if a.what == "kv").values) == 6


def test_armature_on_the_whole_chain():
    """One stiff servo in an arm: armature on its joint, or on all six, and the real step agrees."""
    kp = [50, 50, 5000, 50, 50, 50]
    d = check_cures(
        planar(kp, [1] * 6, dt=5e-3, integrator="implicitfast"),
        {"armature", "armature of the whole chain"},
    )
    chain = next(a for a in d.advice if a.what == "armature of the whole chain")
    assert [value.owner for value in chain.values] == [f"joint `j{i}`" for i in range(6)]
    assert " times the inertia that each moves" in chain.text


def bounces(scene, dt):
    """Whether a ball that rests on the floor starts to bounce at a step [s]."""
    model = scene.compile()
    rest = sc.Sim(model, integrator="euler", dt=2e-5)
    rest.step(20_000)
    sim = sc.Sim(model, integrator="euler", dt=dt)
    sim.qpos[:] = 1.001 * rest.qpos
    sim.step(3000)
    return max(abs(float((sim.step(), sim.qvel[0])[1])) for _ in range(200)) > 1e-6


@pytest.mark.parametrize("solref", [(-1e6, -200.0), (-1e5, -1500.0)])
def test_cures_of_a_contact_in_direct_form(solref):
    """A softer solref in direct form, and one of the standard form instead: at rest at 1.5
    times the wanted dt where the ball bounced before; the direct one within 20 % of its limit."""
    scene = stiff.pad(solref, dt=5e-3, integrator="euler")
    assert bounces(scene, 5e-3)
    d = diagnosed(scene)
    met = {a.what: a for a in d.advice if a.met}
    assert {"solref", "standard form of solref"} <= met.keys()
    assert met["standard form of solref"].values[0].after[0] >= 2 * MARGIN * 5e-3
    for advice in met.values():
        if advice.values:
            assert not bounces(cured(scene, advice), 0.8 * MARGIN * 5e-3), advice.text


def test_a_cure_that_is_smaller_comes_first():
    """Law: the size of a change is |log| of its factor; armature counts relative to the inertia."""
    d = check_cures(servo(4e5, 20.0, "semi-implicit"), {"kp", "armature"})
    met = {a.what: a for a in d.advice if a.met}
    kp, armature = met["kp"].values[0], met["armature"].values[0]
    assert met["kp"].size == pytest.approx(math.log(kp.before[0] / kp.after[0]))
    assert met["armature"].size == pytest.approx(math.log(1 + armature.after[0]), rel=0.02)
    assert d.sentences[1].endswith("makes 5 ms stable with a margin of 1.5×:")
    assert any(s.endswith("The smallest change comes first, hardware last.") for s in d.sentences)


# --- numbers that leave their range -------------------------------------------------------------


@every_value(
    integrator=["euler", "rk4", "implicitfast"],
    fields=[
        {"stiffness": 1e12, "damping": 1e-154},
        {"stiffness": 1e20, "armature": 1e-20, "frictionloss": 1e12},
        {"damping": 1e80, "range": (-0.1, 0.5), "solreflimit": (-1e154, -1e-6)},
        {"stiffness": 1e-154, "armature": 1e154, "damping": 1e154},
        {"frictionloss": 1e80, "solreffriction": (-1e200, -1e154), "stiffness": 3.0},
    ],
)
def test_an_answer_or_a_named_refusal_never_a_failure_of_algebra(fields, integrator):
    """Law: SVD, inverses and squares that leave their range end in a sentence, without numbers
    that were not requested, or in a ValueError that names the defect of the scene."""
    scene = servo(3e3, 1e-3, integrator, **fields)
    scene.add_geom(scene.body("wheel"), "sphere", 0.1, pos=(0, 1, 0), mass=1e-6)
    try:
        d = diagnosed(scene, horizon=0.02)
    except ValueError as error:
        assert "accelerations are not finite" in str(error)
        return
    said = " ".join(d.sentences)
    blown = "The motion blows up at every step tried"  # Its top speed is 1e77 rad/s.
    assert said.startswith(("A step of 5 ms", "No element limits dt", blown))
    assert not re.search(r"nan\b|inf\b|e[-+]?([1-9]\d|\d{3})| ns\b", d.sentences[0]), said
    assert d.to_json() and d.text(full=True)


@pytest.mark.long
def test_rows_that_begin_to_act_within_the_step_are_compared_where_they_act():
    """dm_control's humanoid: its rows at the limit differ from the rows of the limiting state."""
    d = sc.diagnose("dm_control:suite/humanoid", horizon=0.5, progress=False)
    assert d.limit() > 0.005 and d.stiffest()


def test_growth_faster_than_any_step_is_not_told_in_numbers():
    """Law: a spring that pushes away, k = −1e40 on 1 kg, grows e-fold in 1e-20 s: no meaningless
    number is printed, of the growth or of a solref of 1e-20 s."""
    text = diagnosed(stiff.slider(-1e40, dt=2e-3, integrator="euler"), horizon=0.02).text(full=True)
    assert "diverge e-fold in less than " in text and not re.search(r"e-\d+ n?s\b", text)
    soft = diagnosed(stiff.pad((1e-20, 1.0), dt=2e-3), horizon=0.02)
    assert any(note.startswith("above dt 1 µs the setting refsafe") for note in soft.notes)
    assert not re.search(r"e-\d+ n?s\b", soft.text(full=True))


def test_control_functions_get_advice():
    """Law: an inertia I under −kd q̇ held over dt is stable for dt < 2 I/kd. Armature on its joint
    fixes it, run with the function itself at nearly 1.5 times the wanted dt."""
    scene = servo(0.0, 0.0, "implicitfast")
    scene.actuators[0].type = "motor"
    scene.actuators[0].kp = scene.actuators[0].kv = None

    def hold(time, sim):
        return [-20.0 * sim.qpos[0] - 600.0 * sim.qvel[0]]

    d = diagnosed(scene, control=hold)
    assert d.stiffest() == "control of motor `drive`"
    assert d.limit() == pytest.approx(2 / 600.0, rel=0.02)
    met = {a.what: a for a in d.advice if a.met}
    assert met["armature"].values[0].after[0] == pytest.approx(7.5e-3 * 600 / 2 - 1, rel=0.03)
    for advice in (met["armature"],):
        sim = sc.Sim(cured(scene, advice).compile(), dt=0.97 * MARGIN * 5e-3)
        sim.qvel[:] = 1e-3
        for _ in range(2000):
            sim.ctrl[:] = hold(sim.time, sim)
            sim.step()
        assert abs(sim.qvel[0]) < 1e-2, advice.text


def test_a_softer_penalty_spring():
    """Law: k on 1 kg, damped by 2ζ√(k m), explicit: dt < 2(√(ζ² + 1) - ζ)/ω; at 1.5 times the
    wanted 5 ms that is k = (2(√(ζ² + 1) - ζ)/7.5 ms)². At rest on the floor, by the real step."""
    law = {"law": "penalty", "penalty_stiffness": 1e6, "penalty_damping_ratio": 0.1}
    scene = stiff.pad(dt=5e-3, integrator="semi-implicit", **law)
    scene.body("ball").pos = (0, 0, 0.1005)
    d = diagnosed(scene, horizon=0.2)
    advice = next(a for a in d.advice if a.what == "penalty_stiffness")
    soft = (2 * (math.sqrt(1.01) - 0.1) / 7.5e-3) ** 2
    # The ball falls onto it, so that it takes somewhat less.
    assert advice.met and 0.7 * soft < advice.settings["penalty_stiffness"] < 1.03 * soft

    def rests(dt):
        sim = sc.Sim(scene.with_settings(**advice.settings).compile(), dt=dt)
        # The position at which the spring carries the weight.
        sim.qpos[:] = -0.0005 - 1.0001 * 9.81 / advice.settings["penalty_stiffness"]
        sim.step(3000)
        return abs(float(sim.qvel[0])) < 1e-4

    assert rests(0.9 * 7.5e-3)


# --- order and length ---------------------------------------------------------------------------


def test_the_answer_comes_first_and_a_screen_is_enough():
    """Six springs: the sentence first, then at most 45 lines; every element on demand."""
    scene = stiff.chain((50.0, 100.0, 4000.0) * 2, damping=0.1, dt=5e-3, integrator="euler")
    d = diagnosed(scene, horizon=0.02)
    lines = d.text(width=100).splitlines()
    assert lines[0].startswith("A step of 5 ms ") and str(d).startswith("A step of 5 ms ")
    assert len(lines) <= 45
    assert sum("joint `joint" in line for line in lines) < 16
    assert "Not shown: 6 other elements" in d.text(width=100)
    full = d.text(width=200, full=True)
    assert all(f"spring of joint `joint{i}` " in full for i in range(6))
    assert "Not shown" not in full and "midpoint" in full


def test_the_motion_is_told():
    """From where, for how long, how the controls were driven, and under which law."""

    def told(scene, **options):
        return next(
            s for s in diagnosed(scene, **options).sentences if s.startswith("The motion: ")
        )

    still = told(stiff.slider(1.0, dt=1e-3))
    assert still == "The motion: 100 ms from the pose of the scene; no motors; law solref."
    scene = servo(100.0, 1.0, "euler")
    scene.add_key("ready", qpos=[0.1], ctrl=[0.0])
    assert "from keyframe `ready`; test motion: servos move point to point over" in told(scene)
    assert "from keyframe `ready`; servos are held at zero, because nothing" in told(
        scene, kind="sines"
    )
    scene.actuators[0].ctrlrange = (-1, 1)
    assert "random sines of 0.3 to 3 Hz, ±40 % of the control range" in told(scene, kind="sines")
    assert "hold 0.2" in told(scene, ctrl=[[0.2]])
    function = told(scene, control=lambda time, sim: [0.0])
    assert "servos driven by the control function `<lambda>, line " in function
    assert " of test_diagnose_advice.py, sampled at every step; law" in function


def test_cures_of_a_saturated_servo_hold_in_the_motion():
    """A light wrist (1.5e-4 kg m²) on a strong servo, thrown to hundreds of rad/s from one end of
    its force range to the other: every fix is run with the real step at up to 1.5 times the
    wanted dt, kicked by 2 rad/s, and throws it to no more than four times that."""
    scene = servo(500.0, 50.0, "implicitfast").with_settings(dt=2e-3)
    scene.body("wheel").inertia = (1.5e-4,) * 3
    scene.actuators[0].forcerange, scene.actuators[0].ctrlrange = (-52, 52), (-1, 1)
    scene.add_key("kicked", qvel=[2.0])

    def fastest(scene, dt):
        sim = sc.Sim(scene.compile(), dt=dt)
        sim.reset(key="kicked")
        return max(abs(float((sim.step(), sim.qvel[0])[1])) for _ in range(1000))

    assert fastest(scene, 2e-3) > 100
    d = diagnosed(scene, dt=2e-3, horizon=0.5)
    met = {a.what: a for a in d.advice if a.met}
    assert "kv" in met
    for advice in met.values():
        for part in (1.0, 0.97 * MARGIN):
            assert fastest(cured(scene, advice), part * 2e-3) < 8, advice.text
