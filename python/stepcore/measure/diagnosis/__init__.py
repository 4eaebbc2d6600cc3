"""`diagnose`: which element limits the time step, by name, and what to change."""

from __future__ import annotations

import dataclasses
from concurrent.futures import Executor
from functools import partial
from typing import Unpack

from stepcore import checks
from stepcore.engine.linear_maps import INTEGRATORS
from stepcore.engine.model import Model
from stepcore.executors import each
from stepcore.experiment.motion import Motion, MotionFields
from stepcore.experiment.schedule import HORIZON, scheduled
from stepcore.experiment.setup import Source, set_up
from stepcore.experiment.starts import home
from stepcore.measure.diagnosis.advice import advise
from stepcore.measure.diagnosis.closed_form_bound import closed_form
from stepcore.measure.diagnosis.dt_limits import LONGEST, Limit, Situation, situation
from stepcore.measure.diagnosis.element_forces import INERTIAL, Key
from stepcore.measure.diagnosis.element_limits import ElementLimits, IsolatedElements
from stepcore.measure.diagnosis.linear_step import exact
from stepcore.measure.diagnosis.load import StiffnessWarning
from stepcore.measure.diagnosis.result import Diagnosis
from stepcore.measure.diagnosis.sentences import notes
from stepcore.measure.diagnosis.shares import shares_at
from stepcore.measure.diagnosis.solref import softened_beyond
from stepcore.measure.diagnosis.visited_states import eased, start, visited
from stepcore.report.progress import Choice, Progress
from stepcore.scene.layout import Layout

__all__ = ["Diagnosis", "StiffnessWarning", "diagnose"]

# The run to other states is made at this part of the least step that limits the start.
SAFE = 0.25


def diagnose(
    model: Source,
    motion: Motion | None = None,
    *,
    dt: float | None = None,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
    **fields: Unpack[MotionFields],
) -> Diagnosis:
    """Finds the element that limits the time step, by name, and what to change.

    The step is linearised (`Sim.linearize`) at the start and at some states along the motion; the
    largest stable dt is that at which an eigenvalue grows beyond what the motion itself does,
    found by bisection, for each integrator. The worst state decides.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name").
    dt: the step that is wanted [s]; by default the scene's own. Where it is not stable, each
        suggestion is made on a copy of the model and its step linearised again.
    motion: the `Motion` that is looked along, from one start; or write its fields as arguments.
        The horizon is 1 s by default. What neither grows nor decays by itself counts as unstable
        where a step makes it grow e-fold in this time. Without controls the motion begins at the
        keyframe's own (zero without one) and goes over to smooth seeded ones.
    threads, executor: integrators at once, or elsewhere. progress: as in `trade`.

    Raises ValueError for an argument outside its limits, a scene in which nothing can move, and
    one whose accelerations are not finite at the start.

    >>> from stepcore import Scene
    >>> scene = Scene().with_settings(dt=0.005, integrator="semi-implicit")
    >>> arm = scene.add_body("arm", pos=(0, 0, 1))
    >>> _ = scene.add_joint(arm, "slide", name="knee", stiffness=1e6)
    >>> _ = scene.add_geom(arm, "sphere", 0.1, mass=1.0)
    >>> d = diagnose(scene)
    >>> print(f"{1e3 * d.limit('semi-implicit'):.2f} ms by {d.stiffest('semi-implicit')}")
    2.00 ms by spring "knee"
    """
    # What loading would warn of is told here in full.
    setup = set_up(
        diagnose,
        model,
        motion,
        fields,
        missing="no step to diagnose",
        leaves=("starts",),
        threads=threads,
        executor=executor,
        progress=progress,
    )
    model, motion, workers = exact(setup.model), setup.motion, setup.workers
    wanted = model.settings.dt if dt is None else checks.seconds("dt", dt)
    horizon = HORIZON if motion.horizon is None else motion.horizon
    period = min(horizon, motion.control_dt or max(model.settings.dt, horizon / 200))
    motion = dataclasses.replace(motion, horizon=horizon)
    path = scheduled(motion, model, period, starts=1)
    if motion.ctrl is None and motion.control is None:
        path = eased(path, home(model, motion.key)[1])
    with Progress("states", 1, progress) as bar:
        visit = visited(model, path, _safe(model, situation(model, [start(model, path)], horizon)))
        here = situation(model, visit.states, horizon)
        bar.advance()
    longest = max(LONGEST, 2 * wanted, 2 * model.settings.dt)
    with Progress("limits", len(INTEGRATORS), progress) as bar:
        found = each(
            partial(_limit, here, longest),
            INTEGRATORS,
            bar=bar,
            threads=workers.threads,
            executor=workers.executor,
        )
    limits = {limit.integrator: limit for limit in found}
    elements = _elements(here)
    with Progress("shares", len(limits), progress) as bar:
        shares = dict(zip(limits, each(partial(shares_at, here), found, bar=bar), strict=True))
    own = model.settings.integrator
    advice = []
    if limits[own].dt < wanted and shares[own]:
        with Progress("advice", 1, progress) as bar:
            stiffest = max(shares[own], key=lambda k: shares[own][k])
            advice = advise(here, limits, elements, wanted, stiffest)
            bar.advance()
    return Diagnosis(
        name=model.scene.name or "scene",
        settings=model.settings,
        wanted=wanted,
        horizon=horizon,
        states=list(here.states),
        limits=limits,
        shares={name: {k.label: v for k, v in part.items()} for name, part in shares.items()},
        elements=list(elements.values()),
        advice=advice,
        notes=notes(model, visit, here, elements, horizon),
        rate=_rate(here, limits[own], wanted),
        physical=max(float(r.real.max(initial=0.0)) for r in here.rates),
    )


def _rate(here: Situation, limit: Limit, wanted: float) -> float | None:
    """How fast [1/s] the integrator makes the wanted step grow, where it is beyond the limit."""
    if wanted <= limit.dt:
        return None
    return here.grown(limit.integrator, wanted, limit.state).rate


def _limit(here: Situation, longest: float, integrator: str) -> Limit:
    return here.limit(integrator, longest)


def _safe(model: Model, first: Situation) -> float:
    """A step [s] at which the run to other states can be made."""
    limits = [first.limit("implicitfast").dt, closed_form(model).dt, model.settings.dt / SAFE]
    return max(SAFE * min(limits), 1e-9)


def _elements(here: Situation) -> dict[Key, ElementLimits]:
    """Every element's figures, at the state at which it is stiffest."""
    layout = Layout(here.model.scene)
    found: dict[Key, ElementLimits] = {}
    for k, state in enumerate(here.states):
        motion = here.parts(state)
        if motion is None:
            continue
        alone = IsolatedElements(motion, here.horizon, k)
        for key in motion.elements:
            if key == INERTIAL:
                continue
            one = alone.figures(key, softened_beyond(here.model, layout, key))
            if one.acts and (key not in found or _stiffness(one) > _stiffness(found[key])):
                found[key] = one
    return dict(sorted(found.items(), key=lambda pair: -_stiffness(pair[1])))


def _stiffness(one: ElementLimits) -> float:
    return max(one.omega, one.rate)
