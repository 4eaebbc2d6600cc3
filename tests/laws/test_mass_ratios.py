"""Light bodies under heavy ones, at rest and sliding: solved, or said; no energy from nothing.

Of what 1 g under 1 t lacks, a sweep gives a millionth; `sweeps="auto"` reaches it all the same.
"""

import warnings

import numpy as np
import pytest
from covering import every_pair
from oracle import Sim as Reference
from oracle import solve as reference

import stepcore as sc

AUTO = {"solver": "pgs", "sweeps": "auto", "dt": 2e-3}
G, DT = 9.81, 2e-3
SMALL = {"box": 'type="box" size=".05 .05 .05"', "sphere": 'size=".05"'}


def stack(masses, shape="box", cone="pyramidal", condim=3):
    """Bodies on a floor: of more than 10 kg boxes of 20 cm, the others of 10 cm."""
    bodies, z = "", 0.0
    for k, mass in enumerate(masses):
        half = 0.1 if mass > 10 else 0.05
        geom = 'type="box" size=".1 .1 .1"' if mass > 10 else SMALL[shape]
        bodies += f'<body name="b{k}" pos="0 0 {z + half}"><freejoint/>'
        bodies += f'<geom {geom} mass="{mass}" condim="{condim}"/></body>'
        z += 2 * half
    return sc.loads(
        f'<mujoco><option cone="{cone}"/><worldbody>'
        f'<geom type="plane" size="9 9 1" condim="{condim}"/>{bodies}</worldbody></mujoco>'
    )


def feet(masses, **slide):
    """Plates on four feet each, foot on foot: spheres, which the reference knows as well."""
    scene = sc.Scene(gravity=(0, 0, -G))
    scene.add_geom("world", "plane")
    for k, mass in enumerate(masses):
        body = scene.add_body(f"plate{k}", pos=(0, 0, 0.05 + 0.1 * k))
        scene.add_joint(body, "free")
        for x in (-0.05, 0.05):
            for y in (-0.05, 0.05):
                for z in (-0.04, 0.04):
                    scene.add_geom(body, "sphere", 0.01, pos=(x, y, z), mass=mass / 8)
    return scene


def rise(sim, steps):
    """The most by which the energy exceeds what it was before [J]."""
    start = least = sim.energy.total
    most = 0.0
    for _ in range(steps):
        sim.step()
        least = min(least, sim.energy.total)
        most = max(most, sim.energy.total - least)
    return most, start


@every_pair(
    ratio=[1e2, 1e4, 1e5, 1e6],
    shape=["box", "sphere"],
    law=["rigid", "lesson", "relaxed"],
    cone=["pyramidal", "elliptic"],
)
def test_one_on_another_rests(ratio, shape, law, cone):
    """0.3 s: nobody moves by a micrometre, and the floor bears both."""
    light, heavy = 1e-3, 1e-3 * ratio
    sim = sc.Sim(stack([light, heavy], shape, cone), law=law, **AUTO)
    start = sim.qpos.copy()
    most, _ = rise(sim, 150)
    assert most < 1e-8 * heavy
    assert np.abs(sim.qpos - start).max() < 1e-6
    assert sim.residual < 1e-9
    normals = sim.rows["impulse"][sim.rows["lo"] == 0].sum() / DT
    assert normals == pytest.approx(G * (light + 2 * heavy), rel=1e-6)


@every_pair(
    cone=["pyramidal", "elliptic"],
    masses=[(1e-3, 1e3, 1e-3), (1e3, 1e-3, 1e3), (1e-3, 1e2, 1e-3, 1e2)],
)
def test_stacks_of_alternating_masses(masses, cone):
    """Three and four, spheres not among them: at rest to a micrometre."""
    sim = sc.Sim(stack(masses, "box", cone), law="rigid", **AUTO)
    start = sim.qpos.copy()
    most, _ = rise(sim, 50)
    assert most < 1e-8 * max(masses)
    assert np.abs(sim.qpos - start).max() < 1e-6


@every_pair(
    cone=["pyramidal", "elliptic"], masses=[(1e-3, 1e3), (1e-3, 1.0, 1e3), (1e3, 1e-3, 1e3)]
)
def test_the_references_rows_are_met(masses, cone):
    """Plates on feet: numpy's own rows at the same state, with the engine's impulses in them."""
    scene = feet(masses)
    settings = AUTO | {"law": "rigid", "cone": cone}
    ours = sc.Sim(scene.compile(), **settings)
    theirs = Reference(scene, **settings | {"sweeps": 1, "tolerance": 0.0})
    for _ in range(3):
        ours.forward()
        theirs.qpos[:], theirs.qvel[:] = ours.qpos, ours.qvel
        theirs.forward()
        impulse = ours.rows["impulse"]
        velocity = ours.qvel + DT * ours.qacc
        settings_of = theirs.settings
        left = reference.residual(theirs.system, velocity, impulse, settings_of)
        assert left < 1e-8
        ours.step()


