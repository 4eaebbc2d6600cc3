"""What users write for an error and for a budget, as numbers."""

from __future__ import annotations

import math
import re

from stepcore import checks

LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "nm": 1e-9}
TIMES = {"s": 1e6, "ms": 1e3, "us": 1.0, "µs": 1.0, "ns": 1e-3}
WORK = {"flop": 1.0, "kflop": 1e3, "Mflop": 1e6, "Gflop": 1e9}
NUMBER = r"\s*([0-9.]+(?:[eE][+-]?[0-9]+)?)\s*"


def length(value: object, size: float) -> float:
    """An error [m]: a number, "1mm", or "0.1%" of the scene's size [m].

    >>> length("2 mm", 0.5), length("1%", 0.5), length(1e-3, 0.5)
    (0.002, 0.005, 0.001)
    """
    limit = 'a length > 0: metres, "1mm", or "0.1%" of the scene\'s size'
    found = checks.number(value)
    if found is None and isinstance(value, str):
        match = re.fullmatch(NUMBER + r"(%|\w*)", value)
        unit = match[2] if match else "?"
        scale = size / 100 if unit == "%" else LENGTHS.get(unit or "m")
        if match is not None and scale is not None:
            found = _plain(match[1]) * scale
    if found is None or not 0 < found < math.inf:
        raise checks.refuse("trade", "error", value, limit)
    return found


def price(value: object, dt: float, by: str) -> float:
    """A budget per simulated second: µs of computing, or operations where `by` is "flops".

    dt: the shipped time step [s], the step of "/step".

    >>> price("20us/step", 0.002, "time"), price("500x", 0.002, "time"), price(300, 0.002, "time")
    (10000.0, 2000.0, 300.0)
    """
    units = WORK if by == "flops" else TIMES
    limit = f'> 0: a number, or as "20{"kflop" if by == "flops" else "us"}/step" or "/s"'
    if by != "flops":
        limit += ', or "100x" for that many times real time'
    found = checks.number(value)
    if found is None and isinstance(value, str):
        found = _priced(value, units, dt)
    if found is None or not 0 < found < math.inf:
        raise checks.refuse("trade", "budget", value, limit)
    return found


def _priced(text: str, units: dict[str, float], dt: float) -> float | None:
    match = re.fullmatch(NUMBER + r"x", text)
    if match is not None and units is TIMES:
        times = _plain(match[1])
        return 1e6 / times if times > 0 else None
    match = re.fullmatch(NUMBER + r"(\w+)\s*/\s*(step|s)", text)
    if match is None or match[2] not in units:
        return None
    return _plain(match[1]) * units[match[2]] / (dt if match[3] == "step" else 1.0)


def _plain(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
