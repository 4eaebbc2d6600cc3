"""The frugal search for the cheapest settings that meet an error.

A method is all of the settings except the time step. For each method, the search looks for the
longest time step that meets the error, in three rounds. First, families of methods are judged from
a few starts. Then the cheapest methods change one setting at a time as long as the change makes
them cheaper at equal error. Finally, the best methods are judged from all starts. Costs are counted
operations, so that the same seed finds the same settings on any machine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from stepcore._core import Settings
from stepcore.engine.linear_maps import STAGED
from stepcore.experiment.reference import FINER
from stepcore.measure.trade import words
from stepcore.measure.trade.methods import Kind, Steps, families, moves
from stepcore.measure.trade.rows import MARGIN
from stepcore.measure.trade.run_cache import PricedError, RunCache
from stepcore.report.settings import label
from stepcore.report.units import times

# Number of starts that methods are first judged from.
FEW = 2
# Largest cost, relative to the best, of methods in the second round and in the round from all
# starts; and the largest number of methods there.
FIRST, SECOND, MOST = 1.6, 1.25, 4
# Largest relative cost, at equal error, at which a changed setting is accepted; and the number of
# successive changes.
BETTER, CLIMBS = 0.97, 4
# Ratios to which the longest step is found: in the first rounds, and at the end.
COARSE, FINE = 1.3, 1.08
ROUNDS = 8
# Least work of a shorter step, relative to the work of a longer one.
CHEAPER = 0.8
# A method is at its floor if steps FLOOR times shorter reduce the error less than HELPS times.
FLOOR, HELPS = 4.0, 1.3
# The target errors, relative to the requested error (without a request, to the shipped error), and
# whether methods are changed there. `Trade.next_better` uses the target of one half.
ASKED = ((MARGIN, True), (0.5, False))
UNASKED = ((1.0, True), (0.5, False), (0.1, False))
BUDGET = ((4.0, False), (1.0, True), (0.25, False), (0.06, True), (0.015, False))
# Least ratio between the costs of neighbouring settings on an integrator's front.
SPARSE = 1.6
# Errors this many times below the smallest target are not useful.
USELESS = 6.0
# Number of the cheapest settings that are also tried in single precision.
SINGLE = 2
# Largest number of reference halvings for one target. For targets more than DEEP times below the
# requested error, the reference is not halved.
REFINED, DEEP = 4, 20.0


@dataclass
class Bracket:
    """The scores of a method by the number of steps in a control period.

    base: the method.
    guess: the number of steps to begin with.
    known: the score for each number of steps in a period.
    floored: whether shorter steps no longer reduce the error.
    """

    base: Settings
    guess: int
    known: dict[int, PricedError] = field(default_factory=dict)
    floored: bool = False

    def meets(self, error: float) -> int | None:
        """Return the fewest steps in a period that meet an error, or None."""
        return min((n for n, s in self.known.items() if s.error <= error), default=None)

    def misses(self, error: float) -> int:
        """Return the most steps, fewer than `meets` returns, that exceed an error; 0 if unknown."""
        good = self.meets(error)
        return max(
            (n for n, s in self.known.items() if s.error > error and (good is None or n < good)),
            default=0,
        )

    def at_least(self, pieces: int) -> float:
        """Return a lower bound of the price of this many steps; 0 if no fewer steps were run."""
        fewer = [n for n in self.known if n < pieces and self.known[n].price < math.inf]
        n = max(fewer, default=0)
        return self.known[n].price * pieces / n * CHEAPER if n else 0.0

    def order(self, error: float) -> float:
        """Return the order with which the error falls near the target, between 1/2 and 4."""
        near = sorted(
            (n for n, s in self.known.items() if 0 < s.error < math.inf),
            key=lambda n: abs(math.log(self.known[n].error / error)),
        )
        if len(near) < 2:
            return 2.0 if self.base.integrator in STAGED else 1.0
        a, b = sorted(near[:2])
        slope = math.log(self.known[a].error / self.known[b].error) / math.log(b / a)
        return min(4.0, max(0.5, slope))

    def price(self, error: float) -> float:
        """Return the estimated price of meeting an error at any step; inf if out of reach."""
        near = [n for n, s in self.known.items() if 0 < s.error < math.inf]
        if not near or (self.floored and self.meets(error) is None):
            exact = [s.price for s in self.known.values() if s.error <= error]
            return min(exact, default=math.inf)
        n = min(near, key=lambda n: abs(math.log(self.known[n].error / error)))
        return equal_error(self.known[n], error, self.order(error))


def equal_error(score: PricedError, error: float, order: float) -> float:
    """Return the price at another error, if the error falls with the step at this order."""
    if not 0 < score.error < math.inf:
        return score.price
    return float(score.price * (score.error / error) ** (1 / order))


class SettingsSearch:
    """A search for the cheapest settings that meet an error; the runs stay in the cache."""

    def __init__(self, cache: RunCache, steps: Steps, kind: Kind) -> None:
        self.cache, self.steps, self.kind = cache, steps, kind
        self.shipped = cache.experiment.model.settings
        self.all = len(cache.experiment.schedule.starts)
        self.few = min(FEW, self.all)
        # Methods found by changing settings of the families.
        self.methods: list[Settings] = []
        # The settings that meet the targets, and the targets as `targets` returns them.
        self.chosen: list[Settings] = []
        self.aims: list[tuple[float, bool]] = []

    @property
    def finest(self) -> int:
        """The most steps in a control period that the reference is accurate enough to judge."""
        return max(1, int(self.steps.period / self.cache.reference.settings.dt / 2 + 1e-9))

    def search(self, wanted: float | None, budget: bool) -> None:
        """Run the search; `best` returns what it found, also if the time ends the search.

        wanted: the requested error [m], or None.
        budget: whether a budget was requested.
        """
        cache, chosen = self.cache, self.chosen
        tell = cache.experiment.workers.deadline.so_far
        cache.screen([self.shipped], self.few, "search: as shipped")
        tell(self.so_far(wanted))
        self.overview()
        tell(self.so_far(wanted))
        self.aims = targets = self.targets(wanted, budget)
        for k, (error, climb) in enumerate(targets):
            halvings = REFINED
            if k and chosen and wanted is not None:
                # The longest step can be far more accurate than the requested error.
                error = min(error, cache.score(chosen[0], self.all).error / 2)
                halvings = REFINED if error * DEEP >= wanted else 0
                if error <= cache.reference.high:
                    break
            while halvings and cache.reference.high * FINER > error and cache.refine():
                halvings -= 1
            # An error that the reference cannot verify is replaced by the least that it can.
            error = max(error, cache.reference.high)
            some = self.meeting(error, climb)
            while not some and halvings and cache.refine():
                halvings -= 1
                some = self.meeting(error, climb)
            chosen += some + [setting.replace(precision="f32") for setting in some[:SINGLE]]
            tell(self.so_far(wanted))

    def so_far(self, wanted: float | None) -> str:
        """Return the error as shipped, and the cheapest settings that meet an error, in words.

        wanted: the requested error [m]; None for that of the shipped settings.
        """
        cache, few, sure = self.cache, self.few, self.cache.reference.high
        shipped = cache.score(self.shipped, few)
        said = f"error as shipped {words.error(shipped.error, sure)} in {few} of {self.all} starts"
        known = []
        for k, (settings, runs) in enumerate(cache.screened.items()):
            starts = self.all if len(runs) >= self.all else few
            score = cache.score(settings, starts)
            # The error and the starts decide before the price.
            order = max(score.error, wanted or shipped.error), -starts, score.price, k
            known.append((order, settings, score, starts))
        _, best, score, starts = min(known)
        if best == self.shipped:
            return f"{said}; nothing better yet" if len(known) > 1 else said
        said += f"; best {label(best)}: {words.error(score.error, sure)}"
        if shipped.price < math.inf:
            said += f" at {times(score.price / shipped.price)} the shipped work"
        return f"{said} in {starts} of {self.all}, not confirmed"

    def best(self, whole: bool) -> list[Settings]:
        """Return the settings to run from all starts, and those that failed.

        The shipped settings come first, then those that meet the targets.

        whole: whether settings of any error are useful.
        """
        cache = self.cache
        least = 0.0 if whole else min((error for error, _ in self.aims), default=0.0) / USELESS
        # Errors below the reference's uncertainty cannot be ranked.
        known = 0.0 if cache.can_refine else cache.reference.high
        failed = [setting for setting, runs in cache.screened.items() if cache.why_failed(runs)]
        every = [self.shipped, *self.chosen, *self.fronts(least, known), *failed]
        return list(dict.fromkeys(every))

    def targets(self, wanted: float | None, budget: bool) -> list[tuple[float, bool]]:
        """Return the errors to search for [m], each with whether methods are changed there."""
        if wanted is not None:
            return [(share * wanted, climb) for share, climb in ASKED]
        shipped = self.cache.score(self.shipped, self.few).error
        if not 0 < shipped < math.inf:
            errors = (self.cache.score(setting, self.few).error for setting in self.cache.screened)
            finite = sorted(error for error in errors if 0 < error < math.inf)
            shipped = finite[len(finite) // 2] if finite else 0.0
        shares = BUDGET if budget else UNASKED
        return [(shipped * share, climb) for share, climb in shares if shipped > 0]

    def fronts(self, least: float, known: float) -> list[Settings]:
        """Return the thinned Pareto front of every integrator, by scores from few starts.

        least: errors below this are not useful [m].
        known: of the errors up to this one, only the cheapest setting is returned [m].
        """
        by_name: dict[str, list[tuple[PricedError, int, Settings]]] = {}
        for i, setting in enumerate(self.cache.screened):
            scored = (self.cache.score(setting, self.few), i, setting)
            by_name.setdefault(setting.integrator, []).append(scored)
        kept = []
        for some in by_name.values():
            best, last = math.inf, 0.0
            for score, _, setting in sorted(some, key=lambda entry: entry[:2]):
                if score.error < best and score.price > SPARSE * last and score.error >= least:
                    kept.append(setting)
                    best, last = score.error, score.price
                    if best <= known:
                        break
        return kept

    def overview(self) -> None:
        """Run every family from few starts at a few time steps around the shipped settings.

        No time step is shorter than the reference can judge, except the shipped one.
        """
        n = self.steps.shipped_pieces
        counts = {1, max(1, n // 4), max(1, n // 2), n, 2 * n, 4 * n, 8 * n}
        judged = sorted(count for count in counts if count <= max(n, self.finest))
        tried = [self.steps.at(base, count) for base in families(self.kind) for count in judged]
        self.cache.screen([self.shipped, *tried], self.few, "search: overview")

    def meeting(self, error: float, climb: bool = True) -> list[Settings]:
        """Return settings near the cheapest that meet an error in every start, cheapest first.

        The list is empty if no step that the reference can judge meets the error.

        error: the error to meet [m].
        climb: whether to change settings of the methods, beyond the families and the methods that
            earlier calls found.
        """
        bases = dict.fromkeys([*families(self.kind), *self.methods])
        open_ = [self.bracket(base) for base in bases]
        self.narrow(open_, error, self.few, COARSE, "search: time steps")
        open_ = self.keep(open_, error, FIRST)
        if climb:
            open_ = self.climb(open_, error)
            self.narrow(open_, error, self.few, COARSE, "search: settings")
            self.methods += [self.steps.method(bracket.base) for bracket in open_]
        kept = [self.again(bracket, error) for bracket in self.keep(open_, error, SECOND)]
        self.narrow(kept, error, self.all, FINE, "all starts")
        good = [(bracket, bracket.meets(error)) for bracket in kept]
        met = [(bracket.known[n].price, self.steps.at(bracket.base, n)) for bracket, n in good if n]
        return [settings for _, settings in sorted(met, key=lambda pair: pair[0])]

    def bracket(self, base: Settings) -> Bracket:
        """Return a method with its scores from few starts so far."""
        bracket = Bracket(base, self.steps.shipped_pieces)
        for settings in self.cache.screened:
            pieces = self.steps.pieces(settings)
            if self.steps.at(base, pieces) == settings and pieces <= self.finest:
                bracket.known[pieces] = self.cache.score(settings, self.few)
        return bracket

    def again(self, bracket: Bracket, error: float) -> Bracket:
        """Return a bracket of the method for all starts, beginning at the step found from few."""
        return Bracket(bracket.base, bracket.meets(error) or self.finest)

    def keep(self, brackets: Sequence[Bracket], error: float, factor: float) -> list[Bracket]:
        """Return the brackets whose price is near the best, without duplicates."""
        prices = sorted((bracket.price(error), i) for i, bracket in enumerate(brackets))
        least = prices[0][0] if prices else math.inf
        kept: list[Bracket] = []
        for price, i in prices:
            new = all(brackets[i].known != other.known for other in kept)
            if price <= factor * least and price < math.inf and new:
                kept.append(brackets[i])
        return kept[:MOST]

    def narrow(
        self, brackets: Sequence[Bracket], error: float, starts: int, ratio: float, label: str
    ) -> None:
        """Find the fewest steps that meet the error, to within a ratio, for each method."""
        for _ in range(ROUNDS):
            asked = [(bracket, self.propose(bracket, error, ratio)) for bracket in brackets]
            prices = [bracket.price(error) for bracket in brackets if bracket.meets(error)]
            least = min(prices, default=math.inf)
            wanted = [
                (bracket, n) for bracket, n in asked if n and bracket.at_least(n) <= FIRST * least
            ]
            if not wanted:
                return
            settings = [self.steps.at(bracket.base, n) for bracket, n in wanted]
            self.cache.screen(settings, starts, label)
            for (bracket, n), made in zip(wanted, settings, strict=True):
                bracket.known[n] = self.cache.score(made, starts)

    def propose(self, bracket: Bracket, error: float, ratio: float) -> int | None:
        """Return the next number of steps in a period to try, or None to stop."""
        good, bad = bracket.meets(error), bracket.misses(error)
        if not bracket.known:
            return min(max(1, bracket.guess), self.finest)
        if good is None:
            if bad >= self.finest or self.floored(bracket):
                return None
            return min(self.finest, max(bad + 1, self.jump(bracket, bad, error)))
        if good - bad <= 1 or (bad and good <= ratio * bad):
            return None
        if not bad:
            return max(1, min(good - 1, self.jump(bracket, good, error)))
        guess = self.jump(bracket, good, error)
        middle = round(math.sqrt(good * bad))
        n = guess if bad < guess < good else middle
        return min(good - 1, max(bad + 1, n))

    def jump(self, bracket: Bracket, n: int, error: float) -> int:
        """Return the steps that the observed order predicts for an error, within a factor of 4."""
        seen = bracket.known[n].error
        if not 0 < seen < math.inf:
            return n * 2 if seen else max(1, n // 4)
        factor = (seen / error) ** (1 / bracket.order(error))
        return max(1, math.ceil(n * min(4.0, max(0.25, factor * 1.02))))

    def floored(self, bracket: Bracket) -> bool:
        """Return whether shorter steps no longer reduce the error."""
        errors = {n: s.error for n, s in bracket.known.items() if s.error < math.inf}
        last = max(errors, default=0)
        bracket.floored = any(
            last >= FLOOR * n and min(e for m, e in errors.items() if m > n) > error / HELPS
            for n, error in errors.items()
        )
        return bracket.floored

    def climb(self, brackets: Sequence[Bracket], error: float) -> list[Bracket]:
        """Change one setting of each method at a time while that is cheaper at equal error."""
        now = list(brackets)
        moving = set(range(len(now)))
        for _ in range(CLIMBS):
            asked = {i: self.near(now[i], error) for i in moving}
            self.cache.screen(
                [s for some in asked.values() for s in some], self.few, "search: settings"
            )
            for i, tried in asked.items():
                base, order = now[i].base, now[i].order(error)
                prices = [
                    (equal_error(self.cache.score(s, self.few), error, order), k)
                    for k, s in enumerate(tried)
                ]
                price, k = min(prices, default=(math.inf, 0))
                if price >= BETTER * now[i].price(error):
                    moving.discard(i)
                    continue
                now[i] = self.bracket(self.steps.at(tried[k], self.steps.pieces(base)))
                now[i].guess = self.steps.pieces(tried[k])
            if not moving:
                break
        return list({self.steps.at(bracket.base, 1): bracket for bracket in now}.values())

    def near(self, bracket: Bracket, error: float) -> list[Settings]:
        """Return the methods that differ in one setting, at the step that meets the error."""
        pieces = bracket.meets(error) or max(bracket.known)
        return moves(self.steps.at(bracket.base, pieces), self.kind)
