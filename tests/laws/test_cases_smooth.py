"""Cases I1, I2, I3, I10: motion without contact, against closed forms."""

import cmath
import math

import numpy as np
import pytest
from covering import every_pair
from engines import ENGINES, RUST_ONLY, make

from stepcore import lesson
from stepcore.scene.scene import Scene

ORDER = {"explicit": 1, "semi-implicit": 1, "midpoint": 2, "rk4": 4}


def flying_box(gravity=(0, 0, -9.8)):
    scene = Scene(gravity=gravity)
    box = scene.add_body("box")
    scene.add_joint(box, "free")
    scene.add_geom(box, "box", (0.05, 0.2, 0.45), mass=10)
    return scene


@every_pair(engine=ENGINES, integrator=ORDER, dt=[1e-3, 1e-2])
def test_i1_free_flight(engine, integrator, dt):
    """p = p0 + v0 t + g t²/2; v-first is g·dt·t/2 low, explicit as much high, the others exact."""
    time = 10.0 if engine == "rust" else 1.0
    sim = make(engine, flying_box(), dt=dt, integrator=integrator)
    start, v0, g = np.array(sim.qpos[:3]), np.array([-2.0, 2.0, 8.0]), np.array([0, 0, -9.8])
    sim.qvel[:3] = v0
    sim.step(round(time / dt))
    exact = start + v0 * time + g * time**2 / 2
    law = {"semi-implicit": 0.5, "explicit": -0.5}.get(integrator, 0.0) * g * dt * time
    assert np.array(sim.qpos[:3]) == pytest.approx(exact + law, abs=1e-9)


@every_pair(engine=ENGINES, dt=[0.1, 0.05, 0.01])
def test_i2_oscillator_dispersion(engine, dt):
    """v-first oscillates with cos(w' dt) = 1 - (w dt)²/2: the phase over 1e4 cycles, 1e-9."""
    phi = math.acos(1 - (10 * dt) ** 2 / 2)
    sim = make(engine, lesson.spring(dt=dt), "start")
    steps = round(10000 * 2 * math.pi / phi) if engine == "rust" else 1200
    phases = []
    for n in (0, steps):
        sim.step(n)
        x0 = float(sim.qpos[0])
        # x_n = C cos(a_n), and the position after is C cos(a_n + phi).
        v1 = float(sim.qvel[0]) - 100 * dt * x0
        x1 = x0 + dt * v1
        phases.append(cmath.phase(complex(x0, (x0 * math.cos(phi) - x1) / math.sin(phi))))
    advanced = steps * phi
    error = (phases[1] - phases[0] - advanced + math.pi) % (2 * math.pi) - math.pi
    assert abs(error) < 1e-9 * advanced


@pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")
@pytest.mark.parametrize("engine", ENGINES)
def test_i2_stable_below_two(engine):
    """Bounded at w·dt = 1.999 (by 1/cos(phi/2) = 31.6), diverging at 2.001."""
    sim = make(engine, lesson.spring(dt=0.1999), "start")
    largest = 0.0
    for _ in range(1000):
        sim.step()
        largest = max(largest, abs(float(sim.qpos[0])))
    assert largest < 31.7
    sim = make(engine, lesson.spring(dt=0.2001), "start")
    try:
        sim.step(400)
    except Exception as error:  # an engine may say so instead
        assert type(error).__name__ == "SimulationError"
    else:
        assert abs(sim.qpos[0]) > 1e8


def damped(k, c, t):
    """x(t) from x = 1, v = 0 with unit mass: the sum of the two exponentials."""
    root = cmath.sqrt(c * c / 4 - k)
    if abs(root) < 1e-9:
        return (1 + c / 2 * t) * math.exp(-c / 2 * t)
    a, b = -c / 2 + root, -c / 2 - root
    return ((b * cmath.exp(a * t) - a * cmath.exp(b * t)) / (b - a)).real


