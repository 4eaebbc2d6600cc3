"""`Diagnosis`: the result of `diagnose`, with its sentences, tables and data."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from stepcore import checks
from stepcore._core import Settings
from stepcore.engine.element import (
    EQUALITIES,
    FRICTION_LOSSES,
    INERTIAL,
    ROWS,
    Element,
    Elements,
    name_list,
)
from stepcore.experiment.judge import Outcome, Runaway
from stepcore.experiment.motion import Motion
from stepcore.experiment.pairs import AMPLE, SHORTEST, Pair
from stepcore.measure.diagnosis.cures import MARGIN, Advice
from stepcore.measure.diagnosis.inner_steps import InnerSteps
from stepcore.measure.diagnosis.limits import HOLDS, STEP, Limit
from stepcore.measure.diagnosis.linear import VELOCITY_LAWS, State
from stepcore.measure.diagnosis.naming import Figures
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import counted, hertz, round_number, seconds, times
from stepcore.report.verdict import Verdict

DT, HELD = "largest stable dt [s]", "held pose [s]"
# The number of elements that are printed.
PRINTED = 6
# Frequencies and rates above this [1/s] belong to a state that blew up, and are not printed.
HIGH = 1e9
# Rows that can open.
OPEN = ("contact", "limit", "tendon limit")


@dataclass(eq=False, repr=False)
class Diagnosis(Result):
    """The elements that limit the time step of a scene; `stepcore.diagnose` returns it.

    settings: the settings of the scene, with constraint rows solved to rounding.
    motion: the motion; see `diagnose`. wanted: the time step in question [s].
    states: states of the motion at which the step was linearised, the last one at its end.
    limits: the largest stable dt, by integrator.
    limiters: by integrator, the elements that limit dt; several if no single element does. If
        nothing limits dt, the element of the fastest motion.
    rows: the figures of each element: first the limiting ones, then the others by frequency.
    advice: changes that make the wanted step stable. untried: changes not tried before the time
        was over.
    physical: the fastest growth of the motion itself [1/s].
    observed: the outcome of the wanted step; None if the motion blows up at every step.
    saturated: the limiting servos whose force saturates just above the limit.
    runaway: how the motion blows up at every step that was tried; None if it does not.
    confirmed: whether two short steps agree on the motion itself. covered: the converged motion.
    longest_period: the longest control period at which the wanted step is stable [s], inf beyond
        the horizon; None without a control function and a control_dt.
    inner: the inner steps of a model with adaptive steps; None for others.
    engine: the version of MuJoCo if it ran the motion; "" for stepcore.
    """

    kind = "diagnosis"
    units: ClassVar[Mapping[str, str]] = {
        "frequency": "Hz",
        "omega": "rad/s",
        "ratio": "1",
        "rate": "1/s",
        "softened": "s",
    }

    settings: Settings
    motion: Motion
    wanted: float
    states: list[State]
    limits: dict[str, Limit]
    limiters: dict[str, tuple[Element, ...]]
    rows: list[Figures]
    covered: Pair = field(repr=False)
    advice: list[Advice] = field(default_factory=list)
    untried: tuple[str, ...] = ()
    physical: float = 0.0
    observed: Outcome | None = None
    saturated: tuple[Element, ...] = ()
    runaway: Runaway | None = None
    confirmed: bool = True
    longest_period: float | None = None
    inner: InnerSteps | None = None
    engine: str = ""

    def __post_init__(self) -> None:
        self.notes = [*self._remarks(), *self.notes]

    @property
    def horizon(self) -> float:
        """Length of the motion [s]."""
        return self.motion.horizon or 0.0

    @property
    def own(self) -> Limit:
        """The limit of the scene's integrator."""
        return self.limits[self.settings.integrator]

    @property
    def fails(self) -> bool:
        """Whether the wanted step fails."""
        if self.observed is not None and not self.observed.holds:
            return True
        return self.own.dt < self.wanted

    def verdict(self) -> Verdict:
        """Return whether the wanted step is stable; undecided if the time was over before."""
        test = f"a stable step of {seconds(self.wanted)} under {self.own.integrator}"
        if self.fails:
            return Verdict(test, False, self._answer().rstrip("."))
        known = self.own.known or self.wanted <= self.own.holds
        return Verdict(test, True if known else None, self._answer().rstrip("."))

    @property
    def names_cause(self) -> bool:
        """Whether the wanted step fails, and its limit or the elements that cause it are known."""
        return self.fails and (math.isfinite(self.limit()) or bool(self.together()))

    def limit(self, integrator: str | None = None) -> float:
        """Return the largest stable dt [s] under an integrator (default: the scene's).

        Runs of the motion are stable at 0.98 of it and fail at 1.03; both were run. The value is
        inf if no step that was tried fails, 0 if none is stable, and NaN if the time was over
        before the limit was found. Raises ValueError for an integrator that was not diagnosed.
        """
        return self.limits[self._known(integrator)].dt

    def held(self, integrator: str | None = None) -> float:
        """Return the largest stable dt [s] of the linearised step where the motion ends.

        Special values and errors are as for `limit`.
        """
        return self.limits[self._known(integrator)].held

    def stiffest(self, integrator: str | None = None) -> str:
        """Return the name of the element that limits dt under an integrator (default: the scene's).

        It is the element whose softening raises the limit most. Equal elements that limit dt only
        as a group are named as a group (`together`). If nothing limits dt, the element of the
        fastest motion is named, or "".
        """
        return Elements(self._limiters(integrator)).together

    def together(self, integrator: str | None = None) -> list[str]:
        """Return the names of the elements that limit dt as a group, usually a single one."""
        return [element.name for element in self._limiters(integrator)]

    def limiting(self, integrator: str | None = None) -> Figures | None:
        """Return the figures of the element that `stiffest` names, or None."""
        elements = self._limiters(integrator)
        return next((row for row in self.rows if row.element in elements), None)

    def element(self, name: str) -> Figures | None:
        """Return the figures of the element with this name, or None if it never acts."""
        return next((row for row in self.rows if row.name == name), None)

    @property
    def _bounded(self) -> bool:
        """Whether saturation takes away the damping that the limiting element has.

        Saturation is not the cause if the linearised step has the limit of the runs, if the element
        has no damping, or if chatter saturates it.
        """
        row, limit = self.limiting(), self.own
        damped = row is not None and (row.ratio > 0 or row.rate > 0)
        return bool(self.saturated) and damped and limit.state < 0 and limit.outcome != "chatters"

    @property
    def _late(self) -> bool:
        """Whether a run just above the limit fails only after the motion."""
        limit = self.own
        return limit.outcome == "diverges" and limit.state < 0 and limit.time > self.horizon

    @property
    def _grows(self) -> bool:
        """Whether nearby motions diverge within the converged motion, and still are apart at its
        end: growth at one state may be lost again later.
        """
        apart = self.covered.apart
        calm = self.runaway is None and apart[-1] <= math.e * apart[0]
        return self.physical * self.covered.reached > 1 and not calm

    def _limiters(self, integrator: str | None) -> tuple[Element, ...]:
        name = self._known(integrator)
        elements = self.limiters[name]
        return () if math.isinf(self.limits[name].dt) and INERTIAL in elements else elements

    def _unknown(self) -> str:
        """Return the sentence about the runs if the limit is unknown."""
        limit, step = self.own, f"step of {seconds(self.wanted)}"
        integrator = limit.integrator
        if self.observed is None:
            does = f"Whether a {step} is stable under {integrator} is not known"
        elif self.observed.holds:
            does = f"A {step} is stable under {integrator} over {seconds(self.horizon)}"
        else:
            elements = self._limiters(None)
            fed = f", fed by {Elements(elements).together}" if elements else ""
            does = f"A {step} {self._failure(elements)} under {integrator}{fed}"
        tried = "no stable step was found"
        if limit.holds:
            holds, fails = seconds(limit.holds), seconds(limit.fails)
            tried = f"a step of {holds} holds, and the limit was not found"
            if math.isfinite(limit.fails):
                tried = f"{holds} holds, {fails} fails, and the limit was not found"
        return f"{does}; {tried} in the time available."

    def _known(self, integrator: str | None) -> str:
        name = self.settings.integrator if integrator is None else integrator
        if name not in self.limits:
            near = checks.nearest(str(name), self.limits)
            raise ValueError(f"integrator = {checks.shown(name)}: was not diagnosed{near}")
        return name

    # --- sentences --------------------------------------------------------------------------------

    @property
    def title(self) -> str:
        """The title of the report."""
        return f"{self.name}: what limits the time step"

    @property
    def head(self) -> str:
        """An empty string: the answer comes first, and a sentence describes the motion."""
        return ""

    @property
    def sentences(self) -> list[str]:
        """The sentences of the report: the answer, how runs and linear step differ, the advice."""
        return list(self._sentences())

    def _sentences(self) -> Iterator[str]:
        if self.inner is not None:
            yield from self.inner.sentences
            yield f"Steps of a fixed length, {seconds(self.wanted)} as these are on average:"
        if self.runaway is not None and self.own.dt > 0:
            yield self._blown_up(self.runaway)
        yield self._answer()
        yield from self._differs()
        if self._late:
            yield (
                f"Just above it the run diverges only after {seconds(self.own.time)}: which steps "
                f"hold for longer is not known; horizon={2 * math.ceil(self.own.time)} tells."
            )
            if self.fails and self._grows:
                growing = f"The motion itself grows: {self._growing()}"
                yield f"{growing}. stepcore check tells what drives it."
        if self.longest_period is not None and self.motion.control_dt is not None:
            yield self._period(self.longest_period, self.motion.control_dt)
        if self.fails:
            yield from self._advised()
        if self.ran:
            yield f"The motion: {self.ran}."
        if self.own.state > 0:
            state = self.states[self.own.state]
            acting = Elements(state.rows).summary
            where = (
                f", where {acting} {'acts' if len(state.rows) == 1 else 'act'}" if acting else ""
            )
            after = ", after the motion" * (state.time > self.horizon * (1 + 1e-9))
            yield f"The limiting state is {state.label}{after}{where}."

    def _answer(self) -> str:
        limit, step = self.own, f"A step of {seconds(self.wanted)}"
        if not limit.known:
            return self._unknown()
        elements, under = self._limiters(None), f"under {limit.integrator}"
        name = Elements(elements).together or "the motion as a whole"
        traits, fails = self._traits(elements), self._failure(elements)
        judged = f"judged over {seconds(self.horizon)} of motion"
        if not limit.ran:
            judged = "by the linearised step"
        if math.isinf(limit.dt):
            below = seconds(min(limit.longest, max(self.wanted, self.horizon / 10)))
            return f"No element limits dt below {below} {under}, {judged}."
        if limit.dt <= 0 and self.longest_period:
            return f"{step} {fails} {under}: the control function is sampled too rarely."
        if limit.dt <= 0:
            tried = f"every step tried unstable, down to {seconds(limit.shortest)}"
            return f"{step} {fails} {under}: {name}{traits} {_verb(elements, 'make')} {tried}."
        cause = f"{name}{traits} {_verb(elements, 'limit')} dt to {seconds(limit.dt)}"
        if elements and not self.motion.is_users and {e.kind for e in elements} == {"control"}:
            cause += " (the controller of stepcore's test motion, not of the model)"
        if not limit.ran:
            return f"{cause[0].upper()}{cause[1:]} {under}, {judged}."
        if self.fails and self.observed is not None and self.observed.holds:
            return f"{step} holds in this run {under}, but shorter ones fail: {cause}."
        if self.fails:
            return f"{step} {fails} {under}: {cause}."
        over = f"over {seconds(self.horizon)}"
        margin = limit.dt / self.wanted
        holds = f"{step} is stable {under} {over}, with a stability margin of {times(margin)}"
        accurate = "" if margin < AMPLE else " Accuracy ends before that: run stepcore trade."
        return f"{holds}: {cause}.{accurate}"

    def _traits(self, elements: Sequence[Element]) -> str:
        """Return frequency and damping of the limiting element in brackets, or that it saturates.

        While an element saturates, its frequency by itself has nothing to do with the limit.
        """
        if self.saturated and self.own.state < 0 and self.own.outcome == "chatters":
            return ""
        if self._bounded:
            return ", while saturated," if len(self.saturated) == len(elements) else ""
        row = self.limiting()
        if row is None:
            return ""
        if row.element.kind == "spin":
            state = self.states[row.state] if row.state < len(self.states) else None
            speed = 0.0 if state is None else float(abs(state.qvel).max())
            return f" (at {speed:.3g} rad/s)" if 0 < round(speed, 3) < HIGH else ""
        traits = []
        # An element damped 100 times critically has no frequency.
        if 0 < row.omega < HIGH and not row.ratio > 100:
            traits.append(f"{hertz(row.omega)}, {row.omega:.4g} rad/s")
            if not math.isnan(row.ratio):
                traits.append(f"damping ratio {round(row.ratio, 6):.2g}")
        elif 0 < row.rate < HIGH:
            traits.append(f"damping rate {row.rate:.4g}/s")
        first = ["the stiffest by itself"] if len(elements) > 1 else []
        return f" ({', '.join([*first, *traits])})" if traits else ""

    def _failure(self, elements: Sequence[Element]) -> str:
        seen, kinds = self.observed, {element.kind for element in elements}
        chatters = seen is not None and seen.kind == "chatters"
        if chatters or self.saturated or kinds & {*FRICTION_LOSSES}:
            # The force is bounded, so the motion stays finite.
            return "chatters"
        if seen is not None and seen.kind == "grows" and kinds & {*OPEN, *EQUALITIES}:
            return "rattles"
        if seen is not None and seen.kind == "diverges" and math.isfinite(seen.time):
            return f"explodes after {seconds(seen.time)}"
        return "explodes"

    def _differs(self) -> Iterator[str]:
        limit = self.own
        run, at_end = limit.dt, limit.held
        if not limit.ran or run == at_end or not run > 0 or math.isnan(at_end):
            return
        elements = self._limiters(None)
        if self.motion.control is not None and "control" in {of.kind for of in elements}:
            # The linearised step does not include the feedback of a user's function.
            return
        if limit.longest <= at_end if math.isinf(run) else 1 / STEP < at_end / run < STEP:
            return
        name, rows = limit.integrator, self.states[-1].rows
        words = "bears any step" if math.isinf(at_end) else f"bears {seconds(at_end)}"
        if at_end <= 0:
            words = "bears no step"
        if run < at_end:
            why = "the motion passes through other states than its end"
            servos = Elements(self.saturated)
            if self.saturated and limit.outcome == "chatters" and limit.state < 0:
                why = f"in longer steps {servos.name} {_verb(servos, 'jump')} between force bounds"
            elif self._bounded:
                has = "their force ranges" if len(servos) > 1 else "its force range"
                why = f"in longer steps {servos.name} {_verb(servos, 'reach')} {has}, "
                why += "where damping has no effect"
            elif limit.state >= 0:
                why = f"at {self.states[limit.state].label} the linearised step bears less"
            elif {element.kind for element in elements} & {*ROWS}:
                why = "rows open and close in the motion"
        else:
            why = "what grows there stays small"
            if self._grows:
                why = "the motion itself grows there, and grows faster in longer steps"
            if rows:
                why = f"there {Elements(rows).summary} {_verb(rows, 'act')}, and growth ends where "
                why += "rows open or slip"
        limited = f"no limit up to {seconds(limit.longest)}" if math.isinf(run) else seconds(run)
        yield (
            f"Runs show {limited}, while the linearised step at the end of the motion, held there, "
            f"{words} under {name}: {why}."
        )

    def _blown_up(self, runaway: Runaway) -> str:
        coarse, fine = (seconds(dt) for dt in runaway.dts)
        before, after = (seconds(time) for time in runaway.times)
        if runaway.alike:
            return (
                f"The motion itself blows up after {after}, at a step of {fine} as at {coarse}. No "
                "dt prevents that."
            )
        how = f": after {before} at {coarse}, after {after} at {fine}. These do not agree"
        if min(runaway.dts) < self.own.shortest:
            longest = seconds(max(*runaway.times, self.own.shortest))
            how = f", within {longest} but at different times"
        cause = "the cause may be the step or the motion"
        return f"The motion blows up at every step tried{how}: {cause}."

    def _period(self, longest: float, asked: float) -> str:
        stable = f"a period of up to {seconds(longest)} is stable"
        if math.isinf(longest):
            stable = "every period is stable"
        elif longest <= 0:
            stable = "no period is stable, however short"
        held = f"The control function is sampled every {seconds(asked)}"
        return f"{held}; at steps of {seconds(min(self.wanted, asked))} {stable}."

    def _advised(self) -> Iterator[str]:
        met = [advice.text for advice in self.advice if advice.met]
        failed = [advice.text for advice in self.advice if not advice.met]
        wanted, limit = seconds(self.wanted), self.own.dt
        if met:
            over = f" over {seconds(self.horizon)}" * self._late
            yield (
                f"Any one of these changes makes {wanted} stable{over} with a margin of "
                f"{times(MARGIN)}:"
            )
            yield from (f"- {text}" for text in met)
            yield (
                "Each was made, and the same motion run. The smallest change comes first, hardware "
                "last."
            )
        elif failed:
            left = f" ({len(failed)} tried, {len(self.untried)} not tried)" * bool(self.untried)
            yield f"No change that was tried makes {wanted} stable{left}."
        elif not self.engine:
            yield f"Which changes make {wanted} stable is not known: none was run."
        if failed:
            yield f"Tried without success: {', '.join(failed)}."
        if self.untried:
            yield f"Not tried in the time available: {', '.join(self.untried)}."
        if 0 < limit < math.inf and self.runaway is None and not self._late:
            safe = round_number(min(limit, self.wanted) / MARGIN, up=False)
            yield f"Unchanged, the scene needs a step of {seconds(safe)} for the same margin."

    def _remarks(self) -> Iterator[str]:
        fine, limit = self.covered, self.own
        labels = ", ".join(state.label for state in self.states) or "no state"
        if fine.dt >= limit.shortest:
            yield (
                f"compared with runs at dt {seconds(fine.dt)} under implicitfast, "
                f"{seconds(fine.reached)} long; linearised at {labels}"
            )
        if fine.failure and fine.dt >= limit.shortest:
            yield f"these runs ended early: {fine.failure}"
        elif fine.reached < 0.99 * self.horizon:
            yield "the whole motion at so short a step would take too many operations"
        if 0 < limit.dt < math.inf and limit.ran:
            yield f"runs hold at {seconds(HOLDS * limit.dt)}, and fail just above the limit"
        if limit.erratic is not None:
            low, high = map(seconds, limit.erratic)
            yield f"between {low} and {high} stability is erratic: some steps hold and others fail"
        if not self.confirmed and self.runaway is None:
            yield "no two short steps agree on the motion itself"
        if self._grows and not (self._late and self.fails):
            yield self._growing()
        soft = [row for row in self.rows if math.isfinite(row.softened)]
        if soft:
            least = min(row.softened for row in soft)
            names = name_list([row.name for row in soft if row.softened == least])
            yield (
                f"above dt {seconds(max(least, limit.shortest))} the setting refsafe (MuJoCo's) "
                f"softens {names}; refsafe=False, or a solref of negative numbers, keeps the "
                "stiffness"
            )
        if self.settings.law in VELOCITY_LAWS:
            yield (
                f"under the law {self.settings.law} the stiffness of a row is 1/dt², so rows do "
                "not limit dt"
            )

    def _growing(self) -> str:
        if self.physical * SHORTEST > 1:
            return (
                f"at some state nearby motions diverge e-fold in less than {seconds(SHORTEST)}, "
                "faster than any step that is tried: check masses and gains"
            )
        doubling = f"nearby motions diverge, doubling every {seconds(math.log(2) / self.physical)}"
        if self.confirmed if self.runaway is None else self.runaway.alike:
            return (
                f"{doubling} at the fastest, as where a body falls, balances or is driven; two "
                "fine steps agree, so this is physical, and no dt changes it"
            )
        return f"{doubling} at some state; no finer step confirms that this is physical"

    # --- tables and data --------------------------------------------------------------------------

    def text(self, width: int | None = None, full: bool = False) -> str:
        """Return the report, which starts with the answer.

        width: as in `Result.text`. full: whether to list every element.
        """
        return dataclasses.replace(self.report(full), title="").text(width, full)

    @property
    def table(self) -> Table:
        """The figures of the elements, those that limit dt first.

        The columns are: frequency [Hz], omega [rad/s], ratio (damping ratio), rate (the element's
        damping over the mass that it moves [1/s]), softened (the dt [s] above which refsafe softens
        the element), state (at which the element is stiffest), kind and index (as data).
        """
        return Table([self._record(row) for row in self.rows], columns=COLUMNS)

    def _record(self, row: Figures) -> dict[str, Any]:
        omega = row.omega if row.omega < HIGH else None
        return {
            "element": row.name,
            "frequency": None if omega is None else omega / (2 * math.pi),
            "ratio": None if math.isnan(row.ratio) else row.ratio,
            "rate": row.rate if row.rate < HIGH else None,
            "omega": omega,
            "softened": row.softened if math.isfinite(row.softened) else None,
            "state": self.states[row.state].label,
            "kind": row.element.kind,
            "index": row.element.index,
        }

    def tables(self, full: bool) -> list[Table]:
        """Return the limits by integrator, and the figures of the elements.

        full: whether to list every element, not only the first ones.
        """
        limits = list(self.limits.values())
        together = Table(
            (self._limit_record(limit) for limit in limits),
            formats={DT: ".3g", HELD: ".3g"},
            heading=f"By integrator (* the scene's, at dt {self.wanted:g} s)",
            legend=self._extremes(),
        )
        if not self.rows:
            return [together]
        rows = self.rows if full or len(self.rows) <= PRINTED + 1 else self.rows[:PRINTED]
        left = len(self.rows) - len(rows)
        more = f"Not shown: {counted(left, 'other element')} (--all; in Python text(full=True))."
        alone = Table(
            [self._record(row) for row in rows],
            columns=COLUMNS if full else COLUMNS[:4],
            # Names are never truncated: a narrow report drops columns first.
            formats={"element": "", "frequency": ".4g", "ratio": ".2g", "rate": ".4g"},
            heading="Each element on its own: frequency [Hz], damping ratio, damping rate [1/s]",
            legend=more if left else "",
        )
        return [together, alone]

    def _limit_record(self, limit: Limit) -> dict[str, Any]:
        name, fails = limit.integrator, limit.outcome
        if limit.erratic is not None:
            fails += f" (erratic up to {seconds(limit.holds)})"
        return {
            "integrator": name + (" *" if name == self.settings.integrator else ""),
            DT: limit.dt if limit.known else None,
            HELD: limit.held,
            "by": self.stiffest(name) if math.isfinite(limit.dt) else "",
            "fails": fails,
        }

    def _extremes(self) -> str:
        every = [x for limit in self.limits.values() for x in (limit.dt, limit.held)]
        meanings = []
        if any(limit <= 0 for limit in every):
            meanings.append(
                f"0: no step that was tried holds, down to {seconds(self.own.shortest)}."
            )
        if any(math.isinf(limit) for limit in every):
            longest = max(limit.longest for limit in self.limits.values())
            meanings.append(f"inf: no step that was tried fails, up to {seconds(longest)}.")
        if not self.own.known:
            meanings.append("Empty: not found in the time available.")
        return " ".join(meanings)

    def details(self) -> dict[str, Any]:
        """Return data specific to this measurement."""
        limits = {
            name: {
                "dt": limit.dt,
                "held": limit.held,
                "limited": math.isfinite(limit.dt) if limit.known else None,
                "stiffest": self.stiffest(name),
                "together": self.together(name),
                "state": limit.state,
                "longest": limit.longest,
                "holds": limit.holds,
                "fails": limit.fails,
                "erratic": limit.erratic,
                "outcome": limit.outcome,
            }
            for name, limit in self.limits.items()
        }
        states = [
            {"label": s.label, "time": s.time, "rows": [e.name for e in s.rows]}
            for s in self.states
        ]
        plain = (
            *("wanted", "advice", "physical", "ran", "horizon", "observed", "saturated", "runaway"),
            *("longest_period", "confirmed", "fails", "untried"),
        )
        return {"limits": limits, "states": states} | {name: getattr(self, name) for name in plain}


COLUMNS = ("element", "frequency", "ratio", "rate", "omega", "softened", "state", "kind", "index")


def _verb(elements: Sequence[Element], verb: str) -> str:
    if len(elements) > 1 or INERTIAL in elements:
        return verb
    return verb + ("es" if verb.endswith("ch") else "s")
