"""The answer of a trade in sentences: what is recommended, how good the shipped settings are."""

from __future__ import annotations

import math
from collections.abc import Iterator

from stepcore.measure.trade.findings import TradeFindings
from stepcore.measure.trade.frontier import NOTABLE
from stepcore.measure.trade.in_batch import BatchPoint
from stepcore.measure.trade.mujoco import compared_with_mujoco
from stepcore.measure.trade.notes import short
from stepcore.measure.trade.row import TradeRow
from stepcore.report.settings import label
from stepcore.report.units import computing, counted, metres, operations, percent, seconds

# From here on the worst start says something else than the median of the starts.
DIFFER = 30.0


def sentences(trade: TradeFindings) -> Iterator[str]:
    """The recommendation first, then the shipped settings, MuJoCo, and what the motion shows."""
    if trade.target is not None:
        yield from _for_error(trade, trade.target)
    elif trade.budget is not None:
        yield from _for_budget(trade, trade.budget)
    yield _shipped(trade)
    if trade.target is None and trade.budget is None:
        yield from _improvements(trade)
    if trade.mujoco:
        yield from compared_with_mujoco(trade.mujoco, trade.shipped)
    yield from _in_a_batch(trade)
    yield from (finding.text for finding in trade.findings)


def _for_error(trade: TradeFindings, error: float) -> Iterator[str]:
    """The cheapest settings within an error and the next better, or what came nearest."""
    row = trade.recommended
    if row is not None:
        what = f"Recommended for an error of at most {metres(error)}"
        if trade.error(row) > error:
            missed, count = trade.misses(row)
            what += f" on {count - missed} of {count} starts, because no setting keeps to it on all"
        yield f"{what}: {_described(trade, row)}"
        yield from _passed_over(trade, row, error)
        yield _next_better(trade, row)
        return
    known = trade.reference.high
    if known > error:
        yield (
            f"No setting can be shown to have an error of at most {metres(error)}: the converged "
            f"motion that errors are measured from is itself known only to {metres(known)} in the "
            "worst start."
        )
    else:
        yield f"No setting tried has an error of at most {metres(error)} in every start."
    ran = [other for other in trade.rows if other.errors is not None]
    if ran:
        least = min(ran, key=lambda other: (trade.error(other), trade.price(other)))
        best = metres(trade.error(least))
        yield f"The most accurate one is {_named(trade, least)}, with an error of {best}."


def _for_budget(trade: TradeFindings, budget: float) -> Iterator[str]:
    """The most accurate settings within a budget and the next better, or the cheapest."""
    within = operations(budget) if trade.by == "flops" else computing(budget)
    row = trade.recommended
    if row is not None:
        what = f"Recommended for at most {within} per simulated second"
        yield f"{what}: {_described(trade, row)}"
        yield _next_better(trade, row)
        return
    yield f"No setting tried costs at most {within} per simulated second."
    ran = [other for other in trade.rows if not other.failure]
    if ran:
        least = min(ran, key=trade.price)
        yield f"The cheapest one is {_named(trade, least)}, at {_priced(trade, least)}."


def _described(trade: TradeFindings, row: TradeRow) -> str:
    """Recommended settings with their error, their cost and the result on further starts."""
    shipped, price = trade.shipped, _priced(trade, row)
    if row.settings == shipped.settings:
        price += ", as shipped"
    elif not math.isnan(trade.price(shipped)):
        times = trade.price(row) / trade.price(shipped)
        price += f", {times:.2f} times the cost of the shipped settings"
    return (
        f"{_named(trade, row)}. The RMS position error is {metres(trade.error(row))} in the worst "
        f"start, for {price}.{_confirmed(trade, row)}"
    )


def _confirmed(trade: TradeFindings, row: TradeRow) -> str:
    """The result on further starts."""
    tried = row.further
    if tried is None:
        return " It was not tried on further starts."
    if tried.starts == 0:
        return f" It could not be confirmed: {short(tried.failure or '')}."
    count = counted(tried.starts, "further start")
    if trade.target is None:
        return f" This includes {count}."
    if tried.held < tried.starts:
        return f" The error stayed within it on {tried.held} of {count}."
    # The next of n + 1 random starts is the worst of them with a probability of 1/(n + 1).
    all_ = trade.starts + tried.starts
    share = percent(all_ / (all_ + 1))
    return f" Confirmed on {count}; {share} of other starts are expected to stay within it."


