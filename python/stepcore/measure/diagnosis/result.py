"""`Diagnosis`: what `diagnose` returns, its findings in sentences, tables and data."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from stepcore.measure.diagnosis.dt_limits import Limit
from stepcore.measure.diagnosis.element_id import ElementId
from stepcore.measure.diagnosis.element_limits import ElementLimits
from stepcore.measure.diagnosis.findings import DiagnosisFindings
from stepcore.measure.diagnosis.sentences import sentences
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import counted, seconds

DT = "largest stable dt [s]"
# The elements that are printed unless all are asked for.
PRINTED = 6


@dataclass(eq=False, repr=False)
class Diagnosis(DiagnosisFindings, Result):
    """Which element limits the time step of a scene; `stepcore.diagnose` returns it.

    name: the name of the scene.
    settings: the settings of the scene, with rows solved to rounding.
    motion: the motion along which the states lie; see `diagnose`.
    wanted: the time step asked about [s].
    states: the states at which the step was linearised.
    limits: the largest stable dt by integrator.
    element_shares: by integrator, each element's share in the mode that sets the limit, or in the
        fastest motion if nothing sets a limit.
    limiters: by integrator, the elements that limit dt; several where none does by itself.
    rows: the elements on their own, the stiffest first.
    advice: changes that make the wanted step stable.
    physical: the fastest growth of the motion itself [1/s].
    ran: what motion was run, in words.
    rate: the growth at the wanted step that the integrator causes [1/s]; None if the step is
        stable.
    observed: what the motion did at the wanted step; None where that is too long to tell.
    saturations: servos that chatter at the ends of their force ranges at the wanted step.
    lasting: when a growth that is the integrator's explodes after the horizon [s]; None where none
        was seen in ten horizons.
    runaway: that the motion blows up at every step that was tried; None where it does not.
    longest_period: the longest stable control period at the wanted step [s], inf beyond the
        horizon; None without a control function and a period of its own.
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

    @property
    def title(self) -> str:
        """What was measured, in a few words."""
        return f"{self.name}: what limits the time step"

    @property
    def head(self) -> str:
        """Nothing: the answer comes first, and what motion was run stands among the sentences."""
        return ""

    @property
    def table(self) -> Table:
        """The elements on their own, the stiffest first.

        frequency [Hz], omega [rad/s], ratio (damping ratio), rate (its own damping over the mass
        that it moves [1/s]), share (in the mode that limits the scene's integrator), the largest
        stable dt [s] in a column for each integrator, softened (the dt [s] from which refsafe
        softens it), state (where it is stiffest), kind and index (the element as data).
        """
        return Table(self._records(self.rows), columns=self._columns())

    def _records(self, rows: Iterable[ElementLimits]) -> Iterator[dict[str, Any]]:
        shares = self.element_shares[self.settings.integrator]
        return (self._record(row, shares) for row in rows)

    def _columns(self) -> list[str]:
        own = self.settings.integrator
        others = [name for name in self.limits if name != own]
        numbers = ("omega", "rate", "softened", "state", "kind", "index")
        return ["element", "frequency", "ratio", "share", own, *others, *numbers]

    def _record(self, row: ElementLimits, shares: dict[ElementId, float]) -> dict[str, Any]:
        record: dict[str, Any] = {
            "element": row.name,
            "kind": row.element.kind,
            "index": row.element.index,
            "frequency": row.omega / (2 * math.pi),
            "omega": row.omega,
            "ratio": None if math.isnan(row.ratio) else row.ratio,
            "rate": row.rate,
            "share": shares.get(row.element, 0.0),
            "softened": row.softened if math.isfinite(row.softened) else None,
            "state": self.states[row.state].label,
        }
        return record | {name: row.limits[name] for name in self.limits}

    @property
    def sentences(self) -> list[str]:
        """The answer, the advice, and the state that decides."""
        return list(sentences(self))

    def text(self, width: int | None = None, full: bool = False) -> str:
        """The report, which begins with the answer; `full`: with every element on its own.

        width: as in `Result.text`.
        """
        return dataclasses.replace(self.report(full), title="").text(width, full)

    def tables(self, full: bool) -> list[Table]:
        """All elements together by integrator, and the stiffest on their own (`full`: each)."""
        own = self.settings.integrator
        together = Table(
            (self._limit_record(name, limit) for name, limit in self.limits.items()),
            formats={"share": ".2f", DT: ".3g"},
            heading=f"All elements together (* the scene's integrator, at dt {self.wanted:g} s)",
            legend=self._zero(limit.dt for limit in self.limits.values()),
        )
        if not self.rows:
            return [together]
        rows = self.rows if full or len(self.rows) <= PRINTED + 1 else self.rows[:PRINTED]
        left = len(self.rows) - len(rows)
        softer = f"{counted(left, 'softer element')}, and " if left else ""
        more = f"Not shown: {softer}the other integrators (--all; in Python text(full=True))."
        # A name is never cut: columns are left out first.
        formats = {"element": "", "frequency": ".4g", "share": ".2f", "ratio": ".2g"}
        columns = self._columns() if full else ["element", "frequency", "ratio", "share", own]
        shown = [row.limits[name] for row in rows for name in columns if name in row.limits]
        alone = Table(
            self._records(rows),
            columns=columns,
            formats=formats | dict.fromkeys(self.limits, ".3g"),
            heading=(
                "Each element on its own: frequency [Hz], damping ratio, share in the mode that "
                f"limits {own}, largest stable dt [s]{' by integrator' if full else ''}"
            ),
            legend=" ".join(filter(None, (self._zero(shown), "" if full else more))),
        )
        return [together, alone]

    def _zero(self, limits: Iterable[float]) -> str:
        """What limits of 0 and inf mean, if there are any."""
        shortest = self.limits[self.settings.integrator].shortest
        known = list(limits)
        unstable = f"0: every step tried is unstable, down to {seconds(shortest)}."
        stable = "inf: nothing limits dt."
        return " ".join(
            said
            for said, shown in (
                (unstable, any(limit <= 0 for limit in known)),
                (stable, any(math.isinf(limit) for limit in known)),
            )
            if shown
        )

    def _limit_record(self, name: str, limit: Limit) -> dict[str, Any]:
        limited = math.isfinite(limit.dt)
        shares = self.element_shares[name].values()
        return {
            "integrator": name + (" *" if name == self.settings.integrator else ""),
            DT: limit.dt,
            "by": self.stiffest(name) if limited else "",
            "share": max(shares, default=None) if limited else None,
            "at": self._where(limit),
        }

    def _where(self, limit: Limit) -> str:
        """Where a limit was found: at a state, or in the motion itself."""
        if limit.outcome:
            return "the motion"
        return self.states[limit.state].label if limit.state >= 0 else ""

    def details(self) -> dict[str, Any]:
        """The limits with their shares, the states and the advice."""
        return {
            "wanted": self.wanted,
            "limits": {
                name: {
                    "dt": limit.dt,
                    "limited": math.isfinite(limit.dt),
                    "stiffest": self.stiffest(name),
                    "together": self.together(name),
                    "state": limit.state,
                    "longest": limit.longest,
                    "outcome": limit.outcome,
                    "shares": shares,
                }
                for (name, limit), shares in zip(
                    self.limits.items(), self.shares.values(), strict=True
                )
            },
            "states": [
                {"label": s.label, "time": s.time, "rows": [e.name for e in s.rows]}
                for s in self.states
            ],
            "advice": self.advice,
            "physical": self.physical,
            "ran": self.ran,
            "rate": self.rate,
            "horizon": self.horizon,
            "observed": self.observed,
            "saturations": self.saturations,
            "lasting": self.lasting,
            "runaway": self.runaway,
            "longest_period": self.longest_period,
        }
