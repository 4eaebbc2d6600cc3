"""Extreme inputs: the matrix of `benches/extremes.py`, and attacks on single numbers.

Right is a finite result within the stated law, or a typed error that names the element or field;
never a silent NaN, a panic or a state that changed before the error.
"""

import itertools
import math

import extremes
import numpy as np
import pytest
from covering import every_pair
from extreme_cases import cells

import stepcore as sc
from stepcore.lesson import scenes

RIGID = {
    "solver": "pgs",
    "law": "rigid",
    "integrator": "semi-implicit",
    "sweeps": 50,
    "tolerance": 0.0,
    "dt": 0.002,
}
SOLVED = {"solver": "newton", "law": "solref", "integrator": "euler"}


# --- the matrix -----------------------------------------------------------------------------------


def check(done):
    missed = [f"{c.table}: {c.row}, {c.column}, {c.precision}: {c.text}" for c in done if not c.ok]
    assert not missed, "\n".join(missed)


def test_a_slice_of_the_matrix():
    """Every eleventh cell, which meets every table, step of time and precision."""
    chosen = list(extremes.cases())[::11]
    done = extremes.run(progress=False, chosen=chosen)
    check(done)
    assert {c.precision for c in done} == {"f64", "f32"}
    assert len({c.row.split(",")[0] for c in done if c.row.startswith("dt")}) == 6
    text = extremes.report(done)
    assert text.startswith(f"{len(done)} cells") and "0 missed" in text
    assert len(text) < len(extremes.report(done, full=True))


@pytest.mark.long
def test_the_whole_matrix():
    done = extremes.run(progress=False)
    check(done)
    finite = sum(cell.law == "finite" for cell in done)
    assert finite <= 2 / 3 * len(done), "finiteness alone is the law of at most two cells in three"
    errors = [cell for cell in done if cell.kind == "error"]
    assert errors and all("`" not in cell.text for cell in errors)


def test_a_miss_is_told():
    """A cell outside its law, and one that raised, are misses in the count and in the list."""

    def broken():
        raise ValueError("stiffness = -1: must be >= 0")

    cases = [
        cells.Case("t\n  law", "r", "a", "f64", lambda: cells.within(2.0, 1.0, "energy")),
        cells.Case("t\n  law", "r", "b", "f64", lambda: cells.within(math.nan, 1.0, "energy")),
        cells.Case("t\n  law", "r", "c", "f64", broken),
    ]
    done = extremes.run(progress=False, chosen=cases)
    assert [cell.ok for cell in done] == [False] * 3
    text = extremes.report(done, full=True)
    assert "3 missed" in text and "2.0e+00 > 1e+00 <--" in text and "must be >= 0" in text


# --- speed ----------------------------------------------------------------------------------------


def wall(speed, half=0.0005, radius=0.05, dt=0.002, **settings):
    """A ball shot at a box wall: the sim, and the nearest that the ball's surface came past it."""
    scene = sc.Scene(gravity=(0, 0, 0))
    scene.add_geom("world", "box", (half, 1, 1), condim=1)
    ball = scene.add_body("ball", pos=(-1.0, 0, 0))
    scene.add_joint(ball, "free")
    scene.add_geom(ball, "sphere", radius, mass=1.0, condim=1)
    sim = sc.Sim(scene, **(RIGID | {"dt": dt} | settings))
    sim.qvel[0] = speed
    deepest = -math.inf
    for _ in range(int(2 / (speed * dt)) + 100):
        sim.step()
        deepest = max(deepest, float(sim.qpos[0]) + radius + half)
    return sim, deepest


@every_pair(speed=[1.0, 100.0, 1e4], integrator=["semi-implicit", "rk4", "midpoint"])
def test_a_thin_wall_stops_a_fast_ball(speed, integrator):
    """Rows on the guess, not on a margin: a 1 mm wall at dt 2 ms, where the ball moves 0.2 m."""
    sim, deepest = wall(speed, integrator=integrator)
    assert deepest <= 1e-12, "the ball entered the wall"
    assert abs(sim.qvel[0]) <= 1e-10, "the ball did not stop"
    assert abs(sim.qpos[0] + 0.0505) <= 1e-9, "the ball did not arrive"


