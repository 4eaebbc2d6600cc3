"""The ledger on energy that grows from nothing, a little at a time, while height takes it."""

import numpy as np
import pytest

import stepcore as sc
from stepcore import SimulationError, lesson
from stepcore.scene.scene import Scene

SETTINGS = {"solver": "pgs", "sweeps": 50, "tolerance": 1e-12, "ledger": True}


def pendulum():
    scene = Scene(gravity=(0, 0, -9.81))
    bob = scene.add_body("bob", mass=1.0, ipos=(0, 0, -1.0), inertia=(1e-3, 1e-3, 1e-3))
    scene.add_joint(bob, "hinge", axis=(0, 1, 0))
    return scene


def test_a_pendulum_that_explicit_drives_is_found():
    """Explicit Euler adds ω²dt² of its energy a step: e-fold in 10,000 steps at ω²dt² = 1e-4."""
    sim = sc.Sim(pendulum(), integrator="explicit", dt=3.2e-3, **SETTINGS)
    sim.qpos[0] = 0.2
    with pytest.raises(SimulationError):
        sim.step(60_000)
    # 0.2 rad are 0.2 J: found before it has a hundred times as much.
    assert np.abs(sim.qpos[0]) < 2.5


@pytest.mark.parametrize("integrator", ["semi-implicit", "midpoint", "rk4"])
def test_a_pendulum_that_keeps_its_energy_is_not(integrator):
    sim = sc.Sim(pendulum(), integrator=integrator, dt=3.2e-3, **SETTINGS)
    sim.qpos[0] = 1.5
    sim.step(60_000)


@pytest.mark.parametrize("restitution", [0.5, 1.0])
@pytest.mark.parametrize("integrator", ["semi-implicit", "midpoint", "rk4"])
def test_bouncing_balls_raise_no_alarm(integrator, restitution):
    """Three of them, 200 s."""
    sim = sc.Sim(
        lesson.tower([1.0, 0.3, 2.0]),
        law="rigid",
        restitution=restitution,
        dt=2e-3,
        integrator=integrator,
        **SETTINGS,
    )
    sim.qpos[:] = 0.2, 0.5, 0.9
    sim.step(100_000)
