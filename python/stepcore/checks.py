"""Checks of values that a user gives: they convert a value to its type, or raise an error.

A *check* takes ``(owner, field, value)`` and returns the value to store. It raises a `ValueError`
that names the element, the field, the value and the limit.
"""

from __future__ import annotations

import difflib
import inspect
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from typing import Any

from stepcore import escapes

Check = Callable[[Any, str, Any], Any]

# Below this length a direction or a quaternion has no meaning (MuJoCo's threshold).
TINY_LENGTH = 1e-14
# Largest length of an error text, for any file or argument [characters].
LONGEST_TEXT = 1000
# Largest length of a name, and of a word or path, in an error [characters].
LONGEST_NAME, LONGEST_WORD = 80, 300


def shown(value: object, width: int = 80) -> str:
    """Return ``repr`` of a value on one line, cut to `width` characters."""
    return cut(" ".join(repr(value).split()), width)


def cut(text: str, width: int = LONGEST_TEXT) -> str:
    """Return the text, escaped for one line and cut to `width` characters."""
    text = escapes.escaped(text[: width + 1])
    return text if len(text) <= width else text[: width - 1] + "…"


_NAME = re.compile(rf'"[^"\n]{{{LONGEST_NAME + 1},}}"')
_WORD = re.compile(rf"\S{{{LONGEST_WORD + 1},}}")


def brief(text: str) -> str:
    """Return an error text without the middle of long names, at most `LONGEST_TEXT` characters.

    Names come first in an error, so names are shortened before the text is cut. Every error about a
    file or an element passes through this function.
    """

    def shortened(match: re.Match[str]) -> str:
        word = match.group()
        name = word[0] == '"' and "/" not in word and os.sep not in word
        return without_middle(word, LONGEST_NAME if name else LONGEST_WORD)

    return cut(_WORD.sub(shortened, _NAME.sub(shortened, text)))


def without_middle(word: str, width: int = LONGEST_WORD) -> str:
    """Return a word of at most `width` characters, without the middle of a longer word."""
    half = width // 2
    return word if len(word) <= width else f"{word[: half - 1]}…{word[-half:]}"


def quoted(name: str) -> str:
    """Return a user's name in quotation marks, cut to fit into a sentence."""
    return f'"{cut(name, 80)}"'


def nearest(name: str, choices: Iterable[str], limit: int = 10) -> str:
    """Return '; nearest: "damping"', or the first `limit` of the names if none is near."""
    names = [k for k in choices if k]
    # Case is ignored, so that "rk4" is near "RK4".
    folded = {k.lower(): k for k in reversed(names)}
    # Cut, because the time of the comparison grows with the square of the length.
    matches = difflib.get_close_matches(cut(name, 200).lower(), folded, n=3, cutoff=0.5)
    close = [folded[k] for k in matches]
    if close:
        return "; nearest: " + ", ".join(quoted(c) for c in close)
    if not limit:
        return ""
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return "; known: " + (", ".join(quoted(n) for n in names[:limit]) or "none") + more


def one_line(error: BaseException) -> str:
    """Return the text of an error on one line without a full stop, for use in a sentence."""
    return " ".join(str(error).split()).removesuffix(".") or type(error).__name__


class KnownNames:
    """Base class that raises AttributeError when an unknown attribute is assigned.

    Without this check, a misspelt name would be stored and never read.
    """

    _attributes: tuple[str, ...] = ()

    def __setattr__(self, name: str, value: object) -> None:
        kind = type(self)
        if not name.startswith("_") and name not in self._attributes and not hasattr(kind, name):
            names = [*self._attributes, *(n for n in dir(kind) if not n.startswith("_"))]
            raise AttributeError(f"a {kind.__name__} has no {quoted(name)}{nearest(name, names)}")
        if isinstance(getattr(kind, name, None), cached_property):
            raise AttributeError(f"{name} of a {kind.__name__} is read-only")
        object.__setattr__(self, name, value)


class ElementError(ValueError):
    """An error about an element of a scene, `owner`."""

    def __init__(self, owner: object, text: str) -> None:
        super().__init__(f"{cut(brief(str(owner)), 200)}: {brief(text)}")
        self.owner = owner
        self.text = text

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self.owner), self.text)


