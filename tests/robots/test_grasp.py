"""SO-101 and its cube: the cube at rest on the floor, and picked up and held."""

from __future__ import annotations

import functools

import menagerie
import numpy as np
import pytest

import stepcore as sc

pytestmark = menagerie.needed

HALF = 0.02  # of the cube's height as it lies [m]
SHOULDER_LIFT, GRIPPER = 1, 5
STEPS = (0.001, 0.002, 0.005, 0.01)


@functools.cache
def model() -> sc.Model:
    return sc.load(menagerie.SO101_CUBE).compile()


def at_pickup(**settings) -> sc.Sim:
    sim = sc.Sim(model(), **settings)
    sim.reset("pickup")
    return sim


def cube(sim: sc.Sim) -> np.ndarray:
    return np.array(sim.body("box").xpos)


def resting_depth(dt: float) -> float:
    """How deep four corners of the cube's weight sink [m].

    In the spring of a row u̇ = −k r − R f, so r = R f/k with R = (1 − d)/d A, k = d/(d₁ T)²
    (damping ratio 1, d₁ the largest impedance). A corner carries f = m g/4; A is 1/m of the cube.
    """
    time = max(0.015, 2 * dt)  # the mean of 10 and 20 ms; refsafe
    low, high, width, depth = 0.9, 0.95, 0.001, 1e-4
    for _ in range(60):
        x = min(depth / width, 1.0)
        d = low + (high - low) * (2 * x * x if x < 0.5 else 1 - 2 * (1 - x) ** 2)
        stiffness = d / (high * time) ** 2
        depth = (1 - d) / d * 9.81 / 4 / stiffness
    return depth


def test_masses_and_contacts():
    """0.644 kg of robot, 0.096 kg of cube, which lies on four corners."""
    masses = dict(zip(model().body_names, model().body_mass, strict=True))
    weight = masses.pop("box")
    assert sum(masses.values()) == pytest.approx(0.644, abs=1e-5)
    assert weight == pytest.approx(0.096, rel=1e-12)
    sim = at_pickup()
    sim.forward()
    names = [{model().geom_names[c["geom1"]], model().geom_names[c["geom2"]]} for c in sim.contacts]
    assert names == [{"floor", "box"}] * 4


@pytest.mark.parametrize("stiction", [False, True])
@pytest.mark.parametrize("dt", STEPS)
def test_the_cube_rests(dt, stiction):
    """It sinks as its contacts' springs say, 61.2 µm at 5 ms, and stays within 2 nm for 10 s."""
    sim = at_pickup(dt=dt, stiction=stiction)
    sim.step(round(2 / dt))
    start = cube(sim)
    assert HALF - start[2] == pytest.approx(resting_depth(dt), rel=1e-6)
    if dt <= 0.005:
        assert HALF - start[2] == pytest.approx(61.2e-6, abs=0.05e-6)
    for _ in range(100):
        sim.step(round(0.1 / dt))
        assert np.abs(cube(sim) - start).max() < 2e-9


def move(sim: sc.Sim, target: np.ndarray, seconds: float, wait: float) -> None:
    """Leads the servos to `target` along a smooth step, then waits."""
    dt = sim.settings.dt
    start, count = np.array(sim.ctrl), round(seconds / dt)
    for k in range(count):
        s = (k + 1) / count
        sim.ctrl[:] = start + (target - start) * s * s * (3 - 2 * s)
        sim.step()
    sim.step(round(wait / dt))


def in_the_hand(sim: sc.Sim) -> np.ndarray:
    """The cube's place in the frame of the gripper [m]."""
    hand = sim.body("gripper")
    return np.asarray(hand.xmat).T @ (cube(sim) - np.asarray(hand.xpos))


def picked_up(dt: float, **settings) -> sc.Sim:
    """Closes the jaws on the cube and lifts it from the shoulder."""
    sim = at_pickup(dt=dt, **settings)
    target = np.array(sim.ctrl)
    target[GRIPPER] = 0.2
    move(sim, target, 1.0, 0.5)
    low = cube(sim)[2]
    target[SHOULDER_LIFT] -= 0.37
    move(sim, target, 1.5, 1.0)
    assert 0.05 < cube(sim)[2] - low < 0.06
    return sim


@pytest.mark.parametrize("dt", STEPS)
def test_a_pick(dt):
    """Closed, lifted by 5 cm and held for 10 s the cube slips by less than 1 µm.

    That is friction that holds, `stiction`; MuJoCo's law lets the cube creep by a millimetre.
    """
    sim = picked_up(dt, stiction=True)
    start = in_the_hand(sim)
    for _ in range(100):
        sim.step(round(0.1 / dt))
        assert np.linalg.norm(in_the_hand(sim) - start) < 1e-6
    # The jaws push with all that the servo has.
    assert sim.actuator_force[GRIPPER] == pytest.approx(-2.94)


def test_without_stiction_it_creeps():
    sim = picked_up(0.005)
    start = in_the_hand(sim)
    sim.step(2000)
    assert np.linalg.norm(in_the_hand(sim) - start) > 1e-4
