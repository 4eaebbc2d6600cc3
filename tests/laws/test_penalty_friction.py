"""Friction under `penalty`: Coulomb's, regularised by a damper γ = ¼ √(k/A_t).

Laws: below the cone a block creeps at f_t/γ; above it slides with a = g (sin θ − μ cos θ); friction
is never more than μ f_n, takes energy and gives none; its energy is in the ledger; its share of the
linearised step is that of the step; a ball comes to roll.
"""

import math

import numpy as np
import pytest
from engines import ENGINES, make

import stepcore as sc

K, MASS, G = 1e5, 2.0, 9.81


def block(theta, mu=0.5, extra=""):
    """A block without turning on a floor tilted by theta: x is down the incline."""
    gravity = f"{G * math.sin(theta)} 0 {-G * math.cos(theta)}"
    return sc.loads(
        f'<mujoco><option gravity="{gravity}"/><worldbody>'
        f'<geom type="plane" size="9 9 1" friction="{mu}"/><body pos="0 0 .1" name="block">'
        '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
        '<joint type="slide" axis="0 0 1"/>'
        f'<geom size=".1" mass="{MASS}" friction="{mu}" {extra}/></body></worldbody></mujoco>'
    )


PENALTY = {"law": "penalty", "solver": "pgs", "penalty_stiffness": K, "dt": 1e-3}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("integrator", ["explicit", "semi-implicit", "midpoint", "rk4"])
def test_a_block_below_the_cone_creeps_as_documented(engine, integrator):
    """m g sin θ / γ with γ = ¼ √(k m): 4 g sin θ √(m/k) = 3.5 cm/s here."""
    theta = 0.2
    steps = 300 if engine == "numpy" else 3000
    sim = make(engine, block(theta), integrator=integrator, penalty_damping_ratio=0.5, **PENALTY)
    depth = MASS * G * math.cos(theta) / K
    creep = 4 * G * math.sin(theta) * math.sqrt(MASS / K)
    sim.qpos[2], sim.qvel[0] = -depth, creep
    sim.step(steps)
    assert sim.qvel[0] == pytest.approx(creep, rel=1e-6)
    assert sim.qpos[0] == pytest.approx(creep * steps * 1e-3, rel=1e-6)
    assert sim.qvel[1] == 0.0


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_a_block_above_the_cone_slides(engine, precision):
    """a = g (sin θ − μ cos θ), down the incline; sideways motion is braked alike."""
    if engine == "numpy" and precision == "f32":
        return
    theta, mu = 0.7, 0.3
    sim = make(engine, block(theta, mu), precision=precision, **PENALTY)
    sim.qpos[2], sim.qvel[0] = -MASS * G * math.cos(theta) / K, 1.0
    sim.step(300)
    gained = G * (math.sin(theta) - mu * math.cos(theta)) * 0.3
    assert sim.qvel[0] == pytest.approx(1.0 + gained, rel=1e-4 if precision == "f32" else 1e-9)


