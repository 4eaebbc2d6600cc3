"""`diagnose` names the element that limits the time step, and the changes that raise the limit."""

from __future__ import annotations

import dataclasses
from concurrent.futures import Executor
from functools import partial
from typing import Unpack

import numpy as np

from stepcore.engine.element import INERTIAL, Element
from stepcore.engine.linear_maps import INTEGRATORS
from stepcore.experiment.arguments import Source, set_up
from stepcore.experiment.motion import Motion, MotionFields, takes_motion
from stepcore.experiment.motion_words import motion_in_words
from stepcore.experiment.schedule import HORIZON
from stepcore.measure.diagnosis.advice import advise
from stepcore.measure.diagnosis.control import KIND
from stepcore.measure.diagnosis.control_advice import advise_control, longest_period
from stepcore.measure.diagnosis.elements import softened_from
from stepcore.measure.diagnosis.isolated import ElementLimits, IsolatedElements
from stepcore.measure.diagnosis.limits import (
    LONGEST,
    SHORTEST,
    Limit,
    StepStability,
    dt_limit,
)
from stepcore.measure.diagnosis.linear_step import with_converged_rows
from stepcore.measure.diagnosis.motion_check import Judge, judge
from stepcore.measure.diagnosis.motion_limit import judged_limit
from stepcore.measure.diagnosis.motion_runs import MotionRuns
from stepcore.measure.diagnosis.result import Diagnosis
from stepcore.measure.diagnosis.saturation import holds_when_kicked, kicked, look
from stepcore.measure.diagnosis.shares import limiters
from stepcore.measure.diagnosis.stiffness_warning import StiffnessWarning
from stepcore.measure.diagnosis.visited_states import visit
from stepcore.measure.diagnosis.words import gentle_chatter, notes
from stepcore.report import units
from stepcore.report.progress import Choice

__all__ = ["Diagnosis", "StiffnessWarning", "diagnose"]


