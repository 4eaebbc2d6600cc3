"""What the frugal search runs: settings that meet a few target errors, and the whole front."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from stepcore._core import Settings
from stepcore.experiment.reference import FINER, ReferenceRuns
from stepcore.measure.trade.frontier import MARGIN
from stepcore.measure.trade.moves import Steps
from stepcore.measure.trade.search import SettingsSearch
from stepcore.measure.trade.trials import Trials

# The target errors, as shares of the error asked for, or of the shipped error without one; and
# whether methods are changed there. The half is what `Trade.next_better` is found from.
ASKED = ((MARGIN, True), (0.5, False))
UNASKED = ((1.0, True), (0.5, False), (0.1, False))
BUDGET = ((4.0, False), (1.0, True), (0.25, False), (0.06, True), (0.015, False))
# Of settings on the front of an integrator, only those count that cost so many times the last.
SPARSE = 1.6
# Errors so many times below the smallest target are of no use.
USELESS = 6.0
# So many of the cheapest settings are also tried in single precision.
SINGLE = 2
# Halvings of the reference that a target may ask for; none where the target is so many times below
# the error asked for.
REFINED, DEEP = 4, 20.0


@dataclass(frozen=True)
class Wanted:
    """error: the target [m], or None. budget: there is one. whole: settings of any error count."""

    error: float | None
    budget: bool
    whole: bool


def searched(
    runs: ReferenceRuns, trials: Trials, steps: Steps, rows: int, friction: bool, wanted: Wanted
) -> list[Settings]:
    """Runs the search; the settings that ran from all starts or failed, coarsest step first."""
    search = SettingsSearch(trials, steps, runs.runner.model.settings, rows, friction)
    search.overview()
    chosen: list[Settings] = []
    targets = _targets(search, wanted)
    for k, (error, climb) in enumerate(targets):
        halvings = REFINED
        if k and chosen and wanted.error is not None:
            error = _next_better(trials, chosen[0], error)
            halvings = REFINED if error * DEEP >= wanted.error else 0
            if error <= trials.reference.high:
                break
        while halvings and trials.reference.high * FINER > error and _finer(runs, trials):
            halvings -= 1
        some = search.meeting(error, climb)
        while not some and halvings and _finer(runs, trials):
            halvings -= 1
            some = search.meeting(error, climb)
        chosen += some + [setting.replace(precision="f32") for setting in some[:SINGLE]]
    least = 0.0 if wanted.whole else min((error for error, _ in targets), default=0.0) / USELESS
    # What is nearer to the reference than it is known is not known to be better.
    known = 0.0 if runs.can_refine(trials.reference) else trials.reference.high
    chosen += _fronts(search, least, known)
    chosen.append(runs.runner.model.settings)
    failed = [
        setting
        for setting, paths in trials.screened.items()
        if paths[-1].failure or trials.far(paths)
    ]
    trials.run([*chosen, *failed], "search: the best")
    return sorted(dict.fromkeys([*chosen, *failed]), key=lambda s: -s.dt)


def _finer(runs: ReferenceRuns, trials: Trials) -> bool:
    """Halves the reference's step once more; False where that is of no use."""
    if not runs.can_refine(trials.reference):
        return False
    with trials.workers.bar("finer reference", runs.starts) as bar:
        better = runs.refined(trials.reference, bar)
    if better is not None:
        trials.reference = better
    return better is not None


def _next_better(trials: Trials, chosen: Settings, error: float) -> float:
    """The target for `Trade.next_better` [m]: at most half the error of the settings chosen.

    The longest step tried can be far more accurate than what was asked for.
    """
    return min(error, trials.score(chosen, len(trials.runner.schedule.starts)).error / 2)


def _targets(search: SettingsSearch, wanted: Wanted) -> list[tuple[float, bool]]:
    """The errors to search for [m], and whether methods are changed there."""
    if wanted.error is not None:
        return [(share * wanted.error, climb) for share, climb in ASKED]
    own = search.trials.score(search.shipped, search.few).error
    if not 0 < own < math.inf:
        scores = [search.trials.score(s, search.few).error for s in search.trials.screened]
        finite = sorted(e for e in scores if 0 < e < math.inf)
        own = finite[len(finite) // 2] if finite else 0.0
    shares = BUDGET if wanted.budget else UNASKED
    return [(own * share, climb) for share, climb in shares if own > 0]


def _fronts(search: SettingsSearch, least: float, known: float) -> list[Settings]:
    """The front of every integrator by its scores from few starts, thinned out.

    least: smaller errors are not wanted [m]. known: of errors up to it the cheapest is wanted.
    """
    by_name: dict[str, list[Settings]] = {}
    for setting in search.trials.screened:
        by_name.setdefault(setting.integrator, []).append(setting)
    return [s for some in by_name.values() for s in _thin(search, some, least, known)]


def _thin(
    search: SettingsSearch, some: Sequence[Settings], least: float, known: float
) -> list[Settings]:
    scores = [(search.trials.score(setting, search.few), i) for i, setting in enumerate(some)]
    kept, best, last = [], math.inf, 0.0
    for score, i in sorted(scores, key=lambda pair: (pair[0].price, pair[0].error, pair[1])):
        if score.error < best and score.price > SPARSE * last and score.error >= least:
            kept.append(some[i])
            best, last = score.error, score.price
            if best <= known:
                break
    return kept
