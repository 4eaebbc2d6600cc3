"""`diagnose`: limits against closed forms and against the real step, and the element's name."""

import math

import numpy as np
import pytest
import stiff
from covering import every_value, first
from tangents import differences

import stepcore as sc
from stepcore.engine.linear_maps import INTEGRATORS
from stepcore.experiment.coordinates import Coordinates
from stepcore.measure.diagnosis.growth import step_growth
from stepcore.measure.diagnosis.isolated import oscillator_dt
from stepcore.measure.diagnosis.linear_motion import linear_motion
from stepcore.measure.diagnosis.linear_step import (
    State,
    rates_matrix,
    step_map,
    with_converged_rows,
)
from stepcore.measure.diagnosis.midpoint_map import midpoint_map

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
        assert d.limit("explicit") == pytest.approx(2 * ratio / omega, rel=2e-3)
    if ratio == 0:
        assert d.limit("rk4") == pytest.approx(2 * math.sqrt(2) / omega, rel=0.03)
    assert d.stiffest("semi-implicit") == (
        "damper of joint `slide`" if ratio > 0.5 else "spring of joint `slide`"
    )


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_an_element_alone_is_the_spectral_radius_of_its_two_by_two_step(integrator):
    """Law: the closed forms of `alone` are where |μ| leaves 1. To 0.5 %."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        omega, implicit, explicit = 10 ** rng.uniform(0, 4), *10 ** rng.uniform(-1, 4, 2)
        if integrator == "explicit" and explicit + implicit < 0.01 * omega:
            continue
        limit = oscillator_dt(omega, explicit, implicit, integrator)

        def radius(dt, omega=omega, explicit=explicit, implicit=implicit):
            c = explicit + implicit
            rates = np.array([[0, 1], [-(omega**2), -c]])
            one = np.eye(2)
            if integrator == "explicit":
                step = one + dt * rates
            elif integrator == "midpoint":
                step = np.linalg.solve(one - dt / 2 * rates, one + dt / 2 * rates)
            elif integrator == "rk4":
                z = dt * rates
                step = one + z + z @ z / 2 + z @ z @ z / 6 + z @ z @ z @ z / 24
            else:
                hidden = 0 if integrator == "semi-implicit" else implicit
                new = np.array([0, 1]) + dt * rates[1] / (1 + dt * hidden)
                step = np.array([np.array([1, 0]) + dt * new, new])
            return abs(np.linalg.eigvals(step)).max()

        if math.isinf(limit):
            assert radius(1e3 / omega) <= 1 + 1e-9
        else:
            assert radius(0.995 * limit) < 1 + 1e-9 < radius(1.005 * limit)


# --- the linearised step ------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_the_elements_make_up_the_step(integrator):
    """Law: with M, J and the implicit damping the step is what `linearize` gives, to 1e-6, and
    what `linearize` gives is what central differences give, to 1e-6 of its size."""
    model = with_converged_rows(
        stiff.chain((50.0, 4000.0, 20.0), gravity=(0, 0, -9.81), dt=1e-3).compile()
    )
    state = State("there", 0.0, np.array([0.2, -0.4, 0.3]), np.array([0.5, 1, -1]), np.zeros(0))
    sim = sc.Sim(model, integrator=integrator, dt=1e-4)
    sim.qpos[:], sim.qvel[:] = state.qpos, state.qvel
    real = step_map(model, state, integrator, 1e-4)
    assert np.abs(real - differences(sim, 1e-4)).max() < 1e-6 * np.abs(real).max()
    made = linear_motion(model, state, None).step(integrator, 1e-4)
    # Off equilibrium the implicit rules see M + dt·D turn, and the others move within the step.
    tolerance = {"explicit": 1e-6, "semi-implicit": 1e-6}.get(integrator, 1e-2)
    assert np.abs(made - real).max() < tolerance * np.abs(real - np.eye(6)).max()


def test_rates_are_those_of_the_motion():
    """Law: a pendulum upright has the rates ±√(g m l / I), hanging ±i of the same."""
    scene = sc.Scene()
    rod = scene.add_body("rod")
    scene.add_joint(rod, "hinge", axis=(0, 1, 0))
    scene.add_geom(rod, "sphere", 0.1, pos=(0, 0, 0.5), mass=2.0)
    model = with_converged_rows(scene.compile())
    omega = math.sqrt(2.0 * 9.81 * 0.5 / (2.0 * 0.25 + 0.4 * 2.0 * 0.01))
    for angle, expected in ((0.0, [-omega, omega]), (math.pi, [-1j * omega, 1j * omega])):
        state = State("there", 0.0, np.array([angle]), np.zeros(1), np.zeros(0))
        rates = np.linalg.eigvals(rates_matrix(model, state))
        assert np.allclose(np.sort_complex(rates), expected, atol=1e-5)


def test_the_midpoint_step_is_one_linear_system():
    """Law: without rows A of the midpoint rule, from one linearised acceleration, is what
    `linearize` iterates to, on free, ball and hinge joints that turn fast; to 1e-8 of its size."""
    scene = sc.Scene().with_settings(integrator="midpoint", dt=0.02)
    parent = scene.world
    for kind in ("free", "ball", "hinge"):
        parent = scene.add_body(kind, parent=parent, pos=(0.3, 0, 0))
        given = {} if kind == "free" else {"stiffness": 20.0, "damping": 0.1}
        scene.add_joint(parent, kind, name=kind, **given)
        scene.add_geom(parent, "box", (0.1, 0.2, 0.3), pos=(0.1, 0.05, 0), mass=1.0)
    scene.add_actuator("hinge", type="position", kp=30.0, kv=0.2)
    scene.features.constraint = False
    model = with_converged_rows(scene.compile())
    rng = np.random.default_rng(0)
    for speed in (0.0, 1.0, 8.0):
        sim = sc.Sim(model)
        change = rng.normal(size=model.nv)
        sim.qpos[:] = Coordinates(model).moved(model.qpos0, change)
        sim.qvel[:], sim.ctrl[:] = speed * rng.normal(size=model.nv), 0.4
        real = sim.linearize().A
        assert np.abs(midpoint_map(sim)[0] - real).max() < 1e-8 * np.abs(real).max()


# --- against the real step ----------------------------------------------------------------------


def check(scene, name, integrators, steps=4000, near=2.0, within=0.02):
    """The predicted limit is where the real step leaves the equilibrium, and `name` is named."""
    d = diagnosed(scene, integrators)
    model = scene.compile()
    for integrator in integrators:
        limit = d.limit(integrator)
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
    assert all(free.limit(name) > 0.1 for name in INTEGRATORS)
    assert free.physical == pytest.approx(3.8, abs=0.2)
    assert "physical" in free.text()
    tip = scene.add_body("tip", parent=rod, pos=(0, 0, 1.0))
    scene.add_joint(tip, "hinge", name="whip", axis=(0, 1, 0), stiffness=50.0, damping=1e-3)
    scene.add_geom(tip, "capsule", 0.01, fromto=(0, 0, 0, 0, 0, 0.2), mass=0.01)
    d = diagnosed(scene)
    assert d.stiffest() == "spring of joint `whip`"
    assert d.physical > 3
    # At the limit the fast mode changes sign and grows from step to step; the fall does not.
    model = with_converged_rows(scene.compile())
    state = d.states[0]
    rates = np.linalg.eigvals(rates_matrix(model, state))
    limit = d.limit()
    assert step_growth(step_map(model, state, "euler", 0.99 * limit), limit, rates, 0.1).stable
    beyond = step_growth(step_map(model, state, "euler", 1.02 * limit), limit, rates, 0.1)
    assert not beyond.stable and beyond.value.real < -1


def test_a_spinning_plate():
    """Law: explicit gyroscopic torque makes the nutation κΩ grow by (κΩ)² dt/2; implicit not."""
    scene = stiff.plate(200.0, dt=5e-3, integrator="euler")
    d = diagnosed(scene, horizon=1.0)
    inertia = scene.compile().body_inertia[1].diagonal()
    omega = 200.0 * (inertia[2] - inertia[0]) / inertia[0]
    for name in ("semi-implicit", "euler", "explicit"):
        assert d.limit(name) == pytest.approx(2 / omega**2, rel=0.02)
        assert d.stiffest(name) == "spin of body `plate`"
    assert math.isinf(d.limit("implicitfast"))
    assert "explodes under euler" in d.sentences[0]
    model = scene.compile()

    def less_than_e_fold(dt):
        sim = sc.Sim(model, integrator="euler", dt=dt)
        sim.reset(key="spinning")
        sim.qvel[3] = 1e-6
        sim.step(round(1.0 / dt))
        return np.hypot(*sim.qvel[3:5]) < math.e * 1e-6

    real = stiff.bisected(less_than_e_fold, 2e-5, 2e-4)
    assert d.limit("euler") == pytest.approx(real, rel=0.02)


@pytest.mark.parametrize("hinges", [21, pytest.param(60, marks=pytest.mark.long)])
def test_many_hinges_take_few_linearisations(monkeypatch, hinges):
    """Law: at most 250 linearised steps a state over all integrators (of 60 hinges 300 and more
    before, the midpoint rule's a hundred times as long); and the midpoint rule, whose iteration
    ends in the rounding of an ill-conditioned mass matrix, limits nothing below 50 ms."""
    counted = []
    real = sc.Sim.linearize
    monkeypatch.setattr(sc.Sim, "linearize", lambda sim: (counted.append(sim), real(sim))[1])
    d = diagnosed(
        stiff.chain((50.0, 100.0, 150.0) * (hinges // 3), damping=0.1, dt=1e-3), horizon=0.01
    )
    assert len(counted) < 250 * len(d.states)
    assert d.limit("midpoint") > 0.05
    assert not any(sim.settings.integrator == "midpoint" for sim in counted)


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
    """Within 20 % of where the ball begins to bounce on the real step."""
    scene = stiff.pad(solref, dt=5e-3, integrator="euler")
    d = diagnosed(scene)
    assert d.stiffest("euler") == "contact `floor`/`ball`"
    model = scene.compile()
    limit = d.limit("euler")
    # At rest R carries a share 1 - d, here 0.1, of the weight: k·d·r + g·(1 - d) = g.
    depth = 1.01 * 9.81 * 0.1 * 0.95**2 / (0.9**2 * solref[0])
    real = stiff.bisected(lambda dt: not rattles(model, "euler", dt, depth), 0.3 * limit, 3 * limit)
    assert limit == pytest.approx(real, rel=0.2)


@first(1, joint=["free", "slide"])
def test_a_state_at_a_switch_does_not_decide(joint):
    """Two balls that begin exactly on the floor and rebound: a step in which a row ends to act is
    no step that could be repeated. Within 20 % of the contact's own limit, and named after it."""
    scene = sc.Scene(name="two").with_settings(dt=1e-3)
    scene.add_geom("world", "plane", name="floor", solref=(-1e8, -100.0))
    for i in range(2):
        body = scene.add_body(f"ball{i}", pos=(i, 0, 0.1))
        scene.add_joint(body, joint)
        scene.add_geom(body, "sphere", 0.1, mass=1.0, name=f"ball{i}", solref=(-1e8, -100.0))
    d = diagnosed(scene, ["rk4", "midpoint"], horizon=1.0)
    assert d.limits["rk4"].state > 0
    assert d.stiffest("rk4").startswith("contact `floor`/`ball")
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
    assert d.limit("semi-implicit") == pytest.approx(2 * (math.sqrt(1.01) - 0.1) / 1e3, rel=0.01)


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
    """One row of a kind, as stiff as it says and damped enough not to rebound."""
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

    limit = d.limit(integrator)
    real = stiff.bisected(stays, 0.5 * limit, 2 * limit)
    assert limit == pytest.approx(real, rel=0.02)


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
    assert figures.limits["implicitfast"] == pytest.approx(d.limit("implicitfast"), rel=2e-3)


def test_the_stiff_servo_of_a_six_joint_arm():
    """A position gain a thousand times the others'; then a velocity gain on the lightest link."""
    kp = (200.0, 200.0, 2e5, 200.0, 200.0, 200.0)
    scene = stiff.arm(kp, kv=0.02, dt=5e-3, integrator="implicitfast")
    d = check(scene, "servo `elbow`", ("implicitfast", "rk4"))
    assert d.sentences[0].startswith("A step of 5 ms explodes under implicitfast: servo `elbow` (")
    scene = stiff.arm(kv=5.0, dt=5e-3, integrator="euler")
    check(scene, "servo `tool`", ("euler", "semi-implicit"), steps=2000)


def test_a_servo_at_the_end_of_its_force_has_no_stiffness():
    scene = stiff.slider(0.0, 1.0, dt=1e-3)
    servo = {"kp": 1e6, "forcerange": (-1.0, 1.0), "ctrlrange": (-5.0, 5.0)}
    scene.add_actuator("slide", type="position", name="weak", **servo)
    scene.add_key("far", ctrl=(5.0,))
    model = with_converged_rows(scene.compile())
    state = State("far", 0.0, np.zeros(1), np.zeros(1), np.array([5.0]))
    assert np.abs(np.linalg.eigvals(rates_matrix(model, state))).max() == pytest.approx(1.0)
    near = State("near", 0.0, np.zeros(1), np.zeros(1), np.zeros(1))
    assert np.abs(np.linalg.eigvals(rates_matrix(model, near))).max() == pytest.approx(
        1e3, rel=1e-3
    )


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
    """Four feet on the floor: within 20 % of where it begins to bounce."""
    scene = stiff.table((-1e5, -500.0), dt=5e-3, integrator="euler", cone=cone)
    d = diagnosed(scene, horizon=0.5)
    assert d.stiffest("euler").startswith("contact `floor`/`foot")
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
