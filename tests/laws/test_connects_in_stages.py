"""Connections under `midpoint` and `rk4`: the integrator's own order, against a closed form."""

import math

import numpy as np
import pytest
from engines import ENGINES, make

import stepcore as sc
from stepcore.scene.scene import Scene

G = 9.81
WAYS = {
    "rigid": {"law": "rigid"},
    "lesson": {"law": "lesson"},
    "relaxed": {"law": "relaxed", "softness": 0.1},
}
SETTINGS = {"solver": "pgs", "sweeps": 200, "tolerance": 1e-12}


def linkage(windows=2):
    """IFToMM's N-four-bar (A02): rods of 1 m and 1 kg, all upright, the tops at 1 m/s along x.

    Upright rods hang on hinges; from each top a coupler goes to the next, where it is connected.
    """
    scene = Scene(gravity=(0, 0, -G))
    uprights = []
    for i in range(windows + 1):
        rod = scene.add_body(
            f"rod{i}", pos=(i, 0, 0), mass=1.0, ipos=(0, 0, 0.5), inertia=(1 / 12, 1 / 12, 1e-3)
        )
        scene.add_joint(rod, "hinge", axis=(0, 1, 0))
        uprights.append(rod)
    for i in range(windows):
        coupler = scene.add_body(
            f"coupler{i}",
            uprights[i],
            pos=(0, 0, 1),
            mass=1.0,
            ipos=(0.5, 0, 0),
            inertia=(1e-3, 1 / 12, 1 / 12),
        )
        scene.add_joint(coupler, "hinge", axis=(0, 1, 0))
        scene.add_equality("connect", coupler, uprights[i + 1], anchor=(1, 0, 0))
    return scene


def speeds(windows=2):
    """Uprights turn at 1 rad/s, couplers stay level; joints by depth first from each upright."""
    return np.array([1.0, -1.0] * windows + [1.0])


def angle_at(time, windows=2):
    """Angle of the uprights from the vertical, by the one equation that is left, to 1e-12 rad.

    (N+1)/3 + N of inertia, and ((N+1)/2 + N) g of moment at a right angle.
    """
    inertia = (windows + 1) / 3 + windows
    c = ((windows + 1) / 2 + windows) * G / inertia
    n = 20000
    h, y = time / n, np.array([0.0, 1.0])
    f = lambda y: np.array([y[1], c * math.sin(y[0])])  # noqa: E731
    for _ in range(n):
        k1 = f(y)
        k2 = f(y + h / 2 * k1)
        k3 = f(y + h / 2 * k2)
        k4 = f(y + h * k3)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return y


def swung(engine, time, dt, windows=2, **settings):
    """The linkage after a time; the distance of the first top from its closed form [m]."""
    scene = linkage(windows)
    sim = make(engine, scene, dt=dt, **SETTINGS | settings)
    sim.qvel[:] = speeds(windows)
    sim.step(round(time / dt))
    angle, _ = angle_at(time, windows)
    at = float(sim.qpos[0])
    return math.hypot(math.sin(at) - math.sin(angle), math.cos(at) - math.cos(angle))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(("integrator", "order"), [("midpoint", 2), ("rk4", 4)])
def test_the_order_of_a_linkage(integrator, order, way):
    """Half a second: halving dt divides the error by 2^order, down to 1e-10 m."""
    errors = [swung("rust", 0.5, dt, integrator=integrator, **WAYS[way]) for dt in (5e-3, 2.5e-3)]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize("integrator", ["midpoint", "rk4"])
def test_numpy_agrees(integrator):
    """The reference's linkage, a tenth of a second, to rounding of the solves."""
    ours, theirs = (
        swung(engine, 0.1, 5e-3, integrator=integrator, law="rigid") for engine in ENGINES
    )
    assert ours == pytest.approx(theirs, abs=1e-11)


@pytest.mark.parametrize("integrator", ["midpoint", "rk4"])
def test_ten_seconds_of_the_linkage(integrator):
    """IFToMM's ten seconds at 1 ms, through the level position where rows are redundant."""
    error = swung("rust", 10.0, 1e-3, integrator=integrator, law="rigid")
    assert error < {"midpoint": 1e-3, "rk4": 1e-6}[integrator]


