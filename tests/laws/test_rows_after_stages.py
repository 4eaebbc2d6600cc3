"""Rows after `midpoint` and `rk4`: bounces keep their energy, what rests is at rest."""

import math

import numpy as np
import pytest
from covering import every_pair
from engines import ENGINES, make

import stepcore as sc
from stepcore import lesson
from stepcore.scene.scene import Scene

G = 9.81
AFTER = ("midpoint", "rk4")
SETTINGS = {"solver": "pgs", "sweeps": 500, "tolerance": 1e-12}


@every_pair(dt=[2e-3, 1e-2], integrator=[*AFTER, "semi-implicit"])
def test_bounces_keep_their_energy(integrator, dt):
    """e = 1, 2,000 s of bounces: midpoint and rk4 keep E to 1e-9, v-first to its g·dt·v/2."""
    scene = lesson.tower([1.0])
    sim = sc.Sim(scene, law="rigid", restitution=1.0, dt=dt, integrator=integrator, **SETTINGS)
    sim.qpos[0] = 1.0
    kept = []
    for _ in range(200):
        sim.step(round(10.0 / dt))
        kept.append(0.5 * float(sim.qvel[0]) ** 2 + G * float(sim.qpos[0]))
    band = 1e-9 if integrator in AFTER else 0.5 * dt * math.sqrt(2 * G) * 1.1
    assert np.abs(np.array(kept) / G - 1).max() < band


@pytest.mark.parametrize("integrator", AFTER)
def test_a_tower_of_elastic_balls_gains_nothing(integrator):
    """Three unequal balls bouncing on each other, 500 s: simultaneous bounces never add energy."""
    scene = lesson.tower([1.0, 0.3, 2.0])
    sim = sc.Sim(scene, law="rigid", restitution=1.0, dt=2e-3, integrator=integrator, **SETTINGS)
    sim.qpos[:] = 0.2, 0.5, 0.9
    start = sum(sim.energy)
    for _ in range(500):
        sim.step(500)
        assert sum(sim.energy) <= start * (1 + 1e-9)


@every_pair(engine=ENGINES, e=[0.5, 0.8], integrator=AFTER)
def test_apexes(engine, integrator, e):
    """apex_n = h·e^(2n), and rest: the energy of each flight is exact, the time to O(dt)."""
    dt = 2e-3 if engine == "rust" else 1e-2
    sim = make(engine, lesson.tower([1.0]), restitution=e, dt=dt, integrator=integrator)
    sim.qpos[0] = 1.0
    y, v = [], []
    for _ in range(round(2.4 / dt)):
        sim.step()
        y.append(float(sim.qpos[0]))
        v.append(float(sim.qvel[0]))
    apexes = [
        y[n] + v[n] ** 2 / (2 * G) for n in range(1, len(y)) if v[n - 1] > 0 >= v[n] > -10 * dt
    ][:3]
    # A bounce comes up to one step early, v·dt too high.
    for n, apex in enumerate(apexes, 1):
        assert apex == pytest.approx(e ** (2 * n), abs=3 * n * dt * math.sqrt(2 * G) * e**n)


@every_pair(
    engine=ENGINES,
    **{"law, softness": [("rigid", 0.0), ("lesson", 0.0), ("lesson", 0.3), ("relaxed", 0.3)]},
    integrator=AFTER,
)
def test_what_rests_is_at_rest(engine, law, softness, integrator):
    """qvel is 0 (it read −g·dt/2), the force is the weight, the depth is the law's."""
    sim = make(
        engine, lesson.tower([2.0]), law=law, softness=softness, dt=2e-3, integrator=integrator
    )
    sim.step(600 if engine == "rust" else 150)
    for _ in range(5):
        sim.step()
        assert abs(float(sim.qvel[0])) < 1e-9
        assert float(np.array(sim.rows["impulse"])[0]) / 2e-3 == pytest.approx(2 * G, rel=1e-6)
    depth = softness * 2.0 * G * 2e-3**2 / 0.2 if law == "lesson" else 0.0
    assert -float(sim.qpos[0]) == pytest.approx(depth, rel=1e-6, abs=2e-5 if not softness else 1e-9)