@takes_motion(without=("starts",))
def diagnose(
    model: Source,
    motion: Motion | None = None,
    *,
    dt: float | str | None = None,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
    **fields: Unpack[MotionFields],
) -> Diagnosis:
    """Find the element that limits the time step, and changes that make a wanted step stable.

    The step is linearised (`Sim.linearize`) at the start and at some states along the motion. The
    largest stable dt is the step above which an eigenvalue grows faster than the motion itself. It
    is found by bisection for each integrator, and the worst state decides.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name").
    motion: the `Motion` along which the states lie; or write its fields as arguments, except
        `starts`, because there is one start. The horizon is 1 s by default; a motion that neither
        grows nor decays by itself counts as unstable if a step makes it grow e-fold in this time.
        If no controls are given, the motion begins with those of the keyframe (zero without one)
        and blends into smooth random ones.
    dt: the wanted time step [s]; by default the scene's own. If it is unstable, each suggestion is
        made on a copy of the model and verified on its linearised step.
    threads: the number of integrators that are diagnosed in parallel (default: one per core).
    executor: any concurrent.futures executor, used in place of threads.
    progress: False for no bar, or a function of (label, done, total).

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
    setup = set_up(
        diagnose,
        model,
        motion,
        fields,
        missing="no step to diagnose",
        threads=threads,
        executor=executor,
        progress=progress,
    )
    workers, model = setup.workers, with_converged_rows(setup.model)
    settings, own = model.settings, model.settings.integrator
    wanted = settings.dt if dt is None else units.time("dt", dt)
    horizon = setup.motion.horizon or HORIZON
    motion = dataclasses.replace(setup.motion, horizon=horizon)
    with workers.bar("states", 1) as bar:
        visited = visit(model, motion, horizon)
        bar.advance()
    here = visited.here
    longest = max(LONGEST, 2 * wanted, 2 * settings.dt)
    shortest = min(SHORTEST, wanted / 2, settings.dt / 2)
    limit_of = partial(dt_limit, here, longest=longest, shortest=shortest)
    linear = workers.each(limit_of, INTEGRATORS, "limits")
    elements = _element_limits(here)
    check = None
    if not any(state.feedback is not None and state.feedback.order for state in here.states):
        # A run with other steps would give a control function with memory another history.
        check = judge(MotionRuns(model, visited.driven, horizon), visited.dt)
    by = check if isinstance(check, Judge) else None
    judged = workers.each(partial(judged_limit, here, by, wanted), linear, "motion")
    limits = {limit.integrator: limit for limit, _ in judged}
    shares = {limit.integrator: its_shares for limit, its_shares in judged}
    seen = look(check, limits[own], shares[own], wanted)
    limits[own], shares[own] = seen.limit, seen.shares
    if by is not None and any(servo.severe and not servo.reached for servo in seen.saturations):
        # The kick that causes severe chatter is repeated under the other integrators stable at dt.
        for name in limits:
            if name != own and wanted <= limits[name].dt:
                limits[name], shares[name], _ = kicked(by, limits[name], shares[name], wanted)
    if by is not None:
        here = dataclasses.replace(here, holds=partial(holds_when_kicked, by))
    limiting = {name: limiters(here, limits[name], shares[name]) for name in limits}
    advice = []
    if limits[own].dt < wanted and limiting[own]:
        with workers.bar("advice", 1) as bar:
            advice = advise(here, limits, elements, wanted, limiting[own])
            if limiting[own][0].kind == KIND:
                advice += advise_control(here, limiting[own], wanted, limits[own].state)
                advice.sort(key=lambda a: (not a.met, a.size))
            bar.advance()
    confirmed = check is not None and check.confirmed
    gentle = [servo for servo in seen.saturations if not (servo.reached or servo.severe)]
    often = "" if motion.control_dt else "at every step"
    return Diagnosis(
        name=setup.name,
        settings=settings,
        motion=motion,
        wanted=wanted,
        states=list(here.states),
        limits=limits,
        element_shares=shares,
        limiters=limiting,
        rows=list(elements.values()),
        advice=advice,
        notes=[
            *notes(visited, list(elements.values()), horizon, confirmed),
            *map(gentle_chatter, gentle),
        ],
        rate=_rate(here, limits[own], wanted),
        ran=motion_in_words(
            model, motion, visited.schedule, often, ", blended in over the first quarter"
        ),
        longest_period=_longest_period(here, own, wanted, motion),
        physical=max(float(rates.real.max(initial=0.0)) for rates in here.rates),
        observed=seen.outcome,
        saturations=seen.saturations,
        lasting=seen.lasting,
        runaway=seen.runaway,
    )


def _rate(here: StepStability, limit: Limit, wanted: float) -> float | None:
    """Return the growth [1/s] that the integrator causes at an unstable wanted step, or None."""
    if wanted <= limit.dt:
        return None
    rate = here.growth(limit.integrator, wanted, limit.state).rate
    return rate if rate > 0 else None


def _longest_period(
    here: StepStability, integrator: str, dt: float, motion: Motion
) -> float | None:
    """Return the longest stable control period [s], or None without feedback or a control_dt."""
    if motion.control_dt is None or not any(state.feedback for state in here.states):
        return None
    return longest_period(here, integrator, min(dt, motion.control_dt), here.horizon)


def _element_limits(here: StepStability) -> dict[Element, ElementLimits]:
    """Return each element's limits at the state where it is stiffest, the stiffest first."""
    elements: dict[Element, ElementLimits] = {}
    for k, state in enumerate(here.states):
        motion = here.motion(state)
        if motion is None:
            continue
        try:
            isolated = IsolatedElements(motion, here.horizon, k)
        except np.linalg.LinAlgError:
            # The mass matrix is singular to rounding.
            continue
        for element in motion.elements:
            if element == INERTIAL:
                continue
            limits = isolated.limits(element, softened_from(here.model, element))
            known = elements.get(element)
            if limits.acts and (known is None or limits.stiffness > known.stiffness):
                elements[element] = limits
    return dict(sorted(elements.items(), key=lambda pair: -pair[1].stiffness))