def active_set(a, b):
    """λ ≥ 0 with aλ − b ≥ 0 where λ = 0: Lawson and Hanson's active set, dense."""
    n, unit = len(b), 1 / np.sqrt(np.diag(a))
    a, b = a * np.outer(unit, unit), b * unit
    free = np.zeros(n, bool)
    impulse = np.zeros(n)
    for _ in range(10 * n):
        w = a @ impulse - b
        worst = int(np.argmin(np.where(free, 0, w)))
        if w[worst] > -1e-10 * np.abs(b).max():
            return impulse * unit
        free[worst] = True
        while True:
            trial = np.zeros(n)
            trial[free] = np.linalg.lstsq(a[np.ix_(free, free)], b[free], rcond=1e-12)[0]
            if (trial[free] >= 0).all():
                impulse = trial
                break
            down = free & (trial < 0)
            share = (impulse[down] / (impulse[down] - trial[down])).min()
            impulse = impulse + share * (trial - impulse)
            free &= impulse > 1e-12 * impulse.max()
            impulse[~free] = 0
    raise AssertionError("the active set does not settle")


@pytest.mark.parametrize("ratio", [1e2, 1e4, 1e6])
def test_a_dense_active_set_agrees(ratio):
    """Frictionless plates that meet at different speeds: the velocities after the impact."""
    scene = feet((1e-3, 1e-3 * ratio, 1e-3))
    for geom in scene.geoms:
        geom.condim = 1
    ours = sc.Sim(scene.compile(), law="rigid", **AUTO)
    theirs = Reference(scene, law="rigid", **AUTO | {"sweeps": 1, "tolerance": 0.0})
    speeds = np.zeros(18)
    speeds[2::6], speeds[3::6] = (-0.1, -0.4, -0.6), (0.2, -0.3, 0.1)
    ours.qvel[:] = theirs.qvel[:] = speeds
    theirs.forward()
    system = theirs.system
    guess = speeds.copy()
    guess[2::6] -= G * DT
    impulse = active_set(system.J @ system.W, system.t - system.J @ guess)
    after = guess + system.W @ impulse
    ours.forward()
    assert ours.residual < 1e-9
    np.testing.assert_allclose(ours.qvel + DT * ours.qacc, after, rtol=0, atol=1e-7)


@pytest.mark.parametrize("lanes", [False, True])
def test_a_batch_has_the_bits_of_each_alone(lanes):
    """Twelve worlds of 1 g under 100 kg, some sliding, and one in the air."""
    model = feet((1e-3, 100.0)).compile()
    settings = AUTO | {"law": "rigid"}
    batch = sc.Batch(model, 12, lanes=lanes, **settings)
    batch.qvel[:, 6] = np.linspace(0, 0.5, 12)
    batch.qpos[4, 9] += 0.01
    batch.step(10)
    for world in (0, 3, 4, 11):
        sim = sc.Sim(model, **settings)
        sim.qvel[6] = np.linspace(0, 0.5, 12)[world]
        sim.qpos[9] += 0.01 if world == 4 else 0
        sim.step(10)
        assert np.array_equal(sim.qpos, batch.qpos[world])
        assert np.array_equal(sim.qvel, batch.qvel[world])


def test_units_of_powers_of_two():
    """Masses times 2^10, lengths and gravity times 2^-4 (times stay): the same bits, scaled."""
    ends = []
    for mass, length in ((1.0, 1.0), (2.0**10, 2.0**-4)):
        scene = sc.Scene(gravity=(0, 0, -8.0 * length))
        scene.add_geom("world", "plane")
        for k, own in enumerate((2.0**-10, 2.0**10)):
            body = scene.add_body(f"b{k}", pos=(0, 0, length * (0.125 + 0.25 * k)))
            scene.add_joint(body, "free")
            scene.add_geom(body, "box", (0.125 * length,) * 3, mass=own * mass)
        tolerance = 2.0**-33 * length
        sim = sc.Sim(scene, law="rigid", tolerance=tolerance, **AUTO)
        sim.qvel[6] = 0.25 * length
        sim.step(5)
        ends.append(np.concatenate([sim.qpos[:3], sim.qpos[7:10], sim.qvel[6:9]]) / length)
    assert np.array_equal(*ends)


def test_a_snapshot_goes_on_bit_for_bit():
    sim = sc.Sim(stack([1e-3, 1e3]), law="rigid", **AUTO)
    sim.qvel[6] = 0.3
    sim.step(3)
    state = sim.state()
    sim.step(3)
    end = sim.qpos.copy()
    other = sc.Sim(sim.model, law="rigid", **AUTO)
    other.restore(state)
    other.step(3)
    assert np.array_equal(other.qpos, end)


def test_a_given_number_of_sweeps_is_said():
    """A hundred sweeps throw 10 kg into the air: the warning says whose rows gave how much."""
    sim = sc.Sim(stack([1e-3, 10.0]), law="rigid", solver="pgs", sweeps=100)
    with pytest.warns(sc.EnergyWarning, match=r"`b0` are not solved: .* and added .* J\."):
        sim.step(150)
        sim.balance()


@pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")
@pytest.mark.parametrize("heavy", [1e2, 1e3])
def test_a_run_names_the_rows_and_its_cure_holds(heavy):
    scene = stack([1e-3, heavy])
    with pytest.warns(sc.UnsolvedWarning, match='`b0`.*sweeps="auto" solves them'):
        sc.Sim(scene, law="rigid", solver="pgs", sweeps=1000).run(0.3)
    assert sc.Sim(scene, law="rigid", **AUTO).run(0.3).unsolved == ""


def test_what_rests_is_not_warned_of():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim = sc.Sim(stack([1e-3, 1e3]), law="rigid", **AUTO)
        assert sim.run(0.3).unsolved == ""
