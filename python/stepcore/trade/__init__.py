"""`trade`: one scene under many settings against its own converged motion."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore._core import Settings
from stepcore.jobs import each
from stepcore.model import Model, compiled
from stepcore.progress import Choice, Progress
from stepcore.scene import Scene
from stepcore.trade.cost import costs
from stepcore.trade.dofs import Dofs
from stepcore.trade.errors import errors, extent, far_off
from stepcore.trade.models import Models
from stepcore.trade.motion import Control, Motion, default_horizon, motion, time_steps
from stepcore.trade.reference import FINER, Reference, Search, smallest
from stepcore.trade.remarks import truths
from stepcore.trade.result import Row, Trade
from stepcore.trade.run import Course, Path
from stepcore.trade.settings import clamping, grid, seconds

__all__ = ["Row", "Trade", "trade"]

# What the reference may cost, in steps × (dofs + 2): some seconds on one core.
BUDGET = 6e6


def trade(
    model: Model | Scene | str | os.PathLike[str],
    *,
    horizon: float | None = None,
    key: str | int | None = None,
    control: Control | None = None,
    control_dt: float | None = None,
    ctrl: ArrayLike | None = None,
    starts: int = 8,
    seed: int = 0,
    dts: Sequence[float] | None = None,
    integrators: Sequence[str] | None = None,
    solvers: Sequence[str] | None = None,
    sweeps: Sequence[int] | None = None,
    precisions: Sequence[str] | None = None,
    budget: float = BUDGET,
    threads: int | None = None,
    progress: Choice = None,
) -> Trade:
    """Measures what speed costs in accuracy: a scene under many settings.

    Every setting runs the same motion and is compared with the scene's own converged motion,
    whose error is stated. See `Errors` for what is measured.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name", see
        `stepcore.lookup`). Its settings are the shipped ones.
    horizon: simulated time [s]; by default 1 s, or a whole number of samples that is near it.
    key: the keyframe to start from, by name or index; by default the first, or the scene's pose.
    starts: how many; all but the first are moved a little, by `seed`.
    ctrl: controls, shape (n, nu), one row a control period (the last is held); or control: a
        function of (time, sim) that returns them, as in `Sim.run`, called once a period. It
        must depend on nothing else, for it is called from several threads. By default every
        motor follows a few smooth seeded sines in its range.
    control_dt: the control period [s], a multiple of every time step; default: the largest
        time step tried.
    dts [s], integrators, solvers, sweeps, precisions: what to try; the shipped settings are
        always among it.
    budget: what the reference may cost, in steps × (dofs + 2).
    threads: how many runs at once (default: one a core). Costs are timed on one, afterwards.
    progress: False for no bar, or a function of (label, done, total).

    Raises ValueError for an argument outside its limits, or if the reference itself fails.

    >>> from stepcore import lesson
    >>> result = trade(lesson.spring(), horizon=0.2, starts=1, dts=[0.005, 0.01])
    >>> result.shipped.settings.integrator
    'semi-implicit'
    >>> print(f"{1e3 * result.error(result.shipped):.1f} mm")
    39.7 mm
    >>> result.best(error=1e-5).integrator
    'rk4'
    """
    model = _model(model)
    checks.told("trade", progress)
    starts, seed = checks.count("starts", starts), checks.count("seed", seed, least=0)
    workers = checks.threads(threads)
    budget = checks.real(low=0)("trade", "budget", budget)
    axes = {"dts": dts, "integrators": integrators, "solvers": solvers, "sweeps": sweeps}
    for name, values in (axes | {"precisions": precisions}).items():
        if values is not None:
            checks.several(name, values)
    for dt in dts or ():
        checks.real(above=0)("trade", "dts", dt)
    shipped = model.settings
    dofs = Dofs(model.scene)
    if not dofs.moving:
        raise ValueError("nothing in the scene can move: there is no motion to trade")
    steps, period = time_steps(shipped.dt, dts, control_dt, 1.0 if horizon is None else horizon)
    motive = motion(
        model,
        dofs,
        horizon=default_horizon(period) if horizon is None else horizon,
        period=period,
        key=key,
        ctrl=ctrl,
        control=control,
        count=starts,
        seed=seed,
    )
    course = Course(model, dofs, motive)
    search = Search(course, shipped, min(steps), budget, workers)
    with Progress("reference", search.runs, progress) as bar:
        reference = search.first(bar)
    alive = max(path.rows for path in reference.paths)
    tried = grid(shipped, steps, integrators, solvers, sweeps, precisions, alive)
    with Progress("errors", len(tried), progress) as bar:
        runs = each(partial(_all_starts, course), tried, bar=bar, threads=workers)
    _refine(search, reference, runs, progress)
    with Progress("costs", len(tried), progress) as bar:
        times = costs(course, tried, bar)
    tau = clamping(model.scene) if shipped.law == "solref" and shipped.refsafe else None
    size = extent(reference.paths, model.scene)
    models = Models(search, reference, size)
    for one, paths in zip(tried, runs, strict=True):
        models.keep(one, paths)
    reference.gaps = models.gaps()
    rows = [
        _row(one, paths, cost, models, shipped, motive.horizon, tau)
        for one, paths, cost in zip(tried, runs, times, strict=True)
    ]
    notes = [*model.scene.notes, *_notes(motive, reference, alive, tau, horizon)]
    name = model.scene.name or "scene"
    return Trade(name, motive.horizon, rows, reference, starts, notes)


def _model(source: Model | Scene | str | os.PathLike[str]) -> Model:
    """The Model of what the user gave."""
    if isinstance(source, (str, os.PathLike)):
        from stepcore.lookup import find_scene

        source = find_scene(source)
    return compiled(source)


def _all_starts(course: Course, settings: Settings) -> list[Path]:
    """Runs of one setting from every start, until one fails."""
    paths = []
    for start in range(len(course.motion.starts)):
        paths.append(course.run(settings, start))
        if paths[-1].failure:
            break
    return paths


def _refine(
    search: Search, reference: Reference, runs: Sequence[list[Path]], progress: Choice
) -> None:
    """Halves the reference's step until its error is a tenth of the smallest in the table."""
    whole = [paths for paths in runs if not paths[-1].failure]
    while whole and search.can_refine(reference):
        found = [errors(p, reference.paths, reference.scored).position for p in whole]
        if reference.error * FINER <= smallest(found):
            return
        with Progress("finer reference", len(search.course.motion.starts), progress) as bar:
            if not search.refine(reference, bar):
                return


