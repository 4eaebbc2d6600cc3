"""Boxes and stones over time: rest depth, towers, sliding, cards, an arch, mass ratios, overlap."""

import math

import numpy as np
import pytest

import stepcore as sc

G = 9.81
RIGID = {"law": "rigid", "solver": "pgs", "integrator": "semi-implicit"}


def boxes(places, half=(0.1, 0.1, 0.1), mass=1.0, mu=0.8, **geom):
    """Free boxes on a plane, centres at `places`; one mass for all, or one each."""
    scene = sc.Scene(gravity=(0, 0, -G))
    scene.add_geom("world", "plane", (0, 0, 1), friction=(mu,), name="floor", **geom)
    masses = np.broadcast_to(mass, len(places))
    for index, (place, m) in enumerate(zip(places, masses, strict=True)):
        body = scene.add_body(f"box{index}", pos=place)
        scene.add_joint(body, "free")
        scene.add_geom(body, "box", half, mass=float(m), friction=(mu,), **geom)
    return scene


def tower(count, mass=1.0):
    return boxes([(0, 0, 0.1 + 0.2 * k) for k in range(count)], mass=mass)


def places(sim):
    return np.array(sim.qpos).reshape(-1, 7)[:, :3]


def borne(sim):
    """What the floor bears [N]."""
    return sum(c["force"][2] for c in sim.contacts if c["name1"] == "floor")


@pytest.mark.parametrize("solver", ["newton", "pgs"])
@pytest.mark.parametrize(("cone", "edges"), [("elliptic", 1.0), ("pyramidal", 0.5 * 0.25 * 1.25)])
def test_c4_a_box_rests_on_four_corners(solver, cone, edges):
    """C4 of one contact is g (1 − d) (tc dr)², from MuJoCo's documentation: K d φ = R f / m with
    K = 1 / (d tc dr)² and R = (1 − d) / d times the inverse weight 1/m. Four corners bear a
    quarter each. Under pyramids a contact is four edges of R 2 μ² (1 + μ²): μ² (1 + μ²) / 2."""
    tc, dr = 0.02, 0.8
    for d in (0.5, 0.9):
        scene = boxes([(0, 0, 0.1)], mass=3.0, mu=0.5, solref=(tc, dr), solimp=(d, d, 1e-3))
        sim = sc.Sim(scene, solver=solver, cone=cone, dt=2e-3, sweeps=300)
        sim.run(2.0)
        depth = G * (1 - d) * (tc * dr) ** 2 / 4 * edges
        assert 0.1 - sim.qpos[2] == pytest.approx(depth, rel=1e-7)
        assert np.abs(sim.qvel).max() < 1e-9
        assert borne(sim) == pytest.approx(3 * G, rel=1e-9)


@pytest.mark.parametrize("law", ["rigid", "lesson", "relaxed"])
def test_a_tower_of_ten_stands_where_sweeps_solve_it(law):
    """Its corners bear all of it, and nothing moves but what the tolerance leaves."""
    settings = {"solver": "pgs", "integrator": "semi-implicit", "softness": 0.0, "sweeps": "auto"}
    sim = sc.Sim(tower(10), law=law, dt=2e-3, **settings)
    sim.step(60)
    assert len(sim.contacts) == 40
    assert borne(sim) == pytest.approx(10 * G, rel=1e-5)
    assert np.abs(sim.qvel).max() < 1e-6
    assert np.abs(places(sim)[:, :2]).max() < 1e-6
    assert places(sim)[:, 2] == pytest.approx(0.1 + 0.2 * np.arange(10), abs=1e-7)


@pytest.mark.parametrize("solver", ["newton", "pgs"])
def test_a_tower_of_ten_rests_under_solref(solver):
    """500 steps: Newton ends at rounding, fifty warm sweeps at some millimetres a second."""
    sim = sc.Sim(tower(10), solver=solver, sweeps=50, dt=2e-3, integrator="semi-implicit")
    sim.step(500)
    assert len(sim.contacts) == 40
    assert borne(sim) == pytest.approx(10 * G, rel=1e-6 if solver == "newton" else 0.1)
    assert np.abs(sim.qvel).max() < (1e-9 if solver == "newton" else 3e-2)
    assert np.abs(places(sim)[:, :2]).max() < (1e-9 if solver == "newton" else 5e-3)


