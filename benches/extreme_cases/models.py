"""Two whole models, half_cheetah and ant, released above the floor, far from their own settings."""

from __future__ import annotations

import copy
import importlib.util
from collections.abc import Iterator
from functools import cache, partial
from typing import Any

import numpy as np

from extreme_cases.cells import (
    EPS,
    TIME_STEPS,
    Case,
    Outcome,
    all_of,
    named_error,
    table_cases,
    within,
)
from extreme_cases.step_laws import step_is_balanced
from stepcore._core import SimulationError
from stepcore.engine.linear_maps import step_matrix
from stepcore.engine.sim import Sim, unwatched
from stepcore.loading import find_scene
from stepcore.scene.scene import Scene

NAMES = ("half_cheetah", "ant")
# What is varied, and its values by the name of their column.
AXES: dict[str, dict[str, float]] = {
    "sweeps": {f"{n} sweeps": n for n in (0, 1, 10, 100, 1000)},
    "ratio": {f"torso x{ratio:.0e}": ratio for ratio in (1e-6, 1e-3, 1.0, 1e3, 1e6)},
    "stiffness": {f"k {k:.0e}": k for k in (1.0, 1e3, 1e6, 1e9, 1e12)},
}
STEPS = 200
# The feet of ant at the middle of their range; everything else as the file has it.
ANKLES = {"ankle_1": 0.9, "ankle_2": -0.9, "ankle_3": -0.9, "ankle_4": 0.9}
LAW = (
    "in every step momentum is balanced, no row pulls, no energy is gained and limits hold; an "
    "error is expected if the springs' linear motion grows; shown: the balance"
)


def cases() -> Iterator[Case]:
    """For each model: sweeps, mass ratio and joint stiffness, by dt. None without gymnasium."""
    if importlib.util.find_spec("gymnasium") is None:
        return
    for name in NAMES:
        for axis, columns in AXES.items():
            title = f"{name} released, {STEPS} steps, by {axis}"
            measure = partial(released, name, axis)
            yield from table_cases(title, LAW, measure, TIME_STEPS, columns)


@cache
def scene_of(name: str) -> Scene:
    """The file's scene."""
    return find_scene(f"gymnasium:{name}")


def released(name: str, axis: str, dt: float, value: float, precision: str) -> Outcome:
    """The model released, with one of its numbers replaced."""
    scene = copy.deepcopy(scene_of(name))
    sweeps = int(value) if axis == "sweeps" else 100
    for geom in scene.geoms:
        if axis == "ratio" and geom.body.name == "torso":
            geom.density *= value
    for joint in scene.joints:
        if axis == "stiffness" and joint.type == "hinge" and joint.range is not None:
            joint.stiffness, joint.springref = value, ANKLES.get(joint.name, 0.0)
    scene.options |= {"solver": "pgs", "integrator": "implicitfast", "tolerance": 0.0}
    scene.options |= {"dt": dt, "precision": precision, "sweeps": sweeps}
    sim = unwatched(Sim(scene.compile()))
    for joint_name, angle in ANKLES.items() if name == "ant" else ():
        sim.joint(joint_name).qpos[...] = angle
    # Not quite at rest, so that an unstable motion has something to grow from.
    hinges = [kind == "hinge" for kind in sim.model.jnt_type]
    sim.qvel[sim.model.jnt_dofadr[hinges]] = 1e-6
    rate = growth(sim)
    try:
        outcome = laws_of_run(sim, sweeps, precision)
        if rate <= 1.1:
            return outcome
        sim.step(5000)
    except SimulationError as error:
        if rate > 1 + 1e-9:
            return named_error(error)
        raise
    return Outcome(False, "no error", "the springs' linear motion grows")


def laws_of_run(sim: Sim, sweeps: int, precision: str) -> Outcome:
    """The laws of momentum, energy and limits, checked along a run."""
    mass, start = float(np.sum(sim.model.body_mass)), sim.energy.total
    # The scale of the energy: a fall from one metre, and what the start holds.
    scale = 9.81 * mass + abs(start)
    gained, beyond, fastest = 0.0, 0.0, 0.0
    checks, probe = [], Sim(sim.model)
    for step in range(STEPS):
        sample = step % 40 == 0
        if sample:
            checks.append(step_is_balanced(sim, precision))
        before = sim.qpos.copy(), sim.qvel.copy()
        sim.step()
        if sample and sweeps == 0:
            checks.append(free_flight(probe, *before, sim.qvel, mass, precision))
        gained = max(gained, (sim.energy.total - start) / scale)
        beyond = max(beyond, beyond_limits(sim))
        fastest = max(fastest, float(np.max(np.abs(sim.qvel))))
    laws = [within(gained, 1e4 * EPS[precision], "energy")]
    if sweeps > 0:
        # A critically damped stop of time constant 0.02 s (never below 2 dt), and one step more.
        stop = 2 * max(0.02, 2 * sim.settings.dt)
        laws.append(within(beyond, fastest * stop + 1e-9, "limits"))
    return all_of(*checks, *laws)


def free_flight(
    probe: Sim, qpos: Any, qvel: Any, after: Any, mass: float, precision: str
) -> Outcome:
    """Without rows only gravity changes the momentum."""
    probe.qpos[:], probe.qvel[:] = qpos, qvel
    old = probe.momentum.linear
    probe.qvel[:] = after
    change = probe.momentum.linear - old
    change[2] += 9.81 * mass * probe.settings.dt
    size = mass * (9.81 * probe.settings.dt + float(np.max(np.abs(after))))
    return within(float(np.max(np.abs(change))) / size, 1e3 * EPS[precision], "momentum in flight")


def growth(sim: Sim) -> float:
    """Spectral radius of one step of the joints' springs and dampers alone, at the start."""
    sim.forward()
    slopes = sim.element_slopes().items()
    joints = [s for e, s in slopes if e.kind in ("spring", "damper", "actuator")]
    none = np.zeros((sim.model.nv, sim.model.nv))
    k, d = sum((s.stiffness for s in joints), none), sum((s.damping for s in joints), none)
    step = step_matrix("euler", sim.settings.dt, sim.mass_matrix(), k, d, d)
    return float(np.max(np.abs(np.linalg.eigvals(step))))


def beyond_limits(sim: Sim) -> float:
    """How far the worst hinge is beyond its range [rad]."""
    worst = 0.0
    addresses: Any = sim.model.jnt_qposadr
    for kind, at, (low, high) in zip(
        sim.model.jnt_type, addresses, sim.model.jnt_range, strict=True
    ):
        if kind == "hinge":
            angle = float(sim.qpos[at])
            worst = max(worst, low - angle, angle - high)
    return worst
