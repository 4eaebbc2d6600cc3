"""The search for the cheapest settings that meet the tolerance.

A family is all settings but the time step. In each family the step is refined from the shipped one
until the error is within the tolerance, or until the observed order of accuracy shows that the
family cannot beat the best candidate. The start that refused the last candidate is run first.
Candidates are ranked by counted work, so the answer is the same in every run and on every machine.
"""

from __future__ import annotations

import contextlib
import math
import operator
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from stepcore.deadline import OutOfTime
from stepcore.experiment.change import Change
from stepcore.experiment.choose import JOIN, ROUNDS, Proof, frontier, least
from stepcore.experiment.schedule import FINEST
from stepcore.experiment.study import SHIPPED, TOGETHER, Study
from stepcore.experiment.trial import Trial
from stepcore.experiment.truth import ROUNDING, SHARE, Truth
from stepcore.report.units import times

# The quantity by which settings are ranked.
COST = operator.attrgetter("cost")
# The search requires this share of the tolerance, because starts that were not run may be harder.
MARGIN = 0.9
# An error can be verified if the converged motion's uncertainty is at most this share of it.
UNSURE = 0.3
# The largest expected price, relative to the best candidate, at which another family is tried.
BETTER = 0.95
# Tolerances to try for adaptive steps, relative to the error. On the ant the last one stays within
# 10 mm from every start; the one before exceeds that by 8 mm from some.
ACCURACIES = (10.0, 3.0, 1.0, 0.3, 0.1, 0.03)
# The shares of the effort that may be spent by the end of the first converged motion, of the first
# choice and of the last choice. Converged motions of 72 starts are computed: 8 of the search, and
# 32 of each test.
KNOWING, SEARCHING, SETTLING = 0.3, 0.5, 0.75
# The most refinements of a held-out start's truth if it does not show whether a candidate holds.
CLEARER = 3


