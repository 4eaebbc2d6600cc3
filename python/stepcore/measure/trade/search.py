"""The frugal search for the cheapest settings that meet an error.

A *method* is all of the settings but the time step. For each method the search looks for the
longest time step that meets the error, in three rounds. Families of methods are judged from a few
starts. The cheapest of them go on, and change one setting at a time as long as that makes them
cheaper at equal error. The best are judged again from all starts. Costs are counted operations, so
that the same seed finds the same settings on any machine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from stepcore._core import Settings
from stepcore.measure.trade.moves import Steps, families, moves
from stepcore.measure.trade.settings import is_stiff
from stepcore.measure.trade.trials import Score, Trials

# Starts that methods are first judged from.
FEW = 2
# A method goes on to the second round, and then to all starts, if it costs at most so many times
# as much as the best.
FIRST, SECOND = 1.6, 1.25
# At most so many methods go on.
MOST = 4
# A changed setting is taken if that costs at most this share at equal error; so many in a row.
BETTER = 0.97
CLIMBS = 4
# The longest step is found to this ratio: in the first rounds, at the end.
COARSE, FINE = 1.3, 1.08
ROUNDS = 8
# A shorter step takes at least this share of the work of a longer one.
CHEAPER = 0.8
# A method is at its floor where steps so many times shorter reduce the error by less than this.
FLOOR, HELPS = 4.0, 1.3


@dataclass
class Bracket:
    """What is known of a method: its scores by the number of steps in a control period.

    base: the method. guess: where to begin. known: steps in a period to score. floored: shorter
    steps have stopped reducing the error.
    """

    base: Settings
    guess: int
    known: dict[int, Score] = field(default_factory=dict)
    floored: bool = False

    def meets(self, error: float) -> int | None:
        """The fewest steps in a period that meet an error, or None."""
        return min((n for n, s in self.known.items() if s.error <= error), default=None)

    def misses(self, error: float) -> int:
        """The most steps in a period, fewer than those, that miss it; 0 if none is known."""
        good = self.meets(error)
        return max(
            (n for n, s in self.known.items() if s.error > error and (good is None or n < good)),
            default=0,
        )

    def at_least(self, pieces: int) -> float:
        """What so many steps cost at least, in proportion to fewer that were run; 0 if none was."""
        fewer = [n for n in self.known if n < pieces and self.known[n].price < math.inf]
        n = max(fewer, default=0)
        return self.known[n].price * pieces / n * CHEAPER if n else 0.0

    def order(self, error: float) -> float:
        """The order with which the error falls near the target; between 1/2 and 4."""
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
        """What meeting an error would cost at any step; inf where it is out of reach."""
        near = [n for n, s in self.known.items() if 0 < s.error < math.inf]
        if not near or (self.floored and self.meets(error) is None):
            exact = [s.price for s in self.known.values() if s.error <= error]
            return min(exact, default=math.inf)
        n = min(near, key=lambda n: abs(math.log(self.known[n].error / error)))
        return equal_error(self.known[n], error, self.order(error))


def equal_error(score: Score, error: float, order: float) -> float:
    """The price at another error, if the error falls with the step at this order."""
    if not 0 < score.error < math.inf:
        return score.price
    return float(score.price * (score.error / error) ** (1 / order))


class SettingsSearch:
    """Searches for the cheapest settings that meet an error; its runs stay in its trials.

    rows: the most at once in the reference. friction: whether a contact can have friction.
    """

    def __init__(
        self, trials: Trials, steps: Steps, shipped: Settings, rows: int, friction: bool
    ) -> None:
        self.trials, self.steps, self.shipped = trials, steps, shipped
        self.rows, self.friction = rows, friction
        self.stiff = is_stiff(trials.runner.model)
        self.all = len(trials.runner.schedule.starts)
        self.few = min(FEW, self.all)
        # Methods found by changing settings of the families.
        self.methods: list[Settings] = []

    @property
    def finest(self) -> int:
        """The most steps in a control period that the reference is accurate enough to judge."""
        return max(1, int(self.steps.period / self.trials.reference.settings.dt / 2 + 1e-9))

    def overview(self) -> list[Settings]:
        """Runs every family at a few time steps from few starts, around the shipped settings.

        None but the shipped one is shorter than the reference can judge.
        """
        some = families(self.shipped, self.rows, self.stiff)
        own = self.steps.own
        counts = {max(1, own // 4), max(1, own // 2), own, 2 * own, 4 * own, 8 * own, 1}
        judged = sorted(n for n in counts if n <= max(own, self.finest))
        tried = [self.steps.at(base, n) for base in some for n in judged]
        self.trials.screen([self.shipped, *tried], self.few, "search: overview")
        return tried

    def meeting(self, error: float, climb: bool = True) -> list[Settings]:
        """Settings near the cheapest that meet an error in every start, cheapest first.

        Empty where no step that the reference can judge meets it. climb: change settings of the
        methods too, beyond the families and what earlier calls have found.
        """
        bases = dict.fromkeys([*families(self.shipped, self.rows, self.stiff), *self.methods])
        open_ = [self.bracket(base) for base in bases]
        self.narrow(open_, error, self.few, COARSE, "search: time steps")
        open_ = self.keep(open_, error, FIRST)
        if climb:
            open_ = self.climb(open_, error)
            self.narrow(open_, error, self.few, COARSE, "search: settings")
            self.methods += [self.steps.at(bracket.base, self.steps.own) for bracket in open_]
        kept = [self.again(bracket, error) for bracket in self.keep(open_, error, SECOND)]
        self.narrow(kept, error, self.all, FINE, "all starts")
        good = [(bracket, bracket.meets(error)) for bracket in kept]
        met = [(bracket.known[n].price, self.steps.at(bracket.base, n)) for bracket, n in good if n]
        return [settings for _, settings in sorted(met, key=lambda pair: pair[0])]

    def bracket(self, base: Settings) -> Bracket:
        """A method with its scores from few starts, as far as it has been run."""
        bracket = Bracket(base, self.steps.own)
        for settings in self.trials.screened:
            pieces = self.steps.pieces(settings)
            if self.steps.at(base, pieces) == settings and pieces <= self.finest:
                bracket.known[pieces] = self.trials.score(settings, self.few)
        return bracket

    def again(self, bracket: Bracket, error: float) -> Bracket:
        """The same method, to be judged from all starts, beginning at the step that few gave."""
        return Bracket(bracket.base, bracket.meets(error) or self.finest)

    def keep(self, brackets: Sequence[Bracket], error: float, factor: float) -> list[Bracket]:
        """Those whose price is near the best; one of those that do exactly the same."""
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
        """Finds the fewest steps that meet the error to within a ratio, for all methods."""
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
        """The next number of steps in a period to try, or None where enough is known."""
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
        """Where the observed order puts the error, at most four times as many steps or as few."""
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
        """Changes one setting of each method at a time while that is cheaper at equal error."""
        now = list(brackets)
        moving = set(range(len(now)))
        for _ in range(CLIMBS):
            asked = {i: self.near(now[i], error) for i in moving}
            self.trials.screen(
                [s for some in asked.values() for s in some], self.few, "search: settings"
            )
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
        """The methods that differ in one setting, at the step where this one meets the error."""
        pieces = bracket.meets(error) or max(bracket.known)
        here = self.steps.at(bracket.base, pieces)
        return moves(here, self.rows, self.friction)
