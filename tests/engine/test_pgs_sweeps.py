"""Plain PGS of the engine equals the numpy reference sweep by sweep, to 1e-12.

Every kind of row, both cones, every law on the guess, warm and cold; then the whole step
under every integrator that both have, and fifty steps.
"""

import numpy as np
import pytest
from covering import every_pair
from engines import make

from stepcore import lesson
from stepcore.scene.scene import Scene

CONES = ["elliptic", "pyramidal"]
LAWS = ["lesson", "relaxed", "rigid"]


def stack():
    """Four balls, heavy on light, moving towards each other."""
    scene = lesson.tower([1.0, 0.3, 5.0, 0.1])
    return scene, [-1e-3, -3e-3, -4e-3, -4.5e-3], [0.1, -0.4, 0.2, -0.3], None


def grasp():
    """The lesson's grasp, knocked."""
    scene = lesson.grasp()
    qpos = list(scene.key("start").qpos)
    qpos[:3] = [0.004, 1e-4, 2e-4]
    qvel = [0.2, 0.1, -0.05, 0.03, 0.02, -0.3, 0.5, -0.7, 0.4]
    return scene, qpos, qvel, [3.0, 2.5]


def sliding():
    """Balls that roll and blocks that do not, all sliding on a floor and against each other."""
    scene = Scene()
    scene.add_geom("world", "plane", friction=(0.4,))
    qpos, qvel = [], []
    for i in range(3):
        ball = scene.add_body(f"ball{i}", pos=(0.21 * i, 0.01 * i, 0.099))
        scene.add_joint(ball, "free")
        scene.add_geom(ball, "sphere", 0.1, mass=1.0 + i, friction=(0.2 + 0.3 * i,))
        qpos += [0.21 * i - 0.02 * i, 0.01 * i, 0.099, 1.0, 0.0, 0.0, 0.0]
        qvel += [2.0 - i, 1.0, -0.2, 0.3, 4.0 * i, -1.0]
    block = scene.add_body("block", pos=(-1, 0, 0))
    for axis in np.eye(3):
        scene.add_joint(block, "slide", axis=axis)
    scene.add_geom(block, "sphere", 0.1, mass=0.5, friction=(0.3,))
    return scene, [*qpos, 0.0, 0.0, 0.0999], [*qvel, 1.0, -2.0, -0.1], None


def box_on_balls():
    """A box on three balls, each on a floor: sphere-box contacts from all sides of a face."""
    scene = Scene()
    scene.add_geom("world", "plane")
    qpos, qvel = [], []
    for i, (x, y) in enumerate([(0.2, 0.0), (-0.15, 0.12), (-0.1, -0.2)]):
        ball = scene.add_body(f"ball{i}")
        scene.add_joint(ball, "free")
        scene.add_geom(ball, "sphere", 0.1, mass=0.7, friction=(0.6,), contype=3, conaffinity=3)
        qpos += [x, y, 0.0995, 1.0, 0.0, 0.0, 0.0]
        qvel += [0.1, -0.2, -0.3, 0.5, 0.5, -0.5]
    box = scene.add_body("box")
    scene.add_joint(box, "free")
    # It meets the balls but not the floor: the reference has no contact of a box and a plane.
    scene.add_geom(box, "box", (0.3, 0.3, 0.1), mass=4.0, friction=(0.6,), contype=2, conaffinity=2)
    return scene, [*qpos, 0.0, 0.0, 0.298, 1, 0, 0, 0], [*qvel, 0.4, 0.1, -0.5, 0.1, 0.2, 0.3], None


def limits():
    """A hinge, a slide and a ball joint beyond their ranges, with dry friction and springs."""
    scene = Scene()
    one = scene.add_body("one", mass=1.0, ipos=(0.3, 0, 0), inertia=(0.02, 0.03, 0.04))
    scene.add_joint(one, "hinge", axis=(0, 1, 0.2), range=(-0.5, 0.3), frictionloss=0.4)
    two = scene.add_body("two", one, pos=(0.5, 0, 0), mass=0.5, inertia=(0.01, 0.02, 0.01))
    scene.add_joint(two, "slide", axis=(1, 0.5, 0), range=(-0.1, 0.1), frictionloss=2.0)
    three = scene.add_body(
        "three", two, pos=(0.2, 0, 0.1), mass=0.8, ipos=(0, 0.1, 0.2), inertia=(0.03, 0.02, 0.01)
    )
    scene.add_joint(three, "ball", range=(0, 0.6), damping=0.1, stiffness=2.0, armature=0.01)
    angle = 0.4
    quat = [np.cos(angle), *(np.sin(angle) * np.array([0.6, 0.0, 0.8]))]
    return scene, [0.31, -0.11, *quat], [0.7, -0.4, 1.0, -0.5, 2.0], None


