"""Quantities with units: printing (2 ms, 3.1 µm, 12 %) and parsing ("1mm", "0.1%", "20us/step")."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from decimal import Decimal
from functools import partial

from stepcore import checks

Units = Sequence[tuple[str, float]]

# Units of each quantity, largest first, with their size in the unit used in computations.
TIMES: Units = (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6), ("ns", 1e-9))
LENGTHS: Units = (("km", 1e3), ("m", 1.0), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9), ("pm", 1e-12))
FORCES: Units = (("MN", 1e6), ("kN", 1e3), ("N", 1.0), ("mN", 1e-3), ("µN", 1e-6), ("nN", 1e-9))
TORQUES: Units = tuple((f"{unit}·m", size) for unit, size in FORCES)
ENERGIES: Units = (("kJ", 1e3), ("J", 1.0), ("mJ", 1e-3), ("µJ", 1e-6), ("nJ", 1e-9))
ANGLES: Units = (("rad", 1.0), ("mrad", 1e-3), ("µrad", 1e-6), ("nrad", 1e-9))
FREQUENCIES: Units = (("MHz", 1e6), ("kHz", 1e3), ("Hz", 1.0))
COMPUTING: Units = (("s", 1e6), ("ms", 1e3), ("µs", 1.0))
OPERATIONS: Units = (("Gflop", 1e9), ("Mflop", 1e6), ("kflop", 1e3), ("flop", 1.0))
# Unit names that can follow a number in a text.
NAMES = {
    *("%", "m/s", "rad/s", "1/s"),
    *(
        name
        for units in (TIMES, LENGTHS, FORCES, ENERGIES, ANGLES, FREQUENCIES, OPERATIONS)
        for name, _ in units
    ),
}

# Units of joint and actuator values: of a rotating and of a sliding joint.
FIELDS = {
    "stiffness": ("N·m/rad", "N/m"),
    "kp": ("N·m/rad", "N/m"),
    "damping": ("N·m·s/rad", "N·s/m"),
    "kv": ("N·m·s/rad", "N·s/m"),
    "armature": ("kg·m²", "kg"),
}


def quantity(value: float, units: Units, digits: int = 3) -> str:
    """Format a number in the largest unit in which its absolute value is at least 1."""
    for unit, size in units:
        if abs(value) >= size * (1 - 0.5 * 10**-digits):
            return f"{_plain(value / size, digits)} {unit}"
    plain = next((unit for unit, size in units if size == 1.0), units[0][0])
    if not value or math.isnan(value):
        return f"{value:g} {plain}"
    unit, size = units[-1]
    return f"{value / size:.{digits}g} {unit}"


def _plain(value: float, digits: int) -> str:
    """Return a number of some digits; one below a million without an exponent."""
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e6 else text


# Numbers in a readable unit: a time [s], a speed [m/s], a force [N], an energy [J], an angle [rad],
# a computing time [µs], a count of floating-point operations.
seconds = partial(quantity, units=TIMES)
speed = partial(quantity, units=tuple((f"{unit}/s", size) for unit, size in LENGTHS))
newtons = partial(quantity, units=FORCES)
joules = partial(quantity, units=ENERGIES)
radians = partial(quantity, units=ANGLES)
computing = partial(quantity, units=COMPUTING)
operations = partial(quantity, units=OPERATIONS)


def metres(value: float) -> str:
    """Format a length [m] with a readable unit; "< 1 pm" for rounding errors.

    >>> seconds(0.002), seconds(62.5e-6), metres(1.3e-4), percent(0.034), hertz(6.2831853e4)
    ('2 ms', '62.5 µs', '130 µm', '3.4 %', '10 kHz')
    """
    unit, least = LENGTHS[-1]
    return f"< 1 {unit}" if 0 < value < least else quantity(value, LENGTHS)


def hertz(omega: float) -> str:
    """Format a circular frequency [rad/s] as a frequency with a readable unit."""
    return quantity(omega / (2 * math.pi), FREQUENCIES, 4)


def percent(share: float) -> str:
    """Format a share in per cent: one decimal below 10 %, more digits close to 0 % and 100 %.

    >>> percent(0.5), percent(0.99963), percent(2e-5)
    ('50 %', '99.96 %', '0.002 %')
    """
    value = 100 * share
    near = min(abs(value), abs(100 - value)) if 0 < share < 1 else abs(value)
    if near >= 10 or near == 0 or not math.isfinite(near):
        return f"{value:.0f} %"
    return f"{value:.{max(1, math.ceil(-math.log10(near)))}f} %"


def times(value: float) -> str:
    """Format a factor: 3.4×, 1000×, 1.2e6×."""
    if 100 <= value < 1e5:
        return f"{value:.0f}×"
    return f"{compact(value)}×" if 1e5 <= value < math.inf else f"{value:.3g}×"


def counted(count: int, noun: str) -> str:
    """Return a number with its noun: 1 start, 8 starts, 2 bodies."""
    return f"{count} {noun if count == 1 else plural(noun)}"


def plural(noun: str) -> str:
    """Return the plural of a noun.

    >>> [plural(noun) for noun in ("start", "body", "key", "mesh", "loss")]
    ['starts', 'bodies', 'keys', 'meshes', 'losses']
    """
    if re.search("[^aeiou]y$", noun):
        return noun[:-1] + "ies"
    return noun + ("es" if noun.endswith(("s", "sh")) else "s")


def beginning(text: str, sentences: int = 1) -> str:
    """Return the first sentences of a text, without the last full stop.

    >>> beginning("start 0: diverged at 0.1 s. The cause is spring `a`, 9 %.")
    'start 0: diverged at 0.1 s'
    """
    parts = re.split(r"(?<=\.)\s+(?=[A-Z])", text)
    return " ".join(parts[:sentences]).rstrip(".")


def compact(value: float) -> str:
    """Format a number for a narrow column: two digits, short exponent; 0 for values <= 0."""
    if value <= 0:
        return "0"
    if not math.isfinite(value):
        return f"{value}"
    digits, exponent = f"{value:.1e}".split("e")
    return f"{digits}e{int(exponent)}"


def kind_unit(field: str, angular: bool) -> str:
    """Return the unit of a joint's or an actuator's value; "" for a value without a unit."""
    return FIELDS.get(field, ("", ""))[not angular]


# Parsing of users' input.

NUMBER = r"\s*([0-9]+\.?[0-9]*(?:[eE][+-]?[0-9]+)?|\.[0-9]+(?:[eE][+-]?[0-9]+)?)\s*"
CENTIMETRES = ("cm", 1e-2)
LENGTH_FORMS = 'a length > 0: metres, "1mm", or "0.1%" of the scene\'s size'


def time_of(text: str) -> float | None:
    """Parse a time [s] such as "0.001", "1ms" or "20 us"; return None for other text.

    >>> time_of("20 us"), time_of("1ms"), time_of("2"), time_of("soon")
    (2e-05, 0.001, 2.0, None)
    """
    return _in_units(text, TIMES)


def length_of(text: str) -> float | None:
    """Parse a length [m] such as "0.01" or "1cm"; return None for other text."""
    return _in_units(text, (*LENGTHS, CENTIMETRES))


def frequency_of(text: str) -> float | None:
    """Parse a frequency [Hz] such as "8" or "8Hz"; return None for other text."""
    return _in_units(text, FREQUENCIES)


def _in_units(text: str, units: Units, plain: bool = True) -> float | None:
    """Parse a number with one of these units, "us" as well as "µs"; plain: or without."""
    if plain:
        with suppress(ValueError):
            return float(text)
    match = re.fullmatch(NUMBER + r"(%|[\w·/²°]+)\s*", text)
    sizes = dict(units) | {unit.replace("µ", "u"): size for unit, size in units}
    if match is None or match[2] not in sizes:
        return None
    # Decimals avoid rounding, so that "20us" is exactly the float 2e-05.
    return float(Decimal(match[1]) * Decimal(repr(sizes[match[2]])))


def time(name: str, value: object) -> float:
    """Return a time [s]: a number, or a text such as "1ms"; see `checks.seconds` for its limits.

    name: the argument, for the ValueError.

    >>> time("dt", "2ms"), time("horizon", 3)
    (0.002, 3.0)
    """
    parsed = time_of(value) if isinstance(value, str) else None
    return checks.seconds(name, value if parsed is None else parsed)


def length(owner: str, name: str, value: object, size: float) -> float:
    """Parse a length [m]: a number, "1mm", or "0.1%" of the scene's size.

    owner, name: the function and its argument, for the ValueError. size: the scene's size [m].

    >>> [length("trade", "error", value, 0.5) for value in ("2 mm", "1%", 1e-3)]
    [0.002, 0.005, 0.001]
    """
    result = checks.number(value)
    if result is None and isinstance(value, str):
        result = _in_units(value, (*LENGTHS, CENTIMETRES, ("%", size / 100)))
    if result is None or not 0 < result < math.inf:
        raise checks.refuse(owner, name, value, LENGTH_FORMS)
    return result


# The units of quantities by their SI unit; other units have no prefixes.
PREFIXED: dict[str, Units] = {
    **{"m": (*LENGTHS, CENTIMETRES), "N": FORCES, "N·m": TORQUES, "J": ENERGIES, "s": TIMES},
    "rad": (*ANGLES, ("deg", math.pi / 180), ("°", math.pi / 180)),
    "m/s": tuple((f"{unit}/s", size) for unit, size in LENGTHS),
    "rad/s": (*((f"{unit}/s", size) for unit, size in ANGLES), ("deg/s", math.pi / 180)),
}


def amount(owner: str, name: str, value: object, unit: str, reference: float, words: str) -> float:
    """Parse a quantity with a unit: a number, "2N", or "1%" of a whole.

    owner, name: the function and its argument, for the ValueError. unit: the SI unit; "" for none.
    reference: 100 %, in `words`.

    >>> [amount("trade", "error", value, "rad", 2.0, "its range") for value in ("1%", "2mrad", 1)]
    [0.02, 0.002, 1.0]
    """
    result, prefixes = checks.number(value), PREFIXED.get(unit, ((unit, 1.0),) if unit else ())
    if result is None and isinstance(value, str):
        plain = {name.replace("·", ""): size for name, size in prefixes}
        result = _in_units(value, (*prefixes, *plain.items(), ("%", reference / 100)))
    if result is None or not 0 < result < math.inf:
        forms = f'an amount > 0: a number in {unit}, "1{unit}"' if unit else "a number > 0"
        raise checks.refuse(owner, name, value, f'{forms}, or "1%" of {words}')
    return result


def amount_in(value: float, unit: str) -> str:
    """Format a number of an SI unit with a prefix, where the unit has any.

    >>> amount_in(2e-4, "m"), amount_in(0.5, "N"), amount_in(3.0, "m/s²"), amount_in(0.25, "")
    ('200 µm', '500 mN', '3 m/s²', '0.25')
    """
    if unit == "m":
        return metres(value)
    if unit in PREFIXED:
        prefixed = [(n, s) for n, s in PREFIXED[unit] if not n.startswith(("deg", "°"))]
        return quantity(value, prefixed)
    return f"{value:.3g} {unit}".rstrip()


def budget(owner: str, name: str, value: object, dt: float, by: str) -> float:
    """Parse a cost per simulated second: computing time [µs], or operations with by="flops".

    A plain number has this unit. dt: the scene's time step [s], the step of "/step".

    >>> [budget("trade", "budget", b, 0.002, "time") for b in ("20us/step", "500x", 300)]
    [10000.0, 2000.0, 300.0]
    """
    units = OPERATIONS if by == "flops" else (*COMPUTING, ("ns", 1e-3))
    example = "20kflop" if by == "flops" else "20us"
    limit = f'> 0, with its unit: "{example}/step" or "{example}/s"'
    if by != "flops":
        limit += ', or "100x" for that many times real time'
    result = checks.number(value)
    if result is None and isinstance(value, str):
        amount, _, per = (part.strip() for part in value.partition("/"))
        if per in ("step", "s"):
            cost = _in_units(amount, units, plain=False)
            result = cost and cost / (dt if per == "step" else 1.0)
        elif by != "flops" and (times_real := _in_units(amount, (("x", 1.0),), plain=False)):
            result = 1e6 / times_real
    if result is None or not 0 < result < math.inf:
        raise checks.refuse(owner, name, value, limit)
    return result


def rounded(value: float, digits: int = 3, *, up: bool | None = None) -> float:
    """Return a number rounded to some digits; upwards or downwards a number >= 0.

    >>> rounded(1234.5), rounded(1236.0, up=False), rounded(0.0012341, 2, up=True)
    (1230.0, 1230.0, 0.0013)
    """
    if up is None:
        return float(f"{value:.{digits}g}")
    if value <= 0 or not math.isfinite(value):
        return max(value, 0.0)
    place = math.floor(math.log10(value)) - digits + 1
    # Through text, because the power of ten of a small number would overflow.
    count = float(f"{value:.16e}".split("e")[0]) * 10.0 ** (digits - 1)
    # A number with as many digits already is kept.
    mantissa = round(count)
    if not math.isclose(count, mantissa, rel_tol=1e-9):
        mantissa = math.ceil(count) if up else math.floor(count)
    return float(f"{mantissa}e{place}")


def round_number(value: float, *, up: bool) -> float:
    """Return the next of 1, 2 and 5 times a power of ten, upwards or downwards; value: > 0.

    >>> round_number(0.00071, up=False), round_number(0.0199, up=True), round_number(0.001, up=True)
    (0.0005, 0.02, 0.001)
    """
    place = math.floor(math.log10(value) + 1e-9)
    steps = [float(f"{k}e{place}") for k in (1, 2, 5, 10)]
    if up:
        return min(step for step in steps if step >= value * (1 - 1e-9))
    return max(step for step in steps if step <= value * (1 + 1e-9))
