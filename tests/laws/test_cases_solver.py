"""Cases C5, C6, S1, S4: the solver's impulses, against exact statics and exact LCPs."""

import itertools
import math

import numpy as np
import pytest
from covering import every_pair
from engines import ENGINES, RUST_ONLY, make

from stepcore import lesson
from stepcore.lesson import measure
from stepcore.lesson.run import maker
from stepcore.scene.scene import Scene


@every_pair(engine=ENGINES, masses=[(1, 1), (1, 2, 3, 4, 5), (100, 10, 1, 0.1), (0.1, 1, 3)])
def test_c5_tower_statics(engine, masses):
    """Converged, contact i carries g·dt·(the mass above it), to 1e-9."""
    assert measure.error_after(maker(engine), masses, 3000) < 1e-9


@every_pair(engine=ENGINES, ratio=[0.1, 1, 10, 1000])
def test_c6_two_ball_contraction(engine, ratio):
    """The error falls by m_top/(m_top + m_bottom) a sweep."""
    got = measure.contraction(maker(engine), (1.0, ratio), after=2, over=4)
    assert got == pytest.approx(ratio / (1 + ratio), rel=1e-6)


@pytest.mark.parametrize(
    ("masses", "after", "law"),
    [
        ((1.0,) * 3, 30, math.cos(math.pi / 6) ** 2),
        ((1.0,) * 10, 300, 0.975528),
        ((1.0,) * 9 + (100.0,), 2000, 0.998922),
        ((1.0,) * 9 + (1000.0,), 2000, math.exp(math.log(1e-6) / 124715)),
        ((1000.0,) + (1.0,) * 9, 300, 0.96985),
    ],
)
@pytest.mark.parametrize("engine", ENGINES)
def test_c6_tower_contraction(engine, masses, after, law):
    """N equal balls: cos²(pi/2N); heavy on light is dear, light on heavy is not."""
    got = measure.contraction(maker(engine), masses, after, over=after)
    assert got == pytest.approx(law, rel=1e-5)


@every_pair(engine=RUST_ONLY, n=[50, 100])
def test_c6_tall_towers(engine, n):
    """50 balls: 13 996 sweeps for 1e-6; 100: 55 990."""
    sweeps = measure.sweeps_for(maker(engine), (1.0,) * n, 5000, 1e-6)
    assert sweeps == pytest.approx({50: 13996, 100: 55990}[n], abs=3)


@pytest.mark.parametrize("engine", ENGINES)
def test_c6_warm_start(engine):
    """A resting tower solved once: every later step needs about one sweep, cold ones do not."""
    left = {}
    for warm in (True, False):
        scene = lesson.stack(1, "lesson", (1.0,) * 4, softness=0.5, warm_start=warm)
        sim = make(engine, scene, "start")
        sim.step(1000)
        left[warm] = float(sim.residual)
    assert left[True] < 1e-10
    assert left[False] > 1e-3


def one_contact(mu):
    """A body whose effective inverse masses are 12, 4 and 3 along x, y and z, on a floor."""
    scene = Scene(gravity=(0, 0, 0))
    scene.add_geom("world", "plane", friction=(mu,))
    body = scene.add_body("body", pos=(0, 0, 0.1))
    for axis, inverse in zip(np.eye(3), (12, 4, 3), strict=True):
        scene.add_joint(body, "slide", axis=axis, armature=1 / inverse - 1 / 16)
    scene.add_geom(body, "sphere", 0.1, mass=1 / 16, friction=(mu,))
    return scene


