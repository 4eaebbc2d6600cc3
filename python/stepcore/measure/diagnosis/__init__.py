"""`diagnose` names the element that limits the time step, and the changes that raise the limit."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Unpack

import numpy as np

from stepcore.engine.element import INERTIAL, Element
from stepcore.engine.linear_maps import INTEGRATORS
from stepcore.executors import checkpoint
from stepcore.experiment.arguments import MeasurementFields, Source, measurement, set_up
from stepcore.experiment.motion import Motion
from stepcore.experiment.motion_words import motion_in_words
from stepcore.experiment.schedule import HORIZON
from stepcore.measure.diagnosis.advice import Advice, ways
from stepcore.measure.diagnosis.circulation import circulation
from stepcore.measure.diagnosis.confirmation import Confirmation
from stepcore.measure.diagnosis.control import KIND
from stepcore.measure.diagnosis.control_advice import control_ways, longest_period
from stepcore.measure.diagnosis.elements import softened_from
from stepcore.measure.diagnosis.examination import Examination, examine
from stepcore.measure.diagnosis.held_elements import held
from stepcore.measure.diagnosis.inner_steps import InnerSteps, inner_steps
from stepcore.measure.diagnosis.isolated import ElementLimits, IsolatedElements
from stepcore.measure.diagnosis.limits import Limit, StepStability
from stepcore.measure.diagnosis.linear_step import with_converged_rows
from stepcore.measure.diagnosis.result import Diagnosis
from stepcore.measure.diagnosis.shares import limiters
from stepcore.measure.diagnosis.stiffness_warning import StiffnessWarning
from stepcore.measure.diagnosis.visited_states import visit
from stepcore.measure.diagnosis.words import gentle_chatter, notes
from stepcore.report import units

# The shares of the time (`seconds`) at which the run of inner steps and the limits of elements end.
INNER, ELEMENTS = 0.4, 0.85

__all__ = ["Diagnosis", "StiffnessWarning", "diagnose"]


@measurement(without=("starts",))
def diagnose(
    model: Source,
    motion: Motion | str | None = None,
    *,
    dt: float | str | None = None,
    **fields: Unpack[MeasurementFields],
) -> Diagnosis:
    """Find the element that limits the time step, and changes that make a wanted step stable.

    The step is linearised (`Sim.linearize`) at the start and at some states along the motion. The
    largest stable dt is the step above which an eigenvalue grows faster than the motion itself. It
    is found by bisection for each integrator, and the worst state decides.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name").
    motion: the `Motion` along which the states lie; or write its fields as arguments, except
        `starts`, because there is one start. The horizon is 1 s by default; a motion that neither
        grows nor decays by itself counts as unstable if a step makes it grow e-fold in this time.
        If no controls are given, the motion is chosen from the model; see `Motion.kind`.
    dt: the wanted time step [s]; by default the scene's own. If it is unstable, each suggestion is
        made on a copy of the model and verified on its linearised step. A model whose steps keep an
        accuracy has no such step: the result says what its steps are made of, and which bodies
        make them short (`Diagnosis.inner`), and judges fixed steps of the mean length.
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
    setup = set_up(diagnose, model, motion, fields, missing="no step to diagnose")
    horizon = setup.motion.horizon or HORIZON
    motion = dataclasses.replace(setup.motion, horizon=horizon)
    workers, model = setup.workers, setup.model
    inner: InnerSteps | None = None
    if model.settings.accuracy is not None:
        with workers.deadline.stage("what the steps are made of", INNER):
            inner = inner_steps(model, motion)
        model = model.with_settings(accuracy=None)
    model = with_converged_rows(model)
    settings, own = model.settings, model.settings.integrator
    wanted = inner.mean if inner else settings.dt
    if dt is not None:
        wanted = units.time("dt", dt)
    with workers.bar("states", 1) as bar:
        visited = visit(model, motion, horizon)
        bar.advance()
    # An answer needs the scene's own integrator, which therefore comes first.
    order, time = sorted(INTEGRATORS, key=lambda name: name != own), workers.deadline
    found = examine(model, visited, horizon, wanted, order, workers.each, time)
    here, limits, shares, seen, check = (
        found.here,
        found.limits,
        found.shares,
        found.seen,
        found.check,
    )
    elements: dict[Element, ElementLimits] = {}
    with time.stage("the limits of all elements", ELEMENTS):
        elements = _element_limits(here)
    with time.closing():
        limiting = {name: limiters(here, limits[name], shares[name]) for name in limits}
    advice: list[Advice] = []
    if limits[own].dt < wanted:
        with time.stage("all changes that make the step stable"), workers.bar("advice", 1) as bar:
            advice.extend(_advice(found, elements, limiting[own], motion))
            bar.advance()
    advice.sort(key=lambda a: a.rank)
    with time.closing():
        rate = _rate(here, limits[own], wanted)
        longest = _longest_period(here, own, wanted, motion)
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
        rows=_first_to_limit(elements, own, limiting[own]),
        advice=advice,
        notes=[
            *notes(visited, list(elements.values()), horizon, confirmed),
            *map(gentle_chatter, gentle),
            *held(here, list(elements.values()), limits[own]),
        ],
        rate=rate,
        ran=motion_in_words(model, motion, visited.schedule, often),
        longest_period=longest,
        physical=max(float(rates.real.max(initial=0.0)) for rates in here.rates),
        observed=seen.outcome,
        saturations=seen.saturations,
        lasting=seen.lasting,
        runaway=seen.runaway,
        circulation=circulation(here),
        gained=seen.gained,
        inner=inner,
    )


def _advice(
    found: Examination,
    elements: dict[Element, ElementLimits],
    limiting: Sequence[Element],
    motion: Motion,
) -> Iterator[Advice]:
    """Yield the changes that make the wanted step stable, and those that fail."""
    here, wanted = found.here, found.wanted
    confirmation = Confirmation(found, motion, here.horizon)
    yield from confirmation.integrators()
    limit = found.limits[found.model.settings.integrator]
    changes = list(ways(here, limit, elements, wanted, limiting))
    if limiting and limiting[0].kind == KIND:
        changes += control_ways(here, limiting, list(elements), wanted, motion)
    yield from confirmation.advice(changes)


def _first_to_limit(
    elements: dict[Element, ElementLimits], integrator: str, limiting: Sequence[Element]
) -> list[ElementLimits]:
    """Return the elements' limits, those that limit dt first, then by the limit of each alone."""
    return sorted(
        elements.values(),
        key=lambda row: (row.element not in limiting, row.limits[integrator], -row.stiffness),
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
            checkpoint()
            limits = isolated.limits(element, softened_from(here.model, element))
            known = elements.get(element)
            if limits.acts and (known is None or limits.stiffness > known.stiffness):
                elements[element] = limits
    return dict(sorted(elements.items(), key=lambda pair: -pair[1].stiffness))
