"""What a diagnosis found: the largest stable dt by integrator, and the elements that limit it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from stepcore import checks
from stepcore._core import Settings
from stepcore.experiment.motion import Motion
from stepcore.measure.diagnosis.advice import Advice
from stepcore.measure.diagnosis.dt_limits import Limit
from stepcore.measure.diagnosis.element_id import INERTIAL, ElementId
from stepcore.measure.diagnosis.element_limits import ElementLimits
from stepcore.measure.diagnosis.element_names import together
from stepcore.measure.diagnosis.judgement import Outcome, Runaway
from stepcore.measure.diagnosis.linear_step import State
from stepcore.measure.diagnosis.saturation import Saturation


@dataclass(eq=False, repr=False)
class DiagnosisFindings:
    """The fields of a `Diagnosis`, which says what each is, and the questions they answer."""

    name: str
    settings: Settings
    motion: Motion
    wanted: float
    states: list[State]
    limits: dict[str, Limit]
    element_shares: dict[str, dict[ElementId, float]]
    limiters: dict[str, tuple[ElementId, ...]]
    rows: list[ElementLimits]
    advice: list[Advice] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    physical: float = 0.0
    rate: float | None = None
    observed: Outcome | None = None
    saturations: list[Saturation] = field(default_factory=list)
    lasting: float | None = None
    runaway: Runaway | None = None
    ran: str = ""
    longest_period: float | None = None

    @property
    def horizon(self) -> float:
        """Length of the motion [s], over which undamped growth counts."""
        return self.motion.horizon or 0.0

    def limit(self, integrator: str | None = None) -> float:
        """The largest stable dt [s] under an integrator (default: the scene's).

        inf where nothing limits it, 0 where no step is stable. An integrator that was not
        diagnosed is a ValueError.
        """
        return self.limits[self._known(integrator)].dt

    def stiffest(self, integrator: str | None = None) -> str:
        """What limits dt under an integrator (default: the scene's), by name.

        It shares the mode that sets the limit, and softened it raises the limit most; equal
        elements that do so only together are named together (`together`). Where nothing limits dt
        it has the largest share in the fastest motion. "" where no element has a share in it.
        """
        return together([element.name for element in self._stiffest(self._known(integrator))])

    def together(self, integrator: str | None = None) -> list[str]:
        """The names of the elements that limit dt together, one in most scenes."""
        return [element.name for element in self._stiffest(self._known(integrator))]

    def limiting(self, integrator: str | None = None) -> ElementLimits | None:
        """Frequency, damping and limits of the element that `stiffest` names, on its own.

        Of several, those of the stiffest.
        """
        elements = self._stiffest(self._known(integrator))
        return next((row for row in self.rows if row.element in elements), None)

    def _stiffest(self, integrator: str) -> tuple[ElementId, ...]:
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
        """An element on its own, by its name; None where no such element acts."""
        return next((row for row in self.rows if row.name == name), None)

    @property
    def shares(self) -> dict[str, dict[str, float]]:
        """`element_shares` by the elements' names."""
        return {
            integrator: {element.name: share for element, share in shares.items()}
            for integrator, shares in self.element_shares.items()
        }
