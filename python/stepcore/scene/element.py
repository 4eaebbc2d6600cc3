"""`Element`: a record whose fields are checked on every assignment.

The annotations of an element class are the table of its attributes (`field_rows`). The MJCF reader
and writer, value paths, the records for the engine, the types of keyword arguments and
docs/mjcf_attributes.md all follow from this table.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import typing
import weakref
from typing import TYPE_CHECKING, Any, ClassVar

from stepcore import checks

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Self

_CONSTANT = frozenset((str, int, float, bool, tuple, type(None)))


@dataclasses.dataclass(frozen=True)
class FieldType:
    """The type of a field.

    check: converts an assigned value to the stored value, or raises.
    annotation: the type of assigned values, for type checkers; "" for a reference.
    attribute: the notation of MJCF's attribute (`stepcore.mjcf.schema`); None if MJCF has none.
    read, write: convert the value of an MJCF attribute to the value of the field, and back.
    refers: the classes of elements that the field refers to.
    """

    check: checks.Check
    annotation: str
    attribute: str | None = None
    read: Callable[[Any], Any] | None = None
    write: Callable[[Any], Any] | None = None
    refers: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Row:
    """A field of an element class, as a row of the table.

    unit: "" for a pure number and for other types than numbers.
    checked: the default as the check returns it.
    poly: the field with the higher coefficients of the same polynomial, or "".
    """

    name: str
    type: FieldType
    unit: str
    default: Any
    checked: Any
    poly: str = ""


class Places(typing.Protocol):
    """The indices of a scene's elements in the compiled model; `Layout` implements it."""

    bodies: list[Any]

    def place(self, element: Element) -> int | None: ...

    def needed(self, owner: Element | str, element: Element) -> int: ...


_TABLES: dict[type, dict[str, Row]] = {}
# For each class and field: the check, the default, and the default as the check returns it.
_CHECKS: dict[type, dict[str, tuple[checks.Check, object, object]]] = {}
E = typing.TypeVar("E", bound="Element")
# The number of renamings.
_renamed = [0]
# The scene of each element.
_SCENES: weakref.WeakKeyDictionary[Element, weakref.ref[Any]] = weakref.WeakKeyDictionary()


def renamed() -> int:
    """Return a counter that grows with every renaming of an element."""
    return _renamed[0]


def belongs(element: Element, scene: Any) -> None:
    """Register the scene of an element, so that errors name the element as the scene does."""
    _SCENES[element] = weakref.ref(scene)


def _named(element: Element, error: checks.ElementError) -> checks.ElementError:
    holder = _SCENES.get(element)
    scene = None if holder is None else holder()
    result: checks.ElementError = error if scene is None else scene._named(error)
    return result


def field_rows(kind: type[Element]) -> dict[str, Row]:
    """Return the fields of an element class by name, in order."""
    if kind not in _TABLES:
        hints = typing.get_type_hints(kind, include_extras=True)
        rows = {}
        for spec in dataclasses.fields(kind):  # type: ignore[arg-type]
            hint, *unit = hints[spec.name].__metadata__
            missing = spec.default is dataclasses.MISSING
            checked = None if missing else hint.check(kind.__name__, spec.name, spec.default)
            poly = f"{spec.name}poly" if f"{spec.name}poly" in hints else ""
            rows[spec.name] = Row(spec.name, hint, "".join(unit), spec.default, checked, poly)
        _TABLES[kind] = rows
        _CHECKS[kind] = {n: (row.type.check, row.default, row.checked) for n, row in rows.items()}
    return _TABLES[kind]


def _checks_of(kind: type[Element]) -> dict[str, tuple[checks.Check, object, object]]:
    if kind not in _CHECKS:
        field_rows(kind)
    return _CHECKS[kind]


# Fields whose name in the engine is not MJCF's.
ENGINE_NAMES = {
    **{"type": "kind", "ref": "reference", "shellinertia": "shell_inertia", "sidesite": "side"},
    **{"inertiafromgeom": "from_geoms", "inertiagrouprange": "group_range"},
    **{"boundmass": "bound_mass", "boundinertia": "bound_inertia"},
    **{"balanceinertia": "balance_inertia", "settotalmass": "total_mass", "fitaabb": "fit_aabb"},
}


