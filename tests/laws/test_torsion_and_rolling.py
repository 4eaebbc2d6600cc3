"""Torsion (condim 4) and rolling friction (condim 6) against closed forms, in both engines.

Laws, for a ball of mass m, radius r and inertia I = 2/5 m r² on a floor: a spin about the normal
loses μ_t m g/I; rolling loses 5/7 μ_r g/r and ends after v²/(2a); a ball that slides first rolls
where μ and μ_r say; force and torque are within the ellipsoid or the box of the cone; two balls
that meet keep their momentum and their angular momentum.
"""

import math

import numpy as np
import pytest
from covering import every_pair
from engines import ENGINES, make

import stepcore as sc

G, R, MASS, DT = 9.81, 0.1, 1.5, 0.002
INERTIA = 0.4 * MASS * R * R
COULOMB = ("lesson", "relaxed", "rigid")
CONES = ("elliptic", "pyramidal")
SOLVED = {"solver": "pgs", "sweeps": 3000, "tolerance": 1e-14}


def ball(condim, friction, gravity=G):
    """A ball on a floor, touching it."""
    words = f'condim="{condim}" friction="{friction}"'
    return sc.loads(
        f'<mujoco><option gravity="0 0 {-gravity}" timestep="{DT}"/><worldbody>'
        f'<geom type="plane" size="9 9 1" {words}/><body name="ball" pos="0 0 {R}"><freejoint/>'
        f'<geom size="{R}" mass="{MASS}" {words}/></body></worldbody></mujoco>'
    )


@every_pair(condim=[4, 6], law=COULOMB, cone=CONES, engine=ENGINES)
def test_a_spin_decays(engine, law, cone, condim):
    """ω̇ = −μ_t m g/I until it rests, and rests."""
    mu = 0.01
    sim = make(engine, ball(condim, f".8 {mu} .001"), law=law, cone=cone, **SOLVED)
    sim.qvel[5] = 5.0
    rate = mu * MASS * G / INERTIA
    sim.step(50)
    assert sim.qvel[5] == pytest.approx(5.0 - rate * 50 * DT, abs=1e-12)
    assert np.abs(sim.qvel[:5]).max() < 1e-12
    sim.step(200 if engine == "rust" else 60)
    if engine == "rust":
        assert np.abs(sim.qvel).max() < 1e-12


@every_pair(law=COULOMB, engine=ENGINES)
def test_a_spin_without_torsion_goes_on(engine, law):
    """condim 3 does not know it, however large its coefficients."""
    sim = make(engine, ball(3, ".8 1 1"), law=law, **SOLVED)
    sim.qvel[5] = 5.0
    sim.step(20)
    assert sim.qvel[5] == pytest.approx(5.0, abs=1e-13)


@every_pair(law=COULOMB, engine=ENGINES)
def test_rolling_stops(engine, law):
    """a = 5/7 μ_r g/r under the box, which leaves the rolling itself alone."""
    mu = 0.002
    sim = make(engine, ball(6, f".8 .01 {mu}"), law=law, cone="pyramidal", **SOLVED)
    sim.qvel[0], sim.qvel[4] = 1.0, 1.0 / R
    rate = 5 / 7 * mu * G / R
    sim.step(40)
    assert sim.qvel[0] == pytest.approx(1.0 - rate * 40 * DT, abs=1e-12)
    assert sim.qvel[4] * R == pytest.approx(sim.qvel[0], abs=1e-12)
    if engine == "rust":
        sim.step(4000)
        assert np.abs(sim.qvel).max() < 1e-12
        # A step late by at most v dt.
        assert sim.qpos[0] == pytest.approx(1 / (2 * rate), abs=DT)


def test_rolling_in_an_ellipsoid_creeps():
    """Friction and rolling share Σ (λ_j/μ_j)² = λ_n², and so their slips: a little slower, with
    a slip that stands in the ratio of what they push."""
    mu, roll = 0.3, 0.005
    sim = make("rust", ball(6, f"{mu} .01 {roll}"), law="rigid", cone="elliptic", **SOLVED)
    sim.qvel[0], sim.qvel[4] = 3.0, 3.0 / R
    sim.step(500)
    before = sim.qvel[0]
    sim.step(500)
    # The slip is c ω with c = (μ_r/μ)² f/τ, so f = m a, a = (r + c) α and τ = r f + I α.
    c = 0.0
    for _ in range(50):
        arm = R + 0.4 * R * R / (R + c)  # τ/f
        c = (roll / mu) ** 2 / arm
    rate = G / math.hypot(1 / mu, arm / roll)
    assert (before - sim.qvel[0]) / (500 * DT) == pytest.approx(rate, rel=1e-4)
    assert sim.qvel[0] - R * sim.qvel[4] == pytest.approx(c * sim.qvel[4], rel=1e-2)