def test_a_thin_wall_throws_back():
    sim, deepest = wall(100.0, restitution=0.5)
    assert deepest <= 0
    assert sim.qvel[0] == pytest.approx(-50.0, abs=1e-9)


@every_pair(speed=[100.0, 1e4, 1e8], law=["rigid", "lesson", "relaxed", "solref"])
def test_an_impact_gives_no_energy(speed, law):
    """The floor catches a ball at any speed, and never gives back more than it got."""
    settings = SOLVED if law == "solref" else RIGID | {"law": law}
    sim = sc.Sim(scenes.tower([1.0]), **(settings | {"dt": 1e-3}))
    sim.qpos[0], sim.qvel[0] = 1.0, -speed
    start = 0.5 * speed**2 + scenes.G
    for _ in range(300):
        sim.step()
        y, v = float(sim.qpos[0]), float(sim.qvel[0])
        assert 0.5 * v * v + scenes.G * y <= start * (1 + 1e-12)
    if law != "solref":
        assert sim.qpos[0] >= -1e-3, "the floor did not catch it"


# --- sliding, duplicates, degenerate shapes -------------------------------------------------------


@every_pair(
    speed=[0.5, 5.0, 100.0], cone=["elliptic", "pyramidal"], law=["rigid", "lesson", "relaxed"]
)
def test_a_slide_keeps_its_height(law, cone, speed):
    """Coulomb's laws do not lift what slides: within 1 µm of the rest in every step."""
    scene = sc.Scene()
    scene.add_geom("world", "plane", friction=0.5)
    block = scene.add_body("block", pos=(0, 0, 0.1))
    scene.add_joint(block, "free")
    for x, y in itertools.product((-0.2, 0.2), repeat=2):
        scene.add_geom(block, "sphere", 0.1, pos=(x, y, 0), mass=0.25, friction=0.5)
    sim = sc.Sim(scene, **(RIGID | {"law": law, "cone": cone, "dt": 0.01, "sweeps": 300}))
    sim.qvel[:2] = speed * math.cos(0.4), speed * math.sin(0.4)
    for _ in range(min(400, int(1.3 * speed / 4.9 / 0.01) + 20)):
        sim.step()
        assert abs(sim.qpos[2] - 0.1) <= 1e-6
    assert np.linalg.norm(sim.qvel[:2]) < speed


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
@pytest.mark.parametrize(("speed", "after", "spin"), [(0.5, 0.25, 0.25), (0.7, 0.4, 0.3)])
def test_duplicate_contacts_change_nothing(cone, speed, after, spin):
    """F7: a disc that lands sticks or slips; the same contact 1, 4, 16, 64 times over."""
    for count in (1, 4, 16, 64):
        scene = sc.Scene(gravity=(0, 0, 0))
        scene.add_geom("world", "plane", friction=0.1)
        disc = scene.add_body("disc", pos=(0, 0, 1), mass=1.0, inertia=(1, 1, 1))
        scene.add_joint(disc, "free")
        for _ in range(count):
            scene.add_geom(disc, "sphere", 1.0, mass=0.0, friction=0.1)
        sim = sc.Sim(scene, **(RIGID | {"cone": cone, "sweeps": 200}))
        sim.qvel[0], sim.qvel[2] = speed, -3.0
        sim.step()
        assert len(sim.rows) == 3 * count
        assert sim.qvel[0] == pytest.approx(after, abs=1e-12), f"{count} contacts"
        assert sim.qvel[4] == pytest.approx(spin, abs=1e-12), f"{count} contacts"


