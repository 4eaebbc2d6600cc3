"""Choices among trials: the cheapest rung of a ladder, the frontier, a greedy set; validation.

A choice is made on the starts of a search and tested on held-out starts, which then join the
search. The reported result comes from starts that no choice has used: `Proof`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from stepcore.experiment.trial import Trial
from stepcore.report.units import counted

T = TypeVar("T")

# How often starts on which a choice fails may join the search, and how many of them at a time.
ROUNDS, JOIN = 8, 3
# The confidence level of the bound of a `Proof`.
CONFIDENCE = 0.95


def frontier(trials: Iterable[Trial], price: Callable[[Trial], float]) -> list[Trial]:
    """Return the trials that no other trial beats in both price and error, the cheapest first.

    The first of equal trials is kept. Failed trials are left out.
    """
    kept, best = list[Trial](), math.inf
    for trial in sorted(trials, key=lambda t: (price(t), t.error)):
        if trial.error < best:
            kept.append(trial)
            best = trial.error
    return kept


def least(
    ladder: Sequence[int],
    error: Callable[[int], float],
    bound: float,
    first: int,
    *,
    ratio: float = 1.08,
    cliff: bool = False,
) -> int | None:
    """Return the least rung of a ladder whose error is within a bound, or None if none was found.

    The search climbs from a first rung, by jumps that follow from the order at which the error
    falls. It gives up if that order shows that the top of the ladder is not enough. Then it narrows
    the gap between a rung that fails and one that holds. It tries nothing below a rung that fails,
    so that a lucky coarse rung is not found.

    ladder: increasing numbers, such as steps in a period. error: of a rung; inf if it failed.
    first: the number to start near. ratio: from a failing rung to a holding one that is accepted.
    cliff: for stability, where the error falls at once and has no order: the jumps are doublings.

    >>> least(range(1, 1000), lambda n: 1 / n**2, 1e-4, first=8)
    100
    """
    if not len(ladder):
        return None
    rungs, errors = np.asarray(ladder), dict[int, float]()

    def at(k: int) -> float:
        errors[k] = error(int(rungs[k]))
        return errors[k]

    def order(k: int, j: int) -> float:
        """Return the order of convergence between two rungs; k: the coarser one."""
        return math.log(errors[k] / errors[j]) / math.log(rungs[j] / rungs[k])

    def rung(n: float) -> int:
        return int(np.searchsorted(rungs, n))

    top, bad = len(rungs) - 1, -1
    good = min(rung(first), top)
    while not at(good) <= bound:
        if good == top:
            return None
        jump, finite = 2.0, math.isfinite(errors[good]) and not cliff
        if finite:
            p = 1.0
            if bad >= 0 and math.isfinite(errors[bad]):
                p = order(bad, good)
                reach = rungs[good] * (errors[good] / bound) ** (1 / max(p, 0.1))
                if p < 0.2 or reach > 1.5 * rungs[top]:
                    return None
            jump = min(4.0, max(1.2, (errors[good] / bound) ** (1 / min(p, 4.0))))
        bad, good = good, min(top, max(good + 1, rung(rungs[good] * jump)))
    while good - bad > 1 and (bad < 0 or rungs[good] > ratio * rungs[bad]):
        if bad >= 0 and not cliff and math.isfinite(errors[bad]) and errors[good] > 0:
            guess = rungs[bad] * (errors[bad] / bound) ** (1 / max(0.25, order(bad, good)))
        elif bad >= 0:
            guess = math.sqrt(rungs[bad] * rungs[good])
        else:
            guess = rungs[good] * min(0.8, max(0.125, math.sqrt(max(errors[good], 1e-300) / bound)))
        middle = min(max(rung(guess), bad + 1), good - 1)
        bad, good = (bad, middle) if at(middle) <= bound else (middle, good)
    return int(rungs[good])


def greedy(parts: Sequence[T], holds: Callable[[tuple[T, ...]], bool]) -> tuple[T, ...]:
    """Return as many parts as hold together, tried in the given order; failing sets are halved.

    >>> greedy([1, 2, 3, 4], lambda some: sum(some) <= 6)
    (1, 2, 3)
    """
    chosen, todo = tuple[T, ...](), [tuple(parts)] if parts else []
    while todo:
        some = todo.pop(0)
        if holds((*chosen, *some)):
            chosen = (*chosen, *some)
        elif len(some) > 1:
            half = len(some) // 2
            todo[:0] = [some[:half], some[half:]]
    return chosen


@dataclass(frozen=True)
class Proof:
    """The validation of a choice on held-out starts.

    trial: the choice, run from these starts. error: the requested error, in the unit of the trial.
    missed: the number of starts that exceed it. unclear: the number of starts whose error differs
    from it by no more than the uncertainty.

    >>> [round(share_of(missed, 32), 3) for missed in (0, 2)]
    [0.089, 0.184]
    """

    trial: Trial
    error: float
    missed: int
    unclear: int = 0

    @classmethod
    def of(cls, trial: Trial, error: float) -> Proof:
        """Return the validation of a trial against a requested error."""
        if trial.failure:
            return cls(trial, error, len(trial.starts))
        unclear = np.abs(trial.errors - error) <= trial.unsure
        return cls(trial, error, int(((trial.errors > error) & ~unclear).sum()), int(unclear.sum()))

    @property
    def starts(self) -> int:
        """The number of starts."""
        return len(self.trial.starts)

    @property
    def share(self) -> float:
        """The largest share of all starts that misses the error, with 95 % confidence.

        Unclear starts count as misses.
        """
        return share_of(self.missed + self.unclear, self.starts)

    def record(self) -> dict[str, Any]:
        """Return the proof as plain data."""
        return {"starts": self.starts, "missed": self.missed, "share": self.share}

    @property
    def words(self) -> str:
        """The proof as a sentence."""
        starts = counted(self.starts, "held-out start")
        if self.unclear == self.starts:
            return f"It is not validated: the converged motion from {starts} is too uncertain."
        number = "None" if not self.missed else f"{self.missed}"
        share = math.ceil(100 * self.share)
        worst = "fails" if self.trial.failure else f"has {self.trial.words(self.trial.error)}"
        over = f"; the worst one {worst}" if self.missed else f" ({worst[4:]} in the worst)"
        if self.unclear:
            over = (
                f", and {self.unclear} cannot be judged, because the converged motion is too "
                "uncertain there"
            )
        return (
            f"{number} of {starts} missed it{over}: with "
            f"{100 * CONFIDENCE:.0f} % confidence at most {share} % of starts do."
        )


def share_of(missed: int, starts: int, confidence: float = CONFIDENCE) -> float:
    """Return Clopper and Pearson's upper bound of the share of misses, from k misses of n starts.

    The bound is the share p at which k or fewer misses have a probability of 1 − confidence.
    """
    if missed >= starts:
        return 1.0
    low, high = missed / starts, 1.0
    hits = np.arange(missed + 1)
    # The logarithms of the binomial coefficients, which overflow.
    rising = np.log(starts - hits[:-1]) - np.log(hits[:-1] + 1)
    counts = np.concatenate([[0.0], np.cumsum(rising)])
    for _ in range(60):
        p = (low + high) / 2
        logs = counts + hits * math.log(p) + (starts - hits) * math.log1p(-p)
        low, high = (p, high) if np.exp(logs).sum() > 1 - confidence else (low, p)
    return high