def test_rest_needs_one_sweep():
    """C6: what rests starts from its own impulses."""
    sim = sc.Sim(tower(3), solver="pgs", sweeps=2000, tolerance=1e-9, dt=2e-3)
    sim.step(600)
    needed = []
    for _ in range(50):
        sim.step()
        needed.append(sim.sweeps_done)
    assert np.median(needed) == 1 and max(needed) <= 10
    sim = sc.Sim(tower(3), solver="pgs", sweeps=2000, tolerance=1e-9, dt=2e-3, warm_start=False)
    sim.qpos[2::7] -= 1e-3
    sim.step(10)
    assert sim.sweeps_done > 50


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_f2_a_box_slides_to_its_stopping_distance(angle):
    """v₀² / 2μg less v₀ dt / 2, as velocities come first, however the box is turned on its way."""
    mu, v0, dt = 0.4, 2.0, 1e-3
    scene = boxes([(0, 0, 0.05)], half=(0.2, 0.15, 0.05), mass=2.0, mu=mu)
    sim = sc.Sim(scene, dt=dt, sweeps=300, tolerance=1e-12, cone="elliptic", **RIGID)
    sim.qpos[3:7] = math.cos(angle / 2), 0, 0, math.sin(angle / 2)
    sim.qvel[0] = v0
    sim.step(round((v0 / (mu * G) + 0.1) / dt))
    assert np.abs(sim.qvel).max() < 1e-9
    assert sim.qpos[0] == pytest.approx(v0 * v0 / (2 * mu * G) - v0 * dt / 2, abs=v0 * dt / 20)
    assert abs(sim.qpos[1]) < 1e-6


@pytest.mark.parametrize("count", [1, 4])
def test_penalty_contacts_are_springs_side_by_side(count):
    """A ball, and a box on four corners, on a slide: stable while dt ω < 2 (√(ζ² + 1) − ζ), with
    ω² = n k / m and ζ of the damper n · 2 ζ₁ √(k m), which is √n ζ₁ of this ω."""
    k, ratio, mass = 1e5, 0.1, 2.0
    zeta = math.sqrt(count) * ratio
    limit = 2 * (math.sqrt(zeta**2 + 1) - zeta) / math.sqrt(count * k / mass)
    scene = sc.Scene(gravity=(0, 0, -G))
    scene.add_geom("world", "plane", (0, 0, 1))
    body = scene.add_body("body", pos=(0, 0, 0.1))
    scene.add_joint(body, "slide", axis=(0, 0, 1))
    scene.add_geom(body, *(("sphere", 0.1) if count == 1 else ("box", (0.1,) * 3)), mass=mass)
    start, ends = -mass * G / (count * k), []
    for dt in (0.98 * limit, 1.02 * limit):
        settings = {"penalty_stiffness": k, "penalty_damping_ratio": ratio, "solver": "pgs"}
        sim = sc.Sim(scene, law="penalty", dt=dt, integrator="semi-implicit", **settings)
        sim.qpos[0] = start * (1 + 1e-3)
        sim.step(60)
        ends.append(abs(float(sim.qpos[0]) - start))
    assert ends[0] < 5e-4 * abs(start) and ends[1] > 2e-3 * abs(start)


def cards(share, lean):
    """F13: two cards that lean on each other by rounded, frictionless edges; friction is `share` of
    what they need. A card has N = m g at its foot; about the foot H · height = m g · arm."""
    thick, length, radius = 0.004, 0.2, 0.006
    arm = length * math.sin(lean) - thick * math.cos(lean)
    middle = length * math.cos(lean) + thick * math.sin(lean)
    mu = share * arm / (middle + length * math.cos(lean))
    scene = sc.Scene(gravity=(0, 0, -G))
    scene.add_geom("world", "plane", (0, 0, 1), friction=(mu,))
    for side in (-1, 1):
        place = (side * (radius + length * math.sin(lean)), 0, middle)
        quat = (math.cos(lean / 2), 0, -side * math.sin(lean / 2), 0)
        body = scene.add_body(f"card{side}", pos=place, quat=quat)
        scene.add_joint(body, "free")
        flat = {"contype": 2, "conaffinity": 1, "friction": (mu,)}
        scene.add_geom(body, "box", (thick, 0.1, length), mass=0.1, **flat)
        ends = (0, -0.09, length, 0, 0.09, length)
        rounded = {"contype": 4, "conaffinity": 4, "condim": 1}
        scene.add_geom(body, "capsule", radius, fromto=ends, mass=0.0, **rounded)
    return sc.Sim(scene, dt=1e-3, sweeps=500, tolerance=1e-12, **RIGID), mu


