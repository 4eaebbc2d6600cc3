"""Cases C1, C3, C4, C7 and a thin wall: contact without friction, against closed forms."""

import math

import numpy as np
import pytest
from covering import every_pair
from engines import ENGINES, RUST_ONLY, make

from stepcore import lesson
from stepcore.scene.scene import Scene


def ball_over_floor(radius=0.1, gravity=9.81):
    return lesson.tower([1.0], radius=radius, gravity=gravity)


@pytest.mark.parametrize(("h", "e", "rest"), [(1, 0.5, 1.35457092), (1, 0.8, 4.06371277)])
@pytest.mark.parametrize("engine", ENGINES)
def test_c1_zeno_bounce(engine, h, e, rest):
    """apex_n = h·e^(2n); at rest after t1·(1 + e)/(1 - e); no sinking, no energy gained."""
    dt = 1e-4 if engine == "rust" else 1e-3
    g = 9.81
    sim = make(engine, ball_over_floor(), restitution=e, dt=dt)
    sim.qpos[0] = h
    steps = round((rest + 0.2) / dt)
    y, v = np.zeros(steps), np.zeros(steps)
    for n in range(steps):
        sim.step()
        y[n], v[n] = sim.qpos[0], sim.qvel[0]
    impact = math.sqrt(2 * g * h)
    apexes = [y[n] for n in range(1, steps) if v[n - 1] > 0 >= v[n]][:5]
    # A bounce comes up to one step early: v·dt too high, and v·(g·dt)/g of speed.
    allowed = [3 * (n + 1) * impact * e**n * dt for n in range(1, 6)]
    for n, apex in enumerate(apexes, 1):
        assert apex == pytest.approx(h * e ** (2 * n), abs=allowed[n - 1])
    assert len(apexes) == 5
    assert y.min() > -1e-12
    assert (0.5 * v**2 + g * y).max() <= g * h * (1 + 1e-12)
    still = dt * (1 + np.flatnonzero(np.abs(v) > 3 * g * dt)[-1])
    assert still == pytest.approx(rest, abs=60 * dt)
    assert abs(v[-1]) <= g * dt


@every_pair(engine=ENGINES, e=[0.0, 0.3, 0.95])
def test_c1_rebound_fraction(engine, e):
    """One bounce returns e² of the height, within 5 %; e = 0 within 2 %."""
    sim = make(engine, ball_over_floor(), restitution=e, dt=1e-3)
    sim.qpos[0], highest, touched = 1.0, 0.0, False
    for _ in range(880):
        sim.step()
        touched |= sim.qvel[0] >= 0
        highest = max(highest, float(sim.qpos[0])) if touched else 0.0
    assert highest == pytest.approx(e * e, abs=0.05 if e else 0.02)


@pytest.mark.parametrize("engine", ENGINES)
def test_c3_bounce_recursion(engine):
    """Sphere r = 2 from y = 10, e = 0.9, dt = 1/60: the rule of law `rigid`, on the guess.

    If the guess y - r + dt·(v - g·dt) is below the floor, the velocity after the step is at
    least -e·v with v the velocity before it, and pushes overlap out at beta/dt.
    """
    r, e, dt, g, beta = 2.0, 0.9, 1 / 60, 9.81, 0.2
    sim = make(engine, ball_over_floor(r), restitution=e, dt=dt, beta=beta)
    sim.qpos[0] = 8.0
    y, v = 10.0, 0.0
    for _ in range(1000):
        sim.step()
        guess = v - g * dt
        if y - r + dt * guess < 0:
            guess = max(guess, -e * v, -beta * min(y - r, 0.0) / dt)
        v = guess
        y += dt * v
        assert [sim.qpos[0] + r, sim.qvel[0]] == pytest.approx([y, v], abs=1e-12)


def row_of_balls(n, gap, radius=0.1):
    """n equal balls on slides along x, `gap` between neighbours [m]; no gravity."""
    scene = Scene(gravity=(0, 0, 0))
    for i in range(n):
        ball = scene.add_body(f"ball{i}", pos=(i * (2 * radius + gap), 0, 0))
        scene.add_joint(ball, "slide", axis=(1, 0, 0))
        scene.add_geom(ball, "sphere", radius, mass=1.0, condim=1)
    return scene


