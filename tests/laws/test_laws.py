"""Laws that need no reference: what a transformed scene must do, known from the scene itself.

Units (powers of two), two copies, restart and the count of sweeps: bit for bit. A mirror: bit for
bit where no tangent had to be chosen. Another order of bodies: to rounding of the converged
solution, and bit for bit where no two trees meet. All on every zoo scene and half_cheetah.
"""

import copy
import functools
import pickle

import numpy as np
import pytest
import transforms
import zoo
from covering import every_pair

import stepcore as sc
from stepcore.loading import find_asset

PRECISIONS = ("f64", "f32")
HEAPS = {"marbles": 12, "capsules27": 12}
SCENES = [*zoo.ZOO, "half_cheetah"]

# One setting of each kind: solver, law, cone and integrator.
PGS = {"solver": "pgs", "sweeps": 15, "tolerance": 0.0}
WAYS = {
    "newton": {"solver": "newton", "sweeps": 50},
    "newton elliptic": {"solver": "newton", "cone": "elliptic", "impratio": 4.0},
    "pgs": PGS | {"integrator": "implicitfast"},
    "implicit": {"integrator": "implicit"},
    "discrete": PGS | {"integrator": "discrete"},
    "pgs elliptic tolerance": PGS | {"cone": "elliptic", "tolerance": 2.0**-20},
    "momentum": PGS | {"acceleration": "momentum", "integrator": "rk4"},
    "rigid": PGS | {"law": "rigid", "cone": "elliptic", "integrator": "semi-implicit"},
    "lesson rk4": PGS | {"law": "lesson", "cone": "pyramidal", "integrator": "rk4"},
    "penalty": PGS | {"law": "penalty", "penalty_stiffness": 4096.0, "integrator": "explicit"},
}


# The hand of `self_collision` lies inside its own arm: a law that undoes an overlap however small
# the lever blows it up, rightly. Laws on velocities refuse what adheres.
NOT_BY = dict.fromkeys(("self_collision", "sticky"), ("rigid", "lesson rk4"))


@functools.cache
def scene_of(name):
    if name != "half_cheetah":
        return transforms.named(sc.loads(zoo.ZOO[name].text))
    return transforms.named(sc.load(find_asset("gymnasium", name)))


def steps_of(name):
    return HEAPS.get(name, 40)


@functools.cache
def start_of(name):
    """A state off every tie in which rows are alive soon: near the scene's pose, and moving."""
    model = scene_of(name).compile()
    entry = zoo.ZOO.get(name, zoo.Entry("", spread=0.1))
    rng = np.random.default_rng(5)
    qpos, qvel = model.qpos0.copy(), entry.speed * rng.normal(size=model.nv)
    size = min(entry.spread, 0.1) * rng.normal(size=model.nq)
    for kind, q, _ in transforms.layout(model).values():
        qpos[q] += 0.1 * size[q] if kind in ("free", "slide") else size[q]
        if kind in ("free", "ball"):
            qpos[q][-4:] /= np.linalg.norm(qpos[q][-4:])
    return qpos, qvel, rng.normal(size=model.nu)


def rounded(values, precision):
    """The values as this precision holds them, so that a transformed start is exact."""
    return values.astype(np.float32).astype(float) if precision == "f32" else values


def set_up(scene, name, precision, move=None, copies=1, **settings):
    """A Sim at the scene's start, transformed by `move`."""
    sim = sc.Sim(scene.compile(), precision=precision, **settings)
    qpos, qvel, ctrl = (rounded(x, precision) for x in start_of(name))
    sim.qpos[:], sim.qvel[:] = (move.qpos(qpos), move.qvel(qvel)) if move else (qpos, qvel)
    sim.ctrl[:] = np.tile(move.ctrl(ctrl) if move else ctrl, copies)
    return sim


def same(name, mine, theirs):
    """Equal bit for bit, but for the sign of zeros."""
    bad = np.flatnonzero(~(mine == theirs))
    assert bad.size == 0, f"{name}[{bad[0]}]: {mine[bad[0]]!r} and {theirs[bad[0]]!r}"


def stays(sim, move, other, steps):
    """Steps both; the second must stay what the first becomes under `move`."""
    for step in range(steps):
        sim.step()
        other.step()
        same(f"qpos after step {step}", move.qpos(sim.qpos), other.qpos)
        same(f"qvel after step {step}", move.qvel(sim.qvel), other.qvel)


