"""Warns of rows that stay unsolved: a residual that is large during most of a run.

A residual is large in single steps of healthy runs, where something hits. Where in half of a run
it is more than the speed that gravity gives in a step, rows do not hold what they should: a stack
sinks, a wheel slips, a chain comes apart.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from stepcore._core import Settings
    from stepcore.engine.arrays import Floats

# A large residual where there is no gravity [m/s].
WEIGHTLESS = 0.05
# It stays large: in this share of at least so many looks.
STAYS, FEWEST = 0.5, 16
# About so many looks at a run; a batch looks after 64, 128, 256, … steps, and tells the third
# large residual of a world in a row.
LOOKS, FIRST, IN_A_ROW = 64, 64, 3


class UnsolvedWarning(UserWarning):
    """Constraint rows stay unsolved: the text says by how much, which, and what solves them."""


class Residuals:
    """The residuals of a run, looked at now and then."""

    def __init__(self, sim: Any) -> None:
        self.large = _large(sim)
        self.seen: list[float] = []
        self.row = ""

    def look(self, sim: Any) -> None:
        """Note the residual of a Sim's last solve, and the row that is farthest from its law."""
        residual = float(sim.residual)
        self.seen.append(residual)
        if residual > self.large:
            self.row = _worst(sim.rows)

    @property
    def typical(self) -> float:
        """The median of the looks [m/s], 0 if they are too few to judge by."""
        return float(np.quantile(self.seen, 1 - STAYS)) if len(self.seen) >= FEWEST else 0.0

    def sentence(self, settings: Settings) -> str:
        """What stays unsolved, and what solves it; "" if nothing does."""
        return unsolved(settings, self.row, self.typical) if self.typical > self.large else ""


class BatchResiduals:
    """The residuals of a batch, looked at more and more rarely."""

    def __init__(self) -> None:
        self.steps, self.next = 0, FIRST
        self.large: Floats | None = None
        self.told = False

    def step(self, batch: Any, steps: int) -> str:
        """Count steps; returns the sentence, once, if a world's residual has stayed large."""
        self.steps += steps
        if self.steps < self.next or self.told:
            return ""
        while self.next <= self.steps:
            self.next *= 2
        residual = batch.residual
        before = np.zeros(len(residual)) if self.large is None else self.large
        self.large = np.where(residual > _large(batch), before + 1, 0)
        world = int(np.argmax(np.where(self.large >= IN_A_ROW, residual, 0)))
        if self.large[world] < IN_A_ROW:
            return ""
        self.told = True
        text = unsolved(batch.settings, _worst(batch.rows[world]), float(residual[world]))
        return f"world {world}: {text}"


def unsolved(settings: Settings, row: str, residual: float) -> str:
    """A sentence on rows that stay unsolved."""
    # Only what is wrong needs the words.
    from stepcore.report.units import speed

    count, newton = settings.sweeps, settings.solver == "newton"
    noun = ("iteration" if newton else "sweep") + ("" if count == 1 else "s")
    with_ = f"{count} {noun} of {settings.solver}"
    cures = [] if settings.sweeps == "auto" else ['sweeps="auto"']
    if settings.law == "solref":
        cures += ['acceleration="momentum"'] if newton else ['solver="newton"']
    cure = f"; {' or '.join(cures)} solves them" if cures else "; a smaller dt may solve them"
    return f"rows stay unsolved: {row} misses its law by {speed(residual)} with {with_}{cure}"


def _large(sim: Any) -> float:
    """The residual above which a run is warned of [m/s]: the speed that gravity gives in a step."""
    scene = sim.model.scene
    given = float(np.linalg.norm(scene.gravity)) * sim.settings.dt
    return given if scene.features.gravity and given > 0 else WEIGHTLESS


def _worst(rows: Any) -> str:
    return str(rows["name"][int(np.argmax(rows["residual"]))]) if len(rows) else ""