@dataclass
class Search:
    """The settings that were tried for one scene.

    study: runs the settings. truth: the converged motion from the starts of the search.
    steps: the numbers of time steps in a control period that may be recommended.
    trials: by change; trials from fewer starts ran before other starts joined, or failed on one
    start. hard: the start that is run first, alone. ended: whether the effort ended the search.
    """

    study: Study
    truth: Truth
    steps: Sequence[int]
    trials: dict[Change, Trial] = field(default_factory=dict)
    hard: int = 0
    ended: bool = False

    @classmethod
    def of(cls, study: Study, error: float | None, *, held: bool) -> Search:
        """Return a search in which only the shipped settings were tried.

        error: the tolerance, or None. held: whether the user gave the control period.
        """
        study.allowed = KNOWING * study.effort
        search = cls(study, study.truth(error), usable_steps(study, held))
        search.allow(SEARCHING, since=KNOWING)
        search.hard = search.trial(SHIPPED).worst
        return search

    @property
    def shipped(self) -> Trial:
        return self.trials[SHIPPED]

    def allow(self, share: float, since: float) -> None:
        """Allow a share of the effort, or if more, the spent effort and the increase of the share.

        The converged motion may exceed its share, because at least two rungs are run.
        """
        study = self.study
        most = max(share * study.effort, study.spent + (share - since) * study.effort)
        study.allowed = min(study.effort, most)

    @property
    def moved(self) -> float:
        """The displacement of the bodies from the first sample [m], in the start with the least.

        For another quantity than the motion it is the quantity's range.
        """
        tracks, measure = self.truth.tracks, self.study.measure
        if not measure.quantity.is_motion:
            return self.study.scale
        return float(measure.error(tracks, tracks.at(0)).min())

    def at(self, family: Change, steps: int) -> Change:
        """Return a family at a number of steps in a control period."""
        shipped = float(self.study.engine.settings(SHIPPED).dt)
        dt = self.study.schedule.period / steps
        same = math.isclose(dt, shipped, rel_tol=1e-9)
        return family if same else family.also(Change(dt=dt))

    def trial(self, change: Change, error: float | None = None) -> Trial:
        """Run a change from the starts of the search.

        error: the tolerance; the truth is refined if it does not show whether the change holds.
        """
        study, starts = self.study, self.truth.starts
        (tracks,) = study.tracks([change], starts)
        trial = study.score(change, tracks, self.truth)
        if error is not None and not trial.refuted(error) and cleared(study, trial, error, UNSURE):
            self.truth = study.truth(self.truth.goal / SHARE, starts)
            trial = study.score(change, tracks, self.truth)
        self.trials[change] = trial
        return trial

    def join(self, starts: Sequence[int], error: float) -> None:
        """Add starts to the search; trials from fewer starts no longer count."""
        self.truth = self.study.truth(error, [*self.truth.starts, *starts])
        self.trial(SHIPPED)

    def sharpen(self, error: float) -> None:
        """Refine the truth for another error, and score all trials again."""
        self.truth = self.study.truth(error, self.truth.starts)
        self.score_again()

    def score_again(self) -> None:
        """Score all trials against the truth, which may be finer than when they ran."""
        for change, trial in self.trials.items():
            if trial.starts == self.truth.starts and trial.tracks is not None:
                self.trials[change] = self.study.score(change, trial.tracks, self.truth)

    def grid(self, changes: Sequence[Change]) -> None:
        """Run all changes, and refine the truth to a tenth of their smallest error."""
        bar = "settings"
        for change, tracks in zip(
            changes, self.study.tracks(changes, self.truth.starts, bar), strict=True
        ):
            self.trials[change] = self.study.score(change, tracks, self.truth)
        before = math.inf
        while self.truth.error < before:
            before = self.truth.error
            least = min((t.error for t in self.trials.values() if not t.failure), default=0.0)
            if ROUNDING * self.study.scale < least < before / SHARE:
                self.sharpen(least)

    def remember(self, error: float) -> None:
        """Score the runs that were made for the converged motion, if no trial holds an error."""
        if self.held(error) is not None:
            return
        starts, finest = self.truth.starts, self.truth.change
        others = [c for c in self.study.changes(starts) if c not in self.trials and c != finest]
        for change, tracks in zip(others, self.study.tracks(others, starts), strict=True):
            self.trials[change] = self.study.score(change, tracks, self.truth)

    def cheapest(self, error: float) -> Trial | None:
        """Return the cheapest settings within an error on the starts of the search, or None."""
        best = next((trial for trial in self.whole if trial.within(error)), None)
        shipped_steps, limit = self.study.steps(), self.study.cost(self.truth.change)
        if best is not None:
            self.hard = best.worst
        for family in sorted(self.families, key=self.rate):
            if not self.study.affords(self.at(family, shipped_steps), 1):
                self.ended = True
                break
            allowed = (limit if best is None else BETTER * best.cost) / self.rate(family)
            ladder = [n for n in self.steps if n <= allowed]
            trial = self._least(family, ladder, error, shipped_steps)
            if trial is not None and (best is None or trial.cost < best.cost):
                best = trial
                self.study.workers.deadline.so_far(self.so_far(best))
        if best is None:
            # No candidate needs validation, so the search may spend that effort.
            self.allow(SETTLING, since=SEARCHING)
        return self._adaptive(error, best)

    def row(self, change: Change, error: float) -> Trial:
        """Score a change from every start that it ran from, including held-out ones.

        error: the tolerance; a held-out start is left out if its converged motion does not show
        whether the change holds.
        """
        trial = self.study.score_everywhere(change)
        known = max(UNSURE * error, self.truth.error)
        tells = (trial.unsure <= known) | (np.abs(trial.errors - error) > trial.unsure)
        told = dict(zip(trial.starts, tells, strict=True))
        return trial.part([s for s in trial.starts if told[s] or s in self.truth.starts])

    def complete(self, error: float) -> None:
        """Run settings that may be on the frontier from all starts of the search.

        The error from some starts is a lower bound. Settings that ran from some starts only run
        from the others too, unless settings that ran from all starts beat that bound.
        """
        rows, every = {c: self.row(c, error) for c in self.trials}, set(self.truth.starts)
        while part := [t for t in frontier(rows.values(), COST) if not every <= set(t.starts)]:
            change = part[0].change
            if self.study.affords(change, len(every - set(part[0].starts))):
                self.trial(change)
                rows[change] = self.row(change, error)
            else:
                self.ended = True
                del rows[change]

    @property
    def whole(self) -> list[Trial]:
        """The trials from all starts of the search, the cheapest first."""
        every = [t for t in self.trials.values() if t.starts == self.truth.starts]
        return sorted(every, key=lambda trial: trial.cost)

    def held(self, error: float) -> Trial | None:
        """Return the cheapest trial from all starts within an error; one with the margin first."""
        holds = (trial for trial in self.whole if trial.error <= error)
        return min(holds, key=lambda t: (t.error > MARGIN * error, t.cost), default=None)

    def so_far(self, best: Trial | None = None) -> str:
        """Describe the errors of the shipped settings and of the best ones so far."""
        shipped = self.shipped
        words = self.study.measure.words
        known = words(self.truth.error)
        said = f"error as shipped {words(shipped.error)}, ± {known}"
        if not math.isfinite(shipped.error):
            said = f"the shipped settings fail; the uncertainty of errors is {known}"
        if best is None:
            return said
        cost = f"{times(best.cost / shipped.cost)} the shipped cost"
        named = best.change.label(shipped.settings)
        return f"{said}; best {named}: {words(best.error)} at {cost}"

    @cached_property
    def families(self) -> list[Change]:
        """The settings of each method without the time step."""
        return self.study.engine.families(self.study.schedule)

    def rate(self, family: Change) -> float:
        """Return the price of a family per step in a control period."""
        steps = self.study.steps()
        return self.study.cost(self.at(family, steps)) / steps

    def _least(
        self, family: Change, ladder: Sequence[int], error: float, first: int
    ) -> Trial | None:
        """Return the trial of a family with the fewest steps that hold, or None."""
        trials = dict[int, Trial]()

        def bound(steps: int) -> float:
            change = self.at(family, steps)
            if not self.study.affords(change, len(self.truth.starts)):
                self.ended = True
                return math.inf
            if len(self.truth.starts) > 1:
                # The hardest start refuses most candidates that fail.
                (alone,) = self.study.tracks([change], [self.hard])
                hardest = self.study.score(change, alone, self.truth.part([self.hard]))
                if hardest.refuted(error):
                    self.trials.setdefault(change, hardest)
                    return hardest.bound
            trials[steps] = trial = self.trial(change, error)
            if not trial.failure and not trial.within(error):
                self.hard = trial.worst
            return trial.bound

        steps = least(ladder, bound, error, first) if ladder else None
        return None if steps is None else trials.get(steps)

    def _adaptive(self, error: float, best: Trial | None) -> Trial | None:
        """Return the best trial, or one with adaptive steps if that is cheaper."""
        study, truth = self.study, self.truth
        if all(way.fixed for way in study.engine.ways(study.schedule, error)):
            return best
        most = BETTER * best.cost if best is not None else self.study.cost(truth.change)
        # A tolerance above the motion's displacement requires nothing.
        for share in (share for share in ACCURACIES if share * error < self.moved):
            accuracy = study.as_length(share * error) / study.schedule.horizon
            change = Change(accuracy=accuracy, dt=study.schedule.period)
            if not study.affords(change, len(truth.starts)) or study.cost(change) >= most:
                break
            (alone,) = study.tracks([change], [self.hard])
            hardest = study.score(change, alone, truth.part([self.hard]))
            self.trials.setdefault(change, hardest)
            if hardest.within(error):
                trial = self.trial(change)
                if trial.within(error):
                    return trial
        return best

    def most_accurate(self, budget: float) -> Trial | None:
        """Return the settings with the smallest error within a budget, or None.

        budget: in the study's unit of cost; computing time [µs per simulated second] is measured.
        """
        study, scale, tried = self.study, 1.0, list[Trial]()
        if study.by == "time":
            # Times from counted work are scaled by one measurement; the final choice is measured.
            scale = study.cost(SHIPPED) / study.times([SHIPPED]).get(SHIPPED, study.cost(SHIPPED))
        for family in [SHIPPED, *self.families]:
            ladder = [n for n in self.steps if n * self.rate(family) <= scale * budget]
            if ladder:
                tried.append(self.trial(self.at(family, ladder[-1])))
        for trial in sorted(tried, key=lambda trial: (trial.error, trial.cost)):
            if trial.failure:
                break
            if study.by == "flops" or study.times([trial.change])[trial.change] <= budget:
                return trial
        return None


