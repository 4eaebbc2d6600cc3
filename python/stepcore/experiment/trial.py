"""`Trial`: the results of one change. Text, tables, plots and choices read nothing else."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore._core import Settings
from stepcore.engine.norm import Tracks
from stepcore.experiment.change import Change
from stepcore.experiment.quantity import Measure
from stepcore.report.units import counted, metres
from stepcore.report.verdict import Verdict

if TYPE_CHECKING:
    from stepcore.experiment.judge import Outcome


@dataclass(frozen=True, eq=False)
class Trial:
    """The results of one change, from several starts.

    change: the change that was run. settings: all settings under which it was run.
    starts: the starts from which it was run, by index.
    errors: the error of every start, (starts,), in the unit of `measure`: by default the RMS
        position error, the distance from the truth by the norm of `stepcore.engine.norm` [m], over
        the samples that can be predicted. It is never below the truth's uncertainty; inf where the
        run failed, NaN without a truth.
    unsure: the uncertainty of the truth of every start, (starts,).
    largest: the largest error of a body or element at any time, of every start, (starts,).
    work: counted floating-point operations per simulated second; the same on every machine.
    cost: ranks trials: the computing time by the counted work [µs per simulated second], see
        `stepcore.experiment.price`; or the work itself, see `Study`.
    failure: the reason of the first failure; "" if no run failed.
    tracks: the poses of the bodies.
    modelled: the modelling error of every start, the distance of the changed model's converged
        motion from the scene's, (starts,); None for a change of settings alone.
    measure: the quantity whose error it is.
    stability: the outcome of a longer run and of a perturbed one, from the first start; None unless
        `Study.run` was called with ``stability=True``. An unstable run counts as failed.
    parts: of several quantities, the error of each in its unit, (quantities, starts); `errors` is
        then the largest of them relative to the allowed errors.
    """

    change: Change
    settings: Any
    starts: tuple[int, ...]
    errors: np.ndarray
    unsure: np.ndarray
    largest: np.ndarray
    work: float
    cost: float = math.nan
    failure: str = ""
    tracks: Tracks | None = field(default=None, repr=False)
    modelled: np.ndarray | None = None
    measure: Measure | None = field(default=None, repr=False)
    stability: Outcome | None = None
    parts: np.ndarray | None = None

    @property
    def energy(self) -> float:
        """The largest kinetic energy relative to the converged motion's; NaN without `stability`.

        Of a converged motion that rests, the energy of a slow motion counts.
        """
        return math.nan if self.stability is None else self.stability.energy

    @property
    def growth(self) -> float:
        """The distance of a perturbed run towards the end, relative to the converged motion's.

        It is NaN without `stability`.
        """
        return math.nan if self.stability is None else self.stability.growth

    @property
    def chatter(self) -> bool:
        """Whether forces of actuators jump between bounds; False without `stability`."""
        return self.stability is not None and self.stability.kind == "chatters"

    def words(self, error: float) -> str:
        """Format an error in the unit of the quantity."""
        return metres(error) if self.measure is None else self.measure.words(error)

    @property
    def error(self) -> float:
        """The error of the worst start; inf if a run failed."""
        return math.inf if self.failure else float(np.max(self.errors, initial=0.0))

    @property
    def median(self) -> float:
        """The error of the median start; inf if a run failed."""
        return math.inf if self.failure else float(np.median(self.errors))

    @property
    def bound(self) -> float:
        """The upper bound of the error of the worst start; inf if a run failed.

        The bound is the error plus the truth's uncertainty and the modelling error.
        """
        modelled = 0.0 if self.modelled is None else self.modelled
        every = self.errors + self.unsure + modelled
        return math.inf if self.failure else float(np.max(every, initial=0.0))

    @property
    def worst(self) -> int:
        """The start with the largest error."""
        return self.starts[int(np.argmax(self.errors))]

    @property
    def dt(self) -> float:
        """The time step [s]."""
        settings: Settings = self.settings
        return float(settings.dt)

    def within(self, error: float) -> bool:
        """Return whether every start stays within an error, by its `bound`."""
        return self.bound <= error

    def refuted(self, error: float) -> bool:
        """Return whether a start exceeds an error beyond its uncertainty, or a run failed."""
        return bool(self.failure) or bool((self.errors - self.unsure > error).any())

    def verdict(self, limit: float, remedy: str = "") -> Verdict:
        """Return whether every start has at most an error, by its uncertainty.

        limit: the error. remedy: how to decide it if it is undecided, in words.
        """
        test = f"error at most {self.words(limit)}"
        if self.failure:
            return Verdict(test, False, self.failure)
        unsure = float(np.max(self.unsure, initial=0.0))
        error = f"{self.words(self.error)} (± {self.words(unsure)})"
        reason = f"{error} in the worst of {counted(len(self.starts), 'start')}"
        if self.within(limit):
            return Verdict(test, True, reason)
        if self.refuted(limit):
            return Verdict(test, False, reason)
        return Verdict(test, None, f"{reason}{remedy and f', {remedy}'}")

    def misses(self, error: float) -> list[int]:
        """Return the starts that exceed an error, worst first; all if a run failed."""
        if self.failure:
            return list(self.starts)
        over = np.flatnonzero(~(self.errors <= error))
        return [self.starts[k] for k in sorted(over, key=lambda k: -self.errors[k])]

    def part(self, starts: Sequence[int]) -> Trial:
        """Return the trial with some of its starts, without poses."""
        places = [self.starts.index(start) for start in starts]
        errors, unsure, largest = self.errors[places], self.unsure[places], self.largest[places]
        parts = None if self.parts is None else self.parts[:, places]
        some = replace(self, starts=tuple(starts), errors=errors, unsure=unsure, largest=largest)
        return replace(some, parts=parts, tracks=None)

    @classmethod
    def joined(cls, parts: Sequence[Trial]) -> Trial:
        """Return the trial of one change from all starts of some parts."""
        first = parts[0]
        errors, unsure, largest = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("errors", "unsure", "largest")
        )
        of_each = [part.parts for part in parts if part.parts is not None]
        starts = tuple(start for part in parts for start in part.starts)
        failure = next((part.failure for part in parts if part.failure), "")
        whole = replace(first, starts=starts, failure=failure, tracks=None)
        each = np.concatenate(of_each, axis=1) if of_each else None
        return replace(whole, errors=errors, unsure=unsure, largest=largest, parts=each)

    @property
    def named(self) -> dict[str, float]:
        """The error of each of several quantities in the worst start, by name, in its unit."""
        if self.parts is None or self.measure is None:
            return {}
        worst = self.parts.max(axis=1, initial=0.0)
        names = (part.quantity.name for part in self.measure.parts)
        return {name: float(error) for name, error in zip(names, worst, strict=True)}

    def record(self) -> dict[str, Any]:
        """Return the trial as plain data."""
        return {
            "change": self.change.words,
            "error": None if self.failure else self.error,
            "median": None if self.failure else self.median,
            "largest": None if self.failure else float(np.max(self.largest)),
            "unsure": float(np.max(self.unsure, initial=0.0)),
            **({} if self.failure else self.named),
            "modelled": None if self.modelled is None else float(np.max(self.modelled)),
            "starts": len(self.starts),
            "work": self.work,
            "cost": self.cost,
            "failure": self.failure or None,
            **({} if self.stability is None else {"stability": vars(self.stability)}),
        }