def test_friction_is_within_the_cone_and_along_the_slip():
    rng = np.random.default_rng(3)
    sim = sc.Sim(block(0.0, 0.4), **PENALTY)
    for _ in range(100):
        sim.qpos[:] = [0, 0, -rng.uniform(0, 1e-3)]
        sim.qvel[:] = rng.normal(size=3) * rng.choice([1e-4, 0.1, 3.0])
        sim.forward()
        force, slip = sim.contacts["force"][0], sim.qvel[:2].copy()
        normal = max(force[2], 0.0)
        along = np.hypot(*force[:2])
        assert along <= 0.4 * normal * (1 + 1e-12)
        want = min(0.4 * normal, math.sqrt(K * MASS) / 4 * np.hypot(*slip))
        assert force[:2] == pytest.approx(-want * slip / np.hypot(*slip), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("integrator", ["semi-implicit", "euler", "midpoint", "rk4"])
def test_friction_takes_energy_and_the_ledger_knows(integrator):
    """A block that slides to rest: its energy never grows, and the account stays balanced."""
    settings = PENALTY | {"integrator": integrator, "ledger": True, "penalty_damping_ratio": 0.0}
    sim = sc.Sim(block(0.0), **settings)
    sim.qpos[2], sim.qvel[0] = -MASS * G / K, 2.0
    run = sim.run(1.0, record=("energy", "qvel"))
    kinetic = run.energy[:, 0]
    assert np.all(np.diff(kinetic) <= 1e-12)
    # What friction took: it stopped after v/(μ g) = 0.41 s.
    assert abs(run.qvel[-1, 0]) < 1e-9
    assert kinetic[200] == pytest.approx(0.5 * MASS * (2.0 - 0.5 * G * 0.2) ** 2, rel=1e-6)


@pytest.mark.parametrize("speed", [0.0, 1e-3, 2.0])
def test_its_share_of_the_linear_step(speed):
    """A and B by dual numbers against central differences of the step, sticking and sliding."""
    scene, settings = block(0.1), PENALTY | {"integrator": "semi-implicit"}
    state = np.r_[0.0, 0.0, -3e-4, speed, -speed / 2, 0.0]
    sim = sc.Sim(scene, **settings)
    sim.qpos[:], sim.qvel[:] = state[:3], state[3:]
    A = sim.linearize().A

    def after(state):
        sim.qpos[:], sim.qvel[:] = state[:3], state[3:]
        sim.step()
        return np.r_[sim.qpos, sim.qvel]

    for k in range(6):
        h = np.zeros(6)
        h[k] = 1e-7
        column = (after(state + h) - after(state - h)) / 2e-7
        assert A[:, k] == pytest.approx(column, abs=1e-6)


@pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")
def test_the_stable_step_is_that_of_the_spring():
    """dt·ω < 2√(ζ² + 1) − 2ζ, as before: the bisection on a resting, slipping ball finds it."""
    ratio = 0.1
    limit = 2 * math.sqrt(ratio**2 + 1) - 2 * ratio
    for share, stable in ((0.97, True), (1.03, False)):
        dt = share * limit / math.sqrt(K / MASS)
        sim = sc.Sim(
            block(0.0, 1.0),
            **PENALTY | {"dt": dt, "integrator": "semi-implicit", "penalty_damping_ratio": ratio},
        )
        sim.qpos[2], sim.qvel[0] = -MASS * G / K - 1e-6, 1e-3
        sim.step(400)
        rests = abs(sim.qpos[2] + MASS * G / K) < 1e-5 and abs(sim.qvel[0]) < 1e-3
        assert bool(rests) is stable


@pytest.mark.parametrize("engine", ENGINES)
def test_a_ball_comes_to_roll(engine):
    """A sliding ball keeps 5/7 of its speed (angular momentum about the contact), then rolls."""
    text = (
        f'<mujoco><worldbody><geom type="plane" size="9 9 1"/><body pos="0 0 .1"><freejoint/>'
        f'<geom size=".1" mass="{MASS}"/></body></worldbody></mujoco>'
    )
    sim = make(engine, sc.loads(text), **PENALTY | {"penalty_damping_ratio": 0.5})
    sim.qpos[2], sim.qvel[0] = 0.1 - MASS * G / K, 1.0
    sim.step(300)
    assert sim.qvel[0] == pytest.approx(5 / 7, rel=1e-3)
    assert sim.qvel[4] == pytest.approx(sim.qvel[0] / 0.1, rel=1e-3)


def test_without_friction_nothing_is_held():
    """μ = 0 and condim 1 slide as if there were none."""
    for scene in (block(0.2, 0.0), block(0.2, 0.5, 'condim="1" priority="1"')):
        sim = sc.Sim(scene, **PENALTY)
        sim.qpos[2] = -MASS * G * math.cos(0.2) / K
        sim.step(100)
        assert sim.qvel[0] == pytest.approx(G * math.sin(0.2) * 0.1, rel=1e-12)