@every_pair(
    kind=["sphere", "capsule"],
    settings=[RIGID, RIGID | {"law": "lesson"}, SOLVED],
    precision=["f64", "f32"],
)
def test_coincident_centres_part(kind, settings, precision):
    """Two bodies in one place have no direction between them: they part along a fixed one."""
    scene = sc.Scene(gravity=(0, 0, 0))
    for i in range(2):
        body = scene.add_body(f"b{i}", pos=(0, 0, 1))
        scene.add_joint(body, "free")
        scene.add_geom(body, kind, (0.1, 0.2, 0)[: 1 + (kind == "capsule")], mass=1.0)
    sim = sc.Sim(scene, precision=precision, **settings)
    sim.step(500)
    assert np.isfinite(sim.qpos).all()
    assert np.linalg.norm(sim.qpos[:3] - sim.qpos[7:10]) > 0.19
    assert np.abs(sim.momentum.linear).max() < 1e-5


@every_pair(
    settings=[RIGID, SOLVED], place=[(0, 0, 0), (0.5, 0, 0), (0.5, 0.5, 0.5), (0.5, 0.5, 0)]
)
def test_a_ball_inside_a_box_comes_out(place, settings):
    scene = sc.Scene(gravity=(0, 0, 0))
    scene.add_geom("world", "box", (0.5, 0.5, 0.5))
    ball = scene.add_body("ball", pos=place)
    scene.add_joint(ball, "free")
    scene.add_geom(ball, "sphere", 0.1, mass=1.0)
    sim = sc.Sim(scene, **settings)
    sim.step(1000)
    assert np.isfinite(sim.qpos).all() and np.abs(sim.qpos[:3]).max() > 0.59


# --- scale ----------------------------------------------------------------------------------------


@every_pair(settings=[RIGID, SOLVED], far=[0.0, 1e4, 1e6, 1e8])
def test_far_from_the_origin(far, settings):
    """A sledge stops where it stops near the origin, to the rounding of its coordinates."""

    def stop(offset):
        scene = sc.Scene()
        scene.add_geom("world", "plane")
        sledge = scene.add_body("sledge", pos=(offset, offset, 0.1), mass=1.0, inertia=(1, 1, 1))
        scene.add_joint(sledge, "free")
        for x, y in itertools.product((-0.1, 0.1), repeat=2):
            scene.add_geom(sledge, "sphere", 0.01, pos=(x, y, -0.09), mass=0.0, friction=0.5)
        sim = sc.Sim(scene, **settings)
        sim.qvel[0] = 1.0
        sim.step(400)
        return sim.qpos[:3] - [offset, offset, 0.1]

    rounding = 400 * np.spacing(far)
    assert np.abs(stop(far) - stop(0.0)).max() <= rounding + 1e-12


@pytest.mark.parametrize("size", [1e-4, 1e-2, 1.0, 1e2, 1e4])
def test_any_size(size):
    """A ball of any radius rests where the law says, to the rounding of its own size."""
    for softness in (0.0, 0.5):
        scene = scenes.tower([1.0], radius=size)
        sim = sc.Sim(scene, **(RIGID | {"law": "lesson", "softness": softness}))
        sim.step(3000)
        depth = softness * scenes.G * 0.002**2 / 0.2
        assert abs(sim.qpos[0] + depth) <= 8 * np.spacing(size) + 1e-12


@every_pair(law=["rigid", "lesson"], dt=[1e-9, 1e-12, 1e-15])
def test_tiny_steps_rest(law, dt):
    """Where g dt² is below the numbers, a resting body may freeze; it must not sink."""
    sim = sc.Sim(scenes.tower([1.0]), **(RIGID | {"law": law, "dt": dt}))
    sim.step(5000)
    assert -np.spacing(0.1) <= sim.qpos[0] <= np.spacing(0.1)
    assert sim.time == 5000 * dt


@every_pair(settings=[RIGID, SOLVED], mass=[1e-300, 1e-150, 1e150, 1e300])
def test_any_mass_that_the_numbers_hold(mass, settings):
    """It rests; where Newton's squares of it would leave the numbers, it is refused by name."""
    if settings is SOLVED and mass in (1e-300, 1e300):
        with pytest.raises(ValueError, match=r"ball0.*square"):
            sc.Sim(scenes.tower([mass]), **settings)
        return
    sim = sc.Sim(scenes.tower([mass]), **settings)
    sim.step(2000)
    assert -1e-3 < sim.qpos[0] <= 1e-3 and abs(sim.qvel[0]) < 1e-9


