"""`diagnose` judges the motion itself: saturated servos, slow growth, fast rotation, contacts that
are not there at the start; each against the real step, run here separately."""

import dataclasses
import functools
import math

import pytest
import stiff
from covering import first
from stiff import diagnosed

import stepcore as sc

# Steps beyond a limit are run on purpose.
pytestmark = pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")


# --- saturated servos ---------------------------------------------------------------------------

INERTIA, KP, KV, FORCE = 1.5e-4, 500.0, 50.0, 52.0


def wrist(kick=0.0, force=FORCE, inertia=INERTIA, kv=KV):
    """An arm with a light wrist and a servo of limited force; kicked at this speed [rad/s]."""
    light = " ".join([f"{inertia}"] * 3)
    return sc.loads(f"""<mujoco><option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/>
    <worldbody><body name="arm"><joint name="shoulder" axis="0 1 0"/>
      <inertial pos=".2 0 0" mass="1" diaginertia=".01 .01 .01"/>
      <body name="hand" pos=".4 0 0"><joint name="wrist" axis="0 1 0"/>
        <inertial pos="0 0 0" mass=".1" diaginertia="{light}"/></body></body></worldbody>
    <actuator><position name="shoulder" joint="shoulder" kp="500" kv="50"/>
      <position name="wrist" joint="wrist" kp="{KP}" kv="{kv}" forcerange="-{force} {force}"/>
    </actuator><keyframe><key qvel="0 {kick}"/></keyframe></mujoco>""")


@functools.cache
def kicked():
    scene = wrist(kick=2.0)
    return scene, diagnosed(scene)


def test_a_servo_that_the_motion_saturates_fails_the_step():
    """Law: beyond F/kv the force is ±F, and a step throws the wrist by F·dt/I = 693 rad/s; it stays
    finite."""
    _, d = kicked()
    assert d.fails and d.limit() < 2e-3 and d.stiffest() == "servo `wrist`"
    assert d.held() > 0.1 and "Runs show" in d.sentences[1]


def test_a_step_that_holds_where_shorter_ones_fail_is_not_said_to_fail():
    """Runs are stable by luck, as where a body tumbles and comes to rest earlier."""
    _, d = kicked()
    lucky = dataclasses.replace(d, observed=dataclasses.replace(d.observed, kind="holds"))
    assert lucky.sentences[0].startswith(
        "A step of 2 ms holds in this run under implicitfast, but "
    )


def test_a_servo_without_force_range_or_with_inertia_does_not_chatter():
    free = wrist(kick=2.0, force=1e9)
    heavy = wrist(kick=2.0, inertia=0.1)
    for scene in (free, heavy):
        d = diagnosed(scene)
        assert d.observed.holds
        assert d.limit() > 0.002


