"""`diagnose` names the element that limits the time step, and the changes that raise the limit."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Unpack

import numpy as np

from stepcore import checks
from stepcore.deadline import Deadline, current
from stepcore.engine.element import INERTIAL, Element
from stepcore.engine.linear_maps import INTEGRATORS
from stepcore.engine.stiffness import slack_lengths
from stepcore.executors import checkpoint
from stepcore.experiment.arguments import MeasurementFields, Source, measurement, set_up
from stepcore.experiment.change import Change
from stepcore.experiment.motion import Motion
from stepcore.experiment.motion_words import motion_in_words
from stepcore.experiment.schedule import HORIZON, scheduled
from stepcore.measure.diagnosis.cures import Advice, Search, longest_period, other_integrators
from stepcore.measure.diagnosis.inner_steps import InnerSteps, inner_steps
from stepcore.measure.diagnosis.limits import FAILS, STEP, Limit, held_limits, run_limit
from stepcore.measure.diagnosis.linear import (
    FINE,
    Held,
    acting_elements,
    every_element,
    shares,
    visited,
)
from stepcore.measure.diagnosis.naming import (
    Figures,
    equals,
    figures,
    linear_limiters,
    run_limiters,
)
from stepcore.measure.diagnosis.result import Diagnosis
from stepcore.measure.diagnosis.running import (
    LONGEST,
    SHORTEST,
    Judge,
    Loop,
    Motions,
    Outcome,
    State,
    with_converged_rows,
)
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
    for name in integrators or ():
        checks.one_of(*INTEGRATORS)("diagnose", "integrators", name)
    setup = set_up(diagnose, model, motion, fields, missing="no step to diagnose")
    workers, compiled, shipped = setup.workers, setup.model, setup.model.settings
    if setup.motion.control is not None:
        # A control function may keep state between calls, which belongs to a single run.
        workers = dataclasses.replace(workers, threads=1)
    motion = dataclasses.replace(setup.motion, horizon=setup.motion.horizon or HORIZON)
    horizon = motion.horizon or HORIZON
    inner: InnerSteps | None = None
    if shipped.accuracy is not None:
        with workers.deadline.stage("what the steps are made of", LIMITS):
            period = motion.period(shipped.dt) or shipped.dt
            inner = inner_steps(compiled, scheduled(motion, compiled, period, starts=1))
    converged = with_converged_rows(compiled.with_settings(accuracy=None))
    wanted = inner.mean if inner else shipped.dt
    if dt is not None:
        wanted = units.time("dt", dt)
    period = min(horizon, motion.period(shipped.dt) or max(shipped.dt, horizon * PERIOD))
    schedule = scheduled(motion, converged, period, starts=1)
    sampled = None if motion.control is None else motion.control_dt
    case = Case(Motions(converged, schedule, setup.engine.size, wanted, sampled), wanted)
    own = shipped.integrator
    others = [n for n in INTEGRATORS if n != own and (integrators is None or n in integrators)]
    limits, observed = dict[str, Limit](), None
    with workers.deadline.stage(f"the limit under {own}, beyond the steps that hold"):
        observed = case.observed(own)
        # Finding the cause of a failure takes less time than finding the limit.
        case.fed(own)
        limits[own] = case.limit(own)
    if own not in limits:
        with workers.deadline.closing():
            limits[own] = case.known(own)
    if limits[own].holds:
        longest = seconds(np.fmin(limits[own].dt, limits[own].holds))
        workers.deadline.so_far(f"runs hold under {own} up to dt {longest}; the rest is run now")
    found: list[Limit | None] = []

    def missing() -> str:
        known = {limit.integrator for limit in found if limit is not None}
        return f"the limits under {', '.join(name for name in others if name not in known)}"

    with workers.deadline.stage(missing, LIMITS):
        workers.each(case.limit, others, "limits", found)
    limits |= {limit.integrator: limit for limit in found if limit is not None}
    named = dict.fromkeys(limits, tuple[Element, ...]())
    with workers.deadline.stage("the names of all elements that limit dt"):
        for name, limit in limits.items():
            named[name] = case.limiters(limit)
    with workers.deadline.closing():
        rows = case.figures(named[own], limits[own].state)
    result = Diagnosis(
        name=setup.name,
        settings=converged.settings,
        motion=motion,
        wanted=wanted,
        states=case.states,
        limits=limits,
        limiters=named,
        rows=rows,
        physical=max(float(held.rates.real.max(initial=0.0)) for held in case.held),
        ran=motion_in_words(compiled, motion, schedule, "" if sampled else "at every step"),
        observed=observed,
        runaway=case.judge.runaway,
        confirmed=case.judge.confirmed,
        covered=case.judge.fine,
        inner=inner,
        notes=schedule.notes,
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


class Case:
    """One motion, its states, and its runs.

    motions: the runs. wanted: the step in question [s]. judge: the converged motion.
    controlled: whether a control function of the user may limit dt.
    states: states of the converged motion, the last at its end. held: the linearised step at each.
    untried: the changes that were not tried yet.
    """

    untried: Sequence[str] = ()

    def __init__(self, motions: Motions, wanted: float) -> None:
        self.motions, self.wanted = motions, wanted
        self.model, self.horizon = motions.of(Change()), motions.horizon
        settings, start = motions.model.settings, motions.first()
        near = Held(self.model, start, self.horizon).limit("implicitfast", settings.dt, fine=1.0)
        safe = min(max(near / 4, SHORTEST / 10), settings.dt)
        self.judge = Judge.calm(motions, safe)
        self.controlled = motions.users is not None
        if self.judge.runaway is not None and self.controlled:
            # If the motion without the function does not blow up, the function is the cause.
            alone = Judge.of(motions.without_control(), safe)
            self.controlled = alone.runaway is None
            if self.controlled:
                self.judge = Judge(motions, alone.fine, False)
        self.states, self.held = list[State](), list[Held]()
        for state in visited(motions, self.judge.fine, start):
            with contextlib.suppress(ValueError):
                self.held.append(Held(self.model, state, self.horizon))
                self.states.append(state)
        if not self.held:
            raise ValueError("the scene cannot be linearised: its accelerations are not finite")
        motions.keep_usual(self.judge.fine)

    def limit(self, integrator: str) -> Limit:
        limit = self._limit(integrator)
        return self._with_runs(limit, self.judge.tried(Change(integrator=integrator)))

    def _limit(self, integrator: str) -> Limit:
        near, change = self.motions.model.settings.dt, Change(integrator=integrator)
        dt, longest, ran = math.nan, LONGEST, self.judge.runaway is None
        short = self.judge.fine.dt
        if self.judge.loop is not None and not self.judge.outcome(change, short).holds:
            bears = self.held[-1].limit(integrator, near)
            return Limit(integrator, 0.0, bears, shortest=short)
        if ran and self.motions.costly and self.motions.users is None:
            # Run first: the linearised step of such a scene takes long and may not finish.
            dt, longest = run_limit(self.judge, change, [])
        if dt == 0 or (math.isinf(dt) and self.judge.outcome(change, self.wanted).holds):
            return Limit(integrator, dt, self.held[-1].limit(integrator, near), longest=longest)
        fine = FINE if math.isnan(dt) else FAILS - 1
        last, each = held_limits(self.held, integrator, near, fine)
        if not ran:
            dt = min(each)
            return Limit(integrator, dt, last, self._state(dt, each), ran=False)
        if math.isnan(dt):
            dt, longest = run_limit(self.judge, change, [last, *each])
        outcome = self.judge.outcome(change, FAILS * dt) if 0 < dt < math.inf else None
        if dt >= self.wanted and not self.judge.outcome(change, self.wanted).holds:
            # Failure is not monotonic in dt: a step below the limit fails.
            dt, _ = run_limit(self.judge, change, [], top=self.wanted)
            outcome = self.judge.outcome(change, self.wanted)
        limit = Limit(integrator, dt, last, self._state(dt, each), longest=longest)
        if outcome is None:
            return limit
        limit = dataclasses.replace(limit, outcome=outcome.kind, time=outcome.time)
        if outcome.kind == "chatters" and limit.state >= 0:
            # Only actuators chatter: any other element has this limit by chance.
            linear = linear_limiters(self.model, self.held[limit.state], integrator, dt)
            if {element.kind for element in linear} - {"actuator"}:
                return dataclasses.replace(limit, state=-1)
        return limit

    def known(self, integrator: str) -> Limit:
        """Return the steps run under an integrator before the time was over; its limit is NaN."""
        limit = Limit(integrator, math.nan, math.nan, ran=self.judge.runaway is None)
        return self._with_runs(limit, self.judge.tried(Change(integrator=integrator)))

    def _with_runs(self, limit: Limit, tried: dict[float, bool]) -> Limit:
        good = max((dt for dt, holds in tried.items() if holds), default=0.0)
        bad = min((dt for dt, holds in tried.items() if not holds), default=math.inf)
        longest = limit.longest if limit.known else max(tried, default=0.0)
        return dataclasses.replace(limit, longest=longest, holds=good, fails=bad)

    def _state(self, dt: float, each: Sequence[float]) -> int:
        """Return the index of the state whose linearised step has this limit; -1 if none has."""
        if not 0 < dt < math.inf:
            return -1
        gaps = [abs(math.log(one / dt)) if 0 < one < math.inf else math.inf for one in each]
        # Each of the two limits is uncertain by a factor of up to STEP.
        return int(np.argmin(gaps)) if min(gaps) <= 2 * math.log(STEP) else -1

    def limiters(self, limit: Limit) -> tuple[Element, ...]:
        """Return the elements that limit an integrator, or the fastest one if nothing does.

        An unknown limit has no elements except controls.
        """
        name, dt = limit.integrator, limit.dt
        controls = tuple(Element.of(self.motions.model, "control", k) for k in self.fed(name))
        if not limit.known:
            return controls
        if dt == math.inf or (dt <= 0 and not self.controlled):
            at = self.held[-1]
            own = list(shares(at, name, min(limit.longest, 1.0) if dt else self.wanted))
            # If no step is stable, softening one of several equal elements shows nothing.
            first = own[:1] if dt or not own else equals(self.model, own[0], own)
            return tuple(self._theirs(first))
        order = list(shares(self.held[max(limit.state, -1)], name, FAILS * dt))
        linear = tuple[Element, ...]()
        if limit.state >= 0:
            held = self.held[limit.state]
            # If a longer step was stable, the limit of the state names the elements.
            bears = held.limit(name, dt) if limit.holds > FAILS * dt else dt
            linear = linear_limiters(self.model, held, name, bears)
            alone = figures(held) if linear and limit.ran else {}
            known = [alone[e] for e in linear if e in alone and e.kind != "spin"]
            rates = [max(one.omega, one.rate) for one in known]
            # Runs must confirm an element whose limit by itself, 2/ω or 2/rate, is above 10 dt.
            if linear and (not rates or max(rates) * dt > 0.2):
                return tuple(self._theirs(self._seen(linear, limit)))
        nu = self.motions.model.nu if self.controlled else 0
        if self.judge.runaway is not None or dt <= 0:
            return tuple(Element.of(self.motions.model, "control", k) for k in range(nu))
        # A longer step may pull a rope taut that is slack in the converged motion.
        ropes = [Element.of(self.model, "tendon spring", k) for k in slack_lengths(self.model)]
        every = list(dict.fromkeys((*every_element(self.model, self.states), *ropes)))
        every.sort(key=lambda e: order.index(e) if e in order else len(order))
        if limit.outcome == "chatters":
            every.sort(key=lambda e: e.kind != "actuator")
        found = run_limiters(self.judge, every, name, dt, nu, linear)
        spins = [e for e in every if e.kind == "spin"]
        last = self._seen((*spins[:1], INERTIAL)[:1], limit)
        return tuple(self._theirs(found or self._lost(limit) or controls or last))

    def _seen(self, elements: tuple[Element, ...], limit: Limit) -> tuple[Element, ...]:
        """Return the elements, without inertial forces if the motion is too slow for those.

        In one step, a rotation at a rate ω grows by a factor of at most 1 + (ω dt)²/2.
        """
        states = self.states if limit.state < 0 else [self.states[limit.state]]
        fastest = max(float(np.abs(state.qvel).max(initial=0.0)) for state in states)
        dt = FAILS * limit.dt
        slow = self.motions.steps(dt) * (fastest * dt) ** 2 / 2 < 1
        return tuple(e for e in elements if not (slow and (e.kind == "spin" or e == INERTIAL)))

    def _lost(self, limit: Limit) -> tuple[Element, ...]:
        """Return contacts at the end of the converged motion that a run that gains energy has lost.

        There a body has passed through another one, and falls.
        """
        pair = self.motions.pair(Change(integrator=limit.integrator), FAILS * limit.dt)
        ran = pair.ran
        if limit.outcome != "gains energy" or ran is None or pair.failure:
            return ()
        own = (ran[name][0, -1] for name in ("qpos", "qvel", "ctrl", "act"))
        sim = State.of("", 0.0, own).sim(self.model)
        sim.forward()
        left = {e for e in self.states[-1].rows if e.kind == "contact"} - {*acting_elements(sim)}
        return tuple(sorted(left))

    def _theirs(self, elements: Sequence[Element]) -> Iterator[Element]:
        """Yield the elements, with servos of the default motion as controls of its motors."""
        for element in elements:
            ours = element.kind == "actuator" and element.index in self.motions.ours
            yield Element.of(self.motions.model, "control", element.index) if ours else element

    def observed(self, integrator: str) -> Outcome | None:
        """Return the outcome of the wanted step; None if the motion blows up at every step."""
        if self.judge.runaway is not None:
            return None
        return self.judge.outcome(Change(integrator=integrator), self.wanted)

    def fed(self, integrator: str) -> range:
        """Return the controls of a user's function if they make the wanted step fail.

        They do if it is stable, or fails only after the motion, under the controls of the converged
        motion.
        """
        seen, nu = self.observed(integrator), self.motions.model.nu
        if seen is None or seen.holds or self.motions.usual is None:
            return range(0)
        frozen = Loop(frozen=tuple(range(nu)))
        held = self.judge.outcome(Change(integrator=integrator), self.wanted, frozen)
        return range(nu if held.holds or seen.time < self.horizon < held.time else 0)

    def saturated(self, limit: Limit, elements: Sequence[Element]) -> tuple[Element, ...]:
        """Return the servos among elements whose force saturates just above a limit."""
        servos = [e for e in elements if e.kind == "actuator"]
        if not limit.ran or not servos or not 0 < limit.dt < math.inf:
            return ()
        full = self.motions.saturated(Change(integrator=limit.integrator), FAILS * limit.dt)
        return tuple(element for element in servos if full[element.index])

    def figures(self, limiting: Sequence[Element], state: int) -> list[Figures]:
        """Return frequency and damping of every element, those that limit first.

        state: the index of the limiting state, whose figures take precedence; -1 for none.
        """
        found: dict[Element, Figures] = {}
        with (current() or Deadline()).stage("the figures of the elements of some states"):
            for k in dict.fromkeys((max(state, 0), len(self.held) - 1, *range(len(self.held)))):
                checkpoint()
                found |= figures(self.held[k], k, found)
        rows = [dataclasses.replace(f, element=next(self._theirs([e]))) for e, f in found.items()]
        order = {element: k for k, element in enumerate(limiting)}
        return sorted(rows, key=lambda f: (order.get(f.element, len(order)), -f.omega, -f.rate))

    def advice(self, limits: dict[str, Limit], elements: Sequence[Element]) -> Iterator[Advice]:
        """Yield the changes that make the wanted step stable, and those that fail."""
        own = next(iter(limits.values()))
        at = self.held[own.state] if own.state >= 0 else self.held[-1]
        every = list(every_element(self.model, self.states))
        known = [e for e in elements if e != INERTIAL]
        linear = not own.ran or (own.state >= 0 and not self.controlled)
        search = Search(self.judge, own, at, linear, self.wanted, known, every, self.states)
        found = search.candidates()
        self.untried = [*(["another integrator"] if own.ran else []), *found]
        if not elements:
            self.untried.append("changes of the element that limits dt")
        if own.ran:
            # Always try the converged motion's integrator: it changes one word of the file.
            fine = "implicitfast"
            more = {} if fine in limits else {fine: self.limit(fine)}
            yield from other_integrators(search, limits | more)
            self.untried.pop(0)
        for what, make in found.items():
            advice = make()
            if advice is not None:
                yield advice
            self.untried.remove(what)
