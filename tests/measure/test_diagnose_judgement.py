"""`diagnose` judges the motion itself: saturated servos, slow growth, fast rotation, contacts that
are not there at the start; each against the real step, run here on its own."""

import functools
import math

import pytest
import stiff
from covering import first
from stiff import diagnosed

import stepcore as sc
from stepcore.measure.diagnosis.motion_limit import first_failing
from stepcore.measure.diagnosis.servo_range import crossing_dt

# Steps beyond a limit are run on purpose.
pytestmark = pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")


def kinetic_peak(scene, integrator, dt, horizon=1.0):
    """The largest kinetic energy of the motion from the scene's keyframe [J]; inf if it fails."""
    sim = sc.Sim(scene.compile(), integrator=integrator, dt=dt)
    if scene.keys:
        sim.reset(key=0)
    peak = sim.energy.kinetic
    try:
        for _ in range(round(horizon / dt)):
            sim.step()
            peak = max(peak, sim.energy.kinetic)
            if not peak < 1e30:
                return math.inf
    except sc.SimulationError:
        return math.inf
    return peak


def tenfold(scene, integrator, low, high, horizon=1.0):
    """The step at which the motion's kinetic energy reaches ten times that of a fine step [s]."""
    fine = kinetic_peak(scene, "rk4", low / 20, horizon)
    return stiff.bisected(
        lambda dt: kinetic_peak(scene, integrator, dt, horizon) <= 10 * fine, low, high, fine=0.01
    )


# --- servos at the ends of their force ranges ---------------------------------------------------

INERTIA, KP, KV, FORCE = 1.5e-4, 500.0, 50.0, 52.0


def wrist(kick=0.0, force=FORCE, inertia=INERTIA, kv=KV):
    """An arm with a light wrist and a servo of limited force; kicked at so many rad/s."""
    light = " ".join([f"{inertia}"] * 3)
    return sc.loads(f"""<mujoco><option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/>
    <worldbody><body name="arm"><joint name="shoulder" axis="0 1 0"/>
      <inertial pos=".2 0 0" mass="1" diaginertia=".01 .01 .01"/>
      <body name="hand" pos=".4 0 0"><joint name="wrist" axis="0 1 0"/>
        <inertial pos="0 0 0" mass=".1" diaginertia="{light}"/></body></body></worldbody>
    <actuator><position name="shoulder" joint="shoulder" kp="500" kv="50"/>
      <position name="wrist" joint="wrist" kp="{KP}" kv="{kv}" forcerange="-{force} {force}"/>
    </actuator><keyframe><key qvel="0 {kick}"/></keyframe></mujoco>""")


def comes_to_rest(scene, dt, kick):
    """Whether the kicked wrist moves less than its kick after 400 steps."""
    sim = sc.Sim(scene.compile(), dt=dt)
    sim.qvel[1] = kick
    sim.step(400)
    fastest = abs(float(sim.qvel[1]))
    sim.step()
    return max(fastest, abs(float(sim.qvel[1]))) < 0.5 * kick


@functools.cache
def kicked():
    scene = wrist(kick=2.0)
    return scene, diagnosed(scene)


def test_a_servo_that_the_motion_saturates_chatters():
    """Law: beyond F/kv the force is ±F, and a step throws the wrist by F·dt/I = 693 rad/s; it stays
    finite, and does not explode. The limit is where the kicked wrist still comes to rest."""
    scene, d = kicked()
    real = stiff.bisected(lambda dt: comes_to_rest(scene, dt, 2.0), 5e-6, 3e-5, fine=0.01)
    assert d.limit() == pytest.approx(real, rel=0.1)
    assert d.stiffest() == "servo `wrist`" and d.limits["implicitfast"].outcome == "chatters"
    assert d.sentences[0].startswith("A step of 2 ms chatters under implicitfast: servo `wrist`")
    assert "explodes" not in d.sentences[0]
    assert "force range of ±52 N·m" in d.sentences[1] and "stays finite" in d.sentences[1]
    saturation = d.saturations[0]
    assert saturation.reached and saturation.speed == pytest.approx(FORCE / KV)
    assert saturation.thrown == pytest.approx(FORCE * 0.002 / INERTIA, rel=0.02)
    assert d.observed.kind == "chatters"