SWINGING = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody>
  <body><joint name="j" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>
  </worldbody><actuator><position name="s" joint="j" kp="100" {}/></actuator></mujoco>"""


@pytest.mark.parametrize("bound", ["", 'forcerange="-25 25"'])
def test_a_servo_that_swings_without_a_damper_does_not_chatter(bound):
    """At every eleventh step its force changes as much as chatter does: 15.9 ms was reported."""
    step = {"ctrl": [[0.0], [0.2]], "control_dt": 0.1}
    for integrator, times in (("euler", 2), ("rk4", 2 * math.sqrt(2))):
        found = diagnosed(sc.loads(SWINGING.format(bound)), [integrator], **step)
        assert found.limit(integrator) == pytest.approx(times / 10, rel=0.03)


FLUNG = """<mujoco><option timestep=".0005"/><worldbody>
<body pos=".3 .4 .54"><joint axis="0 1 0" damping=".0232"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".03" mass=".12"/><body pos=".2 0 0">
<joint name="k" axis="0 1 0" stiffness=".642"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".0166"/></body></body>
<body pos=".6 .4 .5"><joint axis="0 1 0" damping=".19"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".03" mass="9.23"/></body></worldbody>
<actuator><position name="servo" joint="k" kp="700" forcerange="-20 20"/></actuator></mujoco>"""


def test_what_bears_two_hundred_times_the_step_is_not_named_by_a_linearisation_alone():
    """While the servo saturates and the link spins, only a damper of 11/s has a slope."""
    d = sc.diagnose(sc.loads(FLUNG), integrators=("euler",), progress=False)
    assert 5e-4 < d.limit() < 1.1e-3 and d.stiffest() == "servo `servo`"


def test_cures_of_chatter_are_tried_on_the_motion():
    """The advice makes the real wrist come to rest at 2 ms."""
    scene, d = kicked()
    advice = [a for a in d.advice if a.met and a.values]
    assert advice
    for one in advice:
        values = {f"{_path(value.owner)}/{value.field}": value.after[0] for value in one.values}
        cured = scene.compile().with_values(values)
        sim = sc.Sim(cured)
        sim.reset(key=0)
        sim.step(800)
        assert abs(float(sim.qvel[1])) < 1.0, one.text


def _path(owner):
    kind, name, _ = owner.split("`")
    return f"{'actuator' if 'servo' in kind else 'joint'}/{name}"


# --- rotation that nothing damps ----------------------------------------------------------------


def links(speed=60.0, integrator="implicitfast", dt=1e-3):
    """Three links in a row, the first turning fast, without damping or gravity."""
    scene = sc.Scene(gravity=(0, 0, 0), name="links").with_settings(dt=dt, integrator=integrator)
    parent = scene.world
    for i in range(3):
        parent = scene.add_body(f"link{i}", parent=parent, pos=(0.3 if i else 0.0, 0, 0))
        scene.add_joint(parent, "hinge", name=f"hinge{i}", axis=(0, 1, 0))
        ends = (0, 0, 0, 0.3, 0, 0)
        scene.add_geom(parent, "capsule", 0.02, fromto=ends, mass=0.5, **stiff.INERT)
    scene.add_key("turning", qpos=(0, 0.3, 0.3), qvel=(speed, 0, 0))
    return scene


def test_inertial_forces_limit_links_in_the_plural():
    d = diagnosed(links(), dt=2e-3)
    assert d.stiffest() == "inertial forces" and d.limiting() is None
    assert d.sentences[0].startswith("A step of 2 ms explodes after ")
    assert "inertial forces limit dt to " in d.sentences[0]


def test_growth_at_every_step_is_physical_and_named():
    """A servo that pushes with the velocity, e-fold in 50 ms: no dt is the cause, which comes
    first. Its kinetic energy is 1e16 times a slow motion's after 0.77 s at any fine step."""
    scene = sc.loads("""<mujoco><option timestep=".002" integrator="implicitfast" gravity="0 0 0"/>
    <worldbody><body name="cart"><joint name="rail" type="slide" axis="1 0 0"/>
      <geom size=".1" mass="1" contype="0" conaffinity="0"/></body></worldbody>
    <actuator><general name="push" joint="rail" gainprm="1" biastype="affine" biasprm="0 0 20"/>
    </actuator><keyframe><key qvel="1"/></keyframe></mujoco>""")
    d = diagnosed(scene)
    assert d.runaway.alike
    # x = e^(20 t)/20, a run ends at 1e4 sizes and 1e4 m/s² · t²/2: between 1e3 and 1e5 m.
    assert math.log(2e4) / 20 < d.runaway.times[1] < math.log(2e6) / 20
    assert d.sentences[0].startswith("The motion itself blows up after ")
    assert "No dt prevents that." in d.sentences[0]
    assert any("two fine steps agree" in note for note in d.notes)