def refuse(owner: Any, field: str, value: object, limit: str) -> ElementError:
    """Return the error for a bad value of a field; the caller raises it."""
    return ElementError(owner, f"{field} = {shown(value)}: must be {limit}")


def number(value: object) -> float | None:
    """Return `value` as a finite float, or None."""
    if type(value) is float:
        return value if math.isfinite(value) else None
    if isinstance(value, (str, bytes, bool, complex)) or value is None:
        return None
    # Arrays with dimensions and complex numpy numbers are refused.
    if getattr(value, "ndim", False) or getattr(getattr(value, "dtype", None), "kind", "") == "c":
        return None
    try:
        result = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return None
    return result if math.isfinite(result) else None


def as_list(value: object) -> list[Any] | None:
    """Return the entries of a sequence or an array, or None for other values."""
    if isinstance(value, (str, bytes, dict, set)) or value is None:
        return None
    try:
        return [*value]  # type: ignore[misc]
    except TypeError:
        return None


def all_numbers(entries: Iterable[object] | None) -> tuple[float, ...] | None:
    """Return the entries as finite floats, or None if an entry is no finite number."""
    result = tuple(number(entry) for entry in entries or ())
    return None if entries is None or None in result else result  # type: ignore[return-value]


# Arguments of calls.


def count(name: str, value: object, least: int = 1, most: int = 10**9) -> int:
    """Return `value` as a whole number from `least` to `most`; raise ValueError otherwise."""
    result = number(value)
    if result is None or result != int(result) or not least <= result <= most:
        beyond = result is not None and result > most
        limit = f"from {least} to {most:g}" if beyond else f">= {least}"
        raise ValueError(f"{name} = {shown(value)}: must be a whole number {limit}")
    return int(result)


# About 30 million years: a longer time is a mistake, and its square may overflow.
LONGEST_TIME = 1e15


def seconds(name: str, value: object) -> float:
    """Return `value` as a time > 0 [s], at most `LONGEST_TIME`; raise ValueError otherwise."""
    result = number(value)
    if result is None or result <= 0:
        raise ValueError(f"{name} = {shown(value)}: must be a finite number of seconds > 0")
    if result > LONGEST_TIME:
        raise ValueError(f"{name} = {shown(value)}: must be at most {LONGEST_TIME:g} s")
    return result


# Largest number of steps of a run: every step is recorded, and longer runs are mistakes.
MOST_STEPS = 1e9


def steps(horizon: float, dt: float, runs: float, words: str, most: float = MOST_STEPS) -> None:
    """Raise ValueError if runs over the horizon [s] need more than `most` steps in all."""
    total = horizon / dt * runs
    if not total <= most:
        text = f"horizon = {horizon:g} s with dt = {dt:g} s: {words} would take {total:.2g} steps"
        raise ValueError(f"{text}; must be at most {most:g}".replace("e+0", "e").replace("e+", "e"))


def flag_of(name: str, value: object) -> bool:
    """Return `value` as a bool; raise ValueError unless it is True or False."""
    result = _flag(value)
    if result is None:
        raise ValueError(f"{name} = {shown(value)}: must be True or False")
    return result


def word(name: str, value: object) -> str:
    """Return `value`; raise ValueError unless it is a string."""
    if not isinstance(value, str):
        raise ValueError(f"{name} = {shown(value)}: must be a string")
    return value


def nonempty(name: str, value: object) -> list[Any]:
    """Return `value` as a non-empty list; raise ValueError otherwise, also for a string."""
    entries = as_list(value)
    if not entries:
        raise ValueError(f"{name} = {shown(value)}: must be a list of at least one value")
    return entries


