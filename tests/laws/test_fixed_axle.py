"""A row that nothing can move (A = 0) does not take from its block what the others need.

Scene: a wheel with a fixed axle, resting 1 mm deep on the floor and driven by a motor. Its normal
carries a load without end, so its friction holds it, whatever solves the rows.
"""

import numpy as np
import pytest
from covering import every_pair
from engines import ENGINES, make

import stepcore as sc

WHEEL = (
    '<body pos="0 0 {z}"><joint axis="0 1 0" name="axle"/><geom size=".1" mass="1" {geom}/></body>'
)


def wheel(cone="elliptic", tilt=(1.0, 0.0, 0.0, 0.0), gap=-1e-3, geom=""):
    """Its world turned as a whole: then zeros of its rows are rounding."""
    quat = " ".join(str(x) for x in tilt)
    return sc.loads(
        f'<mujoco><option cone="{cone}"/><worldbody><body quat="{quat}">'
        '<geom type="plane" size="1 1 1"/>'
        f"{WHEEL.format(z=0.1 + gap, geom=geom)}</body></worldbody>"
        '<actuator><motor joint="axle" gear="3"/></actuator></mujoco>'
    )


TILTED = np.array([0.3, -0.5, 0.7, 0.4]) / np.sqrt(0.99)


def driven(sim, steps=200):
    sim.ctrl[:] = 1.0
    sim.step(steps)
    return abs(float(sim.qvel[0]))


@every_pair(
    solver=[
        {"solver": "newton"},
        {"solver": "pgs", "sweeps": 50},
        {"solver": "pgs", "sweeps": 50, "acceleration": "momentum"},
        {"solver": "pgs", "sweeps": "auto"},
    ],
    cone=["elliptic", "pyramidal"],
    tilt=[(1.0, 0.0, 0.0, 0.0), TILTED],
)
def test_every_solver_holds_the_wheel(solver, cone, tilt):
    """Free it would turn at 600 rad/s after 0.4 s; the rows are solved, and say so."""
    for precision, limit in (("f64", 1e-6), ("f32", 0.05)):
        sim = sc.Sim(wheel(cone, tilt), precision=precision, **solver)
        assert driven(sim) < limit
        assert sim.residual < limit


@every_pair(engine=ENGINES, cone=["elliptic", "pyramidal"], law=["lesson", "relaxed", "rigid"])
def test_the_laws_on_velocities_hold_it_too(engine, law, cone):
    sim = make(engine, wheel(cone, TILTED), law=law, cone=cone)
    assert driven(sim, 20) < 1e-8
    # A wheel that does not touch is free: 3 N·m on 0.004 kg·m².
    sim = make(engine, wheel(cone, TILTED, gap=1e-3), law=law, cone=cone)
    assert driven(sim, 20) == pytest.approx(750 * 0.002 * 20)


def test_a_batch_is_its_worlds():
    """Some worlds touch and some do not: each is bit for bit what it is alone."""
    scenes = wheel(tilt=TILTED)
    batch = sc.Batch(scenes, 6)
    batch.ctrl[:] = np.linspace(-1, 1, 6)[:, None]
    batch.step(50)
    for world, ctrl in enumerate(np.linspace(-1, 1, 6)):
        sim = sc.Sim(scenes)
        sim.ctrl[:] = ctrl
        sim.step(50)
        assert sim.qvel[0] == batch.qvel[world, 0]


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_its_derivative(cone):
    """The step's derivative by the control against a finite difference: friction takes it all."""
    sim = sc.Sim(wheel(cone, TILTED))
    sim.qvel[:], sim.ctrl[:] = 0.5, 0.3
    linear = sim.linearize()
    after = []
    for change in (-0.1, 0.1):
        other = sc.Sim(wheel(cone, TILTED))
        other.qvel[:], other.ctrl[:] = 0.5, 0.3 + change
        other.step(1)
        after.append(float(other.qvel[0]))
    assert linear.B[1, 0] == pytest.approx((after[1] - after[0]) / 0.2, abs=1e-6)
    assert abs(linear.B[1, 0]) < 1e-6  # 1.5 where it is free


@pytest.mark.parametrize("solver", ["newton", "pgs"])
def test_a_lever_of_rounding_moves_nothing(solver):
    """Without friction the motor turns the wheel, and the load on its axle does not."""
    sim = sc.Sim(wheel(tilt=TILTED, geom='condim="1" priority="1"'), solver=solver)
    assert driven(sim, 10) == pytest.approx(750 * 0.002 * 10)


def test_the_ledger_still_watches():
    """A load without end gives nothing back: beside a wheel an explosion is seen as early."""
    spring = (
        '<body pos="3 0 0"><joint type="slide" axis="1 0 0" stiffness="1e5"/>'
        '<geom size=".1" mass="1" contype="0" conaffinity="0"/></body>'
    )
    ended = []
    for others in (spring, spring.replace("</body>", "</body>" + WHEEL.format(geom="", z=0.099))):
        scene = sc.loads(
            f'<mujoco><worldbody><geom type="plane" size="1 1 1"/>{others}</worldbody></mujoco>'
        )
        sim = sc.Sim(scene, ledger=True, integrator="semi-implicit", dt=0.01)
        sim.qpos[0] = 0.01
        with pytest.raises(sc.SimulationError) as failure:
            sim.step(500)
        ended.append(failure.value.step)
    assert ended[0] == ended[1]
