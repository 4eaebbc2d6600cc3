"""Speculative rows look along the path: what is passed is left alone, what is hit stops."""

import itertools
import math

import numpy as np
import pytest
from covering import every_pair
from engines import ENGINES, make

import stepcore as sc
from stepcore.scene.scene import Scene

LAWS = ("lesson", "relaxed", "rigid")
SETTINGS = {"solver": "pgs", "integrator": "semi-implicit", "sweeps": 20, "tolerance": 1e-12}


def shot(engine, speed, offset, kind="sphere", radius=0.1, start=-1.3, dt=2e-3, **settings):
    """A ball shot along x past or at a shape at the origin, `offset` [m] beside its centre."""
    scene = Scene(gravity=(0, 0, 0))
    size = {"sphere": 0.1, "box": (0.1, 0.1, 0.1), "capsule": (0.1, 0.3)}[kind]
    scene.add_geom("world", kind, size, condim=1)
    ball = scene.add_body("ball", pos=(start, offset, 0))
    scene.add_joint(ball, "free")
    scene.add_geom(ball, "sphere", radius, mass=1.0, condim=1)
    sim = make(engine, scene, dt=dt, **SETTINGS | settings)
    sim.qvel[0] = speed
    return sim


@every_pair(law=LAWS, engine=ENGINES)
def test_what_is_cleared_is_left_alone(engine, law):
    """1 mm to 10 cm beside a sphere and a box, 1 to 1e6 m/s: the speed stays, bit for bit."""
    cases = itertools.product((1.0, 30.0, 100.0, 1e4, 1e6), (0.001, 0.04, 0.1), ("sphere", "box"))
    for speed, clearance, kind in cases:
        sim = shot(engine, speed, 0.2 + clearance, kind, law=law, start=-0.5)
        for _ in range(20):
            sim.step()
        assert sim.qvel[:3].tolist() == [speed, 0.0, 0.0]


def test_a_capsule_is_cleared_as_well():
    """Its cap is a sphere; the ball passes 1 cm above it."""
    for speed in (1.0, 100.0, 1e4):
        sim = shot("rust", speed, 0.0, "capsule", law="lesson")
        sim.qpos[2] = 0.3 + 0.2 + 0.01
        sim.step(20)
        assert sim.qvel[:3].tolist() == [speed, 0.0, 0.0]


@every_pair(speed=[100.0, 1000.0, 1e6], law=LAWS, engine=ENGINES)
def test_a_glancing_blow_leaves_the_speed_along_the_surface(engine, law, speed):
    """Without restitution v·b/(2r) is left, b the offset: the part along the tangent plane."""
    for offset in (0.05, 0.1, 0.18, 0.199):
        sim = shot(engine, speed, offset, law=law)
        for _ in range(int(2.0 / (speed * 2e-3)) + 10):
            sim.step()
        left = np.linalg.norm(sim.qvel[:2])
        assert left == pytest.approx(speed * offset / 0.2, rel=2e-3)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_glancing_bounce(engine):
    """e = 1 under `rigid`: v turns to v − 2 (v·n) n, the normal that of the first touch."""
    for offset in (0.05, 0.1, 0.18):
        sim = shot(engine, 1000.0, offset, law="rigid", restitution=1.0)
        for _ in range(10):
            sim.step()
        angle = math.asin(offset / 0.2)
        turned = 1000.0 * np.array([-math.cos(2 * angle), math.sin(2 * angle)])
        # Touch within 1/1024 of the radius: the normal is right to that over the cosine.
        assert np.array(sim.qvel[:2]) == pytest.approx(turned, abs=5.0)
        assert np.linalg.norm(sim.qvel[:3]) == pytest.approx(1000.0, rel=1e-12)


@every_pair(law=LAWS, engine=ENGINES)
def test_a_ball_at_a_million_metres_a_second_comes_to_the_sphere(engine, law):
    """Head on from 1.1 m away, where a step is 2 km long: it stops at the surface."""
    sim = shot(engine, 1e6, 0.0, law=law)
    for _ in range(10):
        sim.step()
        assert sim.qpos[0] <= -0.2 + 1e-9, "the ball entered the sphere"
    assert sim.qpos[0] == pytest.approx(-0.2, abs=1e-6)
    assert abs(sim.qvel[0]) < 1e-6


def test_two_free_balls_keep_their_momentum_and_lose_energy_only():
    """Random fast pairs of equal balls: momentum to rounding, and never more energy."""
    rng = np.random.default_rng(3)
    met = 0
    for _ in range(200):
        scene = sc.Scene(gravity=(0, 0, 0))
        for i in range(2):
            ball = scene.add_body(f"ball{i}", pos=(1.0 * i, 0, 0))
            scene.add_joint(ball, "free")
            scene.add_geom(ball, "sphere", 0.1, mass=1.0, condim=1)
        sim = sc.Sim(scene, law="rigid", restitution=1.0, dt=2e-3, **SETTINGS)
        v, speed = rng.normal(size=3) * 10 ** rng.uniform(0, 4), 10 ** rng.uniform(1.5, 4)
        aim = np.array([-1.0, *rng.uniform(-0.2, 0.2, size=2)])
        sim.qvel[:3], sim.qvel[6:9] = v, v + speed * aim
        total = sim.qvel[:3] + sim.qvel[6:9]
        energy, start = sum(sim.energy), sim.qvel.copy()
        sim.step(30)
        size = np.abs(start).max()
        assert sim.qvel[:3] + sim.qvel[6:9] == pytest.approx(total, abs=1e-12 * size)
        assert sum(sim.energy) <= energy * (1 + 1e-12)
        met += bool(np.any(sim.qvel != start))
    assert met > 50
