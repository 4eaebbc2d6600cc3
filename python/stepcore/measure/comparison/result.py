"""`Comparison`: the differences between two models and their effects on a motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from stepcore.experiment.change import Change
from stepcore.experiment.motion import Motion
from stepcore.measure.comparison.differences import Difference, together
from stepcore.measure.comparison.events import Event
from stepcore.report.report import SHORT, not_shown
from stepcore.report.result import Result
from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import beginning, compact, counted, length, metres, seconds
from stepcore.report.verdict import Verdict

LEGEND = (
    "alone: RMS distance by which this difference alone moves A's motion in the worst start [m]; "
    "removed: distance from A with all differences, if it has all but this one [m]; *: it matters, "
    "because it is in the smallest set that brings A to B."
)


@dataclass(frozen=True)
class DifferenceEffect:
    """The effect of one difference on the motion.

    alone: the distance between A and A with the difference, in the worst start [m]; inf if the run
        fails, NaN if it was not run.
    removed: the distance between A with all differences and A with all others [m].
    needed: whether the smallest set contains it. failure: why one of the runs failed, or "".
    """

    difference: Difference
    alone: float = math.nan
    removed: float = math.nan
    needed: bool = False
    failure: str = ""

    @property
    def largest(self) -> float:
        """The larger of both effects [m]; 0 if neither was run."""
        return max((x for x in (self.alone, self.removed) if not math.isnan(x)), default=0.0)


@dataclass(frozen=True)
class Attribution:
    """The effects of the differences of one kind: changes of the model, or numerical settings.

    change: the settings of the runs; empty for the settings as shipped. error: of A's run under
        them [m]; NaN as shipped.
    rows: the effect of each difference, largest first.
    within: the distance up to which motions count as equal [m].
    needed: the smallest set that brings A this close to A with all differences; None if it was not
        searched, or a run fails. left: the effect of the differences that are not in the set [m].
    """

    change: Change
    error: float
    rows: list[DifferenceEffect]
    within: float
    needed: list[Difference] | None
    left: float

    @property
    def converged(self) -> bool:
        """Whether the runs are close to converged motions; else they are as shipped."""
        return not math.isnan(self.error)

    @property
    def interactions(self) -> list[DifferenceEffect]:
        """The differences whose effects alone and removed differ by more than `within`."""
        return [row for row in self.rows if abs(row.alone - row.removed) > self.within]


@dataclass(eq=False, repr=False)
class Comparison(Result):
    """The differences between two models, and their effects on a motion; `compare` returns it.

    other: the name of B. differences: those that are `Change`s of A.
    others: the other differences in words. unmapped: differences because of which B cannot make A's
        motion, so that nothing was run.
    rounding: the number of values that differ by rounding alone.
    models: the effects of changes of the model on the converged motion; None without any.
    numerical: the effects of numerical settings on the motion as shipped; None without any.
    distance: between A and B as shipped, in the worst start [m]; inf if one fails; NaN if not run.
    converged: between their converged motions [m]; NaN if unknown. uncertainty: of it [m].
    errors: the integration errors of A and of B as shipped [m]; NaN if unknown.
    unexplained: the distance between A with all differences and B, as shipped [m].
    failures: why A and B fail as shipped; "" if they do not. starts: the number of starts.
    engine: the engine of B with its version; "" for stepcore.
    same: whether the motions as shipped differ by rounding alone.
    separated: when the motions as shipped are more than `separation` [m] apart in the worst start
        [s]; inf if never.
    event: the first contact, joint limit or saturation that begins at different times there, up to
        then; None without one, and under a control function.

    >>> from stepcore import compare, lesson
    >>> result = compare(lesson.drop(), lesson.drop())
    >>> result.rows, result.distance
    ([], 0.0)
    """

    kind = "comparison"
    units: ClassVar = {"alone": "m", "removed": "m"}

    other: str
    settings: Any
    motion: Motion
    differences: list[Difference]
    others: list[str]
    unmapped: list[str]
    rounding: int
    models: Attribution | None = None
    numerical: Attribution | None = None
    distance: float = math.nan
    converged: float = math.nan
    uncertainty: float = math.nan
    errors: tuple[float, ...] = (math.nan, math.nan)
    unexplained: float = math.nan
    failures: tuple[str, str] = ("", "")
    starts: int = 0
    engine: str = ""
    same: bool = False
    separated: float = math.inf
    separation: float = math.nan
    event: Event | None = None

    @property
    def title(self) -> str:
        """The models that are compared."""
        where = f", in {self.engine}" if self.engine else ""
        return f"{self.name} (A) and {self.other} (B{where}): differences that change the motion"

    @property
    def parts(self) -> list[Attribution]:
        """The effects of changes of the model, and of numerical settings."""
        return [part for part in (self.models, self.numerical) if part is not None]

    @property
    def rows(self) -> list[DifferenceEffect]:
        """The effects of all differences."""
        return [row for part in self.parts for row in part.rows]

    def verdict(self, limit: float | str) -> Verdict:
        """Return whether the motions of the two models, as shipped, have at most a distance.

        limit: metres, or a text such as "1mm". The test fails if one of the runs fails, and is
        undecided if nothing could be run.
        """
        limit = length("verdict", "limit", limit, math.nan)
        test = f"distance of the motions at most {metres(limit)}"
        if any(self.failures):
            return Verdict(test, False, "; ".join(filter(None, self.failures)))
        if math.isnan(self.distance):
            reason = "; ".join(self.unmapped) or self.unfinished or "nothing was run"
            return Verdict(test, None, reason)
        return Verdict(test, self.distance <= limit, f"{metres(self.distance)} as shipped")

    @property
    def needed(self) -> list[Difference]:
        """The differences that matter: the smallest sets of both kinds."""
        return [one for part in self.parts for one in part.needed or ()]

    @property
    def change(self) -> Change:
        """The change that gives A the differences that matter."""
        return together(self.needed)

    @property
    def mjcf(self) -> str:
        """The differences that matter as MJCF lines that turn A into B; see `Change.mjcf`."""
        return self.change.mjcf

    @property
    def table(self) -> Table:
        """The effect of each difference; units as in `DifferenceEffect`."""
        return Table(self._record(part, row) for part in self.parts for row in part.rows)

    def _record(self, part: Attribution, row: DifferenceEffect) -> dict[str, Any]:
        return {
            "difference": row.difference.path,
            "a": row.difference.a,
            "b": row.difference.b,
            "converged": part.converged,
            "alone": row.alone,
            "removed": row.removed,
            "needed": row.needed,
            "failure": row.failure or None,
        }

    def details(self) -> dict[str, Any]:
        """Return the distances, the differences that matter, and those that were not tried."""
        return {
            "other": self.other,
            "distance": self.distance,
            "converged": self.converged,
            "uncertainty": self.uncertainty,
            "errors": list(self.errors),
            "unexplained": self.unexplained,
            "engine": self.engine or "stepcore",
            "separated": self.separated,
            "event": str(self.event) if self.event else None,
            "needed": [one.path for one in self.needed],
            "mjcf": self.mjcf,
            "unmapped": self.unmapped,
            "others": self.others,
            "rounding": self.rounding,
        }

    def tables(self, full: bool) -> list[Table]:
        """Return the effects of each kind, largest first; full: whether to include every row."""
        tables = []
        for part in self.parts:
            rows, legend = part.rows, LEGEND if part is self.parts[-1] else ""
            if not full and len(rows) > SHORT + 1:
                rows = sorted(rows, key=lambda row: not row.needed)[:SHORT]
                legend += f" {not_shown(counted(len(part.rows) - SHORT, 'difference'))}"
            how = "converged" if part.converged else "as shipped"
            cells = [
                {
                    "": "*" if row.needed else "",
                    f"difference, {how}": row.difference.words,
                    "alone": _cell(row.alone),
                    "removed": _cell(row.removed),
                }
                for row in rows
            ]
            tables.append(Table(cells, formats={"alone": "", "removed": ""}, legend=legend))
        return tables

    @property
    def sentences(self) -> list[str]:
        """The differences that matter, the distances, and what remains unexplained."""
        said = [self._answer(), *self._distances()]
        said += [
            f"{row.difference.path} interacts with other differences: alone it moves the motion by "
            f"{_far(row.alone)}, together with them by {_far(row.removed)}."
            for part in self.parts
            for row in part.interactions[:SHORT]
        ]
        failed = [row.difference.path for row in self.rows if math.isinf(row.alone)]
        said += [f"A also fails with one of these alone: {_few(failed)}."] * bool(failed)
        if self.others:
            said.append(f"Not tried: {_few(self.others)}.")
        if self.rounding:
            verb = "differs" if self.rounding == 1 else "differ"
            said.append(f"{counted(self.rounding, 'value')} {verb} by rounding alone.")
        return said

    def _answer(self) -> str:
        """Return the first sentence."""
        if self.unmapped:
            return f"B cannot make A's motion, so nothing was run: {_few(self.unmapped)}."
        if self.engine and not self.differences:
            return f"A in stepcore and B in {self.engine}: {self._compared_engines()}"
        if not self.differences:
            beyond = " beyond rounding" if self.rounding else ""
            tried = " that could be tried" if self.others else ""
            return f"There is no difference{beyond}{tried}."
        count = counted(len(self.differences), "difference")
        sides = zip("AB", self.failures, strict=True)
        fails = [f"{side} fails as shipped from {beginning(why)}" for side, why in sides if why]
        if fails:
            return f"{count}; {', and '.join(fails)}."
        judged = [part for part in self.parts if part.needed is not None]
        missing = len(self.differences) - sum(len(part.rows) for part in judged)
        rest = f"; {missing} could not be judged" if missing else ""
        if not judged:
            first = max(self.rows, key=lambda row: row.largest)
            return f"{count}; the largest effect so far has {first.difference.words}{rest}."
        if not self.needed:
            within = metres(max(part.within for part in judged))
            return f"0 of {count} matter: they move the motion by at most {within}{rest}."
        matter = "matters" if len(self.needed) == 1 else "matter"
        return f"{len(self.needed)} of {count} {matter}: {_few(_grouped(self.needed))}{rest}."

    def _compared_engines(self) -> str:
        """Return whether shorter steps make two engines agree on one model."""
        if any(self.failures):
            return "a run fails as shipped."
        if self.same:
            return f"as shipped they make the same motion, to {metres(self.distance)}."
        if math.isnan(self.converged):
            return "no converged motion decides whether they integrate the same model."
        if self.converged <= self.uncertainty:
            return "with shorter steps they agree, so the difference is integration error."
        return "shorter steps do not make them agree."

    def _distances(self) -> list[str]:
        """Describe the distances of A and B, and the effects of all that does not matter."""
        said = list[str]()
        if not math.isnan(self.converged) and (self.models is not None or self.engine):
            far = f"{_far(self.converged)} apart (± {metres(self.uncertainty)})"
            said.append(f"The converged motions of A and B are {far}{_rest(self.models)}.")
        if math.isfinite(self.distance) and (self.differences or self.others or self.engine):
            worst = f"in the worst of {counted(self.starts, 'start')}"
            text = f"As shipped they are {_far(self.distance)} apart {worst}"
            if not any(map(math.isnan, self.errors)):
                text += f"; their integration errors are {' and '.join(map(_far, self.errors))}"
            last = self.parts[-1] if self.parts and not self.parts[-1].converged else None
            if self.same and self.engine:
                return said
            said.append(f"{text}{_rest(last)}.")
            if math.isfinite(self.separated):
                where = f"At {seconds(self.separated)} they are more than {metres(self.separation)}"
                first = f"; before, {self.event}" if self.event else ""
                said.append(f"{where} apart in the worst start{first}.")
            if self.differences and self.unexplained > max(
                [0.0, *(part.within for part in self.parts)]
            ):
                far = _far(self.unexplained)
                said.append(f"Unexplained: with all differences A is {far} from B as shipped.")
        return said

    @property
    def setup(self) -> str:
        """The differences that matter in MJCF."""
        said, part = "", self.models
        if part is not None and part.converged:
            how = label(self.settings.replace(**dict(part.change.settings)))
            said = f"Changes of the model were compared under {how} (error {metres(part.error)}).\n"
        lines = self.mjcf
        return said + (f"In MJCF, these lines turn A into B:\n{lines}" if lines else "")

    def __repr__(self) -> str:
        count = counted(len(self.differences), "difference")
        return f"<Comparison of {self.name} and {self.other}: {count}, {len(self.needed)} needed>"


def _rest(part: Attribution | None) -> str:
    """Return the effect of the differences that are in no smallest set, in words."""
    if part is None or not part.needed or len(part.needed) == len(part.rows):
        return ""
    return f"; all other differences move the motion by {metres(part.left)}"


def _grouped(some: Sequence[Difference]) -> list[str]:
    """Return differences in words; elements that share a field and its values are one entry."""
    groups: dict[tuple[str, ...], list[Difference]] = {}
    for one in some:
        kind, field = one.path.partition("/")[0], one.path.rpartition("/")[2]
        values = one.words.removeprefix(one.path)
        groups.setdefault((kind, field, values), []).append(one)
    return [
        f"{field} of {counted(len(group), kind)}{values}" if len(group) > 1 else group[0].words
        for (kind, field, values), group in groups.items()
    ]


def _few(listed: Sequence[str]) -> str:
    """Return the first of some texts as a list, and the number of the others."""
    more = len(listed) - SHORT
    return "; ".join(listed[:SHORT]) + (f"; and {more} more" if more > 0 else "")


def _far(far: float) -> str:
    return "infinitely far (a run fails)" if math.isinf(far) else metres(far)


def _cell(far: float) -> str:
    return "" if math.isnan(far) else "failed" if math.isinf(far) else compact(far)