def test_solref_under_midpoint():
    """Stiff springs in place of hard connections: second order, and no energy of its own."""
    errors = []
    finest = None
    for dt in (1e-3, 5e-4, 2.5e-4, 2.5e-5):
        scene = linkage()
        sim = sc.Sim(scene, dt=dt, law="solref", integrator="midpoint", solver="newton")
        sim.qvel[:] = speeds()
        sim.step(round(0.3 / dt))
        errors.append(sim.qpos.copy())
        finest = sim.qpos.copy()
    apart = [np.abs(e - finest).max() for e in errors[:-1]]
    assert math.log2(apart[0] / apart[1]) == pytest.approx(2, abs=0.3)
    assert math.log2(apart[1] / apart[2]) == pytest.approx(2, abs=0.3)


@pytest.mark.parametrize("law", ["rigid", "solref"])
@pytest.mark.parametrize("integrator", ["midpoint", "rk4"])
def test_lanes_are_the_worlds_alone(integrator, law):
    """Twelve linkages side by side, one through its level position: the same bits as each alone."""
    settings = SETTINGS | {"dt": 2e-3, "integrator": integrator, "law": law}
    model = linkage().compile()
    batch = sc.Batch(model, 12, **settings)
    qvel = np.outer(np.linspace(0.3, 5.0, 12), speeds())
    batch.qvel[:] = qvel
    batch.step(250)
    for world in range(12):
        sim = sc.Sim(model, **settings)
        sim.qvel[:] = qvel[world]
        sim.step(250)
        assert np.array_equal(sim.qpos, batch.qpos[world])
        assert np.array_equal(sim.qvel, batch.qvel[world])


@pytest.mark.parametrize("integrator", ["midpoint", "rk4"])
def test_an_inconsistent_start_is_made_consistent(integrator):
    """One upright alone gets a speed: the first step moves all of them, and nothing gapes."""
    sim = sc.Sim(linkage(), dt=1e-3, integrator=integrator, law="rigid", **SETTINGS)
    sim.qvel[0] = 3.0
    sim.step()
    angles = sim.qpos[[0, 2, 4]]
    assert np.ptp(angles) < 1e-8 and 5e-4 < angles[0] < 3e-3


@pytest.mark.parametrize("integrator", ["midpoint", "rk4"])
def test_a_connection_bears_its_load(integrator):
    """A hanging rod: the connection's force is the weight, and a gap closes by beta in a step."""
    scene = Scene(gravity=(0, 0, -G))
    rod = scene.add_body("rod", mass=2.0, ipos=(0, 0, -0.5), inertia=(1 / 6, 1 / 6, 1e-3))
    scene.add_joint(rod, "free")
    scene.add_equality("connect", rod, "world", anchor=(0, 0, 0))
    sim = sc.Sim(scene, dt=1e-3, integrator=integrator, law="rigid", beta=0.25, **SETTINGS)
    sim.qpos[2] = -0.01
    sim.step(3)
    assert sim.qpos[2] == pytest.approx(-0.01 * 0.75**3, rel=1e-6)
    sim.step(300)
    assert abs(sim.qpos[2]) < 1e-9 and np.abs(sim.qvel).max() < 1e-9
    assert sim.constraint_force[2] == pytest.approx(2 * G, rel=1e-9)


@pytest.mark.parametrize("integrator", ["midpoint", "rk4"])
def test_a_linkage_that_strikes_the_floor(integrator):
    """Its tips land on a floor: rows of both kinds, the loops stay closed, energy only falls."""
    scene = linkage()
    scene.add_geom("world", "plane", pos=(0, 0, -0.5), condim=1)
    for i in range(2):
        scene.add_geom(f"coupler{i}", "sphere", 0.05, pos=(0.5, 0, 0), mass=1e-6, condim=1)
    settings = SETTINGS | {"sweeps": 3000}
    sim = sc.Sim(scene, dt=1e-3, integrator=integrator, law="rigid", **settings)
    sim.qvel[:] = speeds()
    energy = sum(sim.energy)
    for _ in range(15):
        sim.step(100)
        assert sum(sim.energy) <= energy + 1e-2
        angles = sim.qpos[[0, 2, 4]]
        assert np.ptp(angles) < 1e-4
        lowest = math.cos(float(angles[0])) - 0.05
        assert lowest > -0.5 - 1e-3