def usable_steps(study: Study, held: bool) -> list[int]:
    """Return the numbers of steps in a control period whose length a user can write down.

    Such steps are the shipped step times or divided by a whole number; if the user gave the control
    period, any step that divides it.

    held: whether the user gave the control period.
    """
    shipped = study.steps()
    top = FINEST * shipped
    if held:
        return list(range(1, top + 1))
    coarser = [n for n in range(1, shipped) if shipped % n == 0]
    return [*coarser, *range(shipped, top + 1, shipped)]


def settled(search: Search, error: float, further: int) -> Trial | None:
    """Choose the cheapest settings, test them on a second set of starts, and choose again.

    Starts of the second set on which a choice fails join the search, until a choice holds on all of
    them. Without such a choice, the cheapest trial whose error, apart from its uncertainty, is
    within the tolerance is chosen, else the one that failed on the fewest starts. Settings that
    halve the error replace it if they cost no more and fail on no more starts. The reported
    performance comes from a third set; see `proven`.
    """
    study, chosen, fewest = search.study, None, math.inf
    best = search.cheapest(MARGIN * error)
    search.allow(SETTLING, since=SEARCHING)
    second = study.fresh(further) if further and best is not None else ()
    for _ in range(ROUNDS if second else 0):
        if best is None or best.change == getattr(chosen, "change", None):
            break
        tried = tested(study, best.change, second, error, early=True)
        over = tried.misses(error)
        if len(over) / len(tried.starts) < fewest:
            chosen, fewest = best, len(over) / len(tried.starts)
        # A start whose uncertainty is larger than the search's shows nothing.
        sure = tried.unsure <= max(UNSURE * error, search.truth.error)
        known = dict(zip(tried.starts, sure, strict=True))
        new = [s for s in over if known[s] and s not in search.truth.starts][:JOIN]
        if not new:
            break
        search.join(new, error)
        best = search.cheapest(MARGIN * error)
    found = best or search.held(error) or (chosen and search.trials[chosen.change])
    better = None if found is None else search.cheapest(found.error / 2)
    if found is None or better is None or better.cost > found.cost:
        return found
    if not second:
        return better
    missed = [len(tested(study, t.change, second, error).misses(error)) for t in (found, better)]
    return found if missed[0] < missed[1] else better