@every_pair(engine=ENGINES, cone=["elliptic", "pyramidal"])
def test_s1_one_contact(engine, cone):
    """W = diag(12, 4, 3), v* = (-1, -1, -1): mu 1000 stops it all, mu 0 the normal alone."""
    for mu, expected, v in (
        (1000.0, (1 / 12, 1 / 4, 1 / 3), (0, 0, 0)),
        (0.0, (0, 0, 1 / 3), (-1, -1, 0)),
    ):
        sim = make(engine, one_contact(mu), cone=cone)
        sim.qpos[2] = -1e-12
        sim.qvel[:] = -1.0
        sim.step()
        impulse = np.array(sim.rows["impulse"])
        got = np.zeros(3)
        got[2] = impulse[0]
        if len(impulse) == 3:  # the tangents of a floor are +y and -x
            got[:2] = -impulse[2], impulse[1]
        assert got == pytest.approx(expected, abs=1e-9)
        assert np.array(sim.qvel) == pytest.approx(v, abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_s1_no_contact(engine):
    """Nothing touches: no row, and the velocity stays what it was."""
    sim = make(engine, one_contact(1.0))
    sim.qpos[2] = 1.0
    sim.qvel[:] = -1.0
    sim.step()
    assert len(sim.rows) == 0
    assert np.array(sim.qvel) == pytest.approx([-1, -1, -1], abs=1e-15)


def chain(rng, n):
    """n bodies, each on a slide on the one before, with a stop at the present place of each.

    Slides in scattered directions make M dense; the mass ratio is up to 1e6.
    """
    scene = Scene(gravity=(0, 0, 0))
    parent = scene.world
    for i in range(n):
        mass = float(10 ** rng.uniform(-3, 3))
        parent = scene.add_body(f"link{i}", parent, mass=mass, inertia=(mass, mass, mass))
        axis = rng.normal(size=3)
        scene.add_joint(parent, "slide", name=f"slide{i}", axis=axis, range=(0.0, 1e6))
    return scene


def exact_lcp(K, b):
    """lambda >= 0, w = K lambda + b >= 0, lambda·w = 0: every set of active rows is tried."""
    n = len(b)
    best, least = None, math.inf
    for active in itertools.product((False, True), repeat=n):
        on = np.array(active)
        x = np.zeros(n)
        if on.any():
            x[on] = np.linalg.solve(K[np.ix_(on, on)], -b[on])
        w = K @ x + b
        w[on] = 0.0
        wrong = max(0.0, *(-x / np.abs(x).max(initial=1e-300)), *(-w / np.abs(b).max()))
        if wrong < least:
            best, least = x, wrong
    return best


def compare_with_lcp(engine, seed, most):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, most + 1))
    scene, s = chain(rng, n), float(10 ** rng.uniform(-2, 1))
    # Speeds go into the stops: which of them push in the end, the solver must find.
    v = rng.normal(size=n)
    sim = make(engine, scene, law="lesson", softness=s, sweeps=100000, tolerance=1e-14)
    sim.qvel[:] = v
    sim.qpos[:] = 0.0
    sim.forward()
    masses = np.array([body.mass for body in scene.bodies[1:]])
    axes = np.array([joint.axis for joint in scene.joints])
    beyond = np.cumsum(masses[::-1])[::-1]
    M = beyond[np.maximum.outer(np.arange(n), np.arange(n))] * (axes @ axes.T)
    K = np.linalg.inv(M) + s * np.eye(n)
    got = np.array(sim.rows["impulse"])
    assert len(got) == n  # every slide is at its stop, whichever way it moves
    exact = exact_lcp(K, v)
    error = got - exact
    # In the energy of K: what a velocity error of 1e-9 could hide.
    assert math.sqrt(error @ K @ error) <= 1e-8 * max(1.0, math.sqrt(exact @ K @ exact))


@every_pair(engine=ENGINES, seed=range(20))
def test_s4_random_lcp(engine, seed):
    """Random stops on a chain of slides: PGS finds the exact solution (up to 5 rows)."""
    compare_with_lcp(engine, seed, 5)


@pytest.mark.long
@pytest.mark.parametrize("engine", ["rust"])
def test_s4_random_lcp_many(engine):
    """The same for 10 000 seeds, up to 8 rows."""
    for seed in range(10000):
        compare_with_lcp(engine, seed, 8)
