"""The answer in words: how wrong, what to use instead, and what less error would cost."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from stepcore.measure.trade.mujoco import against
from stepcore.report.settings import label
from stepcore.report.units import computing, metres, operations, seconds

if TYPE_CHECKING:
    from stepcore.measure.trade.result import Trade
    from stepcore.measure.trade.row import Row

# From here on the worst start says something else than the median of the starts.
DIFFER = 30.0
# A saving below this is within what timing can tell.
NOTABLE = 0.9


def answer(trade: Trade) -> list[str]:
    """The sentences below the table."""
    found = [_shipped(trade)]
    if trade.target is not None:
        found += _for_error(trade, trade.target)
    elif trade.budget is not None:
        found += _for_budget(trade, trade.budget)
    else:
        found += _unasked(trade)
    return found + (against(trade) if trade.mujoco else [])


def _shipped(trade: Trade) -> str:
    row = trade.shipped
    if row.errors is None:
        return f"As shipped ({label(row.settings)}) it fails: {row.failure}."
    return f"As shipped ({label(row.settings)}) {_wrong(trade, row)}, for {priced(trade, row)}."


def _for_error(trade: Trade, error: float) -> list[str]:
    """The cheapest within an error, the next better, or what came nearest."""
    row = trade.recommended
    if row is None:
        ran = [one for one in trade.rows if one.errors is not None]
        text = f"Nothing that was tried keeps to {metres(error)} in every start"
        if not ran:
            return [text + "."]
        least = min(ran, key=lambda one: (trade.error(one), trade.price(one)))
        return [f"{text}; nearest: {named(trade, least)}, {metres(trade.error(least))} wrong."]
    kept = f"{metres(trade.error(row))} wrong in the worst start"
    found = [
        f"Within {metres(error)}: {named(trade, row)}: {kept}, for {priced(trade, row)}"
        f"{_compared(trade, row)}.{_confirmed(row)}"
    ]
    return found + _better(trade, row)


def _for_budget(trade: Trade, budget: float) -> list[str]:
    row = trade.recommended
    within = operations(budget) if trade.by == "flops" else computing(budget)
    if row is None:
        ran = [one for one in trade.rows if not one.failure]
        text = f"Nothing that was tried costs as little as {within} per simulated second"
        if not ran:
            return [text + "."]
        least = min(ran, key=trade.price)
        return [f"{text}; the cheapest: {named(trade, least)}, {priced(trade, least)}."]
    found = [
        f"Within {within} per simulated second: {named(trade, row)}: "
        f"{metres(trade.error(row))} wrong in the worst start, for {priced(trade, row)}"
        f"{_compared(trade, row)}.{_included(row)}"
    ]
    return found + _better(trade, row)


def _better(trade: Trade, row: Row) -> list[str]:
    """What at most half of the error costs."""
    better = trade.next_better(trade.error(row))
    if better is None:
        return ["The next better is out of reach: nothing that was tried has half that error."]
    times = trade.price(better) / trade.price(row)
    return [
        f"The next better costs {times:.2f} times as much: {named(trade, better)}: "
        f"{metres(trade.error(better))}."
    ]


def _unasked(trade: Trade) -> list[str]:
    """What half of the shipped error would cost, and no more than that."""
    row = trade.shipped
    if row.errors is None:
        ran = [other for other in trade.rows if not other.failure]
        if not ran:
            return []
        least = min(ran, key=trade.price)
        wrong = metres(trade.error(least))
        return [f"The cheapest that runs: {named(trade, least)}, {wrong} wrong."]
    error = trade.error(row)
    found = [_offer(trade, "Half that error", error / 2, row)]
    same = trade.cheapest(error)
    if trade.price(same) < NOTABLE * trade.price(row):
        found.append(_offer(trade, "No more error than that", error, row))
    return found


def _offer(trade: Trade, what: str, error: float, row: Row) -> str:
    try:
        found = trade.cheapest(error)
    except ValueError:
        return f"{what} is not reached by any setting tried."
    return (
        f"{what} costs {trade.price(found) / trade.price(row):.2f} times as much computing: "
        f"{named(trade, found)} ({metres(trade.error(found))})."
    )


def _wrong(trade: Trade, row: Row) -> str:
    """How wrong positions are: in the worst start, and in the median of the starts."""
    assert row.errors is not None
    error, over = metres(trade.error(row)), f"over {seconds(trade.horizon)}"
    # The error counts turning as well, so that the largest of centres may be below it.
    worst = f"centres at worst {metres(row.errors.position_max)}"
    if trade.starts == 1:
        return f"positions are {error} wrong {over} (rms; {worst})"
    start = f"worst of {trade.starts} starts, start {row.errors.each.index(row.errors.high)}"
    median = f"median {metres(row.errors.median)}"
    if row.errors.high > DIFFER * row.errors.median:
        return (
            f"positions are {error} wrong {over} (rms; {start}; starts differ: {median}; {worst})"
        )
    return f"positions are {error} wrong {over} (rms; {start}; {median}; {worst})"


def named(trade: Trade, row: Row) -> str:
    """Settings in words, with all that is not as shipped."""
    return label(row.settings, trade.shipped.settings)


def priced(trade: Trade, row: Row) -> str:
    """The price in words."""
    if trade.by == "flops":
        return f"{operations(row.flops)} per simulated second"
    return f"{computing(row.cost)} of computing per simulated second"


def _compared(trade: Trade, row: Row) -> str:
    shipped = trade.shipped
    if row is shipped:
        return ", as shipped"
    if math.isnan(trade.price(shipped)):
        return ""
    return f", {trade.price(row) / trade.price(shipped):.2f} times the shipped settings"


def _included(row: Row) -> str:
    """What starts a budget's error is the worst of."""
    tried = row.further
    if tried is None or tried.starts == 0:
        return _confirmed(row)
    return f" {tried.starts} further starts are among them."


def _confirmed(row: Row) -> str:
    """What further starts said."""
    tried = row.further
    if tried is None:
        return " Not tried on further starts."
    if tried.starts == 0:
        return f" Not confirmed: {tried.failure}."
    if tried.held == tried.starts:
        return f" Confirmed on {tried.starts} further starts."
    return f" On {tried.starts} further starts {tried.held} kept to it."