@pytest.mark.parametrize(("damping", "told"), [(0.0, True), (0.5, False)])
def test_growth_that_is_lost_again_is_not_told(damping, told):
    """A pendulum that falls over hangs in the end, with damping, from any start."""
    scene = sc.loads(f"""<mujoco><option integrator="implicitfast"/><worldbody><body>
      <joint axis="0 1 0" damping="{damping}"/><geom type="capsule" fromto="0 0 0 0 0 .5" size=".02"
        mass="1"/></body></worldbody><keyframe><key qpos=".1"/></keyframe></mujoco>""")
    d = diagnosed(scene, dt=2e-3, horizon=5.0)
    assert d.physical > 1
    assert any("nearby motions diverge" in note for note in d.notes) == told


# The second crank is too short in most poses, where its servo has no arm then: a kink.
CRANKS = """<mujoco><default><position ctrlrange="-.1 .1" kp="30"/><joint damping=".1"/>
  <default class="rod"><geom type="capsule" size=".01"/></default></default>
  <worldbody><geom type="plane" size=".5 .5 .01" pos="0 0 -.05"/>
  <site name="a" pos="0 -.1 0" zaxis="1 .5 0"/><site name="b" pos="0 .1 0" zaxis="1 .2 0"/>
  <body><joint/><geom class="rod" fromto="0 0 0 .2 0 0"/><site name="A" pos=".1 0 0"/>
    <body pos=".15 0 0"><joint/><geom class="rod" fromto="0 -.15 0 0 0 0"/></body></body>
  <body pos="0 .2 0"><joint/><geom class="rod" fromto="0 0 0 .15 0 0"/>
    <site name="B" pos=".1 0 0"/></body></worldbody>
  <actuator><position cranksite="A" slidersite="a" cranklength=".08"/>
    <position cranksite="B" slidersite="b" cranklength=".05"/></actuator></mujoco>"""


def test_a_kink_that_two_runs_pass_in_different_steps_is_no_limit():
    """The runs differ for a moment, 2.4 s into a run; if 1000 steps end then, this counted as
    growth without end. Dampers alone limit dt, as in the held pose."""
    d = diagnosed(sc.loads(CRANKS), ["rk4"])
    assert d.limit("rk4") == pytest.approx(d.held("rk4"), rel=0.02)


def test_friction_loss_has_no_frequency():
    scene = sc.loads("""<mujoco><option integrator="implicitfast"/><worldbody><body>
      <joint name="j" axis="0 0 1" frictionloss=".1" armature=".01"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".5"/></body></worldbody>
      <actuator><position joint="j" kp="50" kv="5"/></actuator>
      <keyframe><key qvel="1"/></keyframe></mujoco>""")
    row = diagnosed(scene).element("friction loss of joint `j`")
    assert row is None or row.omega == 0


# --- elements that act later --------------------------------------------------------------------


def drop(height=0.5, dt=2e-3, **law):
    """A ball above a floor that is met for 3 ms."""
    scene = sc.Scene(name="drop").with_settings(dt=dt, integrator="semi-implicit", **law)
    ball = scene.add_body("ball", pos=(0, 0, 0.1 + height))
    scene.add_joint(ball, "free")
    scene.add_geom(ball, "sphere", 0.1, mass=1.0, name="ball", condim=1)
    scene.add_geom("world", "plane", name="floor", condim=1)
    return scene


@first(1, height=[0.5, 0.1])
def test_a_contact_that_begins_in_the_air_limits_dt(height):
    """Law: a ball at rest needs dt < 2(√(ζ² + 1) - ζ)/ω. This ball touches for 3 ms, a few steps at
    a time, and a lucky touch throws it higher below that step: a plain loop at 0.93 of it throws
    the ball from 0.5 m to 4 m within 8 s; from 0.1 m, 0.88 gives 24 times the energy in 4 s."""
    d = diagnosed(drop(height, law="penalty", penalty_stiffness=1e6, penalty_damping_ratio=0.1))
    resting = 2 * (math.sqrt(1.01) - 0.1) / 1e3
    assert d.stiffest() == "contact `floor`/`ball`"
    assert {0.5: 0.9, 0.1: 0.85}[height] * resting < d.limit() < 1.5 * resting
    assert [row.name for row in d.rows] == ["contact `floor`/`ball`"]


