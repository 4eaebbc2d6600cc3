"""What is to be said of a reference: how long it counts, and what it is the limit of."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stepcore.experiment.growth import GROWTH, NEARBY
from stepcore.experiment.reference import Gap, Reference
from stepcore.measure.trade.statistics import QUANTITIES
from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import metres, seconds

if TYPE_CHECKING:
    from stepcore.measure.trade.result import Trade


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


def observed(trade: Trade) -> list[str]:
    """How long the motion can be predicted, and the order that each integrator shows."""
    growth = trade.reference.growth
    if np.isfinite(trade.predictable):
        lines = [f"predictable: {seconds(trade.predictable)} of {seconds(trade.horizon)}"]
    else:
        most = float(growth.factor.max())
        lines = [
            f"predictable: all of {seconds(trade.horizon)} (twins grow {most:.2g} times apart)"
        ]
    found = ", ".join(f"{name} {order:.2g}" for name, order in trade.orders.items())
    return lines + ([f"observed order of accuracy (worst start): {found}"] if found else [])


def after(trade: Trade, width: int | None) -> list[str]:
    """The statistics of a trade as lines; none where all of it can be predicted."""
    told = [row for row in trade.rows if row.after is not None]
    if not told:
        return []
    first = told[0].after
    assert first is not None
    means = {name: getattr(first, name).reference for name in QUANTITIES}
    heads = {"height": "height m", "kinetic": "kinetic J", "touching": "contacts"}
    heads = {name: head for name, head in heads.items() if name != "touching" or means[name]}
    said = ", ".join(f"{head} {means[name]:.3g}" for name, head in heads.items())
    records = []
    for row in told:
        record = {"": "*" * row.best + "s" * row.shipped, "setting": label(row.settings)}
        for name, head in heads.items():
            one = getattr(row.after, name)
            record[head] = f"{one.mean:+.1e} ± {one.interval:.0e}" + " !" * one.seen
        records.append(record)
    return [
        "",
        f"After {seconds(first.since)}: difference from the reference's means ({said}), with 95 % "
        f"intervals over {first.starts} starts; !: seen",
        Table(records).text(width),
    ]


def _gap(name: str, gap: Gap) -> str:
    """What the scene's own model is away from another."""
    what = {
        "pyramid": "the pyramid of friction moves positions by",
        "softness": "the softness of contacts and limits moves positions by",
    }[name]
    open_end = "" if gap.settled else ", and by more the harder it is: at least that"
    return (
        f"modelling: {what} {metres(gap.distance)} (rms, worst start; against "
        f"{gap.against}{open_end}); no setting of dt or solver changes that"
    )
