"""`diagnose`: limits against closed forms and against the real step, and the element's name."""

import math

import numpy as np
import pytest
import stiff
from covering import every_value, first

import stepcore as sc
from stepcore.engine.linear_maps import INTEGRATORS
from stepcore.experiment.engines import Stepcore
from stepcore.measure.diagnosis.linear import Held, State

# Runs beyond their limits are what these tests make.
pytestmark = pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")


def diagnosed(scene, integrators=INTEGRATORS, **options):
    return stiff.diagnosed(scene, integrators, **({"horizon": 0.1} | options))


# --- closed forms -------------------------------------------------------------------------------


@every_value(ratio=[0.0, 0.01, 0.3, 1.0, 4.0], omega=[30.0, 1000.0])
def test_one_spring_has_the_limit_of_its_closed_form(omega, ratio):
    """Law: stiffness explicit, damping implicit: dt < (2ζ + 2√(ζ² + 1))/ω; both explicit: the
    same with -2ζ; explicit Euler: 2ζ/ω while ζ < 1. To 0.2 %."""
    d = diagnosed(stiff.slider(omega**2, 2 * ratio * omega, dt=1e-3))
    root = 2 * math.sqrt(ratio**2 + 1)
    implicit, explicit = (2 * ratio + root) / omega, (root - 2 * ratio) / omega
    for name in ("euler", "implicitfast"):
        assert d.limit(name) == pytest.approx(implicit, rel=2e-3)
    assert d.limit("semi-implicit") == pytest.approx(explicit, rel=2e-3)
    assert math.isinf(d.limit("midpoint"))
    if 0 < ratio <= 1:
        # It grows so slowly at first that a run does not show it.
        assert d.held("explicit") == pytest.approx(2 * ratio / omega, rel=2e-3)
    if ratio == 0:
        assert d.limit("rk4") == pytest.approx(2 * math.sqrt(2) / omega, rel=0.03)
    assert d.stiffest("semi-implicit") == (
        "damper of joint `slide`" if ratio > 0.5 else "spring of joint `slide`"
    )


# --- the linearised step ------------------------------------------------------------------------


def test_rates_are_those_of_the_motion():
    """Law: a pendulum upright has the rates ±√(g m l / I), hanging ±i of the same."""
    scene = sc.Scene()
    rod = scene.add_body("rod")
    scene.add_joint(rod, "hinge", axis=(0, 1, 0))
    scene.add_geom(rod, "sphere", 0.1, pos=(0, 0, 0.5), mass=2.0)
    model = Stepcore(scene.compile()).converged().model
    omega = math.sqrt(2.0 * 9.81 * 0.5 / (2.0 * 0.25 + 0.4 * 2.0 * 0.01))
    for angle, expected in ((0.0, [-omega, omega]), (math.pi, [-1j * omega, 1j * omega])):
        still = np.zeros(1), np.zeros(0), np.zeros(0)
        held = Held(model, State("there", 0.0, np.array([angle]), *still), 1.0)
        assert np.allclose(np.sort_complex(held.rates), expected, atol=1e-5)


# --- against the real step ----------------------------------------------------------------------


def check(scene, name, integrators, steps=4000, near=2.0, within=0.02):
    """The predicted limit is where the real step leaves the equilibrium, and `name` is named."""
    d = diagnosed(scene, integrators)
    model = scene.compile()
    for integrator in integrators:
        # Growth by the explicit rule takes more than a thousand steps to show.
        limit = d.held(integrator) if integrator == "explicit" else d.limit(integrator)
        assert d.stiffest(integrator) == name, integrator
        real = stiff.bisected(
            lambda dt, i=integrator: stiff.stays(model, i, dt, steps), limit / near, near * limit
        )
        assert limit == pytest.approx(real, rel=within), integrator
    return d


def test_the_stiff_spring_of_a_chain():
    scene = stiff.chain((50.0, 20.0, 4000.0, 20.0), dt=5e-3, integrator="semi-implicit")
    check(scene, "spring of joint `joint2`", ("semi-implicit", "euler", "rk4"))
    scene = stiff.chain((50.0, 20.0, 4000.0, 20.0), damping=4.0, dt=5e-3, integrator="explicit")
    check(scene, "spring of joint `joint2`", ("explicit",), steps=20_000, near=1.1)


