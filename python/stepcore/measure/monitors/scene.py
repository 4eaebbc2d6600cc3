"""Findings on a scene as a whole: bodies that only rest, and energy that the steps give it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from stepcore.engine.features import without
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.change import Change
from stepcore.experiment.proposal import Proposal
from stepcore.experiment.sizes import scene_size
from stepcore.measure.monitors.finding import (
    DEEP,
    HALF,
    PARTS,
    PLOT,
    SEEN,
    Finding,
    Proposals,
    named,
    others,
    shorter,
)
from stepcore.measure.monitors.recording import FEWEST, Recording, followed, free_bodies
from stepcore.report.units import metres, percent, times
from stepcore.scene.layout import Layout

# Bodies that only rest.


def resting_findings(run: Recording) -> Iterator[Finding]:
    """Yield the free bodies that rest and take most of a step, with a run that fixes them."""
    model, size = run.model, scene_size(run.model.scene)
    still = [body for body in sorted(free_bodies(model)) if _rests(run, body)]
    # Without a machine, the resting bodies are the scene itself.
    if len(still) < 2 or not model.nu:
        return
    try:
        welded = _welded(run, still)
    except ValueError:
        # An equality or a sensor may need their joints.
        return
    ratio = _operations(run, model) / _operations(run, welded, still)
    if ratio < 1 / HALF:
        return
    bodies, moving = named(model, "body", still), ~np.isin(np.arange(model.nbody), still)
    problem = (
        f"{len(still)} bodies only rest, {bodies[0].name}{others(bodies[1:], 'body')}, and take "
        f"{percent(1 - 1 / ratio)} of a step's operations"
    )

    def again(_: Model) -> Recording:
        """Repeat the motion with the recorded controls and with these bodies fixed."""
        hold = max(1, round(run.spacing / model.settings.dt))
        start, rows = _state(run, 0, still), run["ctrl"][None, :-1]
        return followed(welded, start, hold * (len(run) - 1), ctrl=rows, hold=hold)

    def moved(other: Recording) -> float | None:
        """Return the largest distance of the other bodies from their recorded motion [m]."""
        now, before = (np.reshape(of["xpos"][:, moving], (len(of), -1)) for of in (other, run))
        at = other.times - other.times[0] + run.times[0]
        far = [np.interp(run.times, at, a) - b for a, b in zip(now.T, before.T, strict=True)]
        return None if other.failure else float(np.abs(far).max())

    def say(far: float) -> str:
        saves = f"a step with {times(ratio)} fewer operations"
        return f"{saves}, and every other body within {metres(max(far, 1e-6))} of its motion"

    way = (Proposal("fixing each to the world, without its freejoint,", Change()),)
    proposals = Proposals((way,), moved, SEEN * size, say, needed=True, again=again)
    yield Finding("resting bodies", "remark", problem, "", bodies, ratio, "1", proposals=proposals)


def _rests(run: Recording, body: int) -> bool:
    """Return whether a body is a whole tree and rests during the whole run."""
    size = run.sizes.bodies[body]
    way, turn = (float(np.ptp(run[of][:, body], axis=0).max()) for of in ("xpos", "xquat"))
    return np.count_nonzero(run.roots == body) == 1 and way + 2 * turn * size < SEEN * size


def _welded(run: Recording, still: Sequence[int]) -> Model:
    """Return the model in which bodies are fixed where they rest."""
    scene = without(run.model.scene.with_settings(run.model.settings), ())
    layout = Layout(scene).bodies
    for body in still:
        layout[body].pos, layout[body].quat = (tuple(run[of][-1, body]) for of in ("xpos", "xquat"))
    fixed = {id(layout[body]) for body in still}
    scene.joints = [joint for joint in scene.joints if id(joint.body) not in fixed]
    scene.keys = []
    return scene.compile()


def _state(run: Recording, reading: int, still: Sequence[int]) -> Start:
    """Return the state at a reading without the freejoints of some bodies."""
    joints = np.flatnonzero(np.isin(run.model.jnt_body, still))
    q, v = (at[joints, None] for at in (run.model.jnt_qposadr, run.model.jnt_dofadr))
    qpos = np.delete(run["qpos"][reading], q + np.arange(7))
    qvel = np.delete(run["qvel"][reading], v + np.arange(6))
    sim = run.at(reading)
    mocap = np.array(sim.mocap_pos), np.array(sim.mocap_quat)
    return Start(qpos, qvel, run["act"][reading], mocap)


def _operations(run: Recording, model: Model, still: Sequence[int] = ()) -> int:
    """Return the floating-point operations of a step at the end."""
    sim = Sim(model)
    _state(run, len(run) - 1, still).put(sim)
    sim.ctrl = run["ctrl"][-1]
    return sim.count_flops()


# Energy.


def gained(run: Recording) -> float | None:
    """Return the energy gained over the largest kinetic energy; None if something may supply it.

    Actuators, wind, moving or adhesive surfaces, and rows at the start may supply energy.
    """
    scene = run.model.scene
    drags = (any(geom.surfacevel) or geom.adhesion for geom in scene.geoms)
    if run["actuator_force"].any() or any(scene.wind) or any(drags) or len(run.at(0).rows):
        return None
    some = np.unique(np.linspace(0, len(run) - 1, FEWEST**2).astype(int)).tolist()
    kinetic, potential = np.array([run.at(k).energy for k in some]).T
    total = kinetic + potential
    return float((total.max() - total[0]) / max(kinetic.max(), 1e-300))


def energy_findings(run: Recording) -> Iterator[Finding]:
    """Yield a finding if the steps add energy; its fix is an integrator or dt that does not."""
    gain, dt = gained(run), run.model.settings.dt
    if gain is None or gain < DEEP:
        return
    problem = (
        f"the steps give the motion energy, {percent(gain)} of its largest energy of motion, and "
        "may make it explode in a longer run"
    )
    names = ("midpoint", "rk4")
    exact = ((Proposal(f'integrator="{of}"', Change(integrator=of)),) for of in names)
    ways = (*exact, shorter(dt / (2 * part) for part in PARTS))
    proposals = Proposals(ways, gained, SEEN, lambda left: percent(max(left, 0.0)), 2, needed=True)
    yield Finding("energy", "warning", problem, "", (), gain, "1", PLOT, proposals=proposals)
