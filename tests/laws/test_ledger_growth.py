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


@pytest.mark.parametrize("integrator", ["euler", "semi-implicit", "rk4"])
@pytest.mark.parametrize("stiffness", [1e4, 1e5, 1e7, 1e9])
def test_a_spring_far_too_stiff_for_dt_is_found(stiffness, integrator):
    """At ω dt = 16 to 5,000 a sixteenth of dt gains as well: smaller ones are tried."""
    scene = Scene(gravity=(0, 0, 0))
    body = scene.add_body("load", mass=1.0, inertia=(0.4, 0.4, 0.4))
    scene.add_joint(body, "hinge", name="spring", stiffness=stiffness)
    sim = sc.Sim(scene, integrator=integrator, dt=0.05, ledger=True)
    sim.qvel[:] = 1.0
    with pytest.raises(SimulationError, match=r"spring of joint `spring`|not finite"):
        sim.step(20)


def test_a_negative_damper_is_the_scenes_own_however_small_the_steps():
    """It feeds as much at every dt, and is no error."""
    text = """<mujoco><worldbody><body><joint name="rail" type="slide" stiffness="100"/>
      <geom size=".1" mass="1"/></body></worldbody><actuator>
      <general joint="rail" biastype="affine" biasprm="0 0 3"/></actuator></mujoco>"""
    sim = sc.Sim(sc.loads(text), dt=1e-3, integrator="semi-implicit", ledger=True)
    sim.qvel[0] = 1.0
    sim.step(4000)
    assert sim.energy.total > 1e3


@pytest.mark.parametrize("lanes", [False, True])
def test_each_world_of_a_register_has_an_account_of_its_own(lanes):
    """Several that gain by one balance fail by it, as alone, and none opens an account anew."""
    batch = sc.Batch(
        lesson.spring(),
        11,
        threads=1,
        lanes=lanes,
        on_failure="go on",
        dt=0.205,
        integrator="semi-implicit",
        ledger=True,
    )
    batch.qvel[:, 0] = np.linspace(0.1, 1, 11)
    batch.qvel[4, 0] = 0.0
    for _ in range(4):
        batch.step(64)
    assert {world: error.step for world, error in batch.failures.items()} == {
        world: 64 for world in range(11) if world != 4
    }
    assert batch.qvel[4, 0] == 0.0 and np.abs(batch.qvel).max() < 1e13