def test_a_servo_is_kicked_beyond_its_force_range():
    """The same arm at rest: a kick of 1.5 F/kv is tried, and the answer says so. Law: it chatters
    from dt = 2I/kv on at the earliest, and where its first step lands beyond -F/kv for sure."""
    scene = wrist()
    d = diagnosed(scene, kind="hold", horizon=0.2)
    kick = 1.5 * FORCE / KV
    real = stiff.bisected(lambda dt: comes_to_rest(scene, dt, kick), 5e-6, 3e-5, fine=0.01)
    assert d.limit() == pytest.approx(real, rel=0.05)
    assert d.limit() > 2 * INERTIA / KV
    assert d.stiffest() == "servo `wrist`"
    assert d.sentences[1].startswith("Kicked beyond 1.04 rad/s, servo `wrist` reaches its force")
    assert not d.saturations[0].reached and d.saturations[0].severe


def test_a_servo_without_force_range_or_with_inertia_does_not_chatter():
    free = wrist(kick=2.0, force=1e9)
    heavy = wrist(kick=2.0, inertia=0.1)
    for scene in (free, heavy):
        d = diagnosed(scene)
        assert not d.saturations and d.observed.holds
        assert d.limit() > 0.002


def test_a_servo_that_friction_holds_still_is_kicked():
    """At rest friction holds the joint, and the linearised step is stable to 132 ms. Law: while it
    slips the step is stable for ω² h² − 2 c h < 4; beyond, any push ends between ±F for good."""
    kp, inertia, damping, force = 1040.0, 0.03, 3.5, 3.0
    scene = sc.loads(f"""<mujoco><option timestep="0.03" integrator="implicitfast" gravity="0 0 0"/>
    <worldbody><body><joint name="j" axis="0 0 1" damping="{damping}" frictionloss="0.3"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{inertia} {inertia} {inertia}"/></body>
    </worldbody>
    <actuator><position name="a" joint="j" kp="{kp}" forcerange="-{force} {force}"/></actuator>
    </mujoco>""")
    square, c = kp / inertia, damping / inertia
    slips = (c + math.sqrt(c**2 + 4 * square)) / square
    speed = force / math.sqrt(kp * inertia)
    d = diagnosed(scene, ["euler"])
    assert d.limit() == pytest.approx(slips, rel=1e-6)
    assert d.limits["implicitfast"].outcome == "chatters" and d.stiffest() == "servo `a`"
    assert d.limit("euler") == pytest.approx(slips, rel=1e-6)
    saturation = d.saturations[0]
    assert saturation.swinging and saturation.severe and not saturation.reached
    assert saturation.speed == pytest.approx(speed)
    assert "jumps from one end to the other, for good" in d.sentences[1]
    # Stepped here: at the wanted dt no kick comes to rest, below the limit all do.
    for kick in (0.3, 1.0, 3.0):
        for dt, rests in ((0.03, False), (0.98 * slips, True)):
            sim = sc.Sim(scene.compile(), dt=dt)
            sim.qvel[0] = kick
            sim.step(2000)
            assert (abs(float(sim.actuator_force[0])) < 1e-6 * force) == rests
    below = diagnosed(scene, dt=0.012)
    assert not below.saturations and below.observed.holds


def test_cures_of_chatter_are_tried_on_the_motion():
    """What is advised makes the real wrist come to rest at 2 ms."""
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


def brick(integrator="euler", dt=2e-3):
    """A brick that tumbles in space."""
    scene = sc.Scene(gravity=(0, 0, 0), name="brick").with_settings(dt=dt, integrator=integrator)
    body = scene.add_body("brick")
    scene.add_joint(body, "free")
    scene.add_geom(body, "box", (0.1, 0.2, 0.3), mass=1.0, **stiff.INERT)
    scene.add_key("tumbling", qvel=(0, 0, 0, 3, 20, 1))
    return scene


@pytest.mark.parametrize(
    ("scene", "steps"),
    [
        (links(), {"implicitfast": (2e-4, 4e-3), "rk4": (1e-2, 2e-2)}),
        (brick(), {"euler": (1e-2, 0.06), "explicit": (1e-2, 0.06)}),
    ],
)
def test_fast_rotation_is_judged_by_its_energy_over_the_horizon(scene, steps):
    """Law: the limit is where the kinetic energy grows tenfold in the second that the answer
    states; to 20 %, of which the whole number of steps takes some."""
    d = diagnosed(scene, steps)
    assert "over 1 s" in d.sentences[0]
    for integrator, (low, high) in steps.items():
        assert d.limit(integrator) == pytest.approx(tenfold(scene, integrator, low, high), rel=0.2)


