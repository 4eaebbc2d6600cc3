"""`converge`: more sweeps, or smaller steps? And which rows are not solved."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Any, Unpack

import numpy as np

from stepcore import checks
from stepcore.deadline import SEARCHED
from stepcore.engine.norm import apart, rms
from stepcore.experiment.arguments import MeasurementFields, Source, measurement, set_up
from stepcore.experiment.change import Change
from stepcore.experiment.horizon import settled_motion
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import divides, often
from stepcore.experiment.study import EFFORT, SHIPPED, Study
from stepcore.experiment.trial import Trial
from stepcore.experiment.truth import Truth
from stepcore.measure.convergence.result import Convergence, Ending, Split
from stepcore.measure.convergence.sweeps import (
    ResidualHistory,
    RowForce,
    residual_history,
    row_states,
)
from stepcore.measure.monitors import Finding, monitored
from stepcore.report.units import metres

__all__ = ["Convergence", "ResidualHistory", "RowForce", "Split", "converge"]

# Equal work, split into steps × sweeps.
SPLITS = ((64, 1), (16, 4), (4, 16), (1, 64))
# Time steps tried at the shipped sweeps, relative to the shipped one.
FACTORS = (4, 2, 1, 1 / 2, 1 / 4, 1 / 8)
# The default number of starts.
STARTS = 3


@measurement()
def converge(
    model: Source,
    motion: Motion | str | None = None,
    *,
    states: int = 8,
    engine: str = "stepcore",
    **fields: Unpack[MeasurementFields],
) -> Convergence:
    """Test whether contact forces and other rows are solved, and whether sweeps or steps help more.

    Over the whole motion, `converge` measures the error as shipped, with converged forces, at other
    time steps, and at equal row updates split into many sweeps or many steps. Errors are RMS
    distances from the scene's converged motion in the worst start [m], as in `stepcore.trade`. At
    states of the motion, it measures the residual by the number of sweeps, cold and warm; the share
    of the error that each sweep leaves; and which rows are furthest from their converged force.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name"). The model's own
        settings are judged.
    motion: a `Motion`, or its fields as arguments. By default 3 starts and 1 s, or longer
        if it is not at rest by then; see `stepcore.experiment.horizon`.
    states: the number of states at which sweeps are measured.
    engine: "stepcore", or "mujoco", which also runs files that stepcore cannot load. MuJoCo shows
        errors alone, and no rows.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    Raises ValueError for an argument outside its limits, or if no converged motion can be run.

    >>> from stepcore import lesson
    >>> heavy = lesson.stack(5, "rigid", (1.0, 1000.0), warm_start=False)
    >>> result = converge(heavy, horizon=0.1, starts=1, progress=False)
    >>> result.verdict, result.better
    ('under-solved', 'smaller steps')
    >>> print(f"{result.contraction:.4f}")
    0.9990
    """
    setup = set_up(converge, model, motion, fields, missing="nothing to solve", engine=engine)
    states = checks.count("states", states)
    shipped, motion, workers = setup.engine.settings(SHIPPED), setup.motion, setup.workers
    if motion.control_dt is not None and not divides(shipped.dt, motion.control_dt):
        limit = f"must be a whole number of steps of {shipped.dt:g} s"
        raise ValueError(f"control_dt = {motion.control_dt:g}: {limit}")
    starts = motion.starts or STARTS
    motion = dataclasses.replace(motion, starts=starts)
    motion, far = settled_motion(setup.engine, motion, starts, EFFORT)
    frame, period = periods(shipped, motion.period(shipped.dt), far.length)
    study = Study(motion=motion, engine=setup.engine, period=period, workers=workers)
    dts, splits, more = other_steps(study), equal_work(frame), four_times(shipped)
    solved, truth = converged_forces(study), study.truth()
    every = list(dict.fromkeys([SHIPPED, solved, *dts, *splits.values(), *more]))
    # The answer needs two of the settings, which come first.
    two = study.run([SHIPPED, solved], bar="runs")
    said = f"as shipped the error is {metres(two[0].error)}, with converged forces "
    said += f"{metres(two[1].error)}, ± {metres(truth.error)}; other settings are run now"
    workers.deadline.so_far(said)

    def done() -> list[Change]:
        return [c for c in every if all(study.ran(c, start) for start in study.starts)]

    def left_out() -> str:
        return f"{len(every) - len(done())} of {len(every)} settings"

    with workers.deadline.stage(left_out, SEARCHED):
        study.tracks(every, study.starts, "runs")
    with workers.deadline.closing():
        trials = {trial.change: trial for trial in study.run(done())}
    histories, findings = list[ResidualHistory](), list[Finding]()
    if engine == "stepcore":
        with workers.deadline.stage("the findings on the shipped settings"):
            found = monitored(setup.model, study.schedule)[0]
            # The residual is already reported by this measurement.
            findings = [one for one in found if one.kind != "residual"]
        with workers.deadline.stage("the residual by sweeps"):
            chosen = row_states(setup.model, study.schedule, states, study.starts)
            job = partial(residual_history, setup.model, shipped)
            histories = workers.each(job, chosen, "sweeps")
    return Convergence(
        name=setup.name,
        settings=shipped,
        motion=dataclasses.replace(motion, horizon=study.schedule.horizon),
        horizon=study.schedule.horizon,
        shipped=trials[SHIPPED],
        solved=trials[solved],
        dts=[trials[change] for change in dts if change in trials],
        splits=[Split(*at, trials[change]) for at, change in splits.items() if change in trials],
        more=next((trials[change] for change in more if change in trials), None),
        histories=histories,
        has_rows=study.engine.has_rows(study.schedule),
        reference=truth,
        size=study.size,
        ending=_ending(study, trials[SHIPPED], trials[solved], truth),
        notes=[*(setup.model.scene.notes if setup.engine.known else ()), *study.schedule.notes],
        findings=findings,
        ran=far.after(study.motion_ran),
    )


def periods(shipped: Any, control: float | None, horizon: float) -> tuple[float, float]:
    """Return the time over which equal work is split, and the control period [s].

    One of the splits has the shipped time step, with the number of sweeps nearest to the shipped
    one; of a solver without such a number the third split has it.

    control: the control period of the motion [s]; None if it has none.
    """
    known = shipped.solver == "pgs" and shipped.sweeps != "auto"
    sweeps = max(1, int(shipped.sweeps)) if known else SPLITS[2][1]
    frame = shipped.dt * min(SPLITS, key=lambda split: abs(math.log(split[1] / sweeps)))[0]
    if control is not None:
        return control / max(1, round(control / frame)), control
    period = often(max(frame, FACTORS[0] * shipped.dt), shipped.dt, horizon)
    return min(frame, period), period


def converged_forces(study: Study) -> Change:
    """Return the change to converged forces, as in the converged motion; the rest is as shipped."""
    engine = study.engine
    shipped, exact = engine.settings(SHIPPED), engine.ways(study.schedule, 1.0)[0].at(0)
    own = {name: getattr(shipped, name) for name in ("dt", "integrator", "refsafe", "sleep")}
    return Change.between(engine.settings(exact.also(Change(**own))), shipped)


def other_steps(study: Study) -> list[Change]:
    """Return the shipped settings at all time steps that divide the control period."""
    period, shipped = study.schedule.period, study.engine.dt
    steps = {f: f * shipped for f in FACTORS if f * shipped <= period * (1 + 1e-9)}
    own = {f: dt for f, dt in steps.items() if divides(dt, period)}
    return [SHIPPED if f == 1 else Change(dt=dt) for f, dt in own.items()]


def equal_work(frame: float) -> dict[tuple[int, int], Change]:
    """Return equal numbers of row updates in a time [s], by steps and sweeps."""
    plain = Change(solver="pgs", tolerance=0.0, cost_tolerance=0.0)
    return {(n, k): plain.also(Change(dt=frame / n, sweeps=k)) for n, k in SPLITS}


def four_times(shipped: Any) -> list[Change]:
    """Return four times the shipped sweeps; empty for settings without a number of sweeps."""
    if shipped.solver != "pgs" or shipped.sweeps in ("auto", 0):
        return []
    return [Change(sweeps=4 * shipped.sweeps, cost_tolerance=0.0)]


def _ending(study: Study, shipped: Trial, solved: Trial, truth: Truth) -> Ending | None:
    """Compare the ends of both motions in the start where converged forces matter most."""
    a, b = shipped.tracks, solved.tracks
    if a is None or b is None or shipped.failure or solved.failure:
        return None
    over = rms(apart(a, b, study.engine.matter), truth.scored)
    gap = np.linalg.norm(a.com[:, -1] - b.com[:, -1], axis=-1)
    start, body = map(int, np.unravel_index(gap.argmax(), gap.shape))
    # The speed over the last tenth of the motion.
    times = study.schedule.times
    first = max(0, len(times) - 1 - max(1, len(times) // 10))
    with np.errstate(invalid="ignore"):
        moved = a.com[start, -1, body] - a.com[start, first, body]
        speed = float(np.linalg.norm(moved) / (times[-1] - times[first]))
    index = study.engine.matter.moving[body]
    known = study.engine.known
    name = study.model.element_name("body", index) if known else f"body {index}"
    return Ending(start, name, float(gap.max()), speed, float(over.max()))