def test_growth_that_is_physical_is_not_the_integrators():
    """An inverted pendulum grows under every step; a stiff spring on it is still found."""
    scene = sc.Scene(name="upright").with_settings(dt=0.01, integrator="euler")
    rod = scene.add_body("rod")
    scene.add_joint(rod, "hinge", name="foot", axis=(0, 1, 0))
    scene.add_geom(rod, "capsule", 0.02, fromto=(0, 0, 0, 0, 0, 1.0), mass=1.0)
    free = diagnosed(scene)
    # The explicit integrator makes every swing wider.
    assert all(free.limit(name) > 0.1 for name in INTEGRATORS if name != "explicit")
    assert all(math.isinf(free.held(name)) for name in INTEGRATORS)
    assert free.physical == pytest.approx(3.8, abs=0.2)
    assert "physical" in free.text()
    tip = scene.add_body("tip", parent=rod, pos=(0, 0, 1.0))
    scene.add_joint(tip, "hinge", name="whip", axis=(0, 1, 0), stiffness=50.0, damping=1e-3)
    scene.add_geom(tip, "capsule", 0.01, fromto=(0, 0, 0, 0, 0, 0.2), mass=0.01)
    d = diagnosed(scene)
    assert d.stiffest() == "spring of joint `whip`"
    assert d.physical > 3


def test_a_spinning_plate():
    """Law: explicit gyroscopic torque makes the nutation κΩ grow by (κΩ)² dt/2; implicit not."""
    scene = stiff.plate(200.0, dt=5e-3, integrator="euler")
    d = diagnosed(scene, horizon=1.0)
    inertia = scene.compile().body_inertia[1].diagonal()
    omega = 200.0 * (inertia[2] - inertia[0]) / inertia[0]
    for name in ("semi-implicit", "euler", "explicit"):
        assert d.held(name) == pytest.approx(2 / omega**2, rel=0.02)
        # A run shows growth by more than e.
        assert d.limit(name) > d.held(name)
        assert d.stiffest(name) == "spin of body `plate`"
    assert math.isinf(d.held("implicitfast"))
    assert "explodes" in d.sentences[0] and "spin of body `plate`" in d.sentences[0].lower()
    model = scene.compile()

    def less_than_e_fold(dt):
        sim = sc.Sim(model, integrator="euler", dt=dt)
        sim.reset(key="spinning")
        sim.qvel[3] = 1e-6
        sim.step(round(1.0 / dt))
        return np.hypot(*sim.qvel[3:5]) < math.e * 1e-6

    real = stiff.bisected(less_than_e_fold, 2e-5, 2e-4)
    assert d.held("euler") == pytest.approx(real, rel=0.02)


# --- contacts -----------------------------------------------------------------------------------


def rattles(model, integrator, dt, depth):
    """Whether a ball at rest on the floor starts to bounce."""
    sim = sc.Sim(model, integrator=integrator, dt=dt)
    # Little deeper than it rests: a rebound would be another motion.
    sim.qpos[:] = depth
    sim.step(3000)
    fastest = 0.0
    for _ in range(200):
        sim.step()
        fastest = max(fastest, abs(float(sim.qvel[0])))
    return fastest > 1e-6


@first(1, solref=[(-1e6, -1000.0), (-1e6, -200.0), (-1e5, -1500.0)])
def test_a_stiff_contact_in_direct_form(solref):
    """Within 20 % of where the ball at rest starts to bounce on the real step. With little damping
    a fall of one step that never ends is the start of it: the held limit is the same there."""
    scene = stiff.pad(solref, dt=5e-3, integrator="euler")
    d = diagnosed(scene)
    assert d.stiffest("euler") == "contact `floor`/`ball`"
    model = scene.compile()
    limit = d.held("euler") if solref == (-1e6, -200.0) else d.limit("euler")
    assert d.limit("euler") < 1.2 * limit
    # At rest R carries a share 1 - d, here 0.1, of the weight: k·d·r + g·(1 - d) = g.
    depth = 1.01 * 9.81 * 0.1 * 0.95**2 / (0.9**2 * solref[0])
    real = stiff.bisected(lambda dt: not rattles(model, "euler", dt, depth), 0.3 * limit, 3 * limit)
    assert limit == pytest.approx(real, rel=0.2)


@first(1, joint=["free", "slide"])
def test_a_state_at_a_switch_does_not_decide(joint):
    """Two balls that start exactly on the floor and rebound: a step in which a row stops acting
    cannot be repeated. Within 20 % of the contact's limit, which it names."""
    scene = sc.Scene(name="two").with_settings(dt=1e-3)
    scene.add_geom("world", "plane", name="floor", solref=(-1e8, -100.0))
    for i in range(2):
        body = scene.add_body(f"ball{i}", pos=(i, 0, 0.1))
        scene.add_joint(body, joint)
        scene.add_geom(body, "sphere", 0.1, mass=1.0, name=f"ball{i}", solref=(-1e8, -100.0))
    d = diagnosed(scene, ["rk4", "midpoint"], horizon=1.0)
    assert sorted(d.together("rk4")) == ["contact `floor`/`ball0`", "contact `floor`/`ball1`"]
    # solimp's 0.9 at no depth: the row is as stiff as k/0.95², times 0.9 for R.
    omega = 0.9 / 0.95 * 1e4
    assert d.limit("rk4") == pytest.approx(2 * math.sqrt(2) / omega, rel=0.2)
    # Both act there, and neither alone moves the limit of the other.
    assert sorted(d.together("midpoint")) == ["contact `floor`/`ball0`", "contact `floor`/`ball1`"]