def test_inertial_forces_limit_links_in_the_plural():
    d = diagnosed(links(), dt=2e-3)
    assert d.stiffest() == "inertial forces" and d.limiting() is None
    assert d.sentences[0].startswith("A step of 2 ms explodes after ")
    assert "inertial forces limit dt to 1." in d.sentences[0]


def test_slow_growth_of_the_integrator_is_told_with_its_time():
    """Stable over the second that is judged, not for long after it; a quarter of the step is."""
    scene = links(dt=1e-3)
    d = diagnosed(scene)
    assert d.limit() > 1e-3 and d.observed.holds
    assert 1 < d.lasting < 10
    fine = kinetic_peak(scene, "rk4", 1e-4, 1.0)
    assert kinetic_peak(scene, "implicitfast", 1e-3, 0.9 * d.lasting) < 10 * fine
    assert kinetic_peak(scene, "implicitfast", 1e-3, 1.1 * d.lasting) > 10 * fine
    told = next(text for text in d.sentences if text.startswith("Beyond the 1 s"))
    assert "at a quarter of the step it does not" in told
    assert diagnosed(links(dt=1e-3, integrator="rk4")).lasting is None


def payload(dt=1e-3):
    """A body that spins at 200 rad/s; the load welded to it makes that its middle axis."""
    return sc.loads(f"""<mujoco><option timestep="{dt}" integrator="Euler" gravity="0 0 0"/>
    <worldbody><body name="rod"><freejoint/>
      <inertial pos="0 0 0" mass=".1" diaginertia=".00017 .0000066 .00017"/>
      <body name="load" pos=".02 0 0">
        <inertial pos="0 0 0" mass=".01" diaginertia="1e-7 1e-7 1e-7"/></body></body></worldbody>
    <keyframe><key qpos="0 0 0 1 0 0 0" qvel="0 0 0 200 0 0"/></keyframe></mujoco>""")


def spun(dt, horizon=1.0, integrator="euler"):
    """Kinetic energy over that at the start, largest in the horizon; pushed by a rounding."""
    sim = sc.Sim(payload().compile(), integrator=integrator, dt=dt)
    sim.reset(key=0)
    sim.qvel[3:] += 1e-6
    begun = peak = sim.energy.kinetic
    try:
        for _ in range(round(horizon / dt)):
            sim.step()
            peak = max(peak, sim.energy.kinetic)
            if peak > 1e6 * begun:
                return math.inf
    except sc.SimulationError:
        return math.inf
    return peak / begun


def test_a_spinning_body_with_a_payload_tumbles_and_gains_energy():
    """Called stable by a factor of 17 once, because its start never leaves the axis by itself."""
    d = diagnosed(payload())
    real = stiff.bisected(lambda dt: spun(dt) <= 10, 3e-4, 3e-3, fine=0.01)
    assert d.limit() == pytest.approx(real, rel=0.2)
    assert d.stiffest() == "spin of body `rod`"
    assert spun(1e-3) < 10 < spun(1e-3, 1.2 * d.lasting)
    assert "over 1 s" in d.sentences[0] and "the motion explodes after 1." in d.sentences[1]


def test_growth_at_every_step_is_physical_and_named():
    """A servo that pushes with the velocity, e-fold in 50 ms: no dt is to blame, and it is said
    first. Its kinetic energy is 1e16 times that of a slow motion after 0.77 s at any fine step."""
    scene = sc.loads("""<mujoco><option timestep=".002" integrator="implicitfast" gravity="0 0 0"/>
    <worldbody><body name="cart"><joint name="rail" type="slide" axis="1 0 0"/>
      <geom size=".1" mass="1" contype="0" conaffinity="0"/></body></worldbody>
    <actuator><general name="push" joint="rail" gainprm="1" biastype="affine" biasprm="0 0 20"/>
    </actuator><keyframe><key qvel="1"/></keyframe></mujoco>""")
    d = diagnosed(scene)
    assert d.runaway.alike and d.runaway.element.name == "servo `push`"
    # v = e^(20 t), and E = v²/2 against the slow motion's 0.05²/2.
    assert d.runaway.times[1] == pytest.approx(math.log(1e8 * 0.05) / 20, rel=0.02)
    assert d.sentences[0].startswith("The motion itself blows up after 770 ms")
    assert "No dt cures that." in d.sentences[0]
    assert any("two fine steps agree" in note for note in d.notes)


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
    """Law: as for a ball at rest, dt < 2(√(ζ² + 1) - ζ)/ω, though it touches for 3 ms only; 1 %."""
    d = diagnosed(drop(height, law="penalty", penalty_stiffness=1e6, penalty_damping_ratio=0.1))
    assert d.stiffest() == "contact `floor`/`ball`"
    assert d.limit() == pytest.approx(2 * (math.sqrt(1.01) - 0.1) / 1e3, rel=0.01)
    assert [row.name for row in d.rows] == ["contact `floor`/`ball`"]


