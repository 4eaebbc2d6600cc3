"""Times and lengths as people read them."""

from __future__ import annotations

from collections.abc import Sequence


def seconds(value: float) -> str:
    """A time with the unit that makes it readable."""
    return quantity(value, (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6), ("ns", 1e-9)))


def metres(value: float) -> str:
    """A length with the unit that makes it readable."""
    units = (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9), ("pm", 1e-12))
    return quantity(value, units)


def quantity(value: float, units: Sequence[tuple[str, float]], digits: int = 3) -> str:
    """A number in the largest unit that leaves it at least 1, as it is printed."""
    for unit, size in units:
        if abs(value) >= size * (1 - 0.5 * 10**-digits):
            return f"{value / size:.{digits}g} {unit}"
    unit, size = units[-1]
    return f"{value / size:.{digits}g} {unit}" if value else f"0 {units[0][0]}"


def length(value: float) -> str:
    """An error as a length; below 1 pm it is rounding, and exactly 0 is said so."""
    if 0 < value < 1e-12:
        return "< 1 pm"
    return "0" if value == 0 else metres(value)


def percent(share: float) -> str:
    """A share in percent, with a decimal where it is small."""
    return f"{100 * share:.1f} %" if abs(share) < 0.1 else f"{100 * share:.0f} %"
