"""`diagnose` names the element that limits the time step, and the changes that raise the limit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Unpack

import numpy as np

from stepcore import checks
from stepcore.engine.element import Element
from stepcore.experiment.arguments import MeasurementFields, Setup, Source, measurement, set_up
from stepcore.experiment.change import Change
from stepcore.experiment.engines import Engine
from stepcore.experiment.motion import Motion
from stepcore.experiment.motion_words import motion_in_words
from stepcore.experiment.pairs import Motions
from stepcore.experiment.schedule import HORIZON, scheduled
from stepcore.experiment.study import Study
from stepcore.measure.diagnosis.case import Case
from stepcore.measure.diagnosis.cures import longest_period
from stepcore.measure.diagnosis.inner_steps import InnerSteps, inner_steps
from stepcore.measure.diagnosis.limits import Limit
from stepcore.measure.diagnosis.result import Diagnosis
from stepcore.report import units
from stepcore.report.units import seconds

__all__ = ["Diagnosis", "diagnose"]

# The control period over the horizon, unless one step of the scene is longer.
PERIOD = 1 / 200
# The share of the time (`seconds`) for the runs that find limits; finding fixes takes the rest.
LIMITS = 0.6


@measurement(without=("starts",))
def diagnose(
    model: Source,
    motion: Motion | str | None = None,
    *,
    dt: float | str | None = None,
    integrators: Sequence[str] | None = None,
    engine: str = "stepcore",
    **fields: Unpack[MeasurementFields],
) -> Diagnosis:
    """Find the element that limits the time step, and changes that make a wanted step stable.

    The limit of an integrator is found by runs. A run makes the motion, then holds its last
    control, for at least 1000 steps in all; a perturbed run starts 1e-6 of the scene's size away.
    At 0.98 of the limit the run is stable. At 1.03 of it, the run diverges, gains energy, lets the
    perturbation grow without end, or chatters between bounds of forces where the motion rests.
    Both were run. `Diagnosis.held` is the limit of the linearised step (`Sim.linearize`) where the
    motion ends and is held.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name").
    motion: the `Motion`; or write its fields as arguments, except `starts`, because there is one
        start. The horizon is 1 s by default. If no controls are given, the motion is chosen from
        the model; see `Motion.kind`.
    dt: the wanted time step [s]; by default the scene's. If it is too long, changes are searched
        for, made and run. A model with adaptive steps has no such step: the result reports its
        inner steps and the bodies that make them short (`Diagnosis.inner`), and judges fixed steps
        of the mean length.
    integrators: the integrators to diagnose; by default all. The scene's is always among them.
    engine: runs the motion: "stepcore", or "mujoco" for the limits of MuJoCo, also of files that
        stepcore cannot load. The linearised step, and the elements that limit it, are stepcore's if
        it has a model of the file, and missing otherwise. Changes are not searched for.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    Raises ValueError for an argument outside its limits, for a scene in which nothing can move, and
    for a scene whose accelerations are not finite at the start.

    >>> from stepcore import Scene
    >>> scene = Scene().with_settings(dt=0.005, integrator="semi-implicit")
    >>> arm = scene.add_body("arm", pos=(0, 0, 1))
    >>> _ = scene.add_joint(arm, "slide", name="knee", stiffness=1e6)
    >>> _ = scene.add_geom(arm, "sphere", 0.1, mass=1.0)
    >>> d = diagnose(scene)
    >>> print(f"{1e3 * d.limit('semi-implicit'):.2f} ms by the {d.stiffest('semi-implicit')}")
    2.00 ms by the spring of joint `knee`
    """
    setup = set_up(diagnose, model, motion, fields, missing="no step to diagnose", engine=engine)
    for name in integrators or ():
        checks.one_of(*setup.engine.integrators)("diagnose", "integrators", name)
    shipped, workers = setup.engine.shipped, setup.workers
    if setup.motion.control is not None:
        # A control function may keep state between calls, which belongs to a single run.
        workers = dataclasses.replace(workers, threads=1)
    horizon = setup.motion.horizon or HORIZON
    setup = setup._replace(
        motion=dataclasses.replace(setup.motion, horizon=horizon), workers=workers
    )
    inner = _inner_steps(setup) if shipped.accuracy is not None else None
    wanted = inner.mean if inner else float(shipped.dt)
    if dt is not None:
        wanted = units.time("dt", dt)
    study = _study(setup)
    sampled = None if setup.motion.control is None else setup.motion.control_dt
    case = Case(Motions(study.engine, study.schedule, study.size, wanted, sampled), wanted)
    own = shipped.integrator
    others = [n for n in _able(study) if n != own and (integrators is None or n in integrators)]
    limits, observed = dict[str, Limit](), None
    with workers.deadline.stage(f"the limit under {own}, beyond the steps that hold"):
        observed = case.observed(own)
        # Finding the cause of a failure takes less time than finding the limit.
        case.failing_controls(own)
        limits[own] = case.limit(own)
    if own not in limits:
        with workers.deadline.closing():
            limits[own] = case.unfinished(own)
    limits |= _other_limits(case, limits[own], others, setup)
    named = dict.fromkeys(limits, tuple[Element, ...]())
    with workers.deadline.stage("the names of all elements that limit dt"):
        for name, limit in limits.items():
            named[name] = case.limiters(limit)
    with workers.deadline.closing():
        rows = case.figures(named[own], limits[own].state)
    result = Diagnosis(
        name=setup.name,
        settings=study.engine.shipped,
        motion=setup.motion,
        wanted=wanted,
        states=case.states,
        limits=limits,
        limiters=named,
        rows=rows,
        physical=max((float(h.rates.real.max(initial=0.0)) for h in case.linearised), default=0.0),
        ran=_motion_in_words(setup, study, sampled),
        observed=observed,
        runaway=case.judge.runaway,
        confirmed=case.judge.confirmed,
        covered=case.judge.fine,
        inner=inner,
        engine=setup.engine.version,
        notes=[*study.schedule.notes, *_left_out(setup.engine)],
    )
    with workers.deadline.stage("which servos saturate"):
        result.saturated = case.saturated(limits[own], named[own])
    if sampled is not None and case.controlled:
        with workers.deadline.stage("the longest control period"):
            short = min(wanted, sampled)
            result.longest_period = longest_period(case.judge, Change(integrator=own), short)
    if result.fails:
        with workers.deadline.stage("all changes that make the step stable"):
            for advice in case.advice(limits, named[own]):
                result.advice.append(advice)
        result.untried = tuple(case.untried)
    result.advice.sort(key=lambda advice: advice.rank)
    return result


def _inner_steps(setup: Setup) -> InnerSteps | None:
    """Return the inner steps of a model with adaptive steps; None if the time is over before."""
    inner, model, motion = None, setup.model, setup.motion
    with setup.workers.deadline.stage("what the steps are made of", LIMITS):
        period = motion.period(model.settings.dt) or model.settings.dt
        inner = inner_steps(model, scheduled(motion, model, period, starts=1))
    return inner


def _study(setup: Setup) -> Study:
    """Return the study of the motion from one start, with rows solved to rounding."""
    motion, dt = dataclasses.replace(setup.motion, starts=1), setup.engine.dt
    horizon = motion.horizon or HORIZON
    period = min(horizon, motion.period(dt) or max(dt, horizon * PERIOD))
    engine = setup.engine.converged()
    return Study(engine=engine, motion=motion, period=period, workers=setup.workers)


def _able(study: Study) -> Sequence[str]:
    """Return the integrators that the engine can run."""
    engine = study.engine
    if not engine.version:
        return engine.integrators
    changes = {name: Change(integrator=name) for name in engine.integrators}
    return [n for n, change in changes.items() if math.isfinite(study.work(change))]


def _other_limits(
    case: Case, shipped: Limit, others: Sequence[str], setup: Setup
) -> dict[str, Limit]:
    """Return the limits of other integrators that are found within the time."""
    deadline, limits = setup.workers.deadline, list[Limit | None]()
    if shipped.holds:
        longest = seconds(np.fmin(shipped.dt, shipped.holds))
        deadline.so_far(
            f"runs hold under {shipped.integrator} up to dt {longest}; the rest is run now"
        )

    def missing() -> str:
        made = {limit.integrator for limit in limits if limit is not None}
        return f"the limits under {', '.join(name for name in others if name not in made)}"

    with deadline.stage(missing, LIMITS):
        setup.workers.each(case.limit, others, "limits", limits)
    return {limit.integrator: limit for limit in limits if limit is not None}


def _motion_in_words(setup: Setup, study: Study, sampled: float | None) -> str:
    if not setup.engine.known:
        return study.motion_ran
    every = "" if sampled else "at every step"
    motion = motion_in_words(setup.model, setup.motion, study.schedule, every)
    return f"{motion}; in {setup.engine.version}" if setup.engine.version else motion


def _left_out(engine: Engine) -> list[str]:
    """Return notes on the parts that are missing with another engine than stepcore."""
    if not engine.version:
        return []
    linear = "the linearised step and the elements are those of stepcore's model"
    if not engine.known:
        linear = "stepcore cannot load the file, so no step is linearised and no element is named"
    return [f"limits by runs of {engine.version}; {linear}; changes are not searched for"]
