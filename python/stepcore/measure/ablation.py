"""`ablate`: the cost of each modelled feature, and the error added when the feature is removed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np

from stepcore import checks
from stepcore.deadline import PROVEN
from stepcore.engine.features import MotionUsage, RemovableFeatures, Removal, without
from stepcore.experiment.arguments import MeasurementFields, Source, measurement, set_up
from stepcore.experiment.change import Change
from stepcore.experiment.choose import JOIN, ROUNDS, Proof, greedy
from stepcore.experiment.engines import visits
from stepcore.experiment.motion import Motion
from stepcore.experiment.mujoco_engine import MuJoCo
from stepcore.experiment.predictable import until_in_words
from stepcore.experiment.quantity import Measure, Quantity
from stepcore.experiment.study import SHIPPED, Study
from stepcore.experiment.trial import Trial
from stepcore.experiment.truth import KNOWN, Truth
from stepcore.measure.monitors import verified
from stepcore.measure.monitors.recording import recorded
from stepcore.measure.monitors.scene import resting_findings
from stepcore.report import units
from stepcore.report.report import SHORT, not_shown
from stepcore.report.result import Result
from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import compact, counted, percent
from stepcore.scene.scene import Scene

__all__ = ["Ablation", "FeatureEffect", "ablate"]

# Every feature is first removed from this many starts. Only features within the tolerance are
# tested from the others.
SCREENED = 2
# Kinds of features that are unused in some motions.
UNUSED = ("colliders", "collider", "collider group", "self-collision", "limits", "limit")
# Errors below this share of the tolerance are rounding, amplified by the motion.
MEASURABLE = 1e-6
LEGEND = (
    "saved: share of the floating-point operations per simulated second, negative if the variant "
    "costs more; µs: computing time saved per simulated second, as measured here; added: {error} "
    "added in the worst start{unit}; max: the largest error added at any time{unit}; error: "
    "{error} against the converged motion in the worst start{unit}."
)
# A measured saving below this share of the time is noise: with one model under two names, the
# fastest of five alternating runs differed by up to 4 % on half_cheetah and Go2. The difference
# measured here is added.
NOISE = 0.05


@dataclass(frozen=True)
class FeatureEffect:
    """One removed feature.

    trial: the motion without the feature; its errors are distances from the whole model's motion
        under the same settings.
    error: distance from the whole model's converged motion in the worst start; None if this
        is unknown, or the run failed.
    cost: measured computing time without the feature [µs per simulated second]; NaN if not timed.
    """

    removal: Removal
    trial: Trial
    error: float | None
    cost: float


@dataclass(eq=False, repr=False)
class Ablation(Result):
    """The cost of each modelled feature, and the error added by removal; `ablate` returns it.

    measure: the quantity whose error was measured, with its unit: by default the motion.
    tolerance: the error that the smallest model may add.
    whole: the model with all features.
    rows: one for each feature, removed alone.
    removed: the features that the smallest model leaves out.
    best: the smallest model on the starts on which it was chosen.
    proof: the validation of the smallest model on held-out starts; None if it did not run there.
    smallest: the smallest model as a Scene; None for MuJoCo, whose flags are in `in_file`.
    reference: the uncertainty of the converged motion in the worst start; None without one.
    complete: whether the search for the smallest model was completed.
    noise: the relative difference of two timings of the whole model.
    resting: a sentence on bodies that only rest, and the saving if they are fixed; "" without any.

    >>> from stepcore import ablate, lesson
    >>> result = ablate(lesson.drop(), horizon=0.2, starts=1, progress=False)
    >>> isinstance(result, Ablation), result.best.trial.error <= result.tolerance
    (True, True)
    """

    kind = "ablation"
    settings: Any
    motion: Motion
    horizon: float
    starts: int
    measure: Measure
    tolerance: float
    whole: FeatureEffect
    rows: list[FeatureEffect]
    removed: list[Removal]
    best: FeatureEffect
    proof: Proof | None
    smallest: Scene | None
    reference: float | None
    complete: bool = True
    noise: float = 0.0
    resting: str = ""

    @property
    def units(self) -> dict[str, str]:  # type: ignore[override]
        """The units of the columns of `table`."""
        errors = ("added", "added_median", "added_max", "error")
        fixed = {"saved": "1", "flops": "1/s", "cost": "µs/s"}
        return fixed | dict.fromkeys(errors, self.measure.unit)

    def words(self, error: float) -> str:
        """Format an error in the unit of the quantity."""
        return self.measure.words(error)

    @property
    def title(self) -> str:
        """The measured quantity in a few words."""
        of = "" if self.measure.quantity.is_motion else f" on {self.measure.quantity.name}"
        return f"{self.name}: cost and effect of each modelled feature{of}"

    @property
    def setup(self) -> str:
        """The runs that were made."""
        said = f"{counted(len(self.rows), 'feature')} under {label(self.settings)}"
        if self.reference is None:
            return f"{said}."
        return f"{said}; the uncertainty of the reference is {self.words(self.reference)}."

    def saved(self, row: FeatureEffect) -> float:
        """Return the share of the whole model's operations that a row saves; NaN if it fails."""
        whole = self.whole.trial.work
        return math.nan if row.trial.failure else (whole - row.trial.work) / whole

    def partial(self, row: FeatureEffect) -> bool:
        """Return whether a row ran from some starts only, so that its error is a lower bound."""
        return len(row.trial.starts) < self.starts

    def least(self, row: FeatureEffect, error: str) -> str:
        """Return an error of a row in words, as a lower bound if it ran from some starts only."""
        return f"≥ {error}" if self.partial(row) else error

    def measurable(self, row: FeatureEffect) -> bool:
        """Return whether the error that a row adds is more than rounding."""
        return row.trial.error >= MEASURABLE * self.tolerance

    @property
    def in_file(self) -> str:
        """The MJCF flags of the smallest model."""
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
            "starts": own["starts"],
            "at_least": self.partial(row),
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

        full: whether to include every feature, or only the removed ones and the largest savings.
        """
        features = self.sorted()
        legend = LEGEND.format(error=self.measure.error_words, unit=self.measure.in_unit)
        if not full and len(features) > SHORT + 1:
            first = sorted(features, key=lambda row: row.removal not in self.removed)[:SHORT]
            legend += f" {not_shown(counted(len(features) - SHORT, 'feature'))}"
            features = [row for row in features if row in first]
        shown = (self.whole, *features, self.best)
        cells = [self._cells(row) for row in shown]
        if any(self.partial(row) for row in shown):
            cells = [c | {"starts": len(r.trial.starts)} for c, r in zip(cells, shown, strict=True)]
            legend += (
                f" ≥: it ran from {SCREENED} of {self.starts} starts, and exceeds the tolerance."
            )
        formats = dict.fromkeys(("saved", "µs", "added", "max", "error", "starts"), "")
        return [Table(cells, formats=formats, legend=legend)]

    def _cells(self, row: FeatureEffect) -> dict[str, Any]:
        trial, names = row.trial, {id(self.whole): "nothing (the whole model)"}
        names[id(self.best)] = "all marked *"
        saved = "failed" if trial.failure else percent(self.saved(row))
        spared = "" if math.isnan(row.cost) else f"{self.whole.cost - row.cost:.0f}"
        least = MEASURABLE * self.tolerance
        wrong = [] if trial.failure else [trial.error, float(trial.largest.max())]
        added = ["0" if far < least else self.least(row, compact(far)) for far in wrong] or ["", ""]
        return {
            "": "*" if row.removal in self.removed else "",
            "without": names.get(id(row), row.removal.label),
            "saved": "" if row is self.whole else saved,
            "µs": "" if row is self.whole else spared,
            "added": added[0],
            "max": added[1],
            "error": "" if row.error is None else self.least(row, compact(row.error)),
        }

    @property
    def sentences(self) -> list[str]:
        """The smallest model, features without effect, the largest effect, and failures."""
        said, whole = [self.resting] * bool(self.resting), self.whole.trial.work
        said += self._smallest()
        alike = [r for r in self.rows if r.trial.error == 0.0 and r.trial.work < whole]
        if alike:
            labels = "; ".join(row.removal.label for row in alike)
            said.append(f"The motion is bit-identical without: {labels}.")
        done = [row for row in self.rows if not row.trial.failure]
        largest = max(done, key=lambda row: row.trial.error, default=None)
        if largest is not None and largest.trial.error > self.tolerance:
            ran = counted(len(largest.trial.starts), "start")
            some = f"the {ran} of {self.starts} that ran" if self.partial(largest) else ran
            said.append(
                f"The largest effect: without {largest.removal.label} the error in the worst of "
                f"{some} is {self.words(largest.trial.error)}."
            )
        failed = [row for row in self.rows if row.trial.failure]
        return said + [
            f"Without {r.removal.label} the run fails: {r.trial.failure}." for r in failed
        ]

    def _smallest(self) -> list[str]:
        """Describe the features that the smallest model leaves out, and the error added."""
        within = self.words(self.tolerance)
        if not self.removed and not self.complete:
            return [f"A smaller model within {within} has not been found so far."]
        if not self.removed:
            text = "removing any that costs work adds a larger error"
            return [f"No feature can be removed within {within}: {text}."]
        starts = counted(self.starts, "start")
        added = f"It adds an error of {self.words(self.best.trial.error)} in the worst of {starts}."
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
        quicker, noise = 1 - self.best.cost / self.whole.cost, NOISE + self.noise
        if math.isnan(quicker):
            return f"T{saves}."
        if quicker > noise:
            return f"T{saves}, and {100 * quicker:.0f} % of the computing time as measured here."
        if quicker < -noise:
            more = f"{-100 * quicker:.0f} % more time as measured here"
            return f"No gain: t{saves}, but takes {more}."
        return f"No measurable gain in speed: t{saves}, and takes about the same time here."

    def __repr__(self) -> str:
        left_out = f"{len(self.removed)} removed within {self.words(self.tolerance)}"
        return f"<Ablation {self.name}: {len(self.rows)} features, {left_out}>"


@measurement()
def ablate(
    model: Source,
    motion: Motion | str | None = None,
    *,
    quantity: Quantity | str | Callable[..., Any] | None = None,
    added: float | str | None = None,
    further: int = 32,
    engine: str = "stepcore",
    **fields: Unpack[MeasurementFields],
) -> Ablation:
    """Remove one modelled feature at a time, and measure the work saved and the error added.

    Then `ablate` removes as many features together as possible within `added`. Starts of a second
    set on which this smallest model adds more join the choice. The reported performance comes from
    a third set of held-out starts.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name"). Every run uses the
        settings in the model.
    motion: a `Motion`, or its fields as arguments. By default 1 s, and 8 starts for the choice.
    quantity: the quantity whose error is measured, such as "site/tip" or "max(contact/foot)", see
        `stepcore.experiment.Quantity`. By default the motion of all bodies.
    added: the largest error that the smallest model may add in the worst start: of the motion, the
        RMS position error over samples and bodies: metres, "1mm" (the default), or "0.1%" of the
        scene's size; of another quantity "2N", "0.5deg", or "1%" of its range (the default).
    further: the number of starts of the second and of the third set; 0 for neither.
    engine: "stepcore", or "mujoco", whose flags are then the features. It also runs files that
        stepcore cannot load.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    Raises ValueError for an argument outside its limits, or if the whole model fails.

    >>> from stepcore import loads
    >>> result = ablate(loads('''<mujoco><worldbody><body><joint axis="0 1 0" range="-90 90"/>
    ...   <geom type="capsule" size=".02" fromto="0 0 0 .3 0 -.1"/></body></worldbody></mujoco>'''),
    ...   horizon=0.2, starts=2)
    >>> [row.trial.error for row in result.rows if row.removal.kind == "limits"]
    [0.0]
    >>> result.smallest.joints[0].range is None
    True
    """
    # Check the tolerance before minutes of work; the scene's size is known later.
    quantity = Quantity.of(quantity)
    added = (1e-3 if quantity.is_motion else "1%") if added is None else added
    if quantity.is_motion:
        units.length("ablate", "added", added, 1.0)
    further = checks.count("further", further, least=0)
    setup = set_up(ablate, model, motion, fields, missing="no motion to keep", engine=engine)
    shared: dict[str, Any] = {"engine": setup.engine, "workers": setup.workers}
    study = Study(motion=setup.motion, quantity=quantity, **shared)
    time = setup.workers.deadline
    tolerance = study.error_of("ablate", added, "added")
    truth, notes, resting = None, list[str](), ""
    if engine == "stepcore":
        with time.stage("bodies that only rest"):
            found = resting_findings(recorded(study.model, study.schedule))
            resting = " ".join(one.text for one in verified(found, study.model))
            time.so_far(resting)
    with time.stage("the converged motion, and errors against it", KNOWN):
        truth, notes = _truth(study, tolerance)
    choice, complete, proof = Choice(study, tolerance, truth), False, None
    with time.stage("some of the features, and the search for the smallest model", PROVEN):
        choice.begin()
        choice.choose()
        choice.settle(further)
        complete = True
    with time.stage(f"the test on {further} held-out starts"):
        if further and choice.removed:
            proof = Proof.of(choice.trial(choice.removed, study.fresh(further)), tolerance)
    times, twin = dict[Change, float](), Change(dt=study.engine.dt)
    with time.closing(), time.stage("all timing"):
        every = [SHIPPED, *(trial.change for trial in choice.alone.values()), choice.best.change]
        times = study.times([*every, twin])

    def effect(removal: Removal, trial: Trial) -> FeatureEffect:
        off = None if truth is None else choice.off(trial.change, truth)
        return FeatureEffect(removal, trial, off, times.get(trial.change, math.nan))

    scene = None
    if engine == "stepcore":
        own = setup.model.scene.with_settings(setup.model.settings)
        scene = without(own, choice.removed)
    horizon, starts = study.schedule.horizon, len(study.starts)
    notes += [] if truth is None else until_in_words(truth.growth.ends, horizon)
    return Ablation(
        name=setup.name,
        settings=study.engine.settings(SHIPPED),
        motion=dataclasses.replace(setup.motion, horizon=horizon, starts=starts),
        horizon=horizon,
        starts=len(choice.starts),
        measure=study.measure,
        tolerance=tolerance,
        whole=effect(Removal("whole model", "", ()), choice.whole),
        rows=[effect(removal, trial) for removal, trial in choice.alone.items()],
        removed=choice.removed,
        best=effect(Removal("smallest model", "", ()), choice.best),
        proof=proof,
        smallest=scene,
        reference=None if truth is None else truth.error,
        notes=[*notes, *study.schedule.notes],
        ran=study.motion_ran,
        complete=complete,
        noise=abs(times[twin] / times[SHIPPED] - 1) if twin in times else 0.0,
        resting=resting,
    )


def _truth(study: Study, tolerance: float) -> tuple[Truth | None, list[str]]:
    """Return the converged motion of the whole model, or None, and notes on it."""
    try:
        truth = study.truth(tolerance)
    except ValueError as error:
        return None, [f"no converged motion to compare with: {checks.one_line(error)}"]
    if truth.error <= tolerance:
        return truth, []
    return truth, [
        f'column "error" is uncertain by {study.measure.words(truth.error)}, the uncertainty of '
        'the converged motion, which is more than the tolerance; column "added" is not affected'
    ]


class Choice:
    """The choice of features that can be removed one at a time, and together.

    starts: the starts on which the choice is made. whole: the trial of the whole model there.
    alone: trials of features removed alone. removed, best: the smallest model, and its trial.
    """

    def __init__(self, study: Study, tolerance: float, truth: Truth | None) -> None:
        self.study, self.tolerance, self.truth = study, tolerance, truth
        self.starts = study.starts
        self.alone: dict[Removal, Trial] = {}
        self.removed: list[Removal] = []
        self.whole = self.best = self.trial([], self.starts)
        if self.whole.failure:
            raise ValueError(f"the whole model fails from {self.whole.failure}; see diagnose")

    def trial(self, removals: Sequence[Removal], starts: Sequence[int]) -> Trial:
        """Run the model without some features, and compare it with the whole model's motion."""
        study, change = self.study, Change(without=removals)
        whole, tracks = study.tracks([SHIPPED, change], starts)
        motions = tracks, whole, self.scored(starts)
        return Trial(
            change=change,
            settings=study.engine.settings(SHIPPED),
            starts=tuple(starts),
            errors=study.measure.error(*motions),
            unsure=np.zeros(len(starts)),
            largest=study.measure.largest(*motions),
            work=study.engine.work(change, study.schedule),
            cost=study.cost(change),
            failure=tracks.failure_from(starts),
            measure=study.measure,
        )

    def scored(self, starts: Sequence[int]) -> np.ndarray:
        """Return which samples count, because they can be predicted; (starts, samples)."""
        truth = self.truth
        if truth is None or math.isinf(truth.growth.overall):
            return np.ones((len(starts), len(self.study.schedule.times)), bool)
        return self.study.truth(self.tolerance, starts).scored

    def off(self, change: Change, truth: Truth) -> float | None:
        """Return the distance of a change from the whole model's converged motion, or None."""
        known = [start for start in truth.starts if self.study.ran(change, start)]
        if not known:
            return None
        some, own = truth.part(known), self.study.tracks([change], known)[0]
        far = self.study.measure.error(own, some.tracks, some.scored)
        return None if own.failure else float(far.max())

    def begin(self) -> None:
        """Remove each feature alone from two starts; from all starts if within the tolerance."""
        removals = self.removals()
        few = self.starts[:SCREENED]
        self.study.tracks([Change(without=[one]) for one in removals], few, "features")
        self.alone = {one: self.trial([one], few) for one in removals}
        good = [one for one, trial in self.alone.items() if trial.error <= self.tolerance]
        self.study.tracks([Change(without=[one]) for one in good], self.starts, "smallest")
        self.alone |= {one: self.trial([one], self.starts) for one in good}
        self.study.workers.deadline.so_far(self.so_far())

    def removals(self) -> list[Removal]:
        """Return all features, grouped by what the motion from these starts uses."""
        engine = self.study.engine
        if isinstance(engine, MuJoCo):
            return [Removal(flag, "", (("feature", flag),)) for flag in engine.flags]
        features = RemovableFeatures(engine.model)
        return features.removals(usage_of(self.study, self.starts), engine.model.settings)

    def choose(self) -> None:
        """Remove as many features together as the tolerance allows; the largest saving first.

        Features stay removed if that saves work, or if the motion is bit-identical without them and
        no work is added. Features of one kind, such as the limits of joints, do not exclude each
        other and are tried at once, then in halves.
        """
        self.removed, self.best = [], self.whole
        kinds: dict[str, list[Removal]] = {}
        for one in sorted(self.alone, key=lambda one: self.alone[one].cost):
            if self.saves([one], self.alone[one], self.whole):
                kinds.setdefault(one.kind, []).append(one)
        for group in kinds.values():
            greedy(group, self.holds)

    def holds(self, some: Sequence[Removal]) -> bool:
        """Return whether more features can be removed; if so, remove them."""
        more = [one for one in some if one not in self.removed]
        tried = self.trial([*self.removed, *more], self.starts)
        if not self.saves(more, tried, self.best):
            return False
        self.removed, self.best = [*self.removed, *more], tried
        return True

    def saves(self, more: Sequence[Removal], tried: Trial, before: Trial) -> bool:
        unused = all(self.alone[one].error == 0.0 for one in more)
        less = tried.work < before.work or (unused and tried.work == before.work)
        return tried.error <= self.tolerance and less

    def settle(self, further: int) -> None:
        """Test the choice on a second set; failed starts join, and the choice is repeated.

        Then pairs that touch and limits that are reached from these starts are separate features.
        """
        second = self.study.fresh(further) if further and self.removed else ()
        for _ in range(ROUNDS if second else 0):
            over = self.trial(self.removed, second).misses(self.tolerance)
            new = [start for start in over if start not in self.starts][:JOIN]
            if not new or not self.removed:
                return
            self.starts = (*self.starts, *new)
            self.whole = self.trial([], self.starts)
            self.begin()
            self.choose()

    def so_far(self) -> str:
        """Describe the savings of features removed alone."""
        within = {one: t for one, t in self.alone.items() if t.error <= self.tolerance}
        said = f"{len(within)} of {units.counted(len(self.alone), 'feature')} add at most "
        said += f"{self.study.measure.words(self.tolerance)} when removed alone"
        if within:
            best = min(within, key=lambda one: within[one].work)
            share = units.percent(1 - within[best].work / self.whole.work)
            said += f"; most is saved without {best.label}: {share} of the work"
        return f"{said}; the search for the smallest model goes on"


def usage_of(study: Study, starts: Sequence[int]) -> MotionUsage:
    """Return the pairs of bodies that touch, and the joints and tendons that reach a limit."""
    model = study.engine.model
    owner, touched = model.geom_body.tolist(), set[tuple[int, int]]()
    limited = set[tuple[str, int]]()
    for _, _, sim in visits(model, study.schedule, starts, 1):
        contacts, rows = sim.contacts, sim.rows
        pairs = zip(contacts["geom1"].tolist(), contacts["geom2"].tolist(), strict=True)
        for bodies in ((owner[a], owner[b]) for a, b in pairs):
            touched.add((min(bodies), max(bodies)))
        for noun, kind in (("joint", "limit"), ("tendon", "tendon limit")):
            limited |= {(noun, index) for index in rows["index"][rows["kind"] == kind].tolist()}
    return MotionUsage(frozenset(touched), frozenset(limited))
