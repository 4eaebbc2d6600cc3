"""Lengths, shares and tables of numbers as `converge` prints them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from stepcore.report.table import Table
from stepcore.report.units import metres

# Convergence rates below this are rounding.
NO_RATE = 1e-12


def length(value: float, size: float) -> str:
    """Return a length in words; lengths that are rounding are given as a bound."""
    least = 1e-12 * size
    return metres(value) if value >= least else f"less than {metres(least)}"


def share(value: float) -> str:
    """Return a share with enough digits to distinguish a number near 1 from 1."""
    if value <= NO_RATE:
        return "nothing"
    if value < 1e-3:
        return f"{value:.1e}"
    digits = 4 if value < 0.99 else 2 + math.ceil(-math.log10(max(1 - value, 1e-12)))
    return f"{value:.{digits}f}"


def numbers(records: Iterable[dict[str, Any]], heading: str) -> Table:
    """Return a table without empty columns; errors have two digits."""
    rows = list(records)
    columns = [n for n in rows[0] if any(r[n] not in (None, "") for r in rows)]
    short = ("residual", "error", "overlap", "joint", "updates")
    formats = dict.fromkeys(short, ".2e") | {"contraction": ".4f"}
    return Table(rows, columns, formats, heading=heading)