class Element:
    """Base class of all elements: checked assignment, a label for messages, a short ``repr``."""

    # "file:line" in the source file; set by the reader.
    place: ClassVar[str] = ""

    def __setattr__(self, field: str, value: object) -> None:
        field_checks = _CHECKS.get(type(self)) or _checks_of(type(self))
        if field not in field_checks:
            raise AttributeError(
                f"{self} has no field {checks.quoted(field)}{checks.nearest(field, field_checks)}"
            )
        check, default, checked = field_checks[field]
        if value is not default:
            try:
                checked = check(self, field, value)
            except checks.ElementError as error:
                raise _named(self, error) from None
        if field == "name" and "name" in self.__dict__:
            _renamed[0] += 1
        object.__setattr__(self, field, checked)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        result = object.__new__(type(self))
        memo[id(self)] = result
        attributes = result.__dict__
        for field, value in self.__dict__.items():
            # Numbers, strings and tuples of numbers are immutable: copies can share them.
            attributes[field] = value if type(value) in _CONSTANT else copy.deepcopy(value, memo)
        return result

    def values(self) -> dict[str, Any]:
        """Return the fields by name, with values as in MJCF's attributes.

        The coefficients of a polynomial form one tuple if any beyond the first differs from 0.
        """
        attributes, values = self.__dict__, {}
        for name, poly in _value_plan(type(self)):  # type: ignore[arg-type]
            value = attributes[name]
            values[name] = (value, *attributes[poly]) if poly and any(attributes[poly]) else value
        return values

    def record(self, *skip: str) -> dict[str, Any]:
        """Return the fields as the engine reads them, except those to `skip`.

        Tuples become lists, the coefficients of a polynomial become one list, and each pair of
        solref and solimp becomes a dict.
        """
        attributes, record = self.__dict__, {}
        for name, engine_name, poly, solimp in _record_plan(type(self), skip):  # type: ignore[arg-type]
            value = attributes[name]
            if poly:
                value = [value, *attributes[poly]]
            elif solimp:
                value = {"solref": list(value), "solimp": list(attributes[solimp])}
            elif type(value) is tuple:
                value = list(value)
            record[engine_name] = value
        return record

    def plain(self, places: Places) -> dict[str, Any]:
        """Return the element as the engine reads it: its record, with indices for references.

        The index of an element that is not in the scene is −1.
        """
        ends = _references(type(self))  # type: ignore[arg-type]
        record = self.record(*ends)
        for name in ends:
            end = self.__dict__[name]
            record[name] = None if end is None else place_of(places, end)
        return record

    def check(self, places: Places) -> None:
        """Raise ElementError if the element contradicts itself or the scene."""

    def __str__(self) -> str:
        kind = type(self).__name__.lower()
        name = self.__dict__.get("name", "")
        if name:
            return f'{kind} "{name}"'
        body = self.__dict__.get("body")
        return f"unnamed {kind}" + (f" of {body}" if body is not None else "")

    def __repr__(self) -> str:
        parts = []
        for spec in dataclasses.fields(self):  # type: ignore[arg-type]
            value = self.__dict__.get(spec.name)
            if isinstance(value, Element):
                parts.append(f"{spec.name}=<{value}>")
            elif value != spec.default:
                parts.append(f"{spec.name}={value!r}")
        return f"{type(self).__name__}({', '.join(parts)})"


@functools.cache
def _value_plan(kind: type[Element]) -> list[tuple[str, str]]:
    """Return (field, field of its higher coefficients or "") for `Element.values`."""
    rows = field_rows(kind)
    higher = {row.poly for row in rows.values()}
    return [(name, row.poly) for name, row in rows.items() if name not in higher]


@functools.cache
def _record_plan(kind: type[Element], skip: tuple[str, ...]) -> list[tuple[str, str, str, str]]:
    """Return (field, engine's name, higher coefficients or "", solimp or "") for a record."""
    rows = field_rows(kind)
    plan, inside = [], {*skip, *(row.poly for row in rows.values())}
    for name, row in rows.items():
        solimp = name.replace("solref", "solimp") if name.startswith("solref") else ""
        if name in inside:
            continue
        if solimp in rows:
            inside.add(solimp)
            plan.append((name, name.removeprefix("solref") or "soft", "", solimp))
        else:
            plan.append((name, ENGINE_NAMES.get(name, name), row.poly, ""))
    return plan


@functools.cache
def _references(kind: type[Element]) -> tuple[str, ...]:
    return tuple(name for name, row in field_rows(kind).items() if row.type.refers)


def place_of(places: Places, element: Element) -> int:
    """Return the index of an element in the list of its kind; −1 if it is not in the scene."""
    place = places.place(element)
    return -1 if place is None else place


def make_element(kind: type[E], values: Mapping[str, Any]) -> E:
    """Return `kind(**values)`, faster: fields that keep their defaults are not checked again."""
    element = object.__new__(kind)
    attributes = element.__dict__
    for field, (check, default, checked) in (_CHECKS.get(kind) or _checks_of(kind)).items():
        if field in values:
            value = values[field]
            attributes[field] = checked if value is default else check(element, field, value)
        elif default is dataclasses.MISSING:
            return kind(**values)  # Raises a TypeError that names the missing field.
        else:
            attributes[field] = checked
    return element
