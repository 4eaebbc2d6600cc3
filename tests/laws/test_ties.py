"""Equalities in closed form: gears turn in their ratio, a weld carries a load and its moment."""

import numpy as np
import pytest

import stepcore as sc

LAWS = ("solref", "lesson", "rigid")
GRAVITY = 9.81


def gears(ratio, first=0.4, second=0.1):
    """Two flywheels [kg·m²], the second geared to the first: q₂ = ratio · q₁."""
    scene = sc.Scene(gravity=(0, 0, 0))
    for name, inertia in (("one", first), ("two", second)):
        wheel = scene.add_body(name, mass=1.0, inertia=(inertia, inertia, inertia))
        scene.add_joint(wheel, name=name, axis=(0, 0, 1))
    scene.add_equality("joint", joint1="two", joint2="one", polycoef=(0, ratio), name="gear")
    scene.add_actuator("one", name="motor")
    return scene


@pytest.mark.parametrize(
    "integrator",
    ("semi-implicit", "euler", "implicitfast", "implicit", "discrete", "rk4", "midpoint"),
)
def test_geared_flywheels_under_torque(integrator):
    """τ on the first of I₁, I₂ at a ratio r: q̈₁ = τ / (I₁ + r² I₂), and q₂ = r q₁ to rounding."""
    ratio, torque, horizon = -2.5, 0.6, 1.0
    sim = sc.Sim(
        gears(ratio), dt=0.01, law="rigid", solver="pgs", sweeps="auto", integrator=integrator
    )
    sim.ctrl[:] = torque
    sim.step(round(horizon / sim.settings.dt))
    rate = torque / (0.4 + ratio**2 * 0.1)
    assert sim.qvel[0] == pytest.approx(rate * horizon, rel=1e-12)
    assert sim.qvel[1] == pytest.approx(ratio * sim.qvel[0], rel=1e-12)
    assert sim.qpos[1] == pytest.approx(ratio * sim.qpos[0], rel=1e-11)
    if integrator == "midpoint":
        assert sim.qpos[0] == pytest.approx(0.5 * rate * horizon**2, rel=1e-11)


@pytest.mark.parametrize("integrator", ("rk4", "midpoint"))
def test_a_curved_gear_keeps_the_order_of_the_integrator(integrator):
    """q₁ = p(q₂) bends: its energy ½ (I₂ + p′² I₁) q̇₂² is kept to the order of the integrator."""
    drift = []
    for dt in (0.02, 0.01):
        scene = gears(1.0)
        scene.equalities[0].polycoef = (0.1, 0.7, 0.5, 0.2, -0.1)
        sim = sc.Sim(scene, dt=dt, law="rigid", solver="pgs", sweeps="auto", integrator=integrator)
        x = 0.3
        sim.qpos[:] = x, np.polynomial.Polynomial(scene.equalities[0].polycoef)(x)
        slope = np.polynomial.Polynomial(scene.equalities[0].polycoef).deriv()(x)
        sim.qvel[:] = 1.5, 1.5 * slope
        start = sim.energy.kinetic
        sim.step(round(1.0 / dt))
        drift.append(abs(sim.energy.kinetic / start - 1))
    order = np.log2(drift[0] / drift[1])
    assert order > (3.5 if integrator == "rk4" else 1.7), drift


@pytest.mark.parametrize("law", LAWS)
def test_a_weld_carries_a_load_and_its_moment(law):
    """A lever of mass m, length 2a, welded to the world by its end: force m g, moment m g a."""
    mass, a = 2.0, 0.3
    scene = sc.Scene()
    lever = scene.add_body("lever", pos=(0, 0, 1), mass=mass, ipos=(a, 0, 0), inertia=(0.1,) * 3)
    scene.add_joint(lever, "free")
    scene.add_equality("weld", "lever", "world", anchor=(0, 0, 1), name="wall")
    solver = {"solver": "newton"} if law == "solref" else {"solver": "pgs", "sweeps": "auto"}
    sim = sc.Sim(scene, dt=0.002, law=law, tolerance=1e-14, **solver)
    sim.step(2000)
    rows = sim.rows
    assert set(rows["kind"]) == {"weld"} and set(rows["name"]) == {"weld `wall`"}
    force, moment = rows["force"][:3], rows["force"][3:]
    assert force == pytest.approx([0, 0, mass * GRAVITY], rel=1e-6, abs=1e-6)
    # A row of the turn is half the rotation vector.
    sag = 1e-3 if law == "solref" else 1e-8
    assert 0.5 * moment == pytest.approx([0, -mass * GRAVITY * a, 0], rel=sag, abs=1e-5)
    assert np.abs(sim.qvel).max() < 1e-9


def test_a_weld_without_torquescale_is_a_connect():
    """Its turns take no force, and it moves as a connect at the same point does."""
    ends = []
    for kind in ("connect", "weld"):
        scene = sc.Scene()
        arm = scene.add_body("arm", mass=1.0, ipos=(0.2, 0.1, 0), inertia=(0.02, 0.03, 0.04))
        scene.add_joint(arm, "free")
        fields = {"torquescale": 0.0} if kind == "weld" else {}
        scene.add_equality(kind, "arm", "world", **fields)
        sim = sc.Sim(scene, dt=0.002, tolerance=1e-13)
        sim.qvel[3:] = 1, 2, 3
        sim.step(50)
        ends.append(np.r_[sim.qpos, sim.qvel])
    assert ends[1] == pytest.approx(ends[0], rel=1e-9, abs=1e-11)


def test_what_a_scene_refuses():
    scene = sc.Scene()
    body = scene.add_body("arm", mass=1.0, inertia=(1, 1, 1))
    scene.add_joint(body, "ball", name="shoulder")
    hand = scene.add_body("hand", parent="arm", mass=1.0, inertia=(1, 1, 1))
    scene.add_joint(hand, name="wrist")
    scene.add_site("arm", name="here")
    scene.add_site("hand", name="there")
    cases = [
        ({"type": "weld"}, "a weld needs body1, or site1 and site2"),
        ({"type": "joint"}, "a joint equality needs joint1"),
        ({"type": "joint", "joint1": "shoulder"}, 'joint "shoulder" is a ball'),
        ({"type": "joint", "joint1": "wrist", "joint2": "wrist"}, "to itself"),
        ({"type": "joint", "joint1": "wrist", "body1": "arm"}, "a joint has none"),
        (
            {"type": "connect", "body1": "arm", "relpose": (0, 0, 0, 1, 0, 0, 0)},
            "a connect has none",
        ),
        ({"type": "connect", "site1": "here"}, "site1 needs the other site too"),
        (
            {"type": "weld", "site1": "here", "site2": "there", "body1": "arm"},
            "left out beside site1",
        ),
        ({"type": "weld", "site1": "here", "site2": "here"}, "of the same body"),
    ]
    for fields, says in cases:
        equality = scene.add_equality(**fields)
        with pytest.raises(ValueError, match=says):
            scene.compile()
        scene.equalities.remove(equality)
    for fields, says in [
        ({"type": "weld", "body1": "amr"}, 'no body is named "amr"'),
        ({"type": "joint", "joint1": "wirst"}, 'no joint is named "wirst"'),
        ({"type": "glue", "body1": "arm"}, "type = 'glue'"),
        ({"type": "weld", "body1": "arm", "relpose": (0,) * 7}, "relpose"),
        ({"type": "joint", "joint1": "wrist", "polycoef": (0, 1, 2, 3, 4, 5)}, "polycoef"),
    ]:
        with pytest.raises(ValueError, match=says):
            scene.add_equality(**fields)