def units(name, way, precision):
    """M1: other units of length, mass and time, powers of two: the same bits in those units."""
    scene = scene_of(name).with_settings(**WAYS[way])
    mixed = any(
        joint.type == "free"
        and any((joint.stiffness, joint.damping, joint.armature, joint.frictionloss))
        for joint in scene.joints
    )
    for length, mass, time in ((3, -5, 2), (-7, 9, -4)):
        move = transforms.scaled(scene, 0 if mixed else length, mass, time)
        sim = set_up(scene, name, precision)
        other = set_up(move.scene, name, precision, move)
        stays(sim, move, other, steps_of(name) // 2)


def mirror(name, way, precision):
    """M3: nothing in the engine prefers left or right. Without tangents: bit for bit."""
    scene = copy.deepcopy(scene_of(name)).with_settings(**WAYS[way])
    for geom in scene.geoms:
        geom.condim = 1
    move = transforms.mirrored(scene)
    sim = set_up(scene, name, precision)
    stays(sim, move, set_up(move.scene, name, precision, move), steps_of(name) // 2)


def two_copies(name, way, precision):
    """M6: two copies that cannot meet, in one scene: each the same bits as alone."""
    scene = copy.deepcopy(scene_of(name)).with_settings(**WAYS[way])
    scene.mass_rules.settotalmass = -1.0  # of one copy, or of two?
    move = transforms.doubled(scene)
    sim = set_up(scene, name, precision)
    stays(sim, move, set_up(move.scene, name, precision, move, 2), steps_of(name) // 2)


def restart(name, way, precision):
    """M8: a snapshot is complete: another Sim goes on with the same bits."""
    model = scene_of(name).with_settings(**WAYS[way]).compile()
    sim = set_up(model.scene, name, precision, **WAYS[way])
    half = steps_of(name) // 2
    sim.step(half)
    snapshot = pickle.loads(pickle.dumps(sim.state()))
    sim.step(half)
    # Into a Sim that has been elsewhere, and into one that pickle made.
    other = sc.Sim(model, precision=precision)
    other.step(3)
    other.restore(snapshot)
    whole = pickle.loads(pickle.dumps(other))
    for again in (other, whole):
        again.step(half)
        assert again.state() == sim.state(), "the snapshots differ"


# Contacts that are several at a time have the order of their corners: the mirror has another order.
MANIFOLDS = ("plane_cylinder", "plane_box", "box_box", "explicit_pairs")


def holds(law, name, way, precision):
    if law is mirror and (way not in ("pgs", "rigid", "newton") or name in MANIFOLDS):
        return False
    return way not in NOT_BY.get(name, ())


@every_pair(
    holds, law=[units, mirror, two_copies, restart], name=SCENES, way=WAYS, precision=PRECISIONS
)
def test_bit_for_bit(law, name, way, precision):
    law(name, way, precision)


@pytest.mark.parametrize("name", SCENES)
def test_mirror_with_friction(name):
    """M3: with friction the mirrored tangents are other rows of the same problem."""
    move, sim, other = converged(name, transforms.mirrored)
    close(sim, move, other, 6)


@pytest.mark.parametrize("name", SCENES)
def test_order(name):
    """M4: bodies and geoms listed the other way round: the same converged motion."""
    move, sim, other = converged(name, transforms.reordered)
    other.ctrl[:] = by_name(sim.ctrl, sim.model.actuator_names, other.model.actuator_names)
    close(sim, move, other, 6)


def converged(name, moved):
    """A move, and the scene before and after it with solves that converge."""
    exact = {"solver": "newton", "sweeps": 200, "tolerance": 1e-13, "cone": "elliptic"}
    scene = scene_of(name).with_settings(**exact)
    move = moved(scene)
    return move, set_up(scene, name, "f64"), set_up(move.scene, name, "f64", move)


def close(sim, move, other, steps):
    """Steps both a little; equal to the rounding of a converged solve."""
    for _ in range(steps):
        sim.step()
        other.step()
    scale = 1 + max(np.abs(sim.qvel).max(), np.abs(sim.qacc).max() * sim.settings.dt)
    assert np.abs(move.qvel(sim.qvel) - other.qvel).max() <= 1e-9 * scale
    assert np.abs(move.qpos(sim.qpos) - other.qpos).max() <= 1e-10 * scale


def by_name(values, names, others):
    return [values[names.index(name)] for name in others]


@every_pair(
    name=["connect", "plane_capsule", "all_together", "half_cheetah"],
    way=[{}, {"acceleration": "momentum"}, {"law": "rigid"}],
    precision=PRECISIONS,
)
def test_tolerance_zero_runs_every_sweep(name, way, precision):
    """M9: n sweeps with tolerance 0 are n sweeps, though the rows were solved long before."""
    for sweeps in (0, 1, 7, 400):
        settings = PGS | way | {"sweeps": sweeps, "tolerance": 0.0, "warm_start": True}
        sim = set_up(scene_of(name), name, precision, **settings)
        seen = 0
        for _ in range(20):
            before = sim.row_updates
            sim.step()
            rows = len(sim.rows)
            seen += rows
            assert not rows or sim.sweeps_done == sweeps
            assert sim.row_updates - before == rows * sweeps
        assert seen > 0, "no row was ever alive"


@every_pair(
    extra=[{}, {"cone": "elliptic"}, {"acceleration": "momentum"}],
    name=["connect", "self_collision", "half_cheetah"],
)
def test_an_early_stop_is_that_many_sweeps(name, extra):
    """M9: where a tolerance stops a solve after k sweeps, k sweeps without one do the same."""
    settings = PGS | extra
    stopped = set_up(scene_of(name), name, "f64", **settings | {"sweeps": 900, "tolerance": 1e-5})
    counts = set()
    for _ in range(20):
        before = stopped.state()
        stopped.step()
        if not len(stopped.rows):
            continue
        assert stopped.residual <= 1e-5 or stopped.sweeps_done == 900
        counts.add(stopped.sweeps_done)
        told = set_up(scene_of(name), name, "f64", **settings | {"sweeps": stopped.sweeps_done})
        told.restore(before)
        told.step()
        assert told.state() == stopped.state()
    assert len(counts) > 1, f"every solve took {counts} sweeps"
