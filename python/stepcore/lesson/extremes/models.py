"""Two whole models, half_cheetah and ant, let go above the floor, far from their own settings."""

from __future__ import annotations

import copy
import importlib.util
from collections.abc import Iterator
from functools import cache, partial
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.linear_maps import step_matrix
from stepcore.engine.sim import Sim
from stepcore.lesson.extremes.cells import (
    EPS,
    PRECISIONS,
    STEPS_OF_TIME,
    Case,
    Outcome,
    all_of,
    named_error,
    within,
)
from stepcore.lesson.extremes.motion import step_is_balanced
from stepcore.loading import find_scene
from stepcore.scene.scene import Scene

NAMES = ("half_cheetah", "ant")
RATIOS = (1e-6, 1e-3, 1.0, 1e3, 1e6)
STIFFNESSES = (1.0, 1e3, 1e6, 1e9, 1e12)
SWEEPS = (0, 1, 10, 100, 1000)
STEPS = 200
# The feet of ant at the middle of their range; everything else as the file has it.
ANKLES = {"ankle_1": 0.9, "ankle_2": -0.9, "ankle_3": -0.9, "ankle_4": 0.9}


def cases() -> Iterator[Case]:
    """For each model: sweeps, mass ratio and joint stiffness, by dt. None without gymnasium."""
    if importlib.util.find_spec("gymnasium") is None:
        return
    law = (
        "momentum balanced in every step, no row pulls, no energy gained, limits held; "
        "where the springs' linear motion grows, an error; shown: the balance"
    )
    for name in NAMES:
        tables: tuple[tuple[str, str, tuple[float, ...]], ...] = (
            ("sweeps", "{:.0f} sweeps", SWEEPS),
            ("ratio", "torso x{:.0e}", RATIOS),
            ("stiffness", "k {:.0e}", STIFFNESSES),
        )
        for axis, column, values in tables:
            for precision in PRECISIONS:
                for dt in STEPS_OF_TIME:
                    for value in values:
                        yield Case(
                            f"{name} let go, {STEPS} steps, by {axis}\n  law: {law}",
                            f"dt {dt:.0e}",
                            column.format(value),
                            precision,
                            partial(cell, name, axis, value, dt, precision),
                        )


@cache
def scene_of(name: str) -> Scene:
    """The file's scene."""
    return find_scene(f"gymnasium:{name}")


def cell(name: str, axis: str, value: float, dt: float, precision: str) -> Outcome:
    """The model let go, with one of its numbers replaced."""
    scene = copy.deepcopy(scene_of(name))
    sweeps = int(value) if axis == "sweeps" else 100
    for geom in scene.geoms:
        if axis == "ratio" and geom.body.name == "torso":
            geom.density *= value
    for joint in scene.joints:
        if axis == "stiffness" and joint.type == "hinge" and joint.range is not None:
            joint.stiffness, joint.springref = value, ANKLES.get(joint.name, 0.0)
    settings: dict[str, Any] = {
        "dt": dt,
        "precision": precision,
        "sweeps": sweeps,
        "tolerance": 0.0,
    }
    sim = Sim(scene.compile(), solver="pgs", integrator="implicitfast", **settings)
    for joint_name, angle in ANKLES.items() if name == "ant" else ():
        sim.joint(joint_name).qpos[...] = angle
    # Not quite at rest, so that what can grow has something to grow from.
    hinges = [kind == "hinge" for kind in sim.model.jnt_type]
    sim.qvel[sim.model.jnt_dofadr[hinges]] = 1e-6
    rate = growth(sim)
    try:
        watched = watch(sim, sweeps, precision)
        if rate <= 1.1:
            return watched
        sim.step(5000)
    except SimulationError as error:
        if rate > 1 + 1e-9:
            return named_error(error)
        raise
    return Outcome(False, "no error", "the springs' linear motion grows")


def watch(sim: Sim, sweeps: int, precision: str) -> Outcome:
    """The laws along the way."""
    mass, start = float(np.sum(sim.model.body_mass)), sim.energy.total
    # What the motion is about: a fall from one metre, and what the start holds.
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
        # A critically damped stop of time constant 0.02 s (never below 2 dt), and one step's way.
        stop = 2 * max(0.02, 2 * sim.settings.dt)
        laws.append(within(beyond, fastest * stop + 1e-9, "limits"))
    return all_of(*checks, *laws)


def free_flight(
    probe: Sim, qpos: Any, qvel: Any, after: Any, mass: float, precision: str
) -> Outcome:
    """Without rows only gravity changes the momentum, in the directions in which it may move."""
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
    dt, m, n = sim.settings.dt, sim.mass_matrix(), sim.model.nv
    k, d = np.zeros(n), np.zeros(n)
    for name, first in zip(sim.model.joint_names, sim.model.jnt_dofadr, strict=True):
        joint = sim.model.scene.joint(name)
        if joint.type in ("hinge", "slide"):
            k[first], d[first] = joint.stiffness, joint.damping
    step = step_matrix("euler", dt, m, np.diag(k), np.diag(d), np.diag(d))
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
