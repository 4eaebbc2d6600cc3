"""`Diagnosis`: the result of `diagnose`, with its sentences, tables and data."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from stepcore import checks
from stepcore._core import Settings
from stepcore.engine.element import INERTIAL, Element, Elements
from stepcore.experiment.motion import Motion
from stepcore.measure.diagnosis import words
from stepcore.measure.diagnosis.advice import MARGIN, Advice
from stepcore.measure.diagnosis.circulation import Circulation
from stepcore.measure.diagnosis.inner_steps import InnerSteps
from stepcore.measure.diagnosis.isolated import ElementLimits
from stepcore.measure.diagnosis.limits import Limit
from stepcore.measure.diagnosis.linear_step import State
from stepcore.measure.diagnosis.motion_check import Outcome, Runaway
from stepcore.measure.diagnosis.saturation import Saturation
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import counted, percent, round_number, seconds, times

DT = "largest stable dt [s]"
# Number of elements printed by default.
PRINTED = 6
# From this stability margin on, accuracy and not stability limits dt.
AMPLE = 10.0
# From this share of its energy on, what the integrator adds to a motion is told.
GAINED = 0.01
# Growth by less than e to this power over the horizon is called slow, not an explosion.
SLOW = 10.0


@dataclass(eq=False, repr=False)
class Diagnosis(Result):
    """Which element limits the time step of a scene; `stepcore.diagnose` returns it.

    settings: the settings of the scene, with constraint rows solved to rounding.
    motion: the motion along which the states lie; see `diagnose`.
    wanted: the time step to judge [s].
    states: the states at which the step was linearised.
    limits: the largest stable dt, by integrator.
    element_shares: by integrator, each element's share in the mode that sets the limit, or in the
        fastest motion if nothing sets a limit.
    limiters: by integrator, the elements that limit dt; several where no single element does.
    rows: the elements, each on its own: those that limit dt, then the others by their own limit.
    advice: changes that make the wanted step stable.
    physical: the fastest growth of the motion itself [1/s].
    rate: the growth at the wanted step that the integrator causes [1/s]; None if the step is
        stable.
    observed: the outcome of the motion at the wanted step; None if that step is too long to judge.
    saturations: servos that chatter at the ends of their force ranges at the wanted step.
    lasting: the time [s], after the horizon, at which growth caused by the integrator explodes;
        None if there is none within ten horizons.
    runaway: how the motion blows up at every step tried; None if it does not.
    circulation: servos whose forces derive from no energy and make the motion grow; None if there
        are none.
    gained: the energy that the integrator adds at the wanted dt to a motion that nothing drives,
        over its largest kinetic energy.
    longest_period: the longest stable control period at the wanted step [s], inf beyond the
        horizon; None without a control function and a control_dt.
    inner: what the steps of a model that keeps an accuracy are made of; None of others.
    """

    kind = "diagnosis"
    units: ClassVar[Mapping[str, str]] = {
        "frequency": "Hz",
        "omega": "rad/s",
        "ratio": "1",
        "rate": "1/s",
        "share": "1",
        "softened": "s",
    }

    settings: Settings
    motion: Motion
    wanted: float
    states: list[State]
    limits: dict[str, Limit]
    element_shares: dict[str, dict[Element, float]]
    limiters: dict[str, tuple[Element, ...]]
    rows: list[ElementLimits]
    advice: list[Advice] = field(default_factory=list)
    physical: float = 0.0
    rate: float | None = None
    observed: Outcome | None = None
    saturations: list[Saturation] = field(default_factory=list)
    lasting: float | None = None
    runaway: Runaway | None = None
    longest_period: float | None = None
    circulation: Circulation | None = None
    gained: float = 0.0
    inner: InnerSteps | None = None

    @property
    def horizon(self) -> float:
        """Length of the motion [s], over which undamped growth counts."""
        return self.motion.horizon or 0.0

    def limit(self, integrator: str | None = None) -> float:
        """Return the largest stable dt [s] under an integrator (default: the scene's).

        The value is inf if nothing limits dt, and 0 if no step is stable. Raises ValueError for an
        integrator that was not diagnosed.
        """
        return self.limits[self._known(integrator)].dt

    def stiffest(self, integrator: str | None = None) -> str:
        """Return the name of the element that limits dt under an integrator (default: the scene's).

        This element has a share in the mode that sets the limit, and softening it raises the limit
        most. Equal elements that limit dt only as a group are named as a group (`together`). If
        nothing limits dt, the name is that of the element with the largest share in the fastest
        motion. It is "" if no element has a share.
        """
        return words.named(self._stiffest(self._known(integrator)))

    def together(self, integrator: str | None = None) -> list[str]:
        """Return the names of the elements that limit dt as a group, usually a single one."""
        return [element.name for element in self._stiffest(self._known(integrator))]

    def limiting(self, integrator: str | None = None) -> ElementLimits | None:
        """Return the limits of the element that `stiffest` names, on its own, or None."""
        elements = self._stiffest(self._known(integrator))
        return next((row for row in self.rows if row.element in elements), None)

    def _stiffest(self, integrator: str) -> tuple[Element, ...]:
        unlimited = math.isinf(self.limits[integrator].dt)
        elements = self.limiters[integrator]
        if elements and not (unlimited and INERTIAL in elements):
            return elements
        if unlimited:
            shares = dict(self.element_shares[integrator])
            shares.pop(INERTIAL, None)
            largest = max(shares, key=lambda element: shares[element], default=None)
            return (largest,) if largest is not None and shares[largest] else ()
        # A row that begins to act within the step has no share at its start.
        alone = [row for row in self.rows if math.isfinite(row.limits[integrator])]
        return (min(alone, key=lambda row: row.limits[integrator]).element,) if alone else ()

    def _known(self, integrator: str | None) -> str:
        name = self.settings.integrator if integrator is None else integrator
        if name not in self.limits:
            near = checks.nearest(str(name), self.limits)
            raise ValueError(f"integrator = {checks.shown(name)}: was not diagnosed{near}")
        return name

    def element(self, name: str) -> ElementLimits | None:
        """Return the limits of the element with this name, on its own, or None if it never acts."""
        return next((row for row in self.rows if row.name == name), None)

    @property
    def shares(self) -> dict[str, dict[str, float]]:
        """`element_shares` with the elements' names as keys."""
        return {
            integrator: {element.name: share for element, share in shares.items()}
            for integrator, shares in self.element_shares.items()
        }

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
        """The sentences of the report: the answer, the advice, and the limiting state."""
        return list(self._sentences())

    def _sentences(self) -> Iterator[str]:
        limit = self.limits[self.settings.integrator]
        if self.inner is not None:
            yield from self.inner.sentences
            yield f"Steps of a fixed length, {seconds(self.wanted)} as these are on average:"
        if self.runaway is not None:
            yield words.blown_up(self.runaway)
        if self.circulation is not None:
            yield words.circulatory(self.circulation)
        answer = self._answer(limit)
        if self.circulation is not None:
            answer = f"In the motion that grows so, {answer[0].lower()}{answer[1:]}"
        yield answer
        yield from (words.chatter(s) for s in self.saturations if s.reached or s.severe)
        if self.lasting is not None:
            yield words.late_growth(self.horizon, self.wanted, self.lasting)
        if self.longest_period is not None and self.motion.control_dt is not None:
            yield words.period_in_words(self.longest_period, self.motion.control_dt, self.wanted)
        yield from self._advised(limit)
        if self.ran:
            yield f"The motion: {self.ran}."
        if limit.state > 0:
            state = self.states[limit.state]
            acting = Elements(state.rows).summary
            verb = "acts" if len(state.rows) == 1 else "act"
            where = f", where {acting} {verb}" if acting else ""
            yield f"The limiting state is {state.label}{where}."

    def _answer(self, limit: Limit) -> str:
        """Return whether the wanted dt is stable, and which element limits dt."""
        own, step = limit.integrator, f"A step of {seconds(self.wanted)}"
        elements, limiting = self._stiffest(own), self.limiting(own)
        traits = words.traits_of(limiting, len(elements) > 1) if limiting else ""
        spins = any(element.kind == "spin" for element in elements)
        if limit.speed is None or spins:
            traits = words.state_of_limit(limit) or traits
        if math.isinf(limit.dt):
            judged = (
                "until then" if self.runaway else f"judged over {seconds(self.horizon)} of motion"
            )
            fastest = (
                f" The fastest element is {words.named(elements)}{traits}." if elements else ""
            )
            below = seconds(limit.longest)
            return f"No element limits dt below {below} under {own}, {judged}.{fastest}"
        if limit.dt <= 0:
            cause = words.no_stable_dt(elements, limit.shortest, traits)
            return f"{step} explodes under {own}: {cause}."
        cause = words.limits_dt(elements, limit.dt, traits)
        if self.wanted > limit.dt:
            return f"{step} {self._failure(limit, limiting)} under {own}: {cause}."
        until = "until then" if self.runaway else f"over {seconds(self.horizon)}"
        margin = limit.dt / self.wanted
        if self.gained >= GAINED:
            until += f", in which the integrator adds {percent(self.gained)} to its energy"
        stable = f"{step} is stable under {own} {until}, with a stability margin of {times(margin)}"
        if margin < AMPLE:
            return f"{stable}: {cause}."
        return (
            f"{stable}, so stability does not limit dt; accuracy does: run stepcore trade. "
            f"{cause[0].upper()}{cause[1:]}."
        )

    def _failure(self, limit: Limit, limiting: ElementLimits | None) -> str:
        """Return the verb phrase for the failure beyond the limit."""
        if limit.outcome in ("passes", "turns"):
            return words.BEYOND[limit.outcome]
        if limit.outcome == "explodes" and self.observed is not None:
            return f"explodes after {seconds(self.observed.time)}"
        kind = limiting.element.kind if limiting else ""
        if limit.outcome == "chatters" or kind in words.FRICTION:
            # The force of a friction loss is bounded, so the motion cannot explode.
            return "chatters"
        if kind in words.OPEN:
            # A contact or limit that opens may close again at rest.
            return "explodes or rattles"
        if self.rate is None or not self.rate * self.horizon < SLOW:
            return "explodes"
        return f"slowly gains energy from the integrator (e-fold in {seconds(1 / self.rate)})"

    def _advised(self, limit: Limit) -> Iterator[str]:
        """Yield the changes that were tried, and the step that is stable without any change."""
        met = [advice.text for advice in self.advice if advice.met]
        failed = [advice.text for advice in self.advice if not advice.met]
        wanted = seconds(self.wanted)
        if met:
            yield (
                f"Any one of these changes makes {wanted} stable with a margin of {times(MARGIN)}:"
            )
            yield from (f"- {text}" for text in met)
            yield (
                "Each was made, run and diagnosed again with the same motion. The smallest change "
                "comes first, hardware last."
            )
        elif limit.dt < self.wanted:
            yield f"No change that was tried makes {wanted} stable."
        if failed:
            yield f"Tried without success: {', '.join(_shortly(failed))}."
        if 0 < limit.dt < self.wanted:
            safe = seconds(round_number(limit.dt / MARGIN, up=False))
            yield f"Unchanged, the scene needs a step of {safe} for the same margin."

    # --- tables and data --------------------------------------------------------------------------

    def text(self, width: int | None = None, full: bool = False) -> str:
        """Return the report, which begins with the answer.

        width: as in `Result.text`.
        full: whether to list every element on its own.
        """
        return dataclasses.replace(self.report(full), title="").text(width, full)

    @property
    def table(self) -> Table:
        """The elements on their own, those that limit dt first.

        The columns are: frequency [Hz], omega [rad/s], ratio (damping ratio), rate (the element's
        damping over the mass that it moves [1/s]), share (in the mode that limits the scene's
        integrator), the largest stable dt [s] in a column for each integrator, softened (the dt [s]
        above which refsafe softens the element), state (at which the element is stiffest), kind and
        index (the element as data).
        """
        return Table([self._record(row) for row in self.rows], columns=self._columns())

    def _columns(self) -> list[str]:
        own = self.settings.integrator
        others = [name for name in self.limits if name != own]
        numbers = ("omega", "rate", "softened", "state", "kind", "index")
        return ["element", "frequency", "ratio", "share", own, *others, *numbers]

    def _record(self, row: ElementLimits) -> dict[str, Any]:
        shares = self.element_shares[self.settings.integrator]
        record: dict[str, Any] = {
            "element": row.name,
            "kind": row.element.kind,
            "index": row.element.index,
            # Beyond these rates the state was blowing up, and its frequencies mean nothing.
            "frequency": row.omega / (2 * math.pi) if row.omega < words.PRINTED[1] else None,
            "omega": row.omega if row.omega < words.PRINTED[1] else None,
            "ratio": None if math.isnan(row.ratio) else row.ratio,
            "rate": row.rate if row.rate < words.PRINTED[1] else None,
            "share": shares.get(row.element, 0.0),
            "softened": row.softened if math.isfinite(row.softened) else None,
            "state": self.states[row.state].label,
        }
        return record | {name: row.limits[name] for name in self.limits}

    def tables(self, full: bool) -> list[Table]:
        """Return the limits of all elements combined, and those of each element on its own.

        full: whether to list every element and integrator, not only the stiffest elements.
        """
        own = self.settings.integrator
        together = Table(
            (self._limit_record(name, limit) for name, limit in self.limits.items()),
            formats={"share": ".2f", DT: ".3g"},
            heading=f"All elements together (* the scene's integrator, at dt {self.wanted:g} s)",
            legend=self._extremes([limit.dt for limit in self.limits.values()]),
        )
        if not self.rows:
            return [together]
        rows = self.rows if full or len(self.rows) <= PRINTED + 1 else self.rows[:PRINTED]
        left = len(self.rows) - len(rows)
        softer = f"{counted(left, 'other element')}, and " if left else ""
        more = f"Not shown: {softer}the other integrators (--all; in Python text(full=True))."
        # Names are never truncated: a narrow report drops columns first.
        formats = {"element": "", "frequency": ".4g", "share": ".2f", "ratio": ".2g"}
        columns = self._columns() if full else ["element", "frequency", "ratio", "share", own]
        shown = [row.limits[name] for row in rows for name in columns if name in row.limits]
        alone = Table(
            [self._record(row) for row in rows],
            columns=columns,
            formats=formats | dict.fromkeys(self.limits, ".3g"),
            heading=(
                "Each element on its own: frequency [Hz], damping ratio, share in the mode that "
                f"limits {own}, largest stable dt [s]{' by integrator' if full else ''}"
            ),
            legend=" ".join(filter(None, (self._extremes(shown), "" if full else more))),
        )
        return [together, alone]

    def _extremes(self, limits: Iterable[float]) -> str:
        """Return the meanings of limits of 0 and inf, if there are any."""
        limits, meanings = list(limits), []
        if any(limit <= 0 for limit in limits):
            shortest = self.limits[self.settings.integrator].shortest
            meanings.append(f"0: every step tried is unstable, down to {seconds(shortest)}.")
        if any(math.isinf(limit) for limit in limits):
            meanings.append("inf: nothing limits dt.")
        return " ".join(meanings)

    def _limit_record(self, name: str, limit: Limit) -> dict[str, Any]:
        limited = math.isfinite(limit.dt)
        # The limit may come from a run of the motion instead of a state.
        at = self.states[limit.state].label if limit.state >= 0 else ""
        return {
            "integrator": name + (" *" if name == self.settings.integrator else ""),
            DT: limit.dt,
            "by": self.stiffest(name) if limited else "",
            "share": max(self.element_shares[name].values(), default=None) if limited else None,
            "at": "the motion" if limit.outcome else at,
        }

    def details(self) -> dict[str, Any]:
        """Return the limits with their shares, the states, the advice and the motion's outcome."""
        limits = {
            name: {
                "dt": limit.dt,
                "limited": math.isfinite(limit.dt),
                "stiffest": self.stiffest(name),
                "together": self.together(name),
                "state": limit.state,
                "longest": limit.longest,
                "outcome": limit.outcome,
                "shares": self.shares[name],
            }
            for name, limit in self.limits.items()
        }
        states = [
            {"label": s.label, "time": s.time, "rows": [e.name for e in s.rows]}
            for s in self.states
        ]
        plain = (
            *("wanted", "advice", "physical", "ran", "rate", "horizon", "observed", "saturations"),
            *("lasting", "runaway", "longest_period", "circulation", "gained"),
        )
        return {"limits": limits, "states": states} | {name: getattr(self, name) for name in plain}


def _shortly(failed: Sequence[str]) -> list[str]:
    """Return the changes that failed; two gains that also failed as a pair become "both".

    >>> _shortly(["kp", "kv", "kp and kv", "armature"])
    ['kp', 'kv', 'both', 'armature']
    """
    pairs = {f"{a} and {b}" for a in failed for b in failed}
    return ["both" if text in pairs else text for text in failed]