@pytest.mark.parametrize("mass", [1e-300, 1e-60, 1e60, 1e300])
def test_masses_beyond_single_precision(mass):
    """What f32 cannot hold is refused where the precision is chosen, not in the first step."""
    with pytest.raises(ValueError, match=r"ball0.*precision"):
        sc.Sim(scenes.tower([mass]), precision="f32", **RIGID)


def test_masses_without_an_inverse_are_refused():
    for mass in (5e-324, 1e-309):
        with pytest.raises(ValueError, match=r"ball0.*mass"):
            scenes.tower([mass]).compile()
    for mass in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="mass"):
            scenes.tower([mass]).compile()


# --- overflow -------------------------------------------------------------------------------------


@every_pair(array=["qfrc_applied", "xfrc_applied", "qvel"], precision=["f64", "f32"])
def test_what_overflows_is_an_error_with_a_name(array, precision):
    """A huge but finite input: an error with step, time and element, and a state still finite."""
    huge = 1e30 if precision == "f32" else 1e300
    sim = sc.Sim(scenes.grasp(), precision=precision)
    sim.reset("start")
    sim.step(5)
    getattr(sim, array)[:] = huge
    with pytest.raises(sc.SimulationError, match=r"step \d+ at time .*`.*last finite state"):
        sim.step(50)
    assert np.isfinite(sim.qpos).all() and np.isfinite(sim.qvel).all()


@pytest.mark.parametrize("array", ["qpos", "qvel", "ctrl", "qfrc_applied", "xfrc_applied"])
def test_what_is_not_finite_is_refused_before_anything_moves(array):
    sim = sc.Sim(scenes.grasp())
    sim.reset("start")
    sim.step(3)
    before = sim.state()
    entries = getattr(sim, array)
    for i, bad in itertools.product(range(entries.size), (math.nan, math.inf, -math.inf)):
        old = entries.flat[i]
        entries.flat[i] = bad
        for use in (sim.step, sim.forward, lambda: sim.energy, lambda: sim.xpos):
            with pytest.raises(ValueError, match=rf"{array}\["):
                use()
        entries.flat[i] = old
    assert sim.state() == before


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(("dt", x) for x in (0.0, -1e-3, math.nan, math.inf)),
        *(("sweeps", x) for x in (-1, 2**32, 1.5, "many")),
        *(("beta", x) for x in (0.0, 2.0, math.nan)),
        *(("softness", x) for x in (-1.0, math.inf)),
        *(("tolerance", x) for x in (-1.0, math.nan)),
        *(("max_contacts", x) for x in (-1, 10**11, 10**18, 2**70)),
        *(("penalty_stiffness", x) for x in (0.0, math.inf)),
        *(("impratio", x) for x in (0.0, -1.0)),
    ],
)
def test_settings_outside_their_limits(field, value):
    with pytest.raises(ValueError, match=field):
        sc.Sim(scenes.tower([1.0]), **(RIGID | {field: value}))


def test_a_snapshot_that_was_damaged():
    """Whatever bytes are given: restored, or refused with the state as it was."""
    sim = sc.Sim(scenes.grasp())
    sim.reset("start")
    sim.step(20)
    good = sim.state()
    rng = np.random.default_rng(3)
    for _ in range(300):
        bad = bytearray(good)
        bad[rng.integers(len(bad))] ^= 1 << int(rng.integers(8))
        try:
            sim.restore(bytes(bad))
        except ValueError:
            assert sim.state() == good
        sim.restore(good)
    for bad in (b"", good[:-1], good + b"x", b"x" * len(good), None, 3):
        with pytest.raises(ValueError, match="state"):
            sim.restore(bad)
    assert sim.state() == good