def _passed_over(trade: TradeFindings, row: TradeRow, error: float) -> Iterator[str]:
    """A cheaper setting that seems to meet the error too, and why it is not recommended."""
    other = trade.passed_over
    if other is None or other.errors is None:
        return
    times = f"{trade.price(other) / trade.price(row):.2f} times as much"
    named = _named(trade, other)
    if other.shipped:
        named = f"the shipped settings ({named})"
    missed, count = trade.misses(other)
    if not missed and trade.error(other) <= trade.kept:
        yield (
            f"{named[0].upper()}{named[1:]} cost {times} and pass too; a round time step is "
            "recommended in their place."
        )
    elif not missed:
        yield (
            f"{named[0].upper()}{named[1:]} cost {times} and stayed within {metres(error)} too, "
            f"with {metres(trade.error(other))}; but a recommendation keeps to "
            f"{metres(trade.kept)}, because starts that were not run may be worse."
        )
    else:
        yield (
            f"{named[0].upper()}{named[1:]} would cost {times}, but exceeded {metres(error)} on "
            f"{missed} of {count} starts (by up to {metres(trade.error(other) - error)}); "
            "with other starts the answer may change."
        )


def _next_better(trade: TradeFindings, row: TradeRow) -> str:
    """What at most half of the error costs."""
    better, searched = trade.frontier.halving(row), trade.frontier.searched
    there = trade.error(row) > searched(row)
    if better is None:
        where = f" in the {counted(trade.starts, 'start')} of the search" if there else ""
        return f"No setting tried halves that error{where}."
    costs = f"costs {trade.price(better) / trade.price(row):.2f} times as much"
    named = f"{_named(trade, better)}, with an error of {metres(searched(better))}"
    if not there:
        return f"Half that error or less {costs}: {named}."
    return (
        f"Half of its error in the {counted(trade.starts, 'start')} of the search, "
        f"{metres(searched(row))}, or less {costs}: {named} there."
    )


def _shipped(trade: TradeFindings) -> str:
    """The error of the shipped settings: in the worst start, and in the median of the starts."""
    row = trade.shipped
    what = f"As shipped ({label(row.settings)})"
    if row.errors is None:
        return f"{what} the simulation fails: {short(row.failure or '')}."
    e, error = row.errors, metres(trade.error(row))
    where = ""
    if trade.starts > 1:
        median = f"median {metres(e.median)}"
        if e.high > DIFFER * e.median:
            median = f"starts differ widely: {median}"
        where = f" in the worst of {trade.starts} starts (start {e.each.index(e.high)}; {median})"
    # The error counts rotation as well, so that the largest of centres may be below it.
    return (
        f"{what} the RMS position error over {seconds(trade.horizon)} is {error}{where}, for "
        f"{_priced(trade, row)}. The largest error of a centre of mass is {metres(e.position_max)}."
    )


def _improvements(trade: TradeFindings) -> Iterator[str]:
    """The cost of half the shipped error, and of the shipped error itself."""
    row = trade.shipped
    if row.errors is None:
        ran = [other for other in trade.rows if not other.failure]
        if ran:
            least = min(ran, key=trade.price)
            named, least_error = _named(trade, least), metres(trade.error(least))
            yield f"The cheapest setting that runs is {named}, with an error of {least_error}."
        return
    error = trade.error(row)
    half = trade.next_better(error)
    if half is None:
        yield "No setting tried halves that error."
    else:
        yield f"Half that error or less {_offer(trade, half)}"
    same = trade.frontier.cheapest(error)
    if same is not half and trade.price(same) < NOTABLE * trade.price(row):
        yield f"The same error or less {_offer(trade, same)}"


def _offer(trade: TradeFindings, row: TradeRow) -> str:
    times = trade.price(row) / trade.price(trade.shipped)
    return (
        f"costs {times:.2f} times as much: {_named(trade, row)}, with an error of "
        f"{metres(trade.error(row))}."
    )


def _in_a_batch(trade: TradeFindings) -> Iterator[str]:
    """What a world of a batch costs under the recommended or the shipped settings."""
    chosen = trade.recommended or trade.shipped
    alike = chosen.settings.precision
    points = [
        point
        for point in trade.in_batch
        if point.row.settings.replace(precision=alike) == chosen.settings
        and not math.isnan(point.cost)
    ]
    if points:
        which = "recommended" if trade.recommended else "shipped"
        costs = "; ".join(map(_shared, points))
        yield (
            f"Many worlds at once are another cost: under the {which} settings each of "
            f"{points[0].worlds} worlds of a batch on one thread takes {costs}."
        )


def _shared(point: BatchPoint) -> str:
    """What each world of a batch costs, and its error."""
    way = "in vector lanes" if point.lanes else "one by one"
    return (
        f"{computing(point.cost)} per simulated second in {point.row.settings.precision}, {way} "
        f"(alone {point.row.cost / point.cost:.2g} times as much; error {metres(point.error)} in "
        "the starts of the search)"
    )


def _named(trade: TradeFindings, row: TradeRow) -> str:
    """Settings in words, with all that is not as shipped."""
    return label(row.settings, trade.shipped.settings)


def _priced(trade: TradeFindings, row: TradeRow) -> str:
    """The price in words."""
    if trade.by == "flops":
        return f"{operations(row.flops)} per simulated second"
    return f"{computing(row.cost)} of computing per simulated second"