@pytest.mark.parametrize("engine", ENGINES)
def test_c3_elastic_pair(engine):
    """Equal masses exchange their velocities, falling meanwhile: (5, -10) becomes (-10, 5)."""
    scene = Scene(gravity=(0, 0, -9.81))
    for i in range(2):
        ball = scene.add_body(f"ball{i}", pos=(i * 0.5, 0, 0))
        for axis in np.eye(3)[[0, 2]]:
            scene.add_joint(ball, "slide", axis=axis)
        scene.add_geom(ball, "sphere", 0.1, mass=1.0, condim=1)
    sim = make(engine, scene, restitution=1.0, dt=1e-3)
    sim.qvel[:] = [5.0, 0.0, -10.0, 0.0]
    sim.step(100)
    fall = -9.81 * 0.1
    assert np.array(sim.qvel) == pytest.approx([-10.0, fall, 5.0, fall], abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_c4_rest_depth_twin(engine):
    """Under `lesson` depth = s·m·g·dt²/beta, also for the mass of a hinge's arm at its stop."""
    s, m, dt, beta, g = 0.3, 4.0, 0.003, 0.4, 9.81
    scene = ball_over_floor()
    scene.geom("shape0").mass = m
    sim = make(engine, scene, law="lesson", softness=s, dt=dt, beta=beta)
    sim.step(2000)
    assert -sim.qpos[0] == pytest.approx(s * m * g * dt**2 / beta, rel=1e-9)

    scene = Scene()
    arm = scene.add_body("arm", mass=m, ipos=(0.5, 0, 0), inertia=(0.1, 0.1, 0.1))
    scene.add_joint(arm, "hinge", axis=(0, 1, 0), range=(-1, 0))
    sim = make(engine, scene, law="lesson", softness=s, dt=dt, beta=beta)
    sim.step(3000)
    q = float(sim.qpos[0])
    assert q == pytest.approx(s * m * g * 0.5 * math.cos(q) * dt**2 / beta, rel=1e-9)


@every_pair(engine=["rust"], ref=[-100.0, -10.0, 0.1, 0.01], impedance=[0.3, 0.9, 0.99])
def test_c4_rest_depth_of_solref(engine, ref, impedance):
    """MuJoCo's law: depth = g·(1 - d)·(tc·dr)², or g·(1 - d)/stiffness; to 1e-10 m."""
    scene = Scene()
    scene.add_geom("world", "plane", condim=1)
    ball = scene.add_body("ball", pos=(0, 0, 1))
    scene.add_joint(ball, "slide", axis=(0, 0, 1))
    geom = scene.add_geom(ball, "sphere", 1.0, mass=1.0, condim=1)
    # The default geom would be mixed in: the ball's parameters decide.
    geom.priority = 1
    geom.solref = (ref, 1.0) if ref > 0 else (ref, -2 * math.sqrt(-ref))
    geom.solimp = (impedance, impedance, 0.001, 0.5, 2.0)
    sim = make(engine, scene, law="solref", solver="newton", integrator="euler")
    sim.step(25000)
    depth = 9.81 * (1 - impedance) * (ref**2 if ref > 0 else -1 / ref)
    assert -sim.qpos[0] == pytest.approx(depth, abs=1e-10)


@every_pair(engine=ENGINES, n=[2, 3, 5])
def test_c7_cradle_with_gaps(engine, n):
    """Gaps and e = 1: the impacts come one by one, only the last ball leaves, with all of v."""
    sim = make(engine, row_of_balls(n, gap=0.01), restitution=1.0, dt=1e-3)
    sim.qvel[0] = 1.0
    sim.step(100)
    assert np.array(sim.qvel) == pytest.approx([0.0] * (n - 1) + [1.0], abs=1e-12)


@every_pair(engine=ENGINES, n=[2, 3, 5])
def test_c7_cradle_touching(engine, n):
    """All contacts in one system: Newton's law at each gives (2 - n)/n, then 2/n for the others.

    The balls overlap by 1 nm, within the slop, so that every pair has its row at once.
    """
    sim = make(engine, row_of_balls(n, gap=-1e-9), restitution=1.0, slop=1e-6, sweeps=1000)
    sim.qvel[0] = 1.0
    sim.step()
    v = np.array(sim.qvel)
    assert v == pytest.approx([(2 - n) / n] + [2 / n] * (n - 1), abs=1e-12)
    assert v.sum() == pytest.approx(1.0, abs=1e-12)
    assert v @ v == pytest.approx(1.0, abs=1e-12)


@every_pair(engine=ENGINES, speed=[100.0, 1000.0])
def test_thin_wall_stops_a_fast_ball(engine, speed):
    """A ball at 100 m/s (0.2 m a step) never passes a wall of 1 mm: rows on the guess."""
    scene = Scene(gravity=(0, 0, 0))
    scene.add_geom("world", "box", (0.0005, 1, 1), condim=1)
    ball = scene.add_body("ball", pos=(-1.05, 0, 0))
    scene.add_joint(ball, "free")
    scene.add_geom(ball, "sphere", 0.01, mass=1.0, condim=1)
    sim = make(engine, scene, dt=0.002)
    sim.qvel[0] = speed
    for _ in range(50):
        sim.step()
        assert sim.qpos[0] < -0.0105 + 1e-12
    assert sim.qpos[0] == pytest.approx(-0.0105, abs=1e-12)
    assert abs(sim.qvel[0]) < 1e-12


@pytest.mark.parametrize("engine", RUST_ONLY)
def test_c1_long_bounce(engine):
    """h = 10 m, e = 0.9: at rest after 27.129019 s, 500 bounces on."""
    dt = 1e-4
    sim = make(engine, ball_over_floor(), restitution=0.9, dt=dt)
    sim.qpos[0] = 10.0
    sim.step(round(26.0 / dt))
    assert abs(sim.qvel[0]) > 3 * 9.81 * dt
    sim.step(round(1.5 / dt))
    assert abs(sim.qvel[0]) <= 9.81 * dt
