"""The frugal search: which settings are worth running from every start.

For a target error the question to each method (all settings but the time step) is the longest
time step that meets it. Families of methods answer from few starts; those whose answer is cheap go
on, and have one axis at a time changed while that makes them cheaper at equal error; the best
answer again from all starts. Costs are counted operations, so that the same seed finds the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from stepcore._core import Settings
from stepcore.measure.trade.moves import Steps, families, moves
from stepcore.measure.trade.trials import Score, Trials

# Starts of the first round.
FEW = 2
# How much dearer than the best a method may be and go on: to the second round, to all starts.
FIRST, SECOND = 1.6, 1.25
# At most so many go on.
MOST = 4
# A change of an axis is taken if it is cheaper at equal error by this factor.
BETTER = 0.97
CLIMBS = 4
# The longest step is found to this ratio: in the first rounds, at the end.
COARSE, FINE = 1.3, 1.08
ROUNDS = 8
# A step takes no less work than this share of a longer one's.
CHEAPER = 0.8
# Steps up to this many times shorter that all help less than this: the method's own floor.
FLOOR, HELPS = 4.0, 1.3


@dataclass
class Bracket:
    """What is known of a method's step: how many pieces of the control period it needs.

    known: pieces to score.
    """

    base: Settings
    guess: int
    known: dict[int, Score] = field(default_factory=dict)
    floored: bool = False

    def meets(self, error: float) -> int | None:
        """The fewest pieces that meet an error, or None."""
        return min((n for n, s in self.known.items() if s.error <= error), default=None)

    def misses(self, error: float) -> int:
        """The most pieces, fewer than those, that do not; 0 if none is known."""
        good = self.meets(error)
        return max(
            (n for n, s in self.known.items() if s.error > error and (good is None or n < good)),
            default=0,
        )

    def at_least(self, pieces: int) -> float:
        """What so many pieces cost at least, as far as fewer tell: work is in proportion."""
        fewer = [n for n in self.known if n < pieces and self.known[n].price < math.inf]
        n = max(fewer, default=0)
        return self.known[n].price * pieces / n * CHEAPER if n else 0.0

    def order(self, error: float) -> float:
        """How fast the error falls with the step, near the target; between 1/2 and 4."""
        near = sorted(
            (n for n, s in self.known.items() if 0 < s.error < math.inf),
            key=lambda n: abs(math.log(self.known[n].error / error)),
        )
        if len(near) < 2:
            return 2.0 if self.base.integrator in ("rk4", "midpoint") else 1.0
        a, b = sorted(near[:2])
        slope = math.log(self.known[a].error / self.known[b].error) / math.log(b / a)
        return min(4.0, max(0.5, slope))

    def price(self, error: float) -> float:
        """What meeting an error costs, were any step allowed; inf where it is out of reach."""
        near = [n for n, s in self.known.items() if 0 < s.error < math.inf]
        if not near or (self.floored and self.meets(error) is None):
            exact = [s.price for s in self.known.values() if s.error <= error]
            return min(exact, default=math.inf)
        n = min(near, key=lambda n: abs(math.log(self.known[n].error / error)))
        return equal_error(self.known[n], error, self.order(error))


def equal_error(score: Score, error: float, order: float) -> float:
    """The price at another error, by the order with which it falls with the step."""
    if not 0 < score.error < math.inf:
        return score.price
    return float(score.price * (score.error / error) ** (1 / order))


class SettingsSearch:
    """Looks for the cheapest settings that meet errors; all it runs stays in its trials.

    finest: the most pieces of the control period that the reference can judge.
    """

    def __init__(
        self, trials: Trials, steps: Steps, shipped: Settings, rows: int, friction: bool
    ) -> None:
        self.trials, self.steps, self.shipped = trials, steps, shipped
        self.rows, self.friction = rows, friction
        self.all = len(trials.runner.schedule.starts)
        self.few = min(FEW, self.all)
        # Methods that the search has found beside the families.
        self.methods: list[Settings] = []

    @property
    def finest(self) -> int:
        return max(1, int(self.steps.period / self.trials.reference.settings.dt / 2 + 1e-9))

    def overview(self) -> list[Settings]:
        """A few steps of every family, on few starts: where the shipped settings stand."""
        some = families(self.shipped, self.rows)
        own = self.steps.own
        counts = {max(1, own // 4), max(1, own // 2), own, 2 * own, 4 * own, 8 * own, 1}
        tried = [self.steps.at(base, n) for base in some for n in sorted(counts)]
        self.trials.screen([self.shipped, *tried], self.few, "overview")
        return tried

    def meeting(self, error: float, climb: bool = True) -> list[Settings]:
        """Settings near the cheapest that meet an error in every start, cheapest first.

        Empty where nothing within reach of the reference meets it. climb: try other axes too,
        and not only the families and what earlier calls have found.
        """
        bases = dict.fromkeys([*families(self.shipped, self.rows), *self.methods])
        open_ = [self.bracket(base) for base in bases]
        self.narrow(open_, error, self.few, COARSE, "families")
        open_ = self.keep(open_, error, FIRST)
        if climb:
            open_ = self.climb(open_, error)
            self.narrow(open_, error, self.few, COARSE, "axes")
            self.methods += [self.steps.at(bracket.base, self.steps.own) for bracket in open_]
        kept = [self.again(bracket, error) for bracket in self.keep(open_, error, SECOND)]
        self.narrow(kept, error, self.all, FINE, "all starts")
        good = [(bracket, bracket.meets(error)) for bracket in kept]
        met = [(bracket.known[n].price, self.steps.at(bracket.base, n)) for bracket, n in good if n]
        return [settings for _, settings in sorted(met, key=lambda pair: pair[0])]

    def bracket(self, base: Settings) -> Bracket:
        """A method with all that is known of it from few starts."""
        bracket = Bracket(base, self.steps.own)
        for settings in self.trials.screened:
            pieces = self.steps.pieces(settings)
            if self.steps.at(base, pieces) == settings and pieces <= self.finest:
                bracket.known[pieces] = self.trials.score(settings, self.few)
        return bracket

    def again(self, bracket: Bracket, error: float) -> Bracket:
        """The same method, to be judged by all starts, beginning where few starts put it."""
        return Bracket(bracket.base, bracket.meets(error) or self.finest)

    def keep(self, brackets: Sequence[Bracket], error: float, factor: float) -> list[Bracket]:
        """Those whose price is near the best; of two that do the very same, one."""
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
        """Finds the fewest pieces that meet the error, to a ratio, for all methods in step."""
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
            self.trials.screen(settings, starts, label)
            for (bracket, n), made in zip(wanted, settings, strict=True):
                bracket.known[n] = self.trials.score(made, starts)

    def propose(self, bracket: Bracket, error: float, ratio: float) -> int | None:
        """The next number of pieces to try, or None where enough is known."""
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
        """Where the order says that the error is met, at most four times away."""
        seen = bracket.known[n].error
        if not 0 < seen < math.inf:
            return n * 2 if seen else max(1, n // 4)
        factor = (seen / error) ** (1 / bracket.order(error))
        return max(1, math.ceil(n * min(4.0, max(0.25, factor * 1.02))))

    def floored(self, bracket: Bracket) -> bool:
        """Whether shorter steps have stopped helping."""
        errors = {n: s.error for n, s in bracket.known.items() if s.error < math.inf}
        last = max(errors, default=0)
        bracket.floored = any(
            last >= FLOOR * n and min(e for m, e in errors.items() if m > n) > error / HELPS
            for n, error in errors.items()
        )
        return bracket.floored

    def climb(self, brackets: Sequence[Bracket], error: float) -> list[Bracket]:
        """Changes one axis of each method at a time while that is cheaper at equal error."""
        now = list(brackets)
        moving = set(range(len(now)))
        for _ in range(CLIMBS):
            asked = {i: self.near(now[i], error) for i in moving}
            self.trials.screen([s for some in asked.values() for s in some], self.few, "axes")
            for i, tried in asked.items():
                base, order = now[i].base, now[i].order(error)
                prices = [
                    (equal_error(self.trials.score(s, self.few), error, order), k)
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
        """Neighbours of a method, at the step where it meets the error."""
        pieces = bracket.meets(error) or max(bracket.known)
        here = self.steps.at(bracket.base, pieces)
        return moves(here, self.rows, self.friction)
