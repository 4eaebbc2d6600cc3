"""`Ablation`: the table of features, the conclusions in sentences, and the smallest model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from stepcore.engine.features import Removal
from stepcore.experiment.choose import Proof
from stepcore.experiment.motion import Motion
from stepcore.experiment.trial import Trial
from stepcore.report.report import SHORT, not_shown
from stepcore.report.result import Result
from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import compact, counted, metres, percent
from stepcore.scene.scene import Scene

# Kinds of features that a motion may merely not use.
UNUSED = ("colliders", "collider", "collider group", "self-collision", "limits", "limit")
# Errors below this share of the tolerance are rounding, amplified by the motion.
MEASURABLE = 1e-6
LEGEND = (
    "saved: share of the floating-point operations per simulated second, negative if the variant "
    "costs more; µs: computing time saved per simulated second, as measured here; added: RMS "
    "position error added to the motion in the worst start [m]; max: the largest error added to "
    "any body [m]; error: RMS position error against the converged motion in the worst start [m]."
)
# A measured saving below this share of the time is noise of the clock: least of five runs that take
# turns, of one model under two names, differed by up to 4 % on half_cheetah and Go2.
NOISE = 0.05


@dataclass(frozen=True)
class FeatureEffect:
    """One removed feature.

    trial: the motion without the feature; its errors are distances from the whole model's motion
        under the same settings.
    error: RMS distance from the whole model's converged motion in the worst start [m]; None if that
        is not known, or the run failed.
    cost: measured computing time without it [µs per simulated second]; NaN if it was not timed.
    """

    removal: Removal
    trial: Trial
    error: float | None
    cost: float


@dataclass(eq=False, repr=False)
class Ablation(Result):
    """The cost of each modelled feature, and the error added by removal; `ablate` returns it.

    tolerance: the error that the smallest model may add [m].
    whole: the model with all features.
    rows: one for each feature, removed alone.
    removed: the features that the smallest model leaves out.
    best: the smallest model on the starts on which it was chosen.
    proof: the smallest model on starts that no choice has seen; None if it did not run there.
    smallest: the smallest model as a Scene; None for MuJoCo, whose flags are in `in_file`.
    reference: the error of the converged motion in the worst start [m]; None without one.
    complete: whether the search for the smallest model came to its end.

    >>> from stepcore import ablate, lesson
    >>> result = ablate(lesson.drop(), horizon=0.2, starts=1, progress=False)
    >>> isinstance(result, Ablation), result.best.trial.error <= result.tolerance
    (True, True)
    """

    kind = "ablation"
    units: ClassVar = {"saved": "1", "flops": "1/s", "cost": "µs/s"} | dict.fromkeys(
        ("added", "added_median", "added_max", "error"), "m"
    )

    settings: Any
    motion: Motion
    horizon: float
    starts: int
    tolerance: float
    whole: FeatureEffect
    rows: list[FeatureEffect]
    removed: list[Removal]
    best: FeatureEffect
    proof: Proof | None
    smallest: Scene | None
    reference: float | None
    complete: bool = True

    @property
    def title(self) -> str:
        """The quantity measured, in a few words."""
        return f"{self.name}: cost and effect of each modelled feature"

    @property
    def setup(self) -> str:
        """The runs that were made."""
        said = f"{counted(len(self.rows), 'feature')} under {label(self.settings)}"
        if self.reference is None:
            return f"{said}."
        return f"{said}; the uncertainty of the reference is {metres(self.reference)}."

    def saved(self, row: FeatureEffect) -> float:
        """Return the share of the whole model's operations that a row saves; NaN if it fails."""
        whole = self.whole.trial.work
        return math.nan if row.trial.failure else (whole - row.trial.work) / whole

    def measurable(self, row: FeatureEffect) -> bool:
        """Return whether the error that a row adds is more than rounding."""
        return row.trial.error >= MEASURABLE * self.tolerance

    @property
    def in_file(self) -> str:
        """The flags of MJCF that make the smallest model."""
        flags = " ".join(f'{removal.kind}="disable"' for removal in self.removed)
        return f"<option><flag {flags}/></option>" if flags else ""

    def sorted(self) -> list[FeatureEffect]:
        """Return the rows, largest saving first, failures last."""
        return sorted(self.rows, key=lambda row: (bool(row.trial.failure), -self.saved(row)))

    @property
    def table(self) -> Table:
        """Each feature removed alone; units as in `FeatureEffect` and `Trial`."""
        return Table(self.record(row) for row in self.rows)

    def record(self, row: FeatureEffect) -> dict[str, Any]:
        """Return one row as plain data."""
        trial, own = row.trial, row.trial.record()
        return {
            "feature": row.removal.kind,
            "name": row.removal.name,
            "saved": self.saved(row),
            "flops": None if trial.failure else trial.work,
            "cost": row.cost,
            "added": own["error"],
            "added_median": own["median"],
            "added_max": own["largest"],
            "error": row.error,
            "left_out": row.removal in self.removed,
            "failure": own["failure"],
        }

    def details(self) -> dict[str, Any]:
        """Return the tolerance, the whole model and the smallest as plain data."""
        proof = self.proof
        known = None if proof is None else proof.record() | {"added": proof.trial.error}
        smallest = self.record(self.best) | {
            "without": [removal.label for removal in self.removed],
            "proof": known,
            "mjcf": self.in_file if self.smallest is None else self.smallest.to_mjcf(),
        }
        return {
            "tolerance": self.tolerance,
            "reference_error": self.reference,
            "whole": self.record(self.whole),
            "smallest": smallest,
        }

    def tables(self, full: bool) -> list[Table]:
        """Return the tables of the whole model, its features and the smallest model.

        Features are sorted by saving, largest first.

        full: whether to include every feature; otherwise only the removed features and the largest
            savings.
        """
        features, legend = self.sorted(), LEGEND
        if not full and len(features) > SHORT + 1:
            first = sorted(features, key=lambda row: row.removal not in self.removed)[:SHORT]
            legend += f" {not_shown(counted(len(features) - SHORT, 'feature'))}"
            features = [row for row in features if row in first]
        cells = [self._cells(row) for row in (self.whole, *features, self.best)]
        formats = dict.fromkeys(("saved", "µs", "added", "max", "error"), "")
        return [Table(cells, formats=formats, legend=legend)]

    def _cells(self, row: FeatureEffect) -> dict[str, Any]:
        trial, names = row.trial, {id(self.whole): "nothing (the whole model)"}
        names[id(self.best)] = "all marked *"
        saved = "failed" if trial.failure else percent(self.saved(row))
        spared = "" if math.isnan(row.cost) else f"{self.whole.cost - row.cost:.0f}"
        least = MEASURABLE * self.tolerance
        wrong = [] if trial.failure else [trial.error, float(trial.largest.max())]
        added = ["0" if far < least else compact(far) for far in wrong] or ["", ""]
        return {
            "": "*" if row.removal in self.removed else "",
            "without": names.get(id(row), row.removal.label),
            "saved": "" if row is self.whole else saved,
            "µs": "" if row is self.whole else spared,
            "added": added[0],
            "max": added[1],
            "error": "" if row.error is None else compact(row.error),
        }

    @property
    def sentences(self) -> list[str]:
        """The smallest model, features without effect, the largest effect, and failures."""
        said, whole = self._smallest(), self.whole.trial.work
        alike = [r for r in self.rows if r.trial.error == 0.0 and r.trial.work < whole]
        if alike:
            labels = "; ".join(row.removal.label for row in alike)
            said.append(f"The motion is bit-identical without: {labels}.")
        ran = [row for row in self.rows if not row.trial.failure]
        largest = max(ran, key=lambda row: row.trial.error, default=None)
        if largest is not None and largest.trial.error > self.tolerance:
            said.append(
                f"The largest effect: without {largest.removal.label} the error in the worst start "
                f"is {metres(largest.trial.error)}."
            )
        failed = [row for row in self.rows if row.trial.failure]
        return said + [
            f"Without {r.removal.label} the run fails: {r.trial.failure}." for r in failed
        ]

    def _smallest(self) -> list[str]:
        """Describe the features that the smallest model leaves out, and the error added."""
        within = metres(self.tolerance)
        if not self.removed and not self.complete:
            return [f"A smaller model within {within} has not been found so far."]
        if not self.removed:
            text = "removing any that costs work adds a larger error"
            return [f"No feature can be removed within {within}: {text}."]
        starts = counted(self.starts, "start")
        added = f"It adds an error of {metres(self.best.trial.error)} in the worst of {starts}."
        if not self.measurable(self.best):
            added = f"It adds no measurable error from {starts}."
        listed = "; ".join(removal.label for removal in self.removed)
        said = [self._gain(within), f"It leaves out {listed}.", added]
        said += [] if self.proof is None else [self.proof.words]
        said += [f"In the file: {self.in_file}"] if self.smallest is None else []
        if any(removal.kind in UNUSED for removal in self.removed):
            said.append(
                "What this motion never touches or reaches, another may: give your own motion "
                "before you remove it."
            )
        return said

    def _gain(self, within: str) -> str:
        """Describe the work and the time that the smallest model saves."""
        share = percent(self.saved(self.best))
        saves = f"he smallest model within {within} saves {share} of the floating-point operations"
        quicker = (self.whole.cost - self.best.cost) / self.whole.cost
        if math.isnan(quicker):
            return f"T{saves}."
        if quicker > NOISE:
            return f"T{saves}, and {100 * quicker:.0f} % of the computing time as measured here."
        if quicker < -NOISE:
            more = f"{-100 * quicker:.0f} % more time as measured here"
            return f"No gain: t{saves}, but takes {more}."
        return f"No measurable gain in speed: t{saves}, and takes about the same time here."

    def __repr__(self) -> str:
        left_out = f"{len(self.removed)} removed within {metres(self.tolerance)}"
        return f"<Ablation {self.name}: {len(self.rows)} features, {left_out}>"