def test_a_penalty_contact_is_the_spring_that_it_is():
    """Law: k on 1 kg, 2ζ√(k m) with it, both explicit: dt < 2(√(ζ² + 1) - ζ)/ω, to 1 %; the ball
    falls on it from above."""
    law = {"law": "penalty", "penalty_stiffness": 1e6, "penalty_damping_ratio": 0.1}
    scene = stiff.pad(dt=5e-3, integrator="semi-implicit", **law)
    scene.body("ball").pos = (0, 0, 0.101)
    d = diagnosed(scene, horizon=0.2)
    assert d.stiffest("semi-implicit") == "contact `floor`/`ball`"
    resting = 2 * (math.sqrt(1.01) - 0.1) / 1e3
    assert d.held("semi-implicit") == pytest.approx(resting, rel=0.01)
    assert d.limit("semi-implicit") == pytest.approx(resting, rel=0.15)


def test_refsafe_is_told_as_it_is():
    """A contact that refsafe softens limits nothing; without refsafe it does."""
    soft = diagnosed(stiff.pad((0.02, 1.0), dt=5e-3), ["euler"])
    assert math.isinf(soft.limit("euler"))
    note = "above dt 10 ms the setting refsafe (MuJoCo's) softens contact `floor`/`ball`;"
    assert any(note in n for n in soft.notes)
    hard = diagnosed(stiff.pad((0.02, 1.0), dt=5e-3, refsafe=False), ["euler"])
    assert 0.005 < hard.limit("euler") < 0.05
    assert hard.stiffest("euler") == "contact `floor`/`ball`"


def rows_scene(kind):
    """One row of a kind, with its nominal stiffness and enough damping not to rebound."""
    scene = sc.Scene(gravity=(0, 0, 0)).with_settings(dt=5e-3)
    body = scene.add_body("body", pos=(0, 0, 1))
    stiffly = (-1e6, -1500.0)
    if kind == "limit":
        # Pressed into its bound.
        scene.add_joint(
            body, "hinge", name="knee", axis=(0, 1, 0), range=(-1, 0), solreflimit=stiffly
        )
        scene.gravity = (0, 0, -9.81)
    elif kind == "friction loss":
        scene.add_joint(
            body, "slide", name="knee", frictionloss=1e3, solreffriction=(-1.0, -1500.0)
        )
    else:
        scene.add_joint(body, "free")
        scene.add_equality("connect", body, anchor=(0.1, 0, 0), name="knee", solref=stiffly)
    scene.add_geom(body, "box", (0.1, 0.2, 0.05), pos=(0.1, 0, 0), mass=1.0, **stiff.INERT)
    return scene


@every_value(kind=["limit", "friction loss", "connect"], integrator=["euler", "rk4"])
def test_other_rows_are_named_and_limit_where_the_real_step_does(kind, integrator):
    """Within 2 %: these do not open."""
    scene = rows_scene(kind)
    d = diagnosed(scene, [integrator], horizon=0.5)
    joint = "" if kind == "connect" else "of joint "
    assert d.stiffest(integrator) == f"{kind} {joint}`knee`"
    model, rest = scene.compile(), d.states[-1]

    def stays(dt):
        sim = sc.Sim(model, integrator=integrator, dt=dt)
        sim.qpos[:] = rest.qpos
        sim.qvel[-1] = 1e-7
        try:
            sim.step(3000)
        except sc.SimulationError:
            return False
        return abs(sim.qvel[-1]) < 1e-4

    held = d.held(integrator)
    real = stiff.bisected(stays, 0.5 * held, 2 * held)
    assert held == pytest.approx(real, rel=0.02)
    assert d.limit(integrator) == pytest.approx(real, rel=0.05)


# --- servos -------------------------------------------------------------------------------------


