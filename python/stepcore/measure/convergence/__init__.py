"""`converge`: more sweeps, or smaller steps? And which rows are not solved."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Unpack

import numpy as np

from stepcore import checks
from stepcore.engine.norm import apart, rms
from stepcore.experiment.arguments import MeasurementFields, Source, measurement, set_up
from stepcore.experiment.change import Change
from stepcore.experiment.horizon import Horizon, affordable, horizon_of
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import HORIZON, divides
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

# Sweeps in a period of equal work, and how they are split into steps × sweeps.
WORK = 64
SPLITS = ((64, 1), (16, 4), (4, 16), (1, 64))
# Time steps tried at the shipped sweeps, relative to the shipped one.
FACTORS = (4, 2, 1, 1 / 2, 1 / 4, 1 / 8)
# Least number of control periods in a motion.
PERIODS = 4
# The number of sweeps assumed for a solver that has none.
USUAL = 16
# Default number of starts.
STARTS = 3
# The shares of the time (`seconds`) at which the runs and the measurement of sweeps end.
RUN, MEASURED = 0.7, 0.95


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
    motion = dataclasses.replace(motion, starts=motion.starts or STARTS)
    far = Horizon(motion.horizon or HORIZON)
    if setup.engine.known:
        far = horizon_of(setup.model, motion, cost=affordable(EFFORT, motion.starts or STARTS))
    motion = dataclasses.replace(motion, horizon=far.length if far.words else motion.horizon)
    frame, period = periods(shipped, motion.period(shipped.dt), far.length)
    study = Study(motion=motion, engine=setup.engine, period=period, workers=workers)
    some = Candidates.of(study, frame)
    truth = study.truth()
    # The answer needs two of the settings, which come first.
    two = study.run([SHIPPED, some.solved], bar="runs")
    said = f"as shipped the error is {metres(two[0].error)}, with converged forces "
    said += f"{metres(two[1].error)}, ± {metres(truth.error)}; other settings are run now"
    workers.deadline.so_far(said)

    def left_out() -> str:
        return f"{len(some.all) - len(_done(study, some.all))} of {len(some.all)} settings"

    with workers.deadline.stage(left_out, RUN):
        study.tracks(some.all, study.starts, "runs")
    with workers.deadline.closing():
        trials = {trial.change: trial for trial in study.run(_done(study, some.all))}
    histories, findings = list[ResidualHistory](), list[Finding]()
    if engine == "stepcore":
        with workers.deadline.stage("the residual by sweeps", MEASURED):
            chosen = row_states(setup.model, study.schedule, states, study.starts)
            job = partial(residual_history, setup.model, shipped)
            histories = workers.each(job, chosen, "sweeps")
        with workers.deadline.stage("the findings on the shipped settings"):
            found = monitored(setup.model, study.schedule)[0]
            # The residual is already reported by this measurement.
            findings = [one for one in found if one.kind != "residual"]
    return Convergence(
        name=setup.name,
        settings=shipped,
        motion=dataclasses.replace(motion, horizon=study.schedule.horizon),
        horizon=study.schedule.horizon,
        shipped=trials[SHIPPED],
        solved=trials[some.solved],
        dts=[trials[change] for change in some.dts if change in trials],
        splits=[Split(n, k, trials[c]) for (n, k), c in some.splits.items() if c in trials],
        more=trials.get(some.more) if some.more is not None else None,
        histories=histories,
        has_rows=study.engine.has_rows(study.schedule),
        reference=truth,
        size=study.size,
        ending=_ending(study, trials[SHIPPED], trials[some.solved], truth),
        notes=[*(setup.model.scene.notes if setup.engine.known else ()), *study.schedule.notes],
        findings=findings,
        ran=far.after(study.motion_ran),
    )


def periods(shipped: Any, control: float | None, horizon: float) -> tuple[float, float]:
    """Return the time over which equal work is split, and the control period [s].

    One of the splits has the shipped time step, with the nearest of 1, 4, 16 and 64 sweeps.

    control: the control period of the motion [s]; None if it has none.
    """
    known = shipped.solver == "pgs" and shipped.sweeps != "auto"
    sweeps = max(1, int(shipped.sweeps)) if known else USUAL
    frame = shipped.dt * WORK / min((1, 4, 16, 64), key=lambda n: abs(math.log(n / sweeps)))
    if control is not None:
        return control / max(1, round(control / frame)), control
    period = max(frame, 4 * shipped.dt)
    while period > horizon / PERIODS * (1 + 1e-9) and period > shipped.dt:
        period /= 2
    return min(frame, period), period


@dataclass(frozen=True)
class Candidates:
    """The changes of settings that are run.

    solved: the shipped settings with converged forces. dts: the shipped settings at other steps.
    splits: equal work, by steps and sweeps. more: four times the sweeps; None where there is no
    number of sweeps.
    """

    solved: Change
    dts: list[Change]
    splits: dict[tuple[int, int], Change]
    more: Change | None

    @classmethod
    def of(cls, study: Study, frame: float) -> Candidates:
        """Return the changes of a study; frame: the time over which equal work is split [s]."""
        shipped, period = study.engine.settings(SHIPPED), study.schedule.period
        # Forces are converged as in the converged motion, and the rest is as shipped.
        exact = study.engine.ways(study.schedule, 1.0)[0].at(0)
        own = {name: getattr(shipped, name) for name in ("dt", "integrator", "refsafe", "sleep")}
        lengths = [(f, shipped.dt * f) for f in FACTORS]
        plain = Change(solver="pgs", tolerance=0.0, cost_tolerance=0.0)
        fixed = shipped.solver == "pgs" and shipped.sweeps != "auto" and shipped.sweeps > 0
        return cls(
            solved=Change.between(study.engine.settings(exact.also(Change(**own))), shipped),
            dts=[
                SHIPPED if f == 1 else Change(dt=dt)
                for f, dt in lengths
                if dt <= period * (1 + 1e-9) and divides(dt, period)
            ],
            splits={(n, k): plain.also(Change(dt=frame / n, sweeps=k)) for n, k in SPLITS},
            more=Change(sweeps=4 * shipped.sweeps, cost_tolerance=0.0) if fixed else None,
        )

    @property
    def all(self) -> list[Change]:
        """All changes, without repetition."""
        some = [SHIPPED, self.solved, *self.dts, *self.splits.values(), self.more]
        return list(dict.fromkeys(change for change in some if change is not None))


def _done(study: Study, changes: Sequence[Change]) -> list[Change]:
    return [c for c in changes if all(study.ran(c, start) for start in study.starts)]


def _ending(study: Study, shipped: Trial, solved: Trial, truth: Truth) -> Ending | None:
    """Compare the ends of both motions in the start where converged forces matter most."""
    if shipped.failure or solved.failure or shipped.tracks is None or solved.tracks is None:
        return None
    both = np.stack([shipped.tracks.com, solved.tracks.com])
    over = rms(apart(shipped.tracks, solved.tracks, study.engine.matter), truth.scored)
    gap = np.linalg.norm(both[0, :, -1] - both[1, :, -1], axis=-1)
    start, body = map(int, np.unravel_index(gap.argmax(), gap.shape))
    times = study.schedule.times
    last = max(1, len(times) // 10)
    speeds = np.full(2, np.nan)
    if len(times) > last:
        moved = both[:, start, -1, body] - both[:, start, -1 - last, body]
        speeds = np.linalg.norm(moved, axis=-1) / (times[-1] - times[-1 - last])
    index = study.engine.matter.moving[body]
    known = study.engine.known
    name = study.model.element_name("body", index) if known else f"body {index}"
    return Ending(
        start, name, float(gap.max()), float(speeds[0]), float(speeds[1]), float(over.max())
    )