@every_pair(law=COULOMB, engine=ENGINES)
def test_a_slide_becomes_rolling(engine, law):
    """v̇ = −μ g and I ω̇ = (μ r − μ_r) m g until v = r ω."""
    mu, roll, v = 0.2, 0.004, 1.0
    sim = make(engine, ball(6, f"{mu} .01 {roll}"), law=law, cone="pyramidal", **SOLVED)
    sim.qvel[0] = v
    spins = (mu * R - roll) * MASS * G / INERTIA
    meet = v / (mu * G + R * spins)
    before = int(0.9 * meet / DT)
    sim.step(before)
    assert sim.qvel[0] == pytest.approx(v - mu * G * before * DT, abs=1e-12)
    assert sim.qvel[4] == pytest.approx(spins * before * DT, abs=1e-12)
    sim.step(int(meet / DT) + 5 - before)
    assert sim.qvel[4] * R == pytest.approx(sim.qvel[0], abs=1e-12)
    # About the point of contact only rolling friction acts, from the first step on.
    angular = MASS * R * sim.qvel[0] + INERTIA * sim.qvel[4]
    assert angular == pytest.approx(MASS * R * v - roll * MASS * G * sim.time, abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("way, friction", [("torsion", "0 .02 0"), ("roll", "0 0 .02")])
def test_a_way_alone_has_its_row(engine, way, friction):
    """Without sliding friction torsion and rolling still act."""
    sim = make(engine, ball(6, friction), law="rigid", **SOLVED)
    axis = 5 if way == "torsion" else 4
    sim.qvel[0], sim.qvel[axis] = 1.0, 8.0
    sim.step(20)
    rate = 0.02 * MASS * G / INERTIA
    assert sim.qvel[axis] == pytest.approx(8.0 - rate * 20 * DT, abs=1e-12)
    assert sim.qvel[0] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_turning_under_penalty(engine):
    """Fast: the torque is μ_t f_n. Slow: a damper that ends the spin at the rate of sliding,
    ¼ √(k A_t)."""
    k, dt, mu = 1e5, 1e-4, 0.05
    own = {"law": "penalty", "penalty_stiffness": k, "solver": "pgs", "dt": dt}
    sim = make(engine, ball(4, f".8 {mu} 0"), **own)
    depth = MASS * G / k
    sim.qpos[2], sim.qvel[5] = R - depth, 40.0
    sim.step(100)
    rate = mu * MASS * G / INERTIA
    assert sim.qvel[5] == pytest.approx(40.0 - rate * 100 * dt, rel=1e-9)
    # A along a tangent, of a point halfway into the overlap: 1/m + r²/I.
    easy = 1 / MASS + (R - depth / 2) ** 2 / INERTIA
    decay = math.sqrt(k * easy) / 4
    sim.reset()
    sim.qpos[2], sim.qvel[5] = R - depth, 0.01
    sim.step(50)
    assert sim.qvel[5] == pytest.approx(0.01 * (1 - decay * dt) ** 50, rel=1e-9)


def pair_of_balls(condim):
    words = f'condim="{condim}" friction=".5 .02 .01"'
    return sc.loads(
        '<mujoco><option gravity="0 0 0" timestep="0.002"/><worldbody>'
        f'<body pos="0 0 0"><freejoint/><geom size=".1" mass="1" {words}/></body>'
        f'<body pos=".21 .05 .02"><freejoint/><geom size=".12" mass="3" {words}/></body>'
        "</worldbody></mujoco>"
    )


def momenta(sim):
    """Momentum, and angular momentum about the origin, of two free balls."""
    masses, radii = (1.0, 3.0), (0.1, 0.12)
    linear, angular = np.zeros(3), np.zeros(3)
    for i, (m, r) in enumerate(zip(masses, radii, strict=True)):
        v, w = sim.qvel[6 * i : 6 * i + 3], sim.qvel[6 * i + 3 : 6 * i + 6]
        turn = np.array(sim.xquat[i + 1])
        # Angular velocity in body axes, of a body whose inertia is the same about each.
        u, x = turn[0], turn[1:]
        world = w + 2 * np.cross(x, np.cross(x, w) + u * w)
        linear += m * v
        angular += m * np.cross(sim.xpos[i + 1], v) + 0.4 * m * r * r * world
    return linear, angular


@every_pair(law=("solref", *COULOMB), cone=CONES, condim=[4, 6])
def test_two_balls_keep_their_momenta(law, cone, condim):
    """What one gets by torsion and rolling the other gives."""
    solver = {"solver": "newton", "sweeps": 100, "tolerance": 0} if law == "solref" else SOLVED
    sim = make("rust", pair_of_balls(condim), law=law, cone=cone, **solver)
    sim.qvel[:] = [0.5, 0, 0, 9, -3, 2, -0.5, 0, 0, -4, 7, 1]
    before, spins = momenta(sim), sim.qvel[3:6].copy()
    touched = 0
    for _ in range(40):
        sim.step()
        touched += bool(len(sim.contacts)) and np.abs(sim.contacts["torque"]).max() > 0
    assert touched and np.abs(sim.qvel[3:6] - spins).max() > 1e-3
    # Explicit positions and one contact point: angular momentum to the order of the step.
    assert momenta(sim)[0] == pytest.approx(before[0], abs=1e-12)
    assert momenta(sim)[1] == pytest.approx(before[1], abs=2e-3 * np.abs(before[1]).max())


@every_pair(condim=[3, 4, 6], cone=CONES, law=("solref", *COULOMB, "penalty"))
def test_force_and_torque_stay_in_the_cone(law, cone, condim):
    """Σ (λ_j/μ_j)² ≤ λ_n² or |λ_j| ≤ μ_j λ_n (in a pyramid Σ |λ_j|/μ_j ≤ λ_n); nothing else."""
    mu = np.array([0.4, 0.4, 0.05, 0.02, 0.02])[: condim - 1]
    own = {} if law == "solref" else {"solver": "pgs", "penalty_stiffness": 1e4}
    sim = make("rust", ball(condim, ".4 .05 .02"), law=law, cone=cone, **own)
    sim.qvel[:] = [1.5, -0.7, -0.5, 3, 20, 40]
    seen = 0
    for _ in range(60):
        sim.step()
        for contact in sim.contacts:
            normal = contact["normal"]
            y = np.array([0.0, 1.0, 0.0])
            z = np.cross(normal, y)
            force, torque = contact["force"], contact["torque"]
            parts = np.array([force @ y, force @ z, torque @ normal, torque @ y, torque @ z])
            load = max(force @ normal, 0.0)
            seen += load > 0
            assert np.abs(parts[condim - 1 :]).max(initial=0.0) < 1e-12
            parts = np.abs(parts[: condim - 1]) / mu
            most = parts.max() if cone == "pyramidal" else np.linalg.norm(parts)
            if law == "penalty":
                most = np.linalg.norm(parts)
            elif law == "solref" and cone == "pyramidal":
                most = parts.sum()
            assert most <= load * (1 + 1e-9)
    assert seen > 5


def test_single_precision_and_lanes():
    """f32 follows f64; each lane is, bit for bit, the world that it holds."""
    for law in ("solref", *COULOMB, "penalty"):
        for cone in CONES:
            model = ball(6, ".4 .05 .02").compile()
            own = {"law": law, "cone": cone, "solver": "pgs", "sweeps": 50, "tolerance": 0.0}
            own["integrator"] = "semi-implicit"
            starts = np.random.default_rng(3).normal(size=(11, 6)) * [1, 1, 0.1, 5, 20, 20]
            batch = sc.Batch(model, 11, **own)
            batch.qvel[:] = starts
            batch.step(60)
            for world in (0, 7, 9):
                sim = sc.Sim(model, **own)
                sim.qvel[:] = starts[world]
                sim.step(60)
                assert (sim.qpos == batch.qpos[world]).all()
                assert (sim.qvel == batch.qvel[world]).all()
            single = sc.Sim(model, precision="f32", **own)
            single.qvel[:] = starts[9]
            single.step(60)
            assert np.abs(single.qvel - sim.qvel).max() < 2e-3, (law, cone)


def test_what_is_told_of_them():
    """Rows in their own units, plan's count of rows, and the Delassus matrix of such rows."""
    for condim, cone, count in ((4, "elliptic", 4), (6, "elliptic", 6), (4, "pyramidal", 6)):
        scene = ball(condim, ".8 .01 .002").with_settings(cone=cone)
        sim = sc.Sim(scene, solver="newton")
        sim.qpos[2] -= 1e-4
        sim.qvel[:] = [0.01, 0, 0, 0.1, 0.2, 0.3]
        sim.forward()
        assert len(sim.rows) == count
        assert f"{count} rows each" in str(sim.model.plan())
    sim = make("rust", ball(6, ".8 .01 .002"), law="rigid", cone="elliptic", **SOLVED)
    sim.qvel[:] = [0.01, 0, 0, 0.1, 0.2, 0.3]
    sim.forward()
    rows, contact = sim.rows, sim.contacts[0]
    # Along the normal, y and z × y: floor's normal is z.
    assert rows["velocity"][3] == pytest.approx(0.3)
    assert sorted(np.abs(rows["velocity"][4:])) == pytest.approx([0.1, 0.2])
    assert np.linalg.norm(contact["torque"]) == pytest.approx(np.linalg.norm(rows["force"][3:]))
    angular = np.diagonal(sim.delassus())[3:]
    assert angular == pytest.approx([1 / INERTIA] * 3, rel=1e-12)
