"""Loops by the dozen: connections under `rk4` and `midpoint` are eliminated, however many."""

import numpy as np
import pytest
from test_connects_in_stages import angle_at, linkage, speeds, swung

import stepcore as sc

# As few sweeps as anybody may ask for: what holds a loop inside a step does not go by them.
FEW = {"sweeps": 10, "tolerance": 0.0}


def net(loops):
    """A zigzag of 2·loops links on two hinges each; every other tip is held where it is.

    All rows touch the first joint: their matrix is full."""
    scene = sc.Scene()
    parent = "world"
    for k in range(2 * loops):
        turn = np.pi / 6 if k == 0 else (np.pi / 3 if k % 2 == 0 else -np.pi / 3)
        body = scene.add_body(
            f"link{k}",
            parent,
            pos=(0.1 if k else 0, 0, 0),
            quat=(np.cos(turn / 2), 0, np.sin(turn / 2), 0),
            mass=0.1,
            ipos=(0.05, 0, 0),
            inertia=(1e-5, 1e-4, 1e-4),
        )
        for axis in ((0, 1, 0), (0, 0, 1)):
            scene.add_joint(body, "hinge", axis=axis)
        if k % 2:
            scene.add_equality("connect", body, "world", anchor=(0.1, 0, 0))
        parent = body
    return scene


@pytest.mark.parametrize("law", ["rigid", "lesson"])
@pytest.mark.parametrize("n", [20, 31, 32, 33, 40, 80])
def test_the_energy_of_a_linkage(n, law):
    """Half a second of rk4 at 2 ms: the energy stays within 1e-9 of itself, at any length."""
    sim = sc.Sim(linkage(n), dt=2e-3, integrator="rk4", solver="pgs", law=law, **FEW)
    sim.qvel[:] = speeds(n)
    start = sim.energy.total
    sim.step(250)
    assert abs(sim.energy.total - start) < 1e-9 * start
    assert sim.qpos[0] == pytest.approx(angle_at(0.5, n)[0], abs=1e-9)


@pytest.mark.parametrize("n", [40, 80])
def test_midpoint_goes_on(n):
    """Second order, as of two windows; three seconds, through its lowest position."""
    errors = [swung("rust", 0.5, dt, n, integrator="midpoint", **FEW) for dt in (5e-3, 2.5e-3)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.35)
    sim = sc.Sim(linkage(n), dt=2e-3, integrator="midpoint", law="rigid", solver="pgs", **FEW)
    sim.qvel[:] = speeds(n)
    start = sim.energy.total
    sim.step(1500)
    assert abs(sim.energy.total - start) < 1e-3 * start


def test_numpy_agrees_beyond_a_hundred_rows():
    """Thirty-four windows, 102 rows: the reference solves the same dense system."""
    ours, theirs = (
        swung(engine, 0.02, 1e-2, 34, integrator="rk4", law="rigid") for engine in ("rust", "numpy")
    )
    assert ours == pytest.approx(theirs, abs=1e-11)


@pytest.mark.parametrize("loops", [10, 40])
def test_rows_that_all_touch_each_other(loops):
    """120 rows of one tree: the points that are held stay, and the energy as well."""
    sim = sc.Sim(net(loops), dt=1e-3, integrator="rk4", law="rigid", solver="pgs", **FEW)
    sim.qvel[:] = 0.01 * np.random.default_rng(0).normal(size=len(sim.qvel))
    tips = lambda: (sim.xpos + 0.1 * sim.xmat[:, :, 0])[2::2]  # noqa: E731
    sim.forward()
    held = tips()
    sim.step()
    start = sim.energy.total
    sim.step(50)
    sim.forward()
    assert abs(sim.energy.total - start) < 1e-6 * sim.energy.kinetic
    assert len(held) == loops and np.abs(tips() - held).max() < 1e-6


def test_lanes_are_the_worlds_alone():
    """Twelve linkages of 120 rows side by side, one of them opened: the same bits as each alone."""
    model = linkage(40).compile()
    settings = {"dt": 2e-3, "integrator": "rk4", "law": "rigid", "solver": "pgs", **FEW}
    batch = sc.Batch(model, 12, **settings)
    qvel = np.outer(np.linspace(0.3, 5.0, 12), speeds(40))
    batch.qvel[:] = qvel
    batch.eq_active[3, 7] = False
    batch.step(60)
    for world in (0, 3, 11):
        sim = sc.Sim(model, **settings)
        sim.qvel[:] = qvel[world]
        sim.eq_active[7] = world != 3
        sim.step(60)
        assert np.array_equal(sim.qpos, batch.qpos[world])