def _row(
    settings: Settings,
    paths: Sequence[Path],
    cost: float,
    models: Models,
    shipped: Settings,
    horizon: float,
    tau: float | None,
) -> Row:
    failure = paths[-1].failure and f"start {len(paths) - 1}: {paths[-1].failure}"
    if failure is None and math.isnan(cost):
        failure = "failed while it was timed"
    if failure is None:
        failure = far_off(paths, models.reference.paths, models.size)
    updates = [path.row_updates for path in paths]
    return Row(
        settings=settings,
        errors=None if failure else models.errors(settings, paths),
        cost=math.nan if failure else cost,
        row_updates=math.nan if failure else float(np.mean(updates)) / horizon,
        failure=failure,
        shipped=settings == shipped,
        clamped=tau is not None and 2 * settings.dt > tau * (1 + 1e-12),
    )


def _notes(
    motive: Motion, reference: Reference, rows: int, tau: float | None, asked: float | None
) -> list[str]:
    notes = []
    if asked is not None and motive.horizon < asked * (1 - 1e-9):
        notes.append(
            f"the horizon is {seconds(motive.horizon)}, a whole number of samples, not "
            f"{seconds(asked)}"
        )
    if rows == 0:
        notes.append("no contact, limit or other row was ever active: the solver does not matter")
    if motive.undriven:
        names = ", ".join(motive.undriven)
        notes.append(f"motors without a control range are not driven: {names}")
    notes += truths(reference)
    if tau is not None:
        notes.append(
            f"refsafe keeps the time constant of contacts and limits at 2 dt or above: beyond "
            f"dt {seconds(tau / 2)} (rows marked c) it makes the scene itself softer"
        )
    return notes
