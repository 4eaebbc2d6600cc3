"""Closed forms of solids that touch by corners and edges: tip or slide, rocking, rolling, a ladder.

Law `rigid` (no softness, no rebound): what is left is the error of the time step.
"""

import math

import numpy as np
import pytest

import stepcore as sc

G = 9.81
RIGID = {"law": "rigid", "solver": "pgs", "integrator": "semi-implicit", "sweeps": 400}


def tilted(slope):
    """Gravity as a plane feels it that falls towards +x by `slope` [rad]."""
    return (G * math.sin(slope), 0, -G * math.cos(slope))


def block(half, mu, gravity, dt=1e-3):
    """A box of mass 1 on a plane, upright, flat in y."""
    scene = sc.Scene(gravity=gravity)
    scene.add_geom("world", "plane", (0, 0, 1), friction=(mu,))
    body = scene.add_body("block", pos=(0, 0, half[2]))
    scene.add_joint(body, "free")
    scene.add_geom(body, "box", half, mass=1.0, friction=(mu,))
    return sc.Sim(scene.compile(), dt=dt, **RIGID)


def tilt(sim):
    """Rotation about y [rad]."""
    w, _, y, _ = sim.qpos[3:7]
    return 2 * math.atan2(y, w)


@pytest.mark.parametrize("ratio", [0.2, 0.5])
def test_a_block_on_a_slope_tips_before_it_slides(ratio):
    """It tips iff tan θ > width / height, at the rate of a body that turns about its edge."""
    half = (0.5 * ratio, 0.2, 0.5)
    low, high = (math.atan(ratio * factor) for factor in (0.98, 1.04))
    sim = block(half, 2 * ratio + 0.5, tilted(low))
    sim.run(1.0)
    assert abs(tilt(sim)) < 1e-9 and abs(sim.qpos[0]) < 1e-9
    sim = block(half, 2 * ratio + 0.5, tilted(high))
    sim.run(0.4)
    moment = G * (half[2] * math.sin(high) - half[0] * math.cos(high))
    start = moment / (4 / 3 * (half[0] ** 2 + half[2] ** 2))
    # The moment grows with the angle: θ'' = start + grow·θ while the angle is small.
    grow = G * (half[2] * math.cos(high) + half[0] * math.sin(high))
    grow /= 4 / 3 * (half[0] ** 2 + half[2] ** 2)
    expected = start / grow * (math.cosh(math.sqrt(grow) * 0.4) - 1)
    assert tilt(sim) == pytest.approx(expected, rel=0.02)


def test_a_block_on_a_slope_slides_before_it_tips():
    """It slides iff tan θ > μ, at g (sin θ − μ cos θ), and does not turn."""
    half, mu = (0.25, 0.2, 0.3), 0.4
    sim = block(half, mu, tilted(math.atan(0.99 * mu)))
    sim.run(1.0)
    assert abs(sim.qpos[0]) < 1e-9
    slope = math.atan(1.2 * mu)
    sim = block(half, mu, tilted(slope))
    sim.run(1.0)
    assert sim.qvel[0] == pytest.approx(G * (math.sin(slope) - mu * math.cos(slope)), rel=1e-6)
    assert abs(tilt(sim)) < 1e-9


def rocking(half, start, dt):
    """When a block let go at the tilt `start` comes down, and its spin before and after."""
    sim = block(half, 5.0, (0, 0, -G), dt)
    # It stands on its edge at x = −half[0], tilted so that the centre rises over it.
    corner = np.array([half[0], 0, half[2]])
    turn = np.array(
        [[math.cos(start), 0, math.sin(start)], [0, 1, 0], [-math.sin(start), 0, math.cos(start)]]
    )
    qpos = np.zeros(7)
    qpos[:3] = turn @ corner
    qpos[3:] = math.cos(start / 2), 0, math.sin(start / 2), 0
    sim.qpos[:] = qpos
    before = 0.0
    while tilt(sim) * start > 0 and sim.time < 5:
        before = float(sim.qvel[4])
        sim.step()
    fell = sim.time
    sim.step(3)
    return fell, before, float(sim.qvel[4])


@pytest.mark.parametrize("slender", [0.15, 0.3])
def test_rocking_is_housners(slender):
    """Housner 1963: a block that rocks about its edges, θ'' = −p² sin(α − θ) with p² = 3g / 4R,
    and of its spin 1 − 1.5 sin² α is left after each impact."""
    half = (0.5 * slender, 0.3, 0.5)
    alpha, radius = math.atan(slender), math.hypot(half[0], half[2])
    start = -0.5 * alpha
    p2 = 3 * G / (4 * radius)
    angle, spin, t, h = -start, 0.0, 0.0, 1e-5
    while angle > 0:
        middle = spin - 0.5 * h * p2 * math.sin(alpha - angle)
        angle += h * middle
        spin = middle - 0.5 * h * p2 * math.sin(alpha - angle)
        t += h
    small = 2 / math.sqrt(p2) * math.acosh(1 / (1 - 0.5)) / 2
    assert t == pytest.approx(small, rel=0.02)  # Housner's own formula, of slender blocks
    fell, before, after = rocking(half, start, 1e-4)
    assert fell == pytest.approx(t, abs=2e-3)
    assert abs(before) == pytest.approx(abs(spin), rel=5e-3)
    assert after / before == pytest.approx(1 - 1.5 * math.sin(alpha) ** 2, abs=3e-3)