def mapping(name: str, value: object, entries: str) -> Mapping[Any, Any]:
    """Return `value`, a dict of such entries; raise ValueError otherwise."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} = {shown(value)}: must be a dict of {entries}")
    return value


def threads(value: object) -> int:
    """Return `value` as a number of threads; None means one thread per core."""
    return os.cpu_count() or 1 if value is None else count("threads", value)


# Checks of fields.


def checked(convert: Callable[[Any], Any], limit: str) -> Check:
    """Return a check that stores `convert(value)`, and refuses the value if that is None."""

    def check(owner: Any, field: str, value: object) -> Any:
        result = convert(value)
        if result is None:
            raise refuse(owner, field, value, limit)
        return result

    return check


def _flag(value: object) -> bool | None:
    # numpy's bool is no Python bool; the name of its type identifies it without numpy.
    is_flag = isinstance(value, bool) or type(value).__name__ in ("bool_", "bool")
    return bool(value) if is_flag else None


# True or False; 0 and 1 are refused.
flag = checked(_flag, "True or False")
text = checked(lambda value: value if isinstance(value, str) else None, "a string")
# Finite numbers, any number of them.
numbers = checked(lambda value: all_numbers(as_list(value)), "finite numbers")


def real(low: float = -math.inf, above: float = -math.inf, high: float = math.inf) -> Check:
    """Return a check for a finite number in [low, high] and greater than `above`."""
    bounds = [f">= {low:g}"] * (low > -math.inf) + [f"> {above:g}"] * (above > -math.inf)
    bounds += [f"<= {high:g}"] * (high < math.inf)
    limit = " ".join(["a finite number", *[" and ".join(bounds)] * bool(bounds)])

    def convert(value: object) -> float | None:
        result = number(value)
        fits = result is not None and low <= result <= high and result > above
        return result if fits else None

    return checked(convert, limit)


def whole(low: int, high: int) -> Check:
    """Return a check for a whole number in [low, high]."""

    def convert(value: object) -> int | None:
        result = number(value)
        fits = result is not None and result == int(result) and low <= result <= high
        return int(result) if fits else None  # type: ignore[arg-type]

    return checked(convert, f"a whole number from {low} to {high}")


def one_of(*allowed: object) -> Check:
    """Return a check for one of these values."""

    def check(owner: Any, field: str, value: object) -> object:
        for candidate in allowed:
            if type(value) is type(candidate) and value == candidate:
                return candidate
            if type(candidate) is int and number(value) == candidate:
                return candidate
        near = ""
        if isinstance(value, str):
            near = nearest(value, [a for a in allowed if isinstance(a, str)], limit=0)
        raise refuse(owner, field, value, f"one of {', '.join(map(shown, allowed))}{near}")

    return check


def vector(count: int, *, low: float = -math.inf, fill: tuple[float, ...] = ()) -> Check:
    """Return a check for `count` finite numbers >= `low`.

    With `fill`, a single number or a shorter sequence is allowed; the rest comes from `fill`.
    """
    least = 1 if fill else count
    limit = f"{count} finite numbers" if not fill else f"1 to {count} finite numbers"
    limit += f" >= {low:g}" * (low > -math.inf)

    def convert(value: object) -> tuple[float, ...] | None:
        entries = as_list(value)
        result = all_numbers([value] if entries is None and fill else entries)
        if result is None or not least <= len(result) <= count or min(result, default=low) < low:
            return None
        return result + fill[len(result) :]

    return checked(convert, limit)


def unit(count: int) -> Check:
    """Return a check for `count` finite numbers, not all zero; the result has length 1."""
    check_numbers = vector(count)

    def check(owner: Any, field: str, value: object) -> tuple[float, ...]:
        entries: tuple[float, ...] = check_numbers(owner, field, value)
        norm = math.hypot(*entries)
        if not TINY_LENGTH < norm < math.inf:
            raise refuse(owner, field, value, f"{count} finite numbers, not all zero")
        # A unit vector stays bit-identical, so that writing and reading a scene is exact.
        if abs(norm - 1.0) <= 1e-15:
            return entries
        return tuple(entry / norm for entry in entries)

    return check


def pose(owner: Any, field: str, value: object) -> tuple[float, ...]:
    """Check for a position and a quaternion, 7 finite numbers; normalise the quaternion."""
    entries: tuple[float, ...] = vector(7)(owner, field, value)
    return entries[:3] + tuple(unit(4)(owner, f"{field}[3:]", entries[3:]))


def pair(fits: Callable[[float, float], bool], limit: str) -> Check:
    """Return a check for two finite numbers that fit."""

    def convert(value: object) -> tuple[float, ...] | None:
        entries = all_numbers(as_list(value)) or ()
        return entries if len(entries) == 2 and fits(*entries) else None

    return checked(convert, limit)


_SMALLER = "two finite numbers, the first smaller"
interval = pair(lambda low, high: low < high, _SMALLER)
interval_or_zero = pair(lambda low, high: low < high or low == high == 0, _SMALLER)
# Time constants [s] and damping ratios, or minus stiffnesses and minus dampings.
solref = pair(
    lambda time, ratio: (time > 0) == (ratio > 0),
    "(time constant, damping ratio) both > 0, or (-stiffness, -damping) both <= 0",
)
solreffriction = pair(
    lambda time, ratio: ratio >= 0 if time > 0 else ratio <= 0,
    "time constant > 0 and damping ratio >= 0, or -stiffness and -damping, both <= 0",
)


def table(columns: int | None, *, indices: bool = False) -> Check:
    """Return a check for an array of finite numbers, shape (n, columns); the result is read-only.

    columns: None allows any width. A flat sequence is cut into rows.
    indices: True requires indices, whole numbers >= 0.
    """
    entries = "indices (whole numbers >= 0)" if indices else "finite numbers"
    limit = f"{entries}, shape (n, {columns})" if columns else f"{entries}, shape (rows, columns)"

    def check(owner: Any, field: str, value: object) -> Any:
        import numpy as np

        try:
            raw = np.asarray(value)
            array = np.array(raw if raw.dtype.kind in "iuf" else math.nan, dtype=float)
        except (TypeError, ValueError):
            array = np.array(math.nan)
        if columns and array.ndim == 1 and array.size % columns == 0:
            array = array.reshape(-1, columns)
        fits = array.ndim == 2 and columns in (None, array.shape[1]) and np.isfinite(array).all()
        # A float represents whole numbers exactly up to 53 bits.
        if fits and indices:
            fits = ((array == np.floor(array)) & (array >= 0) & (array < 2**53)).all()
        if not fits:
            raise refuse(owner, field, value, limit)
        array = array.astype(np.uintp) if indices else array
        array.flags.writeable = False
        return array

    return check


def most_vertices(owner: Any, field: str, value: object) -> int:
    """Check for the largest number of vertices of a convex hull; -1 means no limit."""
    result: int = whole(-1, 2**31 - 1)(owner, field, value)
    if -1 < result < 4:
        raise refuse(owner, field, value, "larger than 3, or -1 for any number")
    return result


def optional(check: Check) -> Check:
    """Return a check that also allows None."""

    def check_optional(owner: Any, field: str, value: object) -> Any:
        return None if value is None else check(owner, field, value)

    return check_optional


def element(*kinds: str) -> Check:
    """Return a check for a scene element of one of these classes."""

    limit = "a " + " or ".join(kinds)
    return checked(lambda value: value if type(value).__name__ in kinds else None, limit)


def _inertia(value: object) -> tuple[float, ...] | None:
    result = all_numbers(as_list(value)) or ()
    fits = len(result) in (3, 6) and min(result[:3]) >= 0
    return result + (0.0,) * (6 - len(result)) if fits else None


inertia = checked(_inertia, "3 or 6 finite numbers (xx yy zz xy xz yz), the first three >= 0")


def whole_pair(owner: Any, field: str, value: object) -> tuple[int, ...]:
    """Check for two whole numbers."""
    check = whole(-(2**31), 2**31 - 1)
    return tuple(check(owner, field, entry) for entry in vector(2)(owner, field, value))


def function(*arguments: str) -> Check:
    """Return a check for a function that can be called with these arguments."""
    limit = f"a function of ({', '.join(arguments)})"

    def check(owner: Any, field: str, value: object) -> object:
        if not callable(value):
            raise refuse(owner, field, value, limit)
        try:
            inspect.signature(value).bind(*arguments)
        except TypeError:
            raise refuse(owner, field, value, limit) from None
        except ValueError:
            # Some functions written in C have no signature, so they are accepted.
            pass
        return value

    return check


def progress(owner: Any, value: object) -> None:
    """Raise ElementError unless `value` is a valid argument `progress`."""
    if callable(value):
        function("label", "done", "total")(owner, "progress", value)
    elif value is not None and not isinstance(value, bool):
        raise refuse(owner, "progress", value, "True, False, None or a function")
