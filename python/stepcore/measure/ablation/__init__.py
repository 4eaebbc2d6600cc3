"""`ablate`: the cost of each modelled feature, and the error added when the feature is removed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Unpack

import numpy as np

from stepcore import checks
from stepcore.deadline import PROVEN
from stepcore.engine.features import MotionUsage, RemovableFeatures, Removal, without
from stepcore.engine.norm import apart, largest, rms
from stepcore.experiment.arguments import MeasurementFields, Source, measurement, set_up
from stepcore.experiment.change import Change
from stepcore.experiment.choose import JOIN, ROUNDS, Proof, greedy
from stepcore.experiment.engines import visits
from stepcore.experiment.motion import Motion
from stepcore.experiment.mujoco_engine import FLAGS
from stepcore.experiment.study import SHIPPED, Study
from stepcore.experiment.trial import Trial
from stepcore.experiment.truth import Truth
from stepcore.measure.ablation.result import Ablation, FeatureEffect
from stepcore.report import units
from stepcore.report.units import metres

__all__ = ["Ablation", "FeatureEffect", "ablate"]

# Every feature first runs from so many starts; only features within the tolerance run from the
# others.
SCREENED = 2
# Flags of MJCF that say how is computed, and not what is modelled.
METHOD = ("clampctrl", "filterparent", "eulerdamp")
# The share of the time (`seconds`) at which the converged motion is known.
CONVERGED = 0.4


@measurement()
def ablate(
    model: Source,
    motion: Motion | str | None = None,
    *,
    added: float | str = 1e-3,
    further: int = 32,
    engine: str = "stepcore",
    **fields: Unpack[MeasurementFields],
) -> Ablation:
    """Remove one modelled feature at a time, and measure the work saved and the error added.

    Then `ablate` removes as many features together as possible within `added`. Starts of a second
    set on which this smallest model adds more join the choice; what is told of it comes from a
    third set, which no choice has seen.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name"). Every run uses the
        model's own settings.
    motion: a `Motion`, or its fields as arguments. By default 1 s, and 8 starts for the choice.
    added: the largest RMS position error, over samples and bodies, that the smallest model may add
        to the whole model's motion in the worst start: metres, "1mm", or "0.1%" of the scene's
        size.
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
    units.length("ablate", "added", added, 1.0)
    further = checks.count("further", further, least=0)
    setup = set_up(ablate, model, motion, fields, missing="no motion to keep", engine=engine)
    study = Study(motion=setup.motion, engine=setup.engine, workers=setup.workers)
    time = setup.workers.deadline
    tolerance = units.length("ablate", "added", added, study.size)
    truth, notes = None, list[str]()
    with time.stage("the converged motion, and errors against it", CONVERGED):
        truth, notes = _truth(study, tolerance)
    choice, complete, proof = Choice(study, tolerance, truth), False, None
    with time.stage("some of the features, and the search for the smallest model", PROVEN):
        choice.begin()
        choice.choose()
        choice.settle(further)
        complete = True
    with time.stage(f"the test on {further} untouched starts"):
        if further and choice.removed:
            proof = Proof.of(choice.trial(choice.removed, study.fresh(further)), tolerance)
    times = dict[Change, float]()
    with time.closing(), time.stage("all timing"):
        every = [SHIPPED, *(trial.change for trial in choice.alone.values()), choice.best.change]
        times = study.times(every)
    if cut := sum(len(one.starts) < len(choice.starts) for one in choice.alone.values()):
        notes.append(_screened(cut, len(choice.starts)))

    def effect(removal: Removal, trial: Trial) -> FeatureEffect:
        off = None if truth is None else choice.off(trial.change, truth)
        return FeatureEffect(removal, trial, off, times.get(trial.change, math.nan))

    scene = None
    if engine == "stepcore":
        own = setup.model.scene.with_settings(setup.model.settings)
        scene = without(own, choice.removed)
    horizon, starts = study.schedule.horizon, len(study.starts)
    return Ablation(
        name=setup.name,
        settings=study.engine.settings(SHIPPED),
        motion=dataclasses.replace(setup.motion, horizon=horizon, starts=starts),
        horizon=horizon,
        starts=len(choice.starts),
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
    )


def _truth(study: Study, tolerance: float) -> tuple[Truth | None, list[str]]:
    """Return the converged motion of the whole model, or None, and what is to be said of it."""
    try:
        truth = study.truth(tolerance)
    except ValueError as error:
        return None, [f"no converged motion to compare with: {checks.one_line(error)}"]
    if truth.error <= tolerance:
        return truth, []
    return truth, [
        f'column "error" is uncertain by {metres(truth.error)}, the uncertainty of the converged '
        'motion, which is more than the tolerance; column "added" is not affected'
    ]


