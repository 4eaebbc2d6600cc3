"""The page of numpy that the lesson is read from, against the engine."""

import numpy as np
import pytest

import stepcore as sc
from stepcore.lesson import scenes
from stepcore.lesson.loop import Loop
from stepcore.lesson.run import maker

LAWS = ("solref", "lesson", "relaxed", "rigid", "penalty")
INTEGRATORS = ("explicit", "semi-implicit", "midpoint", "rk4")


def apart(scene, lift, steps=400):
    """The largest distance of the positions of both, and how far they moved [m]."""
    engine, loop = maker("rust")(scene), Loop(scene)
    start = np.array(engine.qpos) + lift * (1 + np.arange(len(engine.qpos)))
    engine.qpos[:] = loop.qpos[:] = start
    far, gone = 0.0, 0.0
    for _ in range(steps):
        engine.step(1)
        loop.step(1)
        far = max(far, float(np.abs(engine.qpos - loop.qpos).max()))
        gone = max(gone, float(np.abs(engine.qpos - start).max()))
    return far, gone


@pytest.mark.parametrize("law", LAWS)
def test_a_stack_under_every_law(law):
    scene = scenes.stack(4, law, (1.0, 3.0, 2.0), penalty_stiffness=1e5)
    far, gone = apart(scene, -3e-4, steps=100)
    assert far < 1e-12 and gone > 1e-5


@pytest.mark.parametrize("law", ["lesson", "relaxed", "rigid"])
def test_a_stack_that_just_touches(law):
    """Whether the guess overlaps is rounding there: both have the rows of what is near."""
    far, _ = apart(scenes.stack(4, law, (1.0, 3.0, 2.0)), 0.0, steps=300)
    assert far < 1e-12


@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_a_drop_that_rebounds(restitution):
    far, gone = apart(scenes.drop("rigid", restitution=restitution), 0.0)
    assert far < 1e-12 and gone > 0.29


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_damped_spring_under_every_integrator(integrator):
    far, gone = apart(scenes.spring(damping=0.3, integrator=integrator), 0.1)
    assert far < 1e-13 and gone > 1.0


def test_a_scene_that_is_no_row_of_slides_is_refused():
    with pytest.raises(ValueError, match="one slide each"):
        Loop(scenes.grasp())


def test_an_integrator_that_it_lacks_is_refused():
    with pytest.raises(ValueError, match="implicitfast"):
        Loop(scenes.spring(integrator="implicitfast")).step()


@pytest.mark.parametrize("other", [{"solver": "newton"}, {"warm_start": True}, {"tolerance": 1e-9}])
def test_a_solver_that_it_lacks_is_refused(other):
    with pytest.raises(ValueError, match=f"{next(iter(other))} = .* the numpy loop has"):
        Loop(scenes.stack(4, "solref", **other))


def test_the_first_sweep_by_hand():
    """Impulses g dt/(1 + s) and (g dt - g dt s/(1 + s))/(2 + s), s = 0.5, as in `Sim.rows`."""
    loop, sim = Loop(scenes.stack()), sc.Sim(scenes.stack())
    v, _ = loop.place()
    loop.impulse = np.zeros(2)
    loop.sweep(v, *loop.detect(v))
    assert loop.impulse == pytest.approx([0.01962 / 1.5, 0.01308 / 2.5], rel=1e-12)
    assert v == pytest.approx([-0.011772, -0.014388], rel=1e-12)
    sim.reset("start")
    sim.forward()
    assert sim.rows["impulse"] == pytest.approx(loop.impulse, rel=1e-12)


@pytest.mark.parametrize(
    ("sweeps", "softness", "depth"), [(1, 0.5, 392.4), (20, 0.5, 0.152), (1, 0.0, 196.2)]
)
def test_the_depth_after_two_seconds(sweeps, softness, depth):
    """The reference table's depths of the lower contact [µm]; the formula gives one sweep's."""
    loop = Loop(scenes.stack(sweeps, softness=softness))
    loop.step(1000)
    assert -1e6 * loop.qpos[0] == pytest.approx(depth, rel=3e-3)
