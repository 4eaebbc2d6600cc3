"""What is to be said of a reference: how long it counts, and what it is the limit of."""

from __future__ import annotations

import numpy as np

from stepcore.trade.growth import GROWTH, NEARBY
from stepcore.trade.reference import Gap, Reference
from stepcore.trade.settings import metres, seconds


def truths(reference: Reference) -> list[str]:
    """Remarks on the truth that a trade is measured against."""
    found = []
    ends = reference.growth.ends
    lost = int(np.isfinite(ends).sum())
    if lost:
        found.append(
            f"{lost} of {len(ends)} starts cannot be predicted to the end, the first from "
            f"{seconds(float(ends.min()))} on: twins that begin {NEARBY:g} of the scene's size "
            f"apart are then more than {GROWTH:g} times as far apart; errors of the trajectory are "
            "those before it"
        )
    if reference.exact is not None:
        found.append(
            "the motion has a closed form, and errors are measured from it; the converged run is "
            f"{metres(reference.exact.check)} from it"
        )
    if reference.stiffens:
        found.append(
            f'the law "{reference.settings.law}" makes contacts stiffer as dt shrinks (beta/dt): '
            "the limit dt → 0 that errors are measured from is a harder scene than the shipped one"
        )
    for name, gap in reference.gaps.items():
        found.append(_gap(name, gap))
    return found


def _gap(name: str, gap: Gap) -> str:
    """What the scene's own model is away from another."""
    what = {
        "pyramid": "the pyramid of friction moves positions by",
        "softness": "the softness of contacts and limits moves positions by",
    }[name]
    open_end = "" if gap.settled else ", and by more the harder it is: at least that"
    return (
        f"modelling: {what} {metres(gap.distance)} (rms, median of starts; against "
        f"{gap.against}{open_end}); no setting of dt or solver changes that"
    )