def test_a_limit_that_is_reached_between_two_samples_is_seen():
    """A pendulum that hits a stiff limit in direct form for an instant."""
    scene = sc.Scene(name="stop").with_settings(dt=1e-3, integrator="euler")
    rod = scene.add_body("rod")
    stop = {"range": (-0.5, 3.0), "solreflimit": (-1e6, -500.0)}
    scene.add_joint(rod, "hinge", name="knee", axis=(0, 1, 0), **stop)
    scene.add_geom(rod, "capsule", 0.02, fromto=(0, 0, 0, 0, 0, -0.3), mass=1.0, **stiff.INERT)
    scene.add_key("up", qpos=(0.6,), qvel=(-6.0,))
    d = diagnosed(scene, horizon=0.4)
    assert "limit of joint `knee`" in [row.name for row in d.rows]
    assert d.stiffest() == "limit of joint `knee`"


# --- what has no answer ---------------------------------------------------------------------------


@first(2, stiffness=[1e12, 1e305, 1e150, 1e200])
def test_an_absurd_stiffness_is_an_answer_and_no_exception(stiffness):
    d = diagnosed(stiff.slider(stiffness, 1.0, dt=1e-3))
    text = d.text()
    assert "spring of joint `slide`" in d.sentences[0]
    assert not any(f"e-{n:02d} ns" in text for n in range(2, 40)) and "nan" not in text


DRIVEN_AWAY = """<mujoco><option timestep="0.001"/><worldbody>
  <body><joint name="a" axis="0 1 0" range="-20 20"/><geom size=".1" pos=".3 0 0"/>
    <body pos=".5 0 0"><joint name="b" axis="0 1 0" range="-20 20"/><geom size=".1" pos=".3 0 0"/>
    </body></body></worldbody>
  <actuator><general joint="a" biastype="affine" biasprm="0 {} 0"/></actuator></mujoco>"""


@first(1, gain=[1e7, 1e6])
def test_a_motion_that_blows_up_is_diagnosed_where_accelerations_overflow(gain):
    """Its last states are finite, their accelerations are not; nothing is stable over a second."""
    found = diagnosed(sc.loads(DRIVEN_AWAY.format(gain)))
    assert found.runaway is not None and found.runaway.alike
    assert found.sentences[0].startswith("The motion itself blows up after ")
    assert "over 1 s" not in found.sentences[1]


SLIPPING = """<mujoco><option timestep="0.005" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
  <body><joint name="j" axis="0 1 0" armature="0.03" frictionloss="0.05" damping="3.5"/>
    <geom size=".01" mass="1e-6"/></body></worldbody>
  <actuator><position name="s" joint="j" kp="1040" ctrlrange="-2 2" forcerange="-3 3"/></actuator>
  </mujoco>"""


def test_a_servo_that_friction_would_hold_at_rest_limits_dt_where_it_moves():
    """Beyond 10 ms refsafe softens the friction loss, which slips, with its force, however soft.

    SO-101 by its shape: a step beyond the servo's limit chatters between the force bounds.
    """
    found = diagnosed(sc.loads(SLIPPING))
    omega = math.sqrt(1040 / 0.03)
    ratio = 3.5 / (2 * 0.03 * omega)
    limit = (2 * ratio + 2 * math.sqrt(ratio**2 + 1)) / omega
    # In slightly longer steps friction brings it to rest again: up to 15.4 ms, 5.6 % more.
    assert found.limit() == pytest.approx(limit, rel=0.06) and limit > 0.01
    speeds = {}
    for part in (0.9, 1.3):
        sim = sc.Sim(sc.loads(SLIPPING), dt=part * limit)
        sim.qvel[:] = 1.0
        sim.step(300)
        speeds[part] = float(abs(sim.qvel[0]))
    assert speeds[0.9] < 1e-6 and speeds[1.3] > 0.1


