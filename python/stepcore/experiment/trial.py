"""`Trial`: what one change did. Text, tables, plots and choices read nothing else."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stepcore._core import Settings
from stepcore.engine.norm import Tracks
from stepcore.experiment.change import Change


@dataclass(frozen=True, eq=False)
class Trial:
    """What one change did, from several starts.

    change: what was run. settings: all settings under which it was run.
    starts: the starts of the motion it was run from, by index.
    errors: the RMS position error of every start [m], (starts,): the distance from the truth by the
        norm of `stepcore.engine.norm`, over the samples that can be predicted, and never below
        what the truth is sure of; inf where the run failed, NaN without a truth.
    unsure: how far the truth of every start may be off [m], (starts,).
    largest: the largest error of a body at any time, of every start [m], (starts,).
    work: counted floating-point operations per simulated second; the same on every machine.
    cost: by which trials are ranked: computing time by the counted work [µs per simulated second],
        see `stepcore.experiment.price`; or the work itself, see `Study`.
    failure: why the first run that failed did; "" if none did.
    tracks: the poses of the bodies.
    modelled: (of a change of what is modelled) how far the converged motion of the changed model is
        from the scene's own, of every start [m], (starts,); None for settings alone.
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

    @property
    def error(self) -> float:
        """The RMS position error of the worst start [m]; inf if a run failed."""
        return math.inf if self.failure else float(np.max(self.errors, initial=0.0))

    @property
    def median(self) -> float:
        """The RMS position error of the median start [m]; inf if a run failed."""
        return math.inf if self.failure else float(np.median(self.errors))

    @property
    def bound(self) -> float:
        """The most that the worst start may be off [m]; inf if a run failed.

        That is its error, with what the truth may be off and with the modelling error.
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
        """Return whether every start stays within an error [m], the truth's own included."""
        return self.bound <= error

    def refuted(self, error: float) -> bool:
        """Return whether a start surely exceeds an error [m], or a run failed."""
        return bool(self.failure) or bool((self.errors - self.unsure > error).any())

    def misses(self, error: float) -> list[int]:
        """Return the starts whose error is above one [m], worst first; all if a run failed."""
        if self.failure:
            return list(self.starts)
        over = np.flatnonzero(~(self.errors <= error))
        return [self.starts[k] for k in sorted(over, key=lambda k: -self.errors[k])]

    def part(self, starts: Sequence[int]) -> Trial:
        """Return the trial from some of its starts, without poses."""
        places = [self.starts.index(start) for start in starts]
        errors, unsure, largest = self.errors[places], self.unsure[places], self.largest[places]
        return replace(
            self, starts=tuple(starts), errors=errors, unsure=unsure, largest=largest, tracks=None
        )

    @classmethod
    def joined(cls, parts: Sequence[Trial]) -> Trial:
        """Return the trial of one change from all starts of some parts."""
        first = parts[0]
        errors, unsure, largest = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("errors", "unsure", "largest")
        )
        starts = tuple(start for part in parts for start in part.starts)
        failure = next((part.failure for part in parts if part.failure), "")
        whole = replace(first, starts=starts, failure=failure, tracks=None)
        return replace(whole, errors=errors, unsure=unsure, largest=largest)

    def record(self) -> dict[str, Any]:
        """Return the trial as plain data."""
        return {
            "change": self.change.words,
            "error": None if self.failure else self.error,
            "median": None if self.failure else self.median,
            "largest": None if self.failure else float(np.max(self.largest)),
            "unsure": float(np.max(self.unsure, initial=0.0)),
            "modelled": None if self.modelled is None else float(np.max(self.modelled)),
            "starts": len(self.starts),
            "work": self.work,
            "cost": self.cost,
            "failure": self.failure or None,
        }
