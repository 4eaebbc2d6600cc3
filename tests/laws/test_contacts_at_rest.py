"""A contact that rests is a row in every step, and carries the weight in every step."""

import numpy as np
import pytest
from covering import every_pair
from engines import ENGINES, make

import stepcore as sc
from stepcore import lesson

CONVERGED = {"solver": "pgs", "sweeps": 3000, "tolerance": 1e-11, "integrator": "semi-implicit"}


def of_floor(sim):
    """Force of the rows on the floor [N]: the last contact rows are ball on ball."""
    return float(np.array(sim.rows["impulse"])[0]) / sim.settings.dt


@every_pair(law=["rigid", "lesson", "relaxed"], dt=[1e-3, 5e-3])
def test_a_tower_rests_on_all_of_its_contacts(law, dt):
    """Ten balls, softness 0: ten rows in each of 500 steps, and the floor bears their weight."""
    sim = sc.Sim(lesson.tower([1.0] * 10), law=law, softness=0.0, dt=dt, **CONVERGED)
    sim.step(2500)
    for _ in range(500):
        sim.step()
        assert len(sim.rows) == 10
        assert of_floor(sim) == pytest.approx(10 * 9.81, rel=1e-6)
        assert np.abs(sim.qvel).max() < 1e-9


@every_pair(engine=ENGINES, law=["rigid", "lesson"])
def test_heavy_on_light_rests(engine, law):
    """10 kg on 1 kg, both engines: the floor bears both in each of 50 steps."""
    scene = lesson.tower([1.0, 10.0])
    sim = make(engine, scene, law=law, **CONVERGED | {"warm_start": True, "sweeps": 500})
    sim.step(120)
    for _ in range(50):
        sim.step()
        assert len(sim.rows) == 2
        assert of_floor(sim) == pytest.approx(11 * 9.81, rel=1e-4)


def test_in_single_precision_far_from_the_origin():
    """Positions in f32, 8 m up, are 9.5e-7 m apart: no row is lost to it."""
    scene = lesson.tower([1.0] * 3)
    scene.geoms[0].pos = (0, 0, 8.0)
    for body in scene.bodies[1:]:
        body.pos = (0, 0, body.pos[2] + 8.0)
    settings = CONVERGED | {"precision": "f32", "tolerance": 1e-6, "sweeps": 300}
    sim = sc.Sim(scene, law="rigid", dt=2e-3, **settings)
    sim.step(2000)
    for _ in range(300):
        sim.step()
        assert len(sim.rows) == 3
        # One unit in the last place of a height is a force of 9.5e-7 m/dt² · 1 kg.
        assert of_floor(sim) == pytest.approx(3 * 9.81, abs=3 * 9.5e-7 / 0.002**2)


def test_a_ball_held_against_a_ceiling_by_another():
    """The guess of the upper ball falls off the ceiling; the lower one holds it there."""
    scene = sc.Scene()
    scene.add_geom("world", "plane", pos=(0, 0, 1.0), quat=(0, 1, 0, 0), condim=1, name="ceiling")
    for i in range(2):
        ball = scene.add_body(f"ball{i}", pos=(0, 0, 0.9 - 0.2 * i))
        joint = scene.add_joint(ball, "slide", axis=(0, 0, 1))
        scene.add_geom(ball, "sphere", 0.1, mass=1.0, condim=1)
    scene.add_actuator(joint, name="push")
    sim = sc.Sim(scene, law="rigid", dt=0.01, **CONVERGED)
    sim.ctrl[0] = 50.0
    sim.step(500)
    for _ in range(100):
        sim.step()
        forces = [abs(c["force"][2]) for c in sim.contacts]
        assert sorted(forces) == pytest.approx([50 - 2 * 9.81, 50 - 9.81], rel=1e-6)


@every_pair(restitution=[0.0, 0.5], law=["rigid", "lesson", "relaxed"])
def test_rows_of_what_is_only_near_change_nothing(law, restitution):
    """Two balls in free flight, 1 µm apart or overlapping by 1 µm while they part: as if alone."""
    scene = sc.Scene()
    for i in range(2):
        ball = scene.add_body(f"ball{i}", pos=(0.2 * i, 0, 0))
        scene.add_joint(ball, "free")
        scene.add_geom(ball, "sphere", 0.1, mass=1.0)
    settings = CONVERGED | {"law": law, "dt": 1e-3, "softness": 0.1, "restitution": restitution}
    for gap, parting in ((1e-6, 0.0), (-1e-6, 0.01), (1e-6, -5e-4)):
        sim = sc.Sim(scene, **settings)
        sim.qpos[7] += gap
        sim.qvel[6] = parting
        sim.forward()
        assert len(sim.rows) > 0
        v = -9.81 * 1e-3
        sim.step()
        assert sim.qvel[6:9].tolist() == [parting, 0.0, v] and sim.qvel[2] == v


def test_a_limit_that_another_joint_presses_stays():
    """Two slides in series, the inner one at its stop: the force on the outer keeps both rows."""
    scene = sc.Scene(gravity=(0, 0, 0))
    inner = scene.add_body("inner", mass=1.0, inertia=(1, 1, 1))
    scene.add_joint(inner, "slide", axis=(1, 0, 0), range=(-1.0, 0.0))
    outer = scene.add_body("outer", inner, mass=1.0, inertia=(1, 1, 1))
    scene.add_joint(outer, "slide", axis=(1, 0, 0), range=(-1.0, 0.0))
    sim = sc.Sim(scene, law="rigid", dt=2e-3, **CONVERGED)
    sim.xfrc_applied[2, 0] = 3.0
    sim.step(500)
    for _ in range(100):
        sim.step()
        impulses = np.array(sim.rows["impulse"]) / 2e-3
        assert len(impulses) == 2 and impulses == pytest.approx([3.0, 3.0], rel=1e-9)