@pytest.mark.parametrize("lean", [0.2, 0.436])
def test_f13_cards_stand_iff_friction_holds_them(lean):
    """Of thin cards the bound is ½ tan lean."""
    sim, mu = cards(1.03, lean)
    assert mu == pytest.approx(1.03 * 0.5 * math.tan(lean), rel=0.12)
    sim.step(400)
    assert np.abs(sim.qvel).max() < 1e-6
    sim, _ = cards(0.95, lean)
    sim.step(400)
    assert np.abs(sim.qvel).max() > 0.05


def arch(ratio, stones=7, mu=0.9):
    """F14: half a ring of equal stones, convex meshes, `ratio` of its mean radius thick."""
    scene = sc.Scene(gravity=(0, 0, -G))
    scene.add_geom("world", "plane", (0, 0, 1), friction=(mu,))
    step = math.pi / stones
    for index in range(stones):
        turn = [index * step, (index + 1) * step]
        corners = [
            (r * math.cos(angle), y, r * math.sin(angle))
            for r in (1 - ratio / 2, 1 + ratio / 2)
            for angle in turn
            for y in (-0.2, 0.2)
        ]
        middle = np.mean(corners, axis=0)
        mesh = scene.add_mesh(f"stone{index}", np.array(corners) - middle)
        body = scene.add_body(f"stone{index}", pos=middle)
        scene.add_joint(body, "free")
        hard = {"solref": (0.004, 1), "solimp": (0.99, 0.99, 1e-3)}
        scene.add_geom(body, "mesh", mesh=mesh, density=2000.0, friction=(mu,), **hard)
    return sc.Sim(scene, dt=1e-3, cone="elliptic", integrator="implicitfast")


def test_f14_an_arch_stands_iff_it_is_thick():
    """Milankovitch 1907: half a ring stands from a thickness of 0.1075 of its mean radius on."""
    sim = arch(0.2)
    start = places(sim).copy()
    sim.step(500)
    assert np.abs(places(sim) - start).max() < 2e-3
    sim = arch(0.06)
    start = places(sim).copy()
    sim.step(500)
    assert np.abs(places(sim) - start).max() > 0.05


@pytest.mark.parametrize("settings", [{}, RIGID | {"sweeps": 60}])
def test_c12_overlapping_boxes_part_without_a_pop(settings):
    """A pyramid of four rows set with a quarter of its heights overlapping: with a limit on each
    contact's recovery the top rises by four times that at most, and stays on top."""
    half, overlap, limit = 0.5, 0.25, 0.5
    rise, spots = 2 * half * (1 - overlap), []
    for row in range(4):
        spots += [(1.2 * (k - (3 - row) / 2), 0, half + rise * row) for k in range(4 - row)]
    scene = boxes(spots, half=(half,) * 3, mass=1000.0, mu=0.6)
    sim = sc.Sim(scene, dt=2e-3, max_recovery_speed=limit, **settings)
    fastest = 0.0
    for _ in range(1000):
        sim.step()
        fastest = max(fastest, float(np.abs(np.array(sim.qvel).reshape(-1, 6)[:, :3]).max()))
    assert 0.5 * limit < fastest < 4.2 * limit  # what a soft row lets pass
    assert places(sim)[-1, 2] == pytest.approx(7 * half, abs=0.02)
    assert np.abs(places(sim)[:, :2] - np.array(spots)[:, :2]).max() < 0.02


@pytest.mark.parametrize(
    "settings", [{}, {"solver": "pgs", "sweeps": 200}, RIGID | {"sweeps": 2000, "tolerance": 1e-9}]
)
def test_c13_heavy_on_light(settings):
    """100 on 1 on 1: the floor bears it all; with the top taken off the others do not jump."""
    hard = {"solref": (0.01, 1)}
    scene = boxes([(0, 0, 0.1), (0, 0, 0.3), (0, 0, 0.5)], mass=[1.0, 1.0, 100.0], mu=0.6, **hard)
    sim = sc.Sim(scene, dt=2e-3, **settings)
    sim.step(500)
    assert borne(sim) == pytest.approx(102 * G, rel=1e-3)
    assert np.abs(sim.qvel).max() < 1e-3
    sim.qpos[14] = 50.0
    fastest = 0.0
    for _ in range(120):
        sim.step()
        fastest = max(fastest, float(np.abs(sim.qvel[:12]).max()))
    assert fastest < 0.05
