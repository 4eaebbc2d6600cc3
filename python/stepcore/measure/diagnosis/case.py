"""`Case`: one motion of a scene, its linearised steps, and its limits and elements by runs."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np

from stepcore.deadline import Deadline, current
from stepcore.engine.element import INERTIAL, Element
from stepcore.engine.stiffness import slack_lengths
from stepcore.executors import checkpoint
from stepcore.experiment.change import Change
from stepcore.experiment.judge import Judge, Outcome
from stepcore.experiment.pairs import LONGEST, SHORTEST, Loop, Motions
from stepcore.measure.diagnosis.cures import Advice, Search, other_integrators
from stepcore.measure.diagnosis.limits import FAILS, STEP, Limit, held_limits, run_limit
from stepcore.measure.diagnosis.linear import (
    FINE,
    Held,
    State,
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


class Case:
    """One motion, its states, and its runs.

    motions: the runs. wanted: the step in question [s]. judge: the converged motion.
    controlled: whether a control function of the user may limit dt.
    states: states of the converged motion, the last at its end; none without stepcore's model.
    linearised: the linearised step at each.
    untried: the changes that were not tried yet.
    """

    untried: Sequence[str] = ()

    def __init__(self, motions: Motions, wanted: float) -> None:
        self.motions, self.wanted, self.horizon = motions, wanted, motions.horizon
        self.controlled = motions.users is not None
        self.states, self.linearised = list[State](), list[Held]()
        if not motions.engine.known:
            # Nothing is known of the limit: the first step may be longer.
            self.judge = Judge.of(motions, motions.engine.dt / 4, smooth=True)
            return
        self.model, dt, start = motions.of(Change()), motions.engine.dt, State.first(motions)
        near = Held(self.model, start, self.horizon).limit("implicitfast", dt, fine=1.0)
        short = min(max(near / 4, SHORTEST / 10), dt)
        self.judge = self._judge(short)
        for state in visited(motions, self.judge.fine, start):
            with contextlib.suppress(ValueError):
                self.linearised.append(Held(self.model, state, self.horizon))
                self.states.append(state)
        if not self.linearised:
            raise ValueError("the scene cannot be linearised: its accelerations are not finite")
        motions.keep_usual(self.judge.fine)

    def _judge(self, short: float) -> Judge:
        judge = Judge.calm(self.motions, short)
        if judge.runaway is None or not self.controlled:
            return judge
        # If the motion without the function does not blow up, the function is the cause.
        alone = Judge.of(self.motions.without_control(), short)
        self.controlled = alone.runaway is None
        return Judge(self.motions, alone.fine, False) if self.controlled else judge

    @property
    def _by_runs(self) -> bool:
        """Whether changes of the scene can be run, which names elements and confirms changes."""
        return self.motions.engine.name == "stepcore"

    # --- limits -----------------------------------------------------------------------------------

    def limit(self, integrator: str) -> Limit:
        """Return the limit of an integrator."""
        return self._with_runs(self._limit(integrator))

    def unfinished(self, integrator: str) -> Limit:
        """Return the steps run under an integrator before the time was over; its limit is NaN."""
        return self._with_runs(
            Limit(integrator, math.nan, math.nan, ran=self.judge.runaway is None)
        )

    def _limit(self, integrator: str) -> Limit:
        judge, change = self.judge, Change(integrator=integrator)
        short, ran = judge.fine.dt, judge.runaway is None
        if judge.loop is not None and not judge.outcome(change, short).holds:
            return Limit(integrator, 0.0, self._limit_at_end(integrator), shortest=short)
        dt, longest = math.nan, LONGEST
        costly = self.motions.costly and self.motions.users is None
        if ran and (costly or not self.linearised):
            # Run first: the linearised step of such a scene takes long and may not finish.
            dt, longest = run_limit(judge, change, [])
        if dt == 0 or (math.isinf(dt) and judge.outcome(change, self.wanted).holds):
            return Limit(integrator, dt, self._limit_at_end(integrator), longest=longest)
        end, each = math.nan, list[float]()
        if self.linearised:
            fine = FINE if math.isnan(dt) else FAILS - 1
            end, each = held_limits(self.linearised, integrator, self.motions.engine.dt, fine)
        if not ran:
            dt = min(each, default=0.0)
            return Limit(integrator, dt, end, self._state(dt, each), ran=False)
        if math.isnan(dt):
            dt, longest = run_limit(judge, change, [end, *each])
        outcome = judge.outcome(change, FAILS * dt) if 0 < dt < math.inf else None
        if dt >= self.wanted and not judge.outcome(change, self.wanted).holds:
            # Failure is not monotonic in dt: a step below the limit fails.
            dt, _ = run_limit(judge, change, [], top=self.wanted)
            outcome = judge.outcome(change, self.wanted)
        limit = Limit(integrator, dt, end, self._state(dt, each), longest=longest)
        if outcome is None:
            return limit
        limit = dataclasses.replace(limit, outcome=outcome.kind, time=outcome.time)
        if outcome.kind == "chatters" and limit.state >= 0:
            # Only actuators chatter: any other element has this limit by chance.
            linear = linear_limiters(self.model, self.linearised[limit.state], integrator, dt)
            if {element.kind for element in linear} - {"actuator"}:
                return dataclasses.replace(limit, state=-1)
        return limit

    def _limit_at_end(self, integrator: str) -> float:
        """Return the limit of the linearised step at the end of the motion [s]; NaN without one."""
        if not self.linearised:
            return math.nan
        return self.linearised[-1].limit(integrator, self.motions.engine.dt)

    def _with_runs(self, limit: Limit) -> Limit:
        tried = self.judge.tried(Change(integrator=limit.integrator))
        good = max((dt for dt, holds in tried.items() if holds), default=0.0)
        bad = min((dt for dt, holds in tried.items() if not holds), default=math.inf)
        longest = limit.longest if limit.known else max(tried, default=0.0)
        return dataclasses.replace(limit, longest=longest, holds=good, fails=bad)

    def _state(self, dt: float, each: Sequence[float]) -> int:
        """Return the index of the state whose linearised step has this limit; -1 if none has."""
        if not each or not 0 < dt < math.inf:
            return -1
        gaps = [abs(math.log(x / dt)) if 0 < x < math.inf else math.inf for x in each]
        # Each of the two limits is uncertain by a factor of up to STEP.
        return int(np.argmin(gaps)) if min(gaps) <= 2 * math.log(STEP) else -1

    # --- elements ---------------------------------------------------------------------------------

    def limiters(self, limit: Limit) -> tuple[Element, ...]:
        """Return the elements that limit an integrator, or the fastest one if nothing does.

        An unknown limit has no elements except controls.
        """
        if not self.linearised:
            return ()
        name, dt = limit.integrator, limit.dt
        controls = self._controls(self.failing_controls(name))
        if not limit.known:
            return controls
        if dt == math.inf or (dt <= 0 and not self.controlled):
            longest = min(limit.longest, 1.0) if dt else self.wanted
            fastest = list(shares(self.linearised[-1], name, longest))
            # If no step is stable, softening one of several equal elements shows nothing.
            alone = dt or not fastest
            first = fastest[:1] if alone else equals(self.model, fastest[0], fastest)
            return tuple(self._with_controls(first))
        linear, certain = self._linear_limiters(limit)
        if certain or not self._by_runs:
            return tuple(self._with_controls(self._without_slow(linear, limit)))
        nu = self.motions.model.nu if self.controlled else 0
        if self.judge.runaway is not None or dt <= 0:
            return self._controls(range(nu))
        every = self._candidates(limit)
        limiting = run_limiters(self.judge, every, name, dt, nu, linear)
        spins = [e for e in every if e.kind == "spin"]
        last = self._without_slow((*spins[:1], INERTIAL)[:1], limit)
        return tuple(
            self._with_controls(limiting or self._lost_contacts(limit) or controls or last)
        )

    def _linear_limiters(self, limit: Limit) -> tuple[tuple[Element, ...], bool]:
        """Return the elements that limit the linearised step, and whether no run need confirm."""
        if limit.state < 0:
            return (), False
        name, dt, held = limit.integrator, limit.dt, self.linearised[limit.state]
        # If a longer step was stable, the limit of the state names the elements.
        longest = held.limit(name, dt) if limit.holds > FAILS * dt else dt
        linear = linear_limiters(self.model, held, name, longest)
        alone = figures(held) if linear and limit.ran else {}
        rows = [alone[e] for e in linear if e in alone and e.kind != "spin"]
        rates = [max(row.omega, row.rate) for row in rows]
        # Runs must confirm an element whose limit by itself, 2/ω or 2/rate, is above 10 dt.
        return linear, bool(linear) and (not rates or max(rates) * dt > 0.2)

    def _candidates(self, limit: Limit) -> list[Element]:
        """Return the elements that may limit the runs, the likeliest first."""
        state = self.linearised[max(limit.state, -1)]
        order = list(shares(state, limit.integrator, FAILS * limit.dt))
        # A longer step may pull a rope taut that is slack in the converged motion.
        ropes = [Element.of(self.model, "tendon spring", k) for k in slack_lengths(self.model)]
        every = list(dict.fromkeys((*every_element(self.model, self.states), *ropes)))
        every.sort(key=lambda e: order.index(e) if e in order else len(order))
        if limit.outcome == "chatters":
            every.sort(key=lambda e: e.kind != "actuator")
        return every

    def _without_slow(self, elements: tuple[Element, ...], limit: Limit) -> tuple[Element, ...]:
        """Return the elements, without inertial forces if the motion is too slow for those.

        In one step, a rotation at a rate ω grows by a factor of at most 1 + (ω dt)²/2.
        """
        states = self.states if limit.state < 0 else [self.states[limit.state]]
        fastest = max(float(np.abs(state.qvel).max(initial=0.0)) for state in states)
        dt = FAILS * limit.dt
        slow = self.motions.steps(dt) * (fastest * dt) ** 2 / 2 < 1
        return tuple(e for e in elements if not (slow and (e.kind == "spin" or e == INERTIAL)))

    def _lost_contacts(self, limit: Limit) -> tuple[Element, ...]:
        """Return contacts at the end of the converged motion that a run that gains energy has lost.

        There a body has passed through another one, and falls.
        """
        if limit.outcome != "gains energy":
            return ()
        pair = self.motions.pair(Change(integrator=limit.integrator), FAILS * limit.dt)
        ran = pair.ran
        if ran is None or pair.failure:
            return ()
        arrays = (ran[name][-1] for name in ("qpos", "qvel", "ctrl", "act"))
        sim = State.of("", 0.0, arrays).sim(self.model)
        sim.forward()
        left = {e for e in self.states[-1].rows if e.kind == "contact"} - {*acting_elements(sim)}
        return tuple(sorted(left))

    def _controls(self, indices: Sequence[int]) -> tuple[Element, ...]:
        return tuple(Element.of(self.motions.model, "control", k) for k in indices)

    def _with_controls(self, elements: Sequence[Element]) -> Iterator[Element]:
        """Yield the elements, with servos of the default motion as controls of its motors."""
        model = self.motions.model
        servos = self.motions.schedule.controls.servos
        driven = {model.index("actuator", servo.actuator) for servo in servos}
        for element in elements:
            added = element.kind == "actuator" and element.index in driven
            yield Element.of(model, "control", element.index) if added else element

    # --- the wanted step --------------------------------------------------------------------------

    def observed(self, integrator: str) -> Outcome | None:
        """Return the outcome of the wanted step; None if the motion blows up at every step."""
        if self.judge.runaway is not None:
            return None
        return self.judge.outcome(Change(integrator=integrator), self.wanted)

    def failing_controls(self, integrator: str) -> range:
        """Return the controls of a user's function if they make the wanted step fail.

        They do if it is stable, or fails only after the motion, under the controls of the converged
        motion.
        """
        outcome = self.observed(integrator)
        if outcome is None or outcome.holds or self.motions.usual is None or not self._by_runs:
            return range(0)
        nu = self.motions.model.nu
        frozen = Loop(frozen=tuple(range(nu)))
        usual = self.judge.outcome(Change(integrator=integrator), self.wanted, frozen)
        later = outcome.time < self.horizon < usual.time
        return range(nu if usual.holds or later else 0)

    def saturated(self, limit: Limit, elements: Sequence[Element]) -> tuple[Element, ...]:
        """Return the servos among elements whose force saturates just above a limit."""
        servos = [e for e in elements if e.kind == "actuator"]
        if not limit.ran or not servos or not 0 < limit.dt < math.inf:
            return ()
        pair = self.motions.pair(Change(integrator=limit.integrator), FAILS * limit.dt)
        return tuple(element for element in servos if pair.saturated[element.index])

    def figures(self, limiting: Sequence[Element], state: int) -> list[Figures]:
        """Return frequency and damping of every element, those that limit first.

        state: the index of the limiting state, whose figures take precedence; -1 for none.
        """
        by_element, count = dict[Element, Figures](), len(self.linearised)
        with (current() or Deadline()).stage("the figures of the elements of some states"):
            for k in dict.fromkeys((max(state, 0), count - 1, *range(count))) if count else ():
                checkpoint()
                by_element |= figures(self.linearised[k], k, by_element)
        rows = [
            dataclasses.replace(row, element=next(self._with_controls([element])))
            for element, row in by_element.items()
        ]
        order = {element: k for k, element in enumerate(limiting)}
        return sorted(rows, key=lambda f: (order.get(f.element, len(order)), -f.omega, -f.rate))

    def advice(self, limits: dict[str, Limit], elements: Sequence[Element]) -> Iterator[Advice]:
        """Yield the changes that make the wanted step stable, and those that fail."""
        if not self._by_runs:
            return
        shipped = next(iter(limits.values()))
        at = self.linearised[max(shipped.state, -1)]
        every = list(every_element(self.model, self.states))
        changeable = [e for e in elements if e != INERTIAL]
        linear = not shipped.ran or (shipped.state >= 0 and not self.controlled)
        of_step = at, linear, self.wanted, changeable, every, self.states
        search = Search(self.judge, shipped, *of_step)
        candidates = search.candidates()
        self.untried = [*(["another integrator"] if shipped.ran else []), *candidates]
        if not elements:
            self.untried.append("changes of the element that limits dt")
        if shipped.ran:
            # Always try the converged motion's integrator: it changes one word of the file.
            fine = "implicitfast"
            more = {} if fine in limits else {fine: self.limit(fine)}
            yield from other_integrators(search, limits | more)
            self.untried.pop(0)
        for what, make in candidates.items():
            advice = make()
            if advice is not None:
                yield advice
            self.untried.remove(what)