@pytest.mark.parametrize("integrator", AFTER)
def test_a_tower_rests(integrator):
    """Five balls: at rest, the floor bears them in every step."""
    sim = sc.Sim(lesson.tower([1.0] * 5), law="rigid", dt=2e-3, integrator=integrator, **SETTINGS)
    sim.step(2000)
    for _ in range(200):
        sim.step()
        assert np.abs(sim.qvel).max() < 1e-8
        assert float(sim.rows["impulse"][0]) / 2e-3 == pytest.approx(5 * G, rel=1e-5)
        assert float(sim.contacts["force"][0][2]) == pytest.approx(5 * G, rel=1e-5)


def block(friction, angle):
    """A ball that cannot turn on a plane tilted about y, at its foot."""
    c, s = math.cos(angle), math.sin(angle)
    scene = Scene(gravity=(G * s, 0, -G * c))
    scene.add_geom("world", "plane", friction=friction)
    ball = scene.add_body("ball", pos=(0, 0, 0.1))
    for axis in np.eye(3):
        scene.add_joint(ball, "slide", axis=axis)
    scene.add_geom(ball, "sphere", 0.1, mass=1.0, friction=friction)
    return scene


@every_pair(engine=ENGINES, integrator=AFTER)
def test_sliding_is_exact(engine, integrator):
    """a = g (sin α − μ cos α): both v and the parabola to 1e-9; below the angle it stays."""
    angle, mu = 0.5, 0.3
    settings = {"dt": 2e-3, "integrator": integrator, "cone": "elliptic"}
    sim = make(engine, block(mu, angle), **settings)
    sim.step(2)  # until it has settled on the plane
    x, v = float(sim.qpos[0]), float(sim.qvel[0])
    time = 0.5 if engine == "rust" else 0.06
    sim.step(round(time / 2e-3))
    a = G * (math.sin(angle) - mu * math.cos(angle))
    assert float(sim.qvel[0]) == pytest.approx(v + time * a, abs=1e-9)
    assert float(sim.qpos[0]) == pytest.approx(x + time * v + a * time**2 / 2, abs=1e-9)
    sim = make(engine, block(0.6, angle), **settings)
    sim.step(30)
    assert abs(float(sim.qvel[0])) < 1e-9 and abs(float(sim.qpos[0])) < 1e-4


@every_pair(engine=ENGINES, integrator=AFTER)
def test_friction_loss_is_exact(engine, integrator):
    """A slide with dry friction 2 N, 1 kg, from 3 m/s: stops after 1.5 s and 2.25 m."""
    scene = Scene(gravity=(0, 0, 0))
    body = scene.add_body("sled", mass=1.0, inertia=(1, 1, 1))
    scene.add_joint(body, "slide", axis=(1, 0, 0), frictionloss=2.0)
    sim = make(engine, scene, dt=1e-2, integrator=integrator)
    sim.qvel[0] = 3.0
    sim.step(100)
    assert float(sim.qvel[0]) == pytest.approx(1.0, abs=1e-12)
    assert float(sim.qpos[0]) == pytest.approx(2.0, abs=1e-12)
    sim.step(100)
    assert abs(float(sim.qvel[0])) < 1e-12
    assert float(sim.qpos[0]) == pytest.approx(2.25, abs=1e-3)


@pytest.mark.parametrize("integrator", AFTER)
def test_a_limit_at_rest(integrator):
    """A hanging arm pressed on its stop by a motor: at rest, and the force is the motor's."""
    scene = Scene(gravity=(0, 0, 0))
    body = scene.add_body("arm", mass=1.0, inertia=(0.1, 0.1, 0.1))
    joint = scene.add_joint(body, "hinge", axis=(0, 1, 0), range=(-1.0, 0.5))
    scene.add_actuator(joint, name="push")
    sim = sc.Sim(scene, law="rigid", dt=2e-3, integrator=integrator, **SETTINGS)
    sim.ctrl[0] = 0.7
    sim.step(2000)
    assert abs(sim.qvel[0]) < 1e-12 and sim.qpos[0] == pytest.approx(0.5, abs=1e-9)
    assert sim.rows["impulse"][0] / 2e-3 == pytest.approx(0.7, rel=1e-9)
    assert sim.constraint_force[0] == pytest.approx(-0.7, rel=1e-9)