@pytest.mark.parametrize("integrator, times", [("euler", 2), ("rk4", 2.7853)])
def test_chatter_within_a_force_range_is_no_step_that_holds(integrator, times):
    """Beyond it a servo swings between its bounds, and no perturbation grows."""
    found = diagnosed(sc.loads(stiff.damped_servo()), [integrator])
    assert found.limit(integrator) == pytest.approx(times / stiff.POLE, rel=0.03)


MOTOR = '<motor name="s" joint="j"/>'


def clipped(time, sim):
    target = 0.3 * math.sin(4 * time) if time < 1 else 0.0
    force = 330 * (target - sim.qpos[0]) - 66 * sim.qvel[0]
    return [min(max(force, -56.0), 56.0)]


@pytest.mark.parametrize("dt", [0.001, 0.004])
def test_chatter_within_the_bounds_of_a_user_s_function_is_no_step_that_holds(dt):
    """In the shipped step, too, where it would be the converged motion."""
    scene = sc.loads(stiff.damped_servo(MOTOR, dt))
    found = diagnosed(scene, ["rk4"], control=clipped, horizon=1.0)
    # Forces that are held during a step act as in euler.
    assert found.limit("rk4") == pytest.approx(2 / stiff.POLE, rel=0.03)


def test_a_control_period_in_which_a_function_chatters_is_told():
    scene = sc.loads(stiff.damped_servo(MOTOR))
    found = diagnosed(scene, ["euler"], control=clipped, control_dt=0.004, horizon=1.0)
    assert "the control function is sampled too rarely" in found.sentences[0]
    # In whole steps.
    assert found.longest_period == pytest.approx(0.003)


# --- activations ----------------------------------------------------------------------------------

# The actuator integrates its control, so its activation is a constant of the motion. Its gain is
# -(1e4 length + 2 velocity): multiplied by the activation, a spring and a damper.
ACTIVATED = """<mujoco><option timestep="{dt}" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody><body><joint name="rail" type="slide" axis="1 0 0"
    stiffness="{stiffness}"/><geom size=".1" mass="1" contype="0" conaffinity="0"/></body>
  </worldbody><actuator><general name="drive" joint="rail" dyntype="integrator" gaintype="affine"
    gainprm="0 -1e4 -2"/></actuator>
  <keyframe><key qvel="1" act="4"/></keyframe></mujoco>"""


def test_a_keyframes_activation_is_part_of_the_state_that_is_diagnosed():
    """Law: activation 4 makes ω = 200/s with ζ = 0.02, undamped dt < 2/ω; relaxed, nothing acts."""
    scene = sc.loads(ACTIVATED.format(dt=1e-3, stiffness=0))
    d = diagnosed(scene, ["rk4", "semi-implicit"], control=lambda time, sim: [0.0])
    assert all(state.act.tolist() == [4.0] for state in d.states)
    assert d.stiffest("rk4") == "servo `drive`"
    assert d.limiting("rk4").omega == pytest.approx(200)
    limit = 2 * (math.sqrt(1 + 0.02**2) - 0.02) / 200
    assert d.limit("semi-implicit") == pytest.approx(limit, rel=2e-3)


def test_the_motion_that_judges_begins_with_the_keyframes_activation():
    """The mass swings by 1/ω = 5 mm, more where a step gains energy. Relaxed, it would drift 1 m in
    the second that is run."""
    seen = []

    def control(time, sim):
        seen.append((abs(float(sim.qpos[0])), float(sim.act[0])))
        return [0.0]

    diagnosed(sc.loads(ACTIVATED.format(dt=1e-3, stiffness=0)), control=control)
    assert min(q for q, _ in seen) < 0.1 and {act for _, act in seen} == {4.0}
