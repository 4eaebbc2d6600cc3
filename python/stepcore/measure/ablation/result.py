"""`Ablation`: the table of features, the conclusions in sentences, and the smallest model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from stepcore._core import Settings
from stepcore.engine.features import Removal
from stepcore.experiment.intervals import Difference
from stepcore.experiment.motion import Motion
from stepcore.measure.ablation.variants import VariantOutcome
from stepcore.report.result import Result
from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import compact, counted, metres, percent
from stepcore.scene.scene import Scene

# Kinds of features that a motion may merely not use.
UNUSED = ("colliders", "collider", "collider group", "self-collision", "limits", "limit")
# Number of features printed in the short table.
PRINTED = 10
# Errors below this are rounding, amplified by the motion [m].
MEASURABLE = 1e-9
LEGEND = (
    "saved: share of the work per simulated second ({work}), negative if the variant costs more; "
    "µs: computing time saved per simulated second, with its 95 % interval; added: RMS position "
    "error added to the motion in the worst start [m]; max: the largest error added to any body "
    "[m]; error: RMS position error against the converged motion in the worst start [m]"
)


@dataclass(frozen=True)
class FeatureEffect:
    """One removed feature.

    outcome: the motion without the feature.
    cost: computing time without it [µs per simulated second].
    time_saved: the computing time saved [µs per simulated second]; None if it was not timed.
    """

    removal: Removal
    outcome: VariantOutcome
    cost: float
    time_saved: Difference | None = None


@dataclass(eq=False, repr=False)
class Ablation(Result):
    """The cost of each modelled feature, and the error added by removal; `ablate` returns it.

    tolerance: the error that the smallest model may add [m].
    whole: the model with all features.
    rows: one for each feature, removed alone.
    removed: the features that the smallest model leaves out.
    best: the smallest model on the starts on which it was chosen.
    confirmed: the smallest model on other starts.
    restored: the features that other starts needed.
    restored_on: the smallest model on the last starts that restored a feature, if any.
    smallest: the smallest model as a Scene.
    reference: the error of the converged motion in the worst start [m]; None without one.
    complete: whether the search for the smallest model came to its end.

    >>> from stepcore import ablate, lesson
    >>> result = ablate(lesson.drop(), horizon=0.2, starts=1, progress=False)
    >>> isinstance(result, Ablation), result.best.outcome.worst <= result.tolerance
    (True, True)
    """

    kind = "ablation"
    units: ClassVar = {
        "saved": "1",
        "flops": "1/s",
        "row_updates": "1/s",
        "cost": "µs/s",
        "added": "m",
        "added_median": "m",
        "added_max": "m",
        "error": "m",
    }

    settings: Settings
    motion: Motion
    horizon: float
    starts: int
    tolerance: float
    whole: FeatureEffect
    rows: list[FeatureEffect]
    removed: list[Removal]
    best: FeatureEffect
    confirmed: VariantOutcome
    restored: list[Removal]
    smallest: Scene
    reference: float | None
    restored_on: VariantOutcome | None = None
    complete: bool = True

    @property
    def title(self) -> str:
        """The quantity measured, in a few words."""
        return f"{self.name}: cost and effect of each modelled feature"

    @property
    def setup(self) -> str:
        """The runs that were made."""
        known = ""
        if self.reference is not None:
            known = f"; the uncertainty of the reference is {metres(self.reference)}"
        features = counted(len(self.rows), "feature")
        return f"{features} under {label(self.settings)}{known}."

    def saved(self, row: FeatureEffect) -> float:
        """Return the share of the whole model's work that a row saves."""
        return row.outcome.saved(self.whole.outcome)

    def measurable(self, row: FeatureEffect) -> bool:
        """Return whether the error that a row adds is more than rounding."""
        return row.outcome.worst >= MEASURABLE

    @property
    def kept(self) -> float:
        """The least share of all such starts that stay within the tolerance (95 % confidence).

        After n other starts without a failure this is 0.05^(1/n) (Hanley and Lippman-Hand, JAMA
        249, 1983).
        """
        return 0.05 ** (1 / max(1, len(self.confirmed.added)))

    @property
    def by_flops(self) -> bool:
        """Whether work is floating-point operations rather than row updates."""
        return self.whole.outcome.flops is not None

    @property
    def table(self) -> Table:
        """Each feature removed alone; units as in `FeatureEffect` and `VariantOutcome`."""
        return Table(self.record(row) for row in self.rows)

    def sorted(self) -> list[FeatureEffect]:
        """Return the rows, largest saving first, failures last."""
        shares = [(self.saved(row), i) for i, row in enumerate(self.rows)]
        order = sorted((math.isnan(share), -share, i) for share, i in shares)
        return [self.rows[i] for *_, i in order]

    def record(self, row: FeatureEffect) -> dict[str, Any]:
        """Return one row as plain data."""
        outcome = row.outcome
        failed = outcome.failure is not None
        return {
            "feature": row.removal.kind,
            "name": row.removal.name,
            "saved": self.saved(row),
            "flops": None if failed else outcome.flops,
            "row_updates": None if failed else outcome.row_updates,
            "cost": row.cost,
            "added": None if failed else outcome.worst,
            "added_median": None if failed else outcome.median,
            "added_max": None if failed else outcome.added_max,
            "error": max(outcome.error) if outcome.error else None,
            "left_out": row.removal in self.removed,
            "failure": outcome.failure,
        }

    def details(self) -> dict[str, Any]:
        """Return the tolerance, the whole model and the smallest as plain data."""
        return {
            "tolerance": self.tolerance,
            "reference_error": self.reference,
            "whole": self.record(self.whole),
            "smallest": {
                **self.record(self.best),
                "without": [removal.label for removal in self.removed],
                "restored": [removal.label for removal in self.restored],
                "confirmed": self.confirmed.worst,
                "confirmed_starts": len(self.confirmed.added),
                "restored_on": self.restored_on.worst if self.restored_on else None,
                "kept": self.kept,
                "mjcf": self.smallest.to_mjcf(),
            },
        }

    def tables(self, full: bool) -> list[Table]:
        """Return the tables of the whole model, its features and the smallest model.

        Features are sorted by saving, largest first.

        full: whether to include every feature; otherwise only the removed features and the largest
            savings.
        """
        features = self.sorted()
        if not full and len(features) > PRINTED + 1:
            first = [row.removal in self.removed for row in features]
            order = sorted(range(len(features)), key=lambda k: (not first[k], k))
            features = [features[k] for k in sorted(order[:PRINTED])]
        rows = [self.whole, *features, self.best]
        formats = dict.fromkeys(("saved", "µs", "added", "max", "error"), "")
        legend = LEGEND.format(work="floating-point operations" if self.by_flops else "row updates")
        left = len(self.rows) - len(features)
        if left:
            legend += f". Not shown: {counted(left, 'feature')} (--all; in Python text(full=True))"
        return [Table([self._cells(row) for row in rows], formats=formats, legend=legend)]

    def _cells(self, row: FeatureEffect) -> dict[str, Any]:
        outcome = row.outcome
        mark = "*" if row.removal in self.removed else ""
        cells: dict[str, Any] = {"": mark, "without": row.removal.label}
        share = self.saved(row)
        if row is self.whole:
            cells |= {"without": "nothing (the whole model)", "saved": "", "µs": ""}
        else:
            if row is self.best:
                cells["without"] = "all marked *"
            cells["saved"] = "failed" if math.isnan(share) else percent(share)
            gain = row.time_saved
            cells["µs"] = "" if gain is None else f"{gain.mean:.0f} ± {gain.interval:.0f}"
        cells["added"] = "" if outcome.failure else _rounded(outcome.worst)
        cells["max"] = "" if outcome.failure else _rounded(outcome.added_max)
        cells["error"] = compact(max(outcome.error)) if outcome.error else ""
        return cells

    @property
    def sentences(self) -> list[str]:
        """The smallest model, features without effect, the largest effect, and failures."""
        sentences = self._smallest()
        unused = [
            row.removal.label
            for row in self.rows
            if row.removal not in self.restored
            and row.outcome.worst == 0.0
            and row.outcome.work < self.whole.outcome.work
        ]
        if unused:
            sentences.append(f"The motion is bit-identical without: {'; '.join(unused)}.")
        ran = [row for row in self.rows if not row.outcome.failure]
        largest = max(ran, key=lambda row: row.outcome.worst, default=None)
        if largest is not None and largest.outcome.worst > self.tolerance:
            sentences.append(
                f"The largest effect: without {largest.removal.label} the error in the worst start "
                f"is {metres(largest.outcome.worst)}."
            )
        failed = [row for row in self.rows if row.outcome.failure]
        sentences += [
            f"Without {r.removal.label} the run fails: {r.outcome.failure}." for r in failed
        ]
        return sentences

    def _smallest(self) -> list[str]:
        """Describe the features that the smallest model leaves out, and the error added."""
        within = metres(self.tolerance)
        if not self.removed and self.restored:
            return [
                f"No feature can be removed within {within}: features that were removable on the "
                f"first starts exceed the tolerance on others: {_listed(self.restored)}."
            ]
        if not self.removed and not self.complete:
            return [f"A smaller model within {within} has not been found so far."]
        if not self.removed:
            return [
                f"No feature can be removed within {within}: removing any that costs work adds a "
                "larger error."
            ]
        sentences = [
            self._gain(within),
            f"It leaves out {_listed(self.removed)}.",
            f"It adds {self._added()}{self._confidence()}.",
        ]
        if any(removal.kind in UNUSED for removal in self.removed):
            sentences.append(
                "What this motion never touches or reaches, another may: give your own motion "
                "before you remove it."
            )
        if self.restored:
            sentences.append(f"Kept after all, for other starts: {_listed(self.restored)}.")
        return sentences

    def _gain(self, within: str) -> str:
        """Describe the work and the time that the smallest model saves."""
        kind = "floating-point operations" if self.by_flops else "row updates"
        saves = (
            f"the smallest model within {within} saves {percent(self.saved(self.best))} of the "
            f"{kind}"
        )
        gain = self.best.time_saved
        if gain is None:
            return f"T{saves[1:]}."
        whole = gain.reference + gain.mean
        share = f"{100 * gain.mean / whole:.0f} ± {100 * gain.interval / whole:.0f} %"
        if gain.seen and gain.mean > 0:
            return f"T{saves[1:]}, and {share} of the computing time."
        if gain.seen:
            return f"No gain: {saves}, but takes more time ({share} of it saved)."
        return f"No measurable gain in speed: {saves}, and {share} of the computing time."

    def _confidence(self) -> str:
        """Describe on how many starts the smallest model keeps to the tolerance."""
        if not self.confirmed.added:
            return ""
        return (
            f", so at least {percent(self.kept)} of such starts keep to the tolerance "
            "(95 % confidence)"
        )

    def _added(self) -> str:
        """Describe the error of the smallest model in the first starts, and in others."""
        here, there = self.best.outcome.worst, self.confirmed.worst
        if not self.confirmed.added:
            return f"{_error(here)} in the worst of these starts; others were not tried"
        others = counted(len(self.confirmed.added), "other start")
        before = self.restored_on.worst if self.restored_on else 0.0
        if before > max(here, there, MEASURABLE):
            others += f" ({_error(before)} in those for which features were restored)"
        if max(here, there, before) < MEASURABLE:
            return f"no measurable error, in these starts and in {others}"
        return f"{_error(here)} in the worst start, and {_error(there)} in the worst of {others}"

    def __repr__(self) -> str:
        return (
            f"<Ablation {self.name}: {len(self.rows)} features, {len(self.removed)} removed "
            f"within {metres(self.tolerance)}>"
        )


def _rounded(added: float) -> str:
    """Return an error for the table; errors that are rounding are 0."""
    return "0" if added < MEASURABLE else compact(added)


def _error(added: float) -> str:
    return "no measurable error" if added < MEASURABLE else f"an error of {metres(added)}"


def _listed(removals: list[Removal]) -> str:
    return "; ".join(removal.label for removal in removals)