def connect():
    """A four-bar loop: two pendulums joined by a rod, and a ball leaning on it."""
    scene = Scene()
    parts = {}
    for name, x in (("left", 0.0), ("right", 0.6)):
        parts[name] = scene.add_body(
            name, pos=(x, 0, 0), mass=0.4, ipos=(0, 0, -0.2), inertia=(0.01, 0.01, 0.002)
        )
        scene.add_joint(parts[name], "hinge", axis=(0, 1, 0))
    rod = scene.add_body(
        "rod", "left", pos=(0, 0, -0.4), mass=0.6, ipos=(0.3, 0, 0), inertia=(0.002, 0.02, 0.02)
    )
    scene.add_joint(rod, "ball")
    scene.add_geom(rod, "sphere", 0.05, pos=(0.3, 0, 0), friction=(0.5,))
    scene.add_equality("connect", rod, "right", anchor=(0.6, 0, 0))
    ball = scene.add_body("ball")
    scene.add_joint(ball, "free")
    scene.add_geom(ball, "sphere", 0.05, mass=0.3, friction=(0.5,))
    # Depth first: left, rod (which hangs on it), right, ball.
    quat = [np.cos(0.02), 0.0, np.sin(0.02), 0.0]
    qpos = [0.05, *quat, 0.06, 0.287, 0.01, -0.328, 1.0, 0.0, 0.0, 0.0]
    qvel = [0.5, 0.1, 0.2, -0.4, -0.3, 0.1, 0.0, -0.5, 1.0, 2.0, 3.0]
    return scene, qpos, qvel, None


SCENES = [stack, grasp, sliding, box_on_balls, limits, connect]


def named(make_scene):
    return make_scene.__name__


def both(scene, qpos, qvel, ctrl, **settings):
    """The same state in both implementations."""
    sims = [make(engine, scene, **settings) for engine in ("rust", "numpy")]
    for sim in sims:
        sim.qpos[:], sim.qvel[:] = qpos, qvel
        if ctrl is not None:
            sim.ctrl[:] = ctrl
    return sims


def same(one, two, tolerance=1e-12):
    one, two = np.asarray(one, float), np.asarray(two, float)
    assert one.shape == two.shape
    scale = max(1.0, float(np.abs(two).max(initial=0.0)))
    assert np.abs(one - two).max(initial=0.0) <= tolerance * scale


@every_pair(scene=SCENES, law=LAWS, cone=CONES)
def test_sweep_by_sweep(scene, law, cone):
    """Impulses, accelerations and residual after 1, 2, 3, … cold sweeps."""
    for sweeps in (1, 2, 3, 4, 5, 10, 20, 50):
        settings = {"law": law, "cone": cone, "softness": 0.3, "sweeps": sweeps}
        settings |= {"warm_start": False, "tolerance": 0.0}
        rust, numpy = both(*scene(), **settings)
        rust.forward()
        numpy.forward()
        assert len(numpy.rows) > 0
        same(rust.rows["impulse"], numpy.rows["impulse"])
        same(np.array(rust.qacc) * 0.002, numpy.qacc * 0.002)
        assert rust.residual == pytest.approx(numpy.residual, rel=1e-9, abs=1e-12)


@every_pair(scene=SCENES, restitution=[0.0, 0.7])
def test_bouncing(scene, restitution):
    """Law rigid with and without restitution, and with slop."""
    settings = {"law": "rigid", "restitution": restitution, "slop": 1e-4, "sweeps": 7}
    rust, numpy = both(*scene(), **settings)
    rust.forward()
    numpy.forward()
    same(rust.rows["impulse"], numpy.rows["impulse"])


@every_pair(scene=SCENES, integrator=["explicit", "semi-implicit", "midpoint", "rk4"])
def test_one_step(scene, integrator):
    """qpos and qvel after one whole step."""
    settings = {"integrator": integrator, "law": "lesson", "softness": 0.1, "sweeps": 5}
    rust, numpy = both(*scene(), cone="elliptic", **settings)
    rust.step()
    numpy.step()
    same(rust.qvel, numpy.qvel)
    same(rust.qpos, numpy.qpos)


@pytest.mark.parametrize("scene", [stack, grasp, limits], ids=named)
def test_fifty_warm_steps(scene):
    """Warm starts carry the same impulses on: fifty steps, three sweeps each."""
    settings = {"law": "lesson", "softness": 0.2, "sweeps": 3, "warm_start": True, "tolerance": 0.0}
    rust, numpy = both(*scene(), **settings)
    rust.step(50)
    numpy.step(50)
    same(rust.qvel, numpy.qvel, 1e-9)
    same(rust.qpos, numpy.qpos, 1e-10)


def test_tolerance():
    """A tolerance ends both long before the last sweep, below it, at the same velocities."""
    rust, numpy = both(*box_on_balls(), tolerance=1e-6, sweeps=1000, law="lesson", softness=0.1)
    rust.forward()
    numpy.forward()
    assert 1 < numpy.sweeps_done < 1000
    assert 0 < rust.residual <= 1e-6
    same(np.array(rust.qacc) * 0.002, numpy.qacc * 0.002, 1e-5)


@pytest.mark.parametrize("integrator", ["explicit", "semi-implicit", "midpoint", "rk4"])
def test_penalty(integrator):
    """The penalty force of several overlapping contacts, under every integrator both have."""
    scene, qpos, qvel, _ = stack()
    settings = {"law": "penalty", "penalty_stiffness": 1e4, "integrator": integrator}
    rust, numpy = both(scene, qpos, qvel, None, **settings)
    rust.step(3)
    numpy.step(3)
    same(rust.qvel, numpy.qvel)
    same(rust.qpos, numpy.qpos)
