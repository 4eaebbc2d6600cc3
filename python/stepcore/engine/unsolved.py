"""Warning of rows that stay unsolved: a residual that is large during half of a run.

Impacts cause large residuals in single steps of healthy runs. A run is not healthy if the residual
exceeds the speed that gravity adds in one step during half of the run: the rows then violate their
constraints, so that a stack sinks, a wheel slips or a chain comes apart. With ``sweeps="auto"`` one
such sample is enough, because every step should be solved.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from stepcore._core import Settings
    from stepcore.engine.arrays import Floats

# The approximate number of samples of a run, and the fewest with a meaningful median. A batch
# samples after 64, 128, 256, … steps and warns of a world with this number of consecutive large
# residuals.
LOOKS, FEWEST_LOOKS, IN_A_ROW = 64, 16, 3


class UnsolvedWarning(UserWarning):
    """Constraint rows stay unsolved; the text names the worst row, its residual and a fix."""


class Residuals:
    """The residuals of a run, sampled at intervals."""

    def __init__(self, sim: Any) -> None:
        self.large = _large(sim)
        self.seen: list[float] = []
        self.row, self.worst = "", 0.0

    def look(self, sim: Any) -> None:
        """Sample the residual of a Sim's last solve, and the row with the largest residual."""
        residual = float(sim.residual)
        self.seen.append(residual)
        if residual > max(self.large, self.worst):
            self.row, self.worst = _worst(sim.rows), residual

    @property
    def typical(self) -> float:
        """The median of the samples [m/s]; 0 if there are too few samples."""
        return float(np.median(self.seen)) if len(self.seen) >= FEWEST_LOOKS else 0.0

    def sentence(self, settings: Settings) -> str:
        """Return a sentence on unsolved rows and a fix; "" if there are none."""
        residual = self.worst if settings.sweeps == "auto" else self.typical
        return unsolved_sentence(settings, self.row, residual) if residual > self.large else ""


class BatchResiduals:
    """The residuals of a batch, sampled at increasing intervals."""

    def __init__(self) -> None:
        self.steps, self.next = 0, LOOKS
        self.large: Floats | None = None
        self.warned = False

    def step(self, batch: Any, steps: int) -> str:
        """Count steps; return the sentence once, if a world's residual stays large."""
        self.steps += steps
        if self.steps < self.next or self.warned:
            return ""
        while self.next <= self.steps:
            self.next *= 2
        residual = batch.residual
        before = np.zeros(len(residual)) if self.large is None else self.large
        self.large = np.where(residual > _large(batch), before + 1, 0)
        world = int(np.argmax(np.where(self.large >= IN_A_ROW, residual, 0)))
        if self.large[world] < IN_A_ROW:
            return ""
        self.warned = True
        text = unsolved_sentence(batch.settings, _worst(batch.rows[world]), float(residual[world]))
        return f"world {world}: {text}"


def unsolved_sentence(settings: Settings, row: str, residual: float) -> str:
    """Return a sentence on rows that stay unsolved."""
    # Imported here because only the warning needs the units.
    from stepcore.report.units import speed

    newton, auto = settings.solver == "newton", settings.sweeps == "auto"
    noun = ("iteration" if newton else "sweep") + ("" if settings.sweeps == 1 else "s")
    count = "the most" if auto else settings.sweeps
    with_ = f"{count} {noun} of {settings.solver}" + " that auto makes" * auto
    cures = [] if auto else ['sweeps="auto"']
    if settings.law == "solref":
        cures += ['acceleration="momentum"'] if newton else ['solver="newton"']
    cure = f"; {' or '.join(cures)} solves them" if cures else ""
    return f"rows stay unsolved: {row} misses its law by {speed(residual)} with {with_}{cure}"


def _large(sim: Any) -> float:
    """Return the threshold of the warning [m/s]: the speed that gravity adds in one step."""
    scene = sim.model.scene
    speed = float(np.linalg.norm(scene.gravity)) * sim.settings.dt
    # Without gravity 50 mm/s is a large residual.
    return speed if scene.features.gravity and speed > 0 else 0.05


def _worst(rows: Any) -> str:
    return str(rows["name"][int(np.argmax(rows["residual"]))]) if len(rows) else ""