@every_pair(engine=ENGINES, integrator=ORDER, ratio=[0.1, 1.0, 2.0])
def test_i3_order_on_a_damped_oscillator(engine, integrator, ratio):
    """Under-, critically and overdamped: the error at 0.5 s falls with the integrator's order."""
    errors = []
    for steps in (200, 400):
        scene = lesson.spring(100.0, damping=2 * ratio * 10, dt=0.5 / steps)
        sim = make(engine, scene, "start", integrator=integrator)
        sim.step(steps)
        errors.append(abs(float(sim.qpos[0]) - damped(100.0, 2 * ratio * 10, 0.5)))
    assert math.log2(errors[0] / errors[1]) == pytest.approx(ORDER[integrator], abs=0.12)


def spinning(transverse=0.6, axial=0.2):
    scene = Scene(gravity=(0, 0, 0))
    body = scene.add_body("top", mass=1.0, inertia=(transverse, transverse, axial))
    scene.add_joint(body, "free")
    return scene


def turned(vector):
    """Quaternion of a rotation vector."""
    angle = np.linalg.norm(vector)
    return np.array([math.cos(angle / 2), *(math.sin(angle / 2) / angle * np.asarray(vector))])


def product(p, q):
    """p after q."""
    vector = p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])
    return np.array([p[0] * q[0] - p[1:] @ q[1:], *vector])


def top_at(t, w, transverse=0.6, axial=0.2):
    """Spin in body axes and orientation of a free symmetric top that starts unturned."""
    s = (1 - axial / transverse) * w[2]
    c, n = math.cos(s * t), math.sin(s * t)
    spin = np.array([w[0] * c + w[1] * n, -w[0] * n + w[1] * c, w[2]])
    momentum = np.array([transverse * w[0], transverse * w[1], axial * w[2]])
    # The axis precesses about the momentum; the body turns back about its axis.
    return spin, product(turned(momentum / transverse * t), turned(np.array([0, 0, s * t])))


@every_pair(engine=ENGINES, integrator=["semi-implicit", "midpoint", "rk4"])
def test_i10_symmetric_top(engine, integrator):
    """Spin and orientation of a free axisymmetric body: order of convergence, |q| = 1."""
    w, time, errors = np.array([1.0, 0.5, 3.0]), 0.5, []
    spin, quat = top_at(time, w)
    for steps in (100, 200):
        sim = make(engine, spinning(), dt=time / steps, integrator=integrator)
        sim.qvel[3:] = w
        sim.step(steps)
        got = np.array(sim.qpos[3:7])
        assert np.linalg.norm(got) == pytest.approx(1.0, abs=1e-14)
        apart = min(np.linalg.norm(got - quat), np.linalg.norm(got + quat))
        errors.append((np.linalg.norm(np.array(sim.qvel[3:]) - spin), apart))
    orders = np.log2(np.divide(errors[0], errors[1]))
    assert orders == pytest.approx([ORDER[integrator]] * 2, abs=0.15)
    assert max(errors[1]) < {"semi-implicit": 3e-2, "midpoint": 1e-4, "rk4": 1e-8}[integrator]


@every_pair(engine=ENGINES, integrator=ORDER)
def test_i10_spin_about_an_axis_is_exact(engine, integrator):
    """About its own axis the body turns by w·t, whatever dt."""
    sim = make(engine, spinning(), dt=0.01, integrator=integrator)
    sim.qvel[5] = 7.0
    sim.step(100)
    assert np.array(sim.qpos[3:7]) == pytest.approx(turned(np.array([0, 0, 7.0])), abs=1e-13)


@pytest.mark.parametrize("engine", RUST_ONLY)
def test_i1_slope_of_the_error(engine):
    """The v-first error halves with dt: slope 1.00 to 0.02 over four halvings."""
    errors = []
    for halving in range(5):
        dt = 0.01 / 2**halving
        sim = make(engine, flying_box(), dt=dt)
        sim.qvel[2] = 8.0
        sim.step(round(1.0 / dt))
        errors.append(abs(sim.qpos[2] - (8.0 - 4.9)))
    assert np.diff(np.log2(errors)) == pytest.approx([-1.0] * 4, abs=0.02)