def test_a_cylinder_rolls_down():
    """a = 2/3 g sin θ while μ > tan θ / 3, and slides with g (sin θ − μ cos θ) below that."""
    slope = math.radians(20)
    for mu, speed in (
        (0.5, 2 / 3 * G * math.sin(slope)),
        (0.05, G * (math.sin(slope) - 0.05 * math.cos(slope))),
    ):
        scene = sc.Scene(gravity=tilted(slope))
        scene.add_geom("world", "plane", (0, 0, 1), friction=(mu,))
        body = scene.add_body(
            "roller", pos=(0, 0, 0.1), quat=(math.sqrt(0.5), math.sqrt(0.5), 0, 0)
        )
        scene.add_joint(body, "free")
        scene.add_geom(body, "cylinder", (0.1, 0.2), mass=2.0, friction=(mu,))
        sim = sc.Sim(scene.compile(), dt=1e-3, **RIGID)
        sim.run(1.0)
        assert sim.qvel[0] == pytest.approx(speed, rel=2e-3)
        assert abs(sim.qvel[1]) < 1e-6 and abs(sim.qpos[1]) < 1e-6


@pytest.mark.parametrize("mu", [0.3, 0.6])
def test_a_ladder_stands_iff_it_is_steep(mu):
    """On a rough floor and a smooth wall: tan φ ≥ 1 / 2μ, and the wall bears m g / (2 tan φ)."""
    half, radius = 1.0, 1e-3

    def leant(steepness):
        angle = math.atan(steepness / (2 * mu))
        scene = sc.Scene(gravity=(0, 0, -G))
        scene.add_geom("world", "plane", (0, 0, 1), friction=(mu,), name="floor")
        quarter = (math.sqrt(0.5), 0, math.sqrt(0.5), 0)
        scene.add_geom("world", "plane", (0, 0, 1), quat=quarter, condim=1, priority=1, name="wall")
        x, z = half * math.cos(angle) + radius, half * math.sin(angle) + radius
        lean = math.pi / 2 - angle
        body = scene.add_body(
            "ladder", pos=(x, 0, z), quat=(math.cos(lean / 2), 0, -math.sin(lean / 2), 0)
        )
        scene.add_joint(body, "free")
        scene.add_geom(body, "capsule", (radius, half), mass=3.0, friction=(mu,), name="rod")
        sim = sc.Sim(scene.compile(), dt=1e-3, **RIGID)
        return sim, angle

    sim, angle = leant(1.03)
    sim.run(0.3)
    assert np.abs(sim.qvel).max() < 1e-6
    wall = next(c for c in sim.contacts if c["name1"] == "wall")
    assert np.linalg.norm(wall["force"]) == pytest.approx(3 * G / (2 * math.tan(angle)), rel=5e-3)
    sim, _ = leant(0.95)
    sim.run(0.3)
    assert np.abs(sim.qvel).max() > 0.01


def turntable(hold):
    """A box at 0.4 m on a heavy disc that turns at √(hold · μ g / r): its distance from the axis
    after half a turn."""
    mu, radius = 0.3, 0.4
    spin = math.sqrt(hold * mu * G / radius)
    scene = sc.Scene(gravity=(0, 0, -G))
    disc = scene.add_body("disc", pos=(0, 0, 0.05))
    scene.add_joint(disc, "hinge", axis=(0, 0, 1))
    scene.add_geom(disc, "cylinder", (1.0, 0.05), mass=1e6, friction=(mu,))
    body = scene.add_body("box", pos=(radius, 0, 0.15))
    scene.add_joint(body, "free")
    scene.add_geom(body, "box", (0.04, 0.04, 0.05), mass=1.0, friction=(mu,))
    sim = sc.Sim(scene.compile(), dt=1e-3, **RIGID)
    sim.qvel[:] = 0
    sim.qvel[0] = spin
    sim.qvel[2], sim.qvel[6] = spin * radius, spin
    sim.step(round(math.pi / spin / 1e-3))
    return math.hypot(*sim.qpos[1:3]) / radius, sim


def test_a_box_rides_a_turntable_iff_friction_holds_it():
    """Carried round while ω² r < μ g; the same box beyond that slides outwards."""
    held, sim = turntable(0.9)
    assert held == pytest.approx(1, abs=5e-3)
    # It turns with the disc: half a turn.
    w, z = sim.qpos[4], sim.qpos[7]
    assert 2 * math.atan2(abs(z), abs(w)) == pytest.approx(math.pi, abs=0.05)
    assert turntable(1.15)[0] > 1.1


@pytest.mark.parametrize("count", [2, 4])
def test_an_overhanging_tower_stands_to_the_harmonic_limit(count):
    """Blocks of length 2a, each a / k beyond the one below it (k counted from the top): each part
    of the tower balances on the edge that bears it. A little less stands, a little more falls."""
    half = (0.5, 0.2, 0.05)

    def drop(factor):
        scene = sc.Scene(gravity=(0, 0, -G))
        scene.add_geom("world", "plane", (0, 0, 1), friction=(0.8,))
        shift = 0.0
        for level in range(count + 1):
            body = scene.add_body(f"block{level}", pos=(shift, 0, half[2] * (1 + 2 * level)))
            scene.add_joint(body, "free")
            scene.add_geom(body, "box", half, mass=1.0, friction=(0.8,))
            if level < count:
                shift += factor * half[0] / (count - level)
        sim = sc.Sim(scene.compile(), dt=2e-3, **RIGID)
        top = float(sim.qpos[-5])
        sim.run(0.5)
        return top - float(sim.qpos[-5])

    assert abs(drop(0.96)) < 1e-3
    assert drop(1.04) > 5e-3
