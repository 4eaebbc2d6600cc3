"""`Diagnosis`: what `diagnose` found."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

from stepcore import checks
from stepcore._core import Settings
from stepcore.engine.linear_maps import INTEGRATORS
from stepcore.measure.diagnosis import sentences
from stepcore.measure.diagnosis.advice import Advice
from stepcore.measure.diagnosis.dt_limits import Limit
from stepcore.measure.diagnosis.element_forces import INERTIAL
from stepcore.measure.diagnosis.element_limits import ElementLimits
from stepcore.measure.diagnosis.linear_step import State
from stepcore.report.result import Result
from stepcore.report.table import Table

DT = "largest stable dt [s]"


@dataclass(eq=False, repr=False)
class Diagnosis(Result):
    """Which element limits the time step of one scene; made by `stepcore.diagnose`.

    wanted: the step asked about [s]. horizon [s]: see `diagnose`. states: where the step was
    linearised. limits: by integrator. shares: by integrator, each element's part in the mode that
    sets the limit (or in the fastest motion where nothing does). elements: their figures, the
    stiffest first. advice: ways to the wanted step. physical: the fastest growth of the motion
    itself [1/s]. rate: growth at the wanted step that the integrator makes [1/s].
    """

    kind = "diagnosis"
    units: ClassVar = {"frequency": "Hz", "omega": "rad/s", "rate": "1/s", "softened": "s"} | (
        dict.fromkeys(INTEGRATORS, "s")
    )

    name: str
    settings: Settings
    wanted: float
    horizon: float
    states: list[State]
    limits: dict[str, Limit]
    shares: dict[str, dict[str, float]]
    elements: list[ElementLimits]
    advice: list[Advice] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    physical: float = 0.0
    rate: float | None = None

    @property
    def title(self) -> str:
        """What was measured, in a few words."""
        return f"{self.name}: what limits the time step"

    def limit(self, integrator: str | None = None) -> float:
        """The largest stable dt [s] under an integrator (default: the scene's); inf: nothing
        limits it, 0: no step is stable."""
        return self.limits[self._known(integrator)].dt

    def stiffest(self, integrator: str | None = None) -> str:
        """The element with the largest share in the mode that sets the limit, by name.

        Where nothing limits dt: in the fastest motion. "" where no element has a part in it.
        """
        name = self._known(integrator)
        shares = dict(self.shares[name])
        if math.isinf(self.limits[name].dt):
            shares.pop(INERTIAL.label, None)
        if any(shares.values()):
            return max(shares, key=lambda name: shares[name])
        # A row that begins to act within the step has no share at its start.
        alone = [one for one in self.elements if math.isfinite(one.limits[name])]
        if math.isinf(self.limits[name].dt) or not alone:
            return ""
        return min(alone, key=lambda one: one.limits[name]).key.label

    def _known(self, integrator: str | None) -> str:
        name = self.settings.integrator if integrator is None else integrator
        if name not in self.limits:
            near = checks.nearest(str(name), self.limits)
            raise ValueError(f"integrator = {checks.shown(name)}: was not diagnosed{near}")
        return name

    def element(self, name: str) -> ElementLimits | None:
        """The figures of an element, by name."""
        return next((one for one in self.elements if one.key.label == name), None)

    @property
    def table(self) -> Table:
        """The elements, stiffest first.

        frequency [Hz], omega [rad/s], ratio (damping ratio), rate (its own damping over the mass
        that it moves [1/s]), share (in the mode that limits the scene's integrator), one column
        an integrator with the largest stable dt alone [s], softened (the dt [s] from which
        refsafe softens it), state (at which it is stiffest).
        """
        shares = self.shares[self.settings.integrator]
        return Table((self._record(one, shares) for one in self.elements), columns=self._columns())

    def _columns(self) -> list[str]:
        own = self.settings.integrator
        rest = [name for name in self.limits if name != own]
        return [
            *("element", "frequency", "ratio", "share", own, *rest),
            *("omega", "rate", "softened", "state"),
        ]

    def _record(self, one: ElementLimits, shares: dict[str, float]) -> dict[str, Any]:
        record: dict[str, Any] = {
            "element": one.key.label,
            "frequency": one.omega / (2 * math.pi),
            "omega": one.omega,
            "ratio": None if math.isnan(one.ratio) else one.ratio,
            "rate": one.rate,
            "share": shares.get(one.key.label, 0.0),
            "softened": one.softened if math.isfinite(one.softened) else None,
            "state": self.states[one.state].label,
        }
        return record | {name: one.limits[name] for name in self.limits}

    @property
    def sentences(self) -> list[str]:
        """The answer, the advice and the state that decides, in words."""
        return sentences.sentences(self)

    def tables(self, full: bool) -> list[Table]:
        """The elements, each alone, and the limits of all together."""
        own = self.settings.integrator
        # A name is not cut: columns are left out first.
        formats = {"element": "", "frequency": ".4g", "share": ".2f", "ratio": ".2g"}
        formats |= dict.fromkeys(self.limits, ".3g")
        heading = (
            "Each element alone: frequency [Hz], damping ratio, share in the mode that limits "
            f"{own}, and the largest stable dt [s] by integrator"
        )
        elements = Table(self.table, self._columns(), formats, heading=heading)
        records = [self._limit_record(name, limit) for name, limit in self.limits.items()]
        formats = {"share": ".2f", "by": "", DT: ".3g"}
        limits = Table(records, None, formats, heading="All elements together (* the scene's own)")
        return [elements, limits] if len(elements) else [limits]

    def _limit_record(self, name: str, limit: Limit) -> dict[str, Any]:
        finite = math.isfinite(limit.dt)
        return {
            "integrator": name + (" *" if name == self.settings.integrator else ""),
            DT: limit.dt,
            "by": self.stiffest(name) if finite else "",
            "share": max(self.shares[name].values(), default=None) if finite else None,
            "at": self.states[limit.state].label if limit.state >= 0 else "",
        }

    def details(self) -> dict[str, Any]:
        """The limits, the states and the advice; times in seconds."""
        return {
            "wanted": self.wanted,
            "horizon": self.horizon,
            "limits": {
                name: {
                    "dt": limit.dt,
                    "limited": math.isfinite(limit.dt),
                    "stiffest": self.stiffest(name),
                    "state": limit.state,
                    "longest": limit.longest,
                    "shares": self.shares[name],
                }
                for name, limit in self.limits.items()
            },
            "states": [{"label": s.label, "time": s.time, "rows": s.rows} for s in self.states],
            "advice": self.advice,
            "physical": self.physical,
            "rate": self.rate,
        }
