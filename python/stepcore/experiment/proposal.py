"""`Proposal`: a change that may help, the result of its run, and whether that is sufficient.

`evaluate` runs alternatives in order and returns those that are sufficient. Nothing is claimed for
a proposal that was not run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from stepcore.experiment.change import Change


@dataclass(frozen=True)
class Proposal:
    """A change that is proposed, and the result of its run.

    label: the change as it is written in a file, with the elements in words; see `words`.
    change: the change of the model.
    measured: the value of the measure in the run; None without a run or without a value.
    share: the fraction of the motion that was run; 0 without a run.
    sufficient: whether the measured value is small enough.
    doubt: why the change may fail elsewhere, in words; "" without a reason.

    >>> proposal = Proposal(change=Change(dt=0.001))
    >>> proposal.words, proposal.mjcf, proposal.sufficient
    ('dt 1 ms', '<option timestep="0.001"/>', False)
    """

    label: str = ""
    change: Change = field(default_factory=Change)
    measured: float | None = None
    share: float = 0.0
    sufficient: bool = False
    doubt: str = ""

    @property
    def words(self) -> str:
        """The change in words: its label, or else `Change.words`."""
        return self.label or self.change.words

    @property
    def mjcf(self) -> str:
        """The change as MJCF."""
        return self.change.mjcf


class Evaluation(NamedTuple):
    """The result of `evaluate`.

    best: the sufficient proposals, those without a doubt first; or else the most helpful one.
    failed: the first proposal of each alternative that failed.
    untried: the first proposal that was not run in time; None if all were run.
    """

    best: list[Proposal]
    failed: list[Proposal]
    untried: Proposal | None


def evaluate(
    alternatives: Iterable[Sequence[Proposal]],
    run: Callable[[Proposal], Proposal],
    most: int = 1,
    helps: float = math.inf,
) -> Evaluation:
    """Run alternatives in order, until `most` of them are sufficient without a doubt.

    alternatives: each is a sequence of increasingly strong proposals; the first sufficient one
        ends it.
    run: returns a proposal with its result; `share` is 0 if no time was left for its run.
    most: the largest number of proposals to return.
    helps: the largest measured value of a proposal that helps without being sufficient.

    >>> steps = [Proposal(change=Change(dt=dt)) for dt in (0.004, 0.002)]
    >>> def halved(proposal):
    ...     dt = dict(proposal.change.settings)["dt"]
    ...     return Proposal("", proposal.change, dt, 1.0, sufficient=dt < 0.003)
    >>> [proposal.words for proposal in evaluate([steps], halved).best]
    ['dt 2 ms']
    """
    enough, helped = list[Proposal](), list[Proposal]()
    failed, untried = list[Proposal](), None
    for alternative in alternatives:
        if sum(not proposal.doubt for proposal in enough) >= most:
            break
        fails = False
        for proposal in alternative:
            result = run(proposal)
            if not result.share:
                untried = untried or proposal
                break
            fails = not result.sufficient
            if result.sufficient:
                enough.append(result)
                break
            if result.measured is not None and result.measured <= helps:
                helped.append(result)
        failed += alternative[:1] if fails else ()
    best = sorted(enough, key=lambda proposal: bool(proposal.doubt))[:most]
    # Without a sufficient proposal, the one that leaves least.
    helped.sort(key=lambda proposal: (proposal.measured, proposal.words))
    return Evaluation(best or helped[:1], failed, untried)