class Choice:
    """The features that can be removed one at a time, and together.

    starts: from which the choice is made. whole: the whole model there.
    alone: every feature removed alone. removed, best: the smallest model, and its trial.
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
        far = apart(tracks, whole, study.engine.matter)
        scored = self.scored(starts)
        return Trial(
            change=change,
            settings=study.engine.settings(SHIPPED),
            starts=tuple(starts),
            errors=rms(far, scored),
            unsure=np.zeros(len(starts)),
            largest=largest(far, scored),
            work=study.engine.work(change, study.schedule),
            cost=study.cost(change),
            failure=tracks.failure,
        )

    def scored(self, starts: Sequence[int]) -> np.ndarray:
        """Return the samples that count: those that can be predicted."""
        truth = self.truth
        if truth is None or math.isinf(truth.growth.overall):
            return np.ones((len(starts), len(self.study.schedule.times)), bool)
        return self.study.truth(self.tolerance, starts).scored

    def off(self, change: Change, truth: Truth) -> float | None:
        """Return how far a change is from the whole model's converged motion [m], if known."""
        known = [start for start in truth.starts if self.study.ran(change, start)]
        if not known:
            return None
        some, own = truth.part(known), self.study.tracks([change], known)[0]
        far = rms(apart(own, some.tracks, self.study.engine.matter), some.scored)
        return None if own.failure else float(far.max())

    def begin(self) -> None:
        """Run every feature removed alone; those within the tolerance in two starts from all."""
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
        if engine.name == "mujoco":
            return [Removal(flag, "", (("feature", flag),)) for flag in FLAGS if flag not in METHOD]
        features = RemovableFeatures(engine.model)
        return features.removals(usage_of(self.study, self.starts), engine.model.settings)

    def choose(self) -> None:
        """Remove as many features together as the tolerance allows; the largest saving first.

        Features stay removed if that saves work, or if the motion is bit-identical without them and
        no work is added. Those of one kind, such as the limits of joints, do not exclude each other
        and are tried at once, then in halves.
        """
        self.removed, self.best = [], self.whole
        kinds: dict[str, list[Removal]] = {}
        for one in sorted(self.alone, key=lambda one: self.alone[one].cost):
            if self.saves([one], self.alone[one], self.whole):
                kinds.setdefault(one.kind, []).append(one)
        for group in kinds.values():
            greedy(group, self.holds)

    def holds(self, some: Sequence[Removal]) -> bool:
        """Return whether features can go besides those removed; if so, remove them."""
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
        """Test the choice on a second set of starts; those that it fails join, and it is repeated.

        Pairs that touch and limits that are reached there are then features of their own.
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
        """Return what features save that are removed alone, in words."""
        within = {one: t for one, t in self.alone.items() if t.error <= self.tolerance}
        said = f"{len(within)} of {units.counted(len(self.alone), 'feature')} add at most "
        said += f"{metres(self.tolerance)} when removed alone"
        if within:
            best = min(within, key=lambda one: within[one].work)
            share = units.percent(1 - within[best].work / self.whole.work)
            said += f"; most is saved without {best.label}: {share} of the work"
        return f"{said}; the search for the smallest model goes on"


def usage_of(study: Study, starts: Sequence[int]) -> MotionUsage:
    """Return which pairs of bodies touch and which joints reach a limit in the whole model."""
    model = study.engine.model
    owner, touched, limited = model.geom_body.tolist(), set[tuple[int, int]](), set[int]()
    for _, _, sim in visits(model, study.schedule, starts, 1):
        contacts, rows = sim.contacts, sim.rows
        pairs = zip(contacts["geom1"].tolist(), contacts["geom2"].tolist(), strict=True)
        for bodies in ((owner[a], owner[b]) for a, b in pairs):
            touched.add((min(bodies), max(bodies)))
        limited.update(rows["index"][rows["kind"] == "limit"].tolist())
    return MotionUsage(frozenset(touched), frozenset(limited))


def _screened(cut: int, starts: int) -> str:
    """Return a note on features that ran from few starts."""
    exceeds, were = ("exceeds", "was") if cut == 1 else ("exceed", "were")
    return (
        f"{units.counted(cut, 'feature')} {exceeds} the tolerance in the first {SCREENED} of "
        f"{starts} starts and {were} not run from the others: errors there are of {SCREENED} starts"
    )