@every_value(ratio=[0.05, 0.7, 3.0], omega=[40.0, 900.0])
def test_one_servo_has_the_limit_of_its_closed_form(omega, ratio):
    """Law: kp explicit, kv implicit under implicitfast: dt < (2ζ + 2√(ζ² + 1))/ω; kv explicit
    under euler: with -2ζ. The gear counts twice. To 0.2 %."""
    scene = sc.Scene(gravity=(0, 0, 0)).with_settings(dt=1e-3)
    body = scene.add_body("mass")
    scene.add_joint(body, "slide", name="slide")
    scene.add_geom(body, "sphere", 0.1, mass=2.0, **stiff.INERT)
    gains = {"kp": 2 * omega**2 / 9, "kv": 2 * 2 * ratio * omega / 9}
    scene.add_actuator("slide", type="position", name="elbow", gear=(3.0,), **gains)
    d = diagnosed(scene, ["implicitfast", "euler"])
    root = 2 * math.sqrt(ratio**2 + 1)
    assert d.limit("implicitfast") == pytest.approx((2 * ratio + root) / omega, rel=2e-3)
    assert d.limit("euler") == pytest.approx((root - 2 * ratio) / omega, rel=2e-3)
    assert d.stiffest("implicitfast") == "servo `elbow`"
    figures = d.element("servo `elbow`")
    assert figures.omega == pytest.approx(omega, rel=1e-6)
    assert figures.ratio == pytest.approx(ratio, rel=1e-6)


def test_the_stiff_servo_of_a_six_joint_arm():
    """A position gain a thousand times the others'; then a velocity gain on the lightest link."""
    kp = (200.0, 200.0, 2e5, 200.0, 200.0, 200.0)
    scene = stiff.arm(kp, kv=0.02, dt=5e-3, integrator="implicitfast")
    d = check(scene, "servo `elbow`", ("implicitfast", "rk4"))
    assert d.sentences[0].startswith(
        "A step of 5 ms explodes after 55 ms under implicitfast: servo"
    )
    scene = stiff.arm(kv=5.0, dt=5e-3, integrator="euler")
    check(scene, "servo `tool`", ("euler", "semi-implicit"), steps=2000)


# --- longer proofs ------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("seed", range(12))
def test_random_chains_explode_where_they_are_predicted_to(seed):
    """Law: within 2 %, under every integrator but the midpoint rule; 2 to 6 links, stiffness over
    four decades, under gravity from the pose in which the springs hold them."""
    rng = np.random.default_rng(seed)
    stiffnesses = 10 ** rng.uniform(1.5, 5.5, rng.integers(2, 7))
    scene = stiff.chain(tuple(stiffnesses), damping=10 ** rng.uniform(-2, 0), dt=1e-3)
    d = diagnosed(scene)
    model = scene.compile()
    for integrator in ("semi-implicit", "euler", "implicitfast", "rk4"):
        limit = d.limit(integrator)
        real = stiff.bisected(
            lambda dt, i=integrator: stiff.stays(model, i, dt, 20_000), limit / 1.5, 1.5 * limit
        )
        assert limit == pytest.approx(real, rel=0.02), integrator


@pytest.mark.long
@pytest.mark.parametrize("seed", range(8))
def test_a_random_stiff_servo_is_named(seed):
    """Law: of six servos the one whose gain is multiplied until it limits alone is named."""
    rng = np.random.default_rng(seed)
    which = int(rng.integers(6))
    kp = list(10 ** rng.uniform(1, 2, 6))
    kp[which] *= 1e4
    scene = stiff.arm(tuple(kp), kv=0.0, damping=0.05, dt=1e-3, integrator="implicitfast")
    d = diagnosed(scene)
    name = f"servo `{stiff.NAMES[which]}`"
    model = scene.compile()
    for integrator in ("implicitfast", "semi-implicit", "rk4"):
        assert d.stiffest(integrator) == name
        limit = d.limit(integrator)
        real = stiff.bisected(
            lambda dt, i=integrator: stiff.stays(model, i, dt, 20_000), limit / 1.5, 1.5 * limit
        )
        assert limit == pytest.approx(real, rel=0.02), integrator


@pytest.mark.long
@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_a_stiff_table(cone):
    """Four feet on the floor: within 20 % of where it starts to bounce."""
    scene = stiff.table((-1e5, -500.0), dt=5e-3, integrator="euler", cone=cone)
    d = diagnosed(scene, horizon=0.5)
    assert all(name.startswith("contact `floor`/`foot") for name in d.together("euler"))
    model, rest = scene.compile(), d.states[-1]

    def stays(dt):
        sim = sc.Sim(model, integrator="euler", dt=dt)
        sim.qpos[:] = rest.qpos
        speeds = []
        try:
            sim.step(2000)
            for _ in range(100):
                sim.step()
                speeds.append(np.abs(sim.qvel).max())
        except sc.SimulationError:
            return False
        return max(speeds) < 1e-3

    limit = d.limit("euler")
    real = stiff.bisected(stays, 0.4 * limit, 2.5 * limit)
    assert limit == pytest.approx(real, rel=0.2)


def test_a_step_that_leaves_for_absurd_states_is_told_all_the_same():
    # rk4 on the ant is stable up to a third of a second, and beyond throws it out at once.
    d = sc.diagnose("gymnasium:ant", horizon=0.5, progress=False)
    assert d.limit("rk4") > 0 and d.stiffest("rk4")
