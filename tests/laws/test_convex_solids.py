"""Cylinders and ellipsoids on a box: they stand, roll and rock as the closed forms say."""

import numpy as np
import pytest

import stepcore as sc

FLOOR = '<geom type="box" size="9 9 1" pos="0 0 -1" friction="1"/>'


def _sim(body, gravity="0 0 -9.81", **settings):
    text = f"""<mujoco><option gravity="{gravity}" timestep=".001" cone="elliptic"/>
      <worldbody>{FLOOR}
      {body}</worldbody></mujoco>"""
    return sc.Sim(sc.loads(text).compile(), solver="newton", **settings)


def test_a_cylinder_stands():
    sim = _sim('<body pos="0 0 .2"><freejoint/><geom type="cylinder" size=".1 .2"/></body>')
    sim.step(1000)
    assert len(sim.contacts) == 4
    assert np.abs(sim.qvel).max() < 1e-6
    assert np.abs(sim.qpos[:2]).max() < 1e-6
    assert np.abs(sim.qpos[4:]).max() < 1e-6


@pytest.mark.parametrize("degrees", [0, 22.5, 37, 45, 90])
def test_a_cylinder_on_four_contacts_tips_as_a_disc_does(degrees):
    """A push at the height h of four radii: it stands at 0.9 of m g r/h and falls at 1.1."""
    body = '<body pos="0 0 .1"><freejoint/><geom type="cylinder" size=".1 .1"/></body>'
    turn = np.radians(degrees)
    tilts = []
    for share in (0.9, 1.1):
        sim = _sim(body)
        sim.step(100)
        push = share * sim.model.body_mass[1] * 9.81 / 4
        way = push * np.array([np.cos(turn), np.sin(turn)])
        # At the centre, and the torque of the rest of its height.
        sim.xfrc_applied[1] = [*way, 0, -0.3 * way[1], 0.3 * way[0], 0]
        sim.step(1500)
        tilts.append(np.hypot(*sim.qpos[4:6]))
    assert tilts[0] < 0.01 and tilts[1] > 0.1


def test_a_cylinder_rolls_down_a_slope():
    """a = (2/3) g sin(slope), on a slope made by tilting gravity."""
    slope = np.radians(10)
    gravity = f"{9.81 * np.sin(slope)} 0 {-9.81 * np.cos(slope)}"
    body = (
        '<body pos="0 0 .1" euler="90 0 0"><freejoint/><geom type="cylinder" size=".1 .2"/></body>'
    )
    sim = _sim(body, gravity)
    sim.step(200)
    before = sim.qvel[0]
    sim.step(500)
    assert np.isclose((sim.qvel[0] - before) / 0.5, 2 / 3 * 9.81 * np.sin(slope), rtol=2e-3)
    assert np.abs(sim.qvel[1]) < 1e-9


def test_an_ellipsoid_rocks():
    """ω² = g (a²/c − c)/((a² + c²)/5 + c²): it rolls on the curvature a²/c of its lowest place."""
    a, b, c = 0.2, 0.15, 0.1
    lean = np.radians(0.5)
    quat = f"{np.cos(lean / 2)} 0 {np.sin(lean / 2)} 0"
    height = np.hypot(a * np.sin(lean), c * np.cos(lean))
    body = f"""<body pos="0 0 {height}" quat="{quat}"><freejoint/>
      <geom type="ellipsoid" size="{a} {b} {c}" condim="3"/></body>"""
    sim = _sim(body)
    turns = []
    for _ in range(3000):
        sim.step()
        turns.append(sim.qpos[5])
    turns = np.array(turns)
    falls = np.flatnonzero((turns[:-1] > 0) & (turns[1:] <= 0))
    periods = np.diff(falls + turns[falls] / (turns[falls] - turns[falls + 1])) * 1e-3
    omega = np.sqrt(9.81 * (a * a / c - c) / ((a * a + c * c) / 5 + c * c))
    assert len(periods) > 2
    assert np.isclose(periods.mean(), 2 * np.pi / omega, rtol=0.01)
