"""Bodies that only rest in a run: what they cost, and what a weld of each saves and errs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from stepcore.engine.features import without
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.change import Change
from stepcore.experiment.sizes import scene_size
from stepcore.measure.monitors.finding import HALF, SEEN, Cure, Finding, Remedy, named, others
from stepcore.measure.monitors.recording import Recording, followed, free_bodies
from stepcore.report.units import metres, percent, times
from stepcore.scene.layout import Layout


def resting_findings(run: Recording) -> Iterator[Finding]:
    """Yield the free bodies that stand still and cost most of a step, with a run without them."""
    model, size = run.model, scene_size(run.model.scene)
    still = [body for body in sorted(free_bodies(model)) if _rests(run, body)]
    # Without a machine beside them, what rests is the scene.
    if len(still) < 2 or not model.nu:
        return
    try:
        welded = _welded(run, still)
    except ValueError:
        # An equality or a sensor may need their joints.
        return
    last = len(run) - 1
    ratio = _operations(run, model, last) / _operations(run, welded, last, still)
    if ratio < 1 / HALF:
        return
    bodies, rest = named(model, "body", still), np.isin(np.arange(model.nbody), still)
    problem = (
        f"{len(still)} bodies only rest, {bodies[0].name}{others(bodies[1:], 'body')}, and take "
        f"{percent(1 - 1 / ratio)} of a step's operations"
    )

    def again(_: Model) -> Recording:
        """Run the motion again, with the controls of the readings, where these bodies are fixed."""
        hold = max(1, round(run.spacing / model.settings.dt))
        start, rows = _state(run, 0, still), run["ctrl"][None, :-1]
        return followed(welded, start, hold * (len(run) - 1), ctrl=rows, hold=hold)

    def moved(other: Recording) -> float | None:
        """Return how far the other bodies are from the motion with all bodies [m]."""
        if other.failure is not None:
            return None
        now, before = (np.reshape(of["xpos"][:, ~rest], (len(of), -1)) for of in (other, run))
        at = other.times - other.times[0] + run.times[0]
        far = [np.interp(run.times, at, a) - b for a, b in zip(now.T, before.T, strict=True)]
        return float(np.abs(far).max())

    def say(far: float) -> str:
        saves = f"a step with {times(ratio)} fewer operations"
        return f"{saves}, and every other body within {metres(max(far, 1e-6))} of its motion"

    way = (Cure("fixing each to the world, without its freejoint,", Change()),)
    remedy = Remedy((way,), moved, SEEN * size, say, needed=True)
    yield Finding("resting bodies", "remark", problem, "", bodies, ratio, "1", remedy=remedy)


def _rests(run: Recording, body: int) -> bool:
    """Return whether a body, a tree of its own, stands still during the whole run."""
    size = run.sizes.bodies[body]
    way = np.ptp(run["xpos"][:, body], axis=0).max()
    turn = 2 * np.ptp(run["xquat"][:, body], axis=0).max()
    alone = np.count_nonzero(run.roots == body) == 1
    return bool(alone and way + turn * size < SEEN * size)


def _welded(run: Recording, still: Sequence[int]) -> Model:
    """Return the model in which bodies are fixed where they rest."""
    scene = without(run.model.scene.with_settings(run.model.settings), ())
    bodies = Layout(scene).bodies
    for body in still:
        bodies[body].pos = tuple(run["xpos"][-1, body])
        bodies[body].quat = tuple(run["xquat"][-1, body])
    fixed = {id(bodies[body]) for body in still}
    scene.joints = [joint for joint in scene.joints if id(joint.body) not in fixed]
    scene.keys = []
    return scene.compile()


def _state(run: Recording, reading: int, still: Sequence[int]) -> Start:
    """Return the state at a reading without the freejoints of some bodies."""
    kept = np.ones(run.model.nq, bool), np.ones(run.model.nv, bool)
    for joint in np.flatnonzero(np.isin(run.model.jnt_body, still)):
        q, v = run.model.jnt_qposadr[joint], run.model.jnt_dofadr[joint]
        kept[0][q : q + 7] = kept[1][v : v + 6] = False
    sim = run.at(reading)
    mocap = np.array(sim.mocap_pos), np.array(sim.mocap_quat)
    qpos, qvel = run["qpos"][reading, kept[0]], run["qvel"][reading, kept[1]]
    return Start(qpos, qvel, run["act"][reading], mocap)


def _operations(run: Recording, model: Model, reading: int, still: Sequence[int] = ()) -> int:
    """Return the floating-point operations of a step at a reading."""
    sim = Sim(model)
    _state(run, reading, still).put(sim)
    sim.ctrl = run["ctrl"][reading]
    return sim.count_flops()