def tested(
    study: Study, change: Change, starts: Sequence[int], error: float, *, early: bool = False
) -> Trial:
    """Run a change from held-out starts.

    error: the tolerance. early: whether to stop at the first eight that exceed it anywhere.
    """
    parts = list[Trial]()
    for part in by_eight(study, change, starts, error):
        parts.append(part)
        if early and part.misses(error):
            break
    return Trial.joined(parts)


def by_eight(study: Study, change: Change, starts: Sequence[int], error: float) -> Iterator[Trial]:
    """Run a change from held-out starts, eight at a time, and refine their truth if necessary."""
    coarse = UNSURE / SHARE * error
    for first in range(0, len(starts), TOGETHER):
        some = starts[first : first + TOGETHER]
        (tracks,) = study.tracks([change], some)
        trial = study.score(change, tracks, study.truth(coarse, some))
        for _ in range(CLEARER):
            if not cleared(study, trial, error, SHARE**2):
                break
            trial = study.score(change, tracks, study.truth(coarse, some))
        yield trial


def cleared(study: Study, trial: Trial, error: float, finest: float) -> bool:
    """Refine the truth where it does not show whether a trial holds an error.

    finest: the smallest uncertainty to aim for, as a share of the error. Return whether any start
    needed it.
    """
    gap = np.abs(trial.errors - error)
    unclear = [s for s, far in zip(trial.starts, gap <= trial.unsure, strict=True) if far]
    if trial.failure or not unclear:
        return False
    study.truth(max(float(gap.min()) / 2, finest * error) / SHARE, unclear)
    return True


def proven(study: Study, change: Change, error: float, further: int) -> Proof | None:
    """Validate a choice on held-out starts; return None if the time is over before.

    Fewer starts are run if time or effort run out: eight starts that show nothing end the test, and
    do not count.
    """
    study.allowed, parts = study.effort, list[Trial]()
    with contextlib.suppress(OutOfTime):
        for part in by_eight(study, change, study.fresh(further), error):
            if parts and Proof.of(part, error).unclear == len(part.starts):
                break
            parts.append(part)
    return Proof.of(Trial.joined(parts), error) if parts else None