def test_the_contact_of_two_falling_balls_is_seen_beside_that_of_the_floor():
    """Law: two penalty springs k on m and m/10 in a row, the upper contact alone on the reduced
    mass: dt < 2(√(ζ² + 1) - ζ)/√(11 k/m), less with the floor's beside it; within 10 %."""
    law = {"law": "penalty", "penalty_stiffness": 1e5, "penalty_damping_ratio": 0.1}
    scene = sc.Scene(name="two").with_settings(dt=2e-3, integrator="semi-implicit", **law)
    for i, mass in enumerate((1.0, 0.1)):
        body = scene.add_body(f"ball{i}", pos=(0, 0, 0.2 + 0.4 * i))
        scene.add_joint(body, "slide")
        scene.add_geom(body, "sphere", 0.1, mass=mass, name=f"ball{i}", condim=1)
    scene.add_geom("world", "plane", name="floor", condim=1)
    d = diagnosed(scene)
    assert d.stiffest() == "contact `ball0`/`ball1`"
    alone = 2 * (math.sqrt(1.01) - 0.1) / math.sqrt(1.1e6)
    assert 0.9 * alone < d.limit() < 1.001 * alone


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


def test_a_limit_is_found_where_nothing_says_from_where_on():
    """An actuator without damping, or along a tendon, may cross its range at no known step."""
    found = first_failing(lambda dt: dt < 0.01, math.inf, 0.02)
    assert found == pytest.approx(0.01, rel=0.03)
    model = sc.loads(
        """<mujoco><worldbody><body><joint name="a"/><geom size=".1"/></body></worldbody>
        <tendon><fixed name="t"><joint joint="a" coef="1"/></fixed></tendon>
        <actuator><position tendon="t" kp="10" kv="1" forcerange="-1 1"/></actuator></mujoco>"""
    ).compile()
    assert crossing_dt(model, model.qpos0, 0) == math.inf


SLIPPING = """<mujoco><option timestep="0.005" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
  <body><joint name="j" axis="0 1 0" armature="0.03" frictionloss="0.05" damping="3.5"/>
    <geom size=".01" mass="1e-6"/></body></worldbody>
  <actuator><position name="s" joint="j" kp="1040" ctrlrange="-2 2" forcerange="-3 3"/></actuator>
  </mujoco>"""


def test_a_servo_that_friction_would_hold_at_rest_limits_dt_where_it_moves():
    """Beyond 10 ms refsafe softens the friction loss, which slips, with its force, however soft.

    SO-101 by its shape: a step beyond the servo's limit chatters at the ends of the force range.
    """
    found = diagnosed(sc.loads(SLIPPING))
    omega = math.sqrt(1040 / 0.03)
    ratio = 3.5 / (2 * 0.03 * omega)
    limit = (2 * ratio + 2 * math.sqrt(ratio**2 + 1)) / omega
    assert found.limit() == pytest.approx(limit, rel=0.01) and limit > 0.01
    speeds = {}
    for part in (0.9, 1.3):
        sim = sc.Sim(sc.loads(SLIPPING), dt=part * limit)
        sim.qvel[:] = 1.0
        sim.step(300)
        speeds[part] = float(abs(sim.qvel[0]))
    assert speeds[0.9] < 1e-6 and speeds[1.3] > 0.1


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
    assert max(q for q, _ in seen) < 0.1 and {act for _, act in seen} == {4.0}


def test_the_warning_at_load_knows_the_keyframes_activation():
    """The spring alone allows 39 ms; with the servo ω² is 2600 + 4e4, and c = 8:
    dt < (c + √(c² + 4ω²))/ω² = 9.88 ms, found to 0.5 %."""
    with pytest.warns(sc.StiffnessWarning, match="servo `drive` limits dt to 9.8"):
        sc.loads(ACTIVATED.format(dt=0.02, stiffness=2600))
