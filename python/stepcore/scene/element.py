"""`Element`: a record whose fields are checked whenever they are assigned."""

from __future__ import annotations

import copy
import dataclasses
import typing
import weakref
from typing import TYPE_CHECKING, Any, ClassVar

from stepcore import checks

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Self

_CONSTANT = frozenset((str, int, float, bool, tuple, type(None)))

# By class and field: the check, the default, and what the check makes of that.
_CHECKS: dict[type, dict[str, tuple[checks.Check, object, object]]] = {}
# By class: the names of its fields.
_FIELDS: dict[type, tuple[str, ...]] = {}
E = typing.TypeVar("E", bound="Element")
# How often an element has got another name.
_renamed = [0]
# By element, the scene that holds it.
_SCENES: weakref.WeakKeyDictionary[Element, weakref.ref[Any]] = weakref.WeakKeyDictionary()


def renamed() -> int:
    """A number that grows whenever some element gets another name."""
    return _renamed[0]


def belongs(element: Element, scene: Any) -> None:
    """Remembers which scene holds an element: errors call it as the scene does."""
    _SCENES[element] = weakref.ref(scene)


def _named(element: Element, error: checks.ElementError) -> checks.ElementError:
    holder = _SCENES.get(element)
    scene = None if holder is None else holder()
    result: checks.ElementError = error if scene is None else scene._named(error)
    return result


def _checks_of(kind: type[Element]) -> dict[str, tuple[checks.Check, object, object]]:
    """The check of each field of an element class, read once from its annotations."""
    if kind not in _CHECKS:
        hints = typing.get_type_hints(kind, include_extras=True)
        known = {}
        for spec in dataclasses.fields(kind):  # type: ignore[arg-type]
            check, default = hints[spec.name].__metadata__[0], spec.default
            missing = default is dataclasses.MISSING
            checked = None if missing else check(kind.__name__, spec.name, default)
            known[spec.name] = (check, default, checked)
        _CHECKS[kind] = known
    return _CHECKS[kind]


class Element:
    """Base of all elements: checked assignment, a label for messages, a short ``repr``."""

    # Its place in the file that it was read from, "file:line"; set by the reader.
    place: ClassVar[str] = ""

    def __setattr__(self, field: str, value: object) -> None:
        known = _CHECKS.get(type(self)) or _checks_of(type(self))
        if field not in known:
            raise AttributeError(
                f"{self} has no field {checks.quoted(field)}{checks.nearest(field, known)}"
            )
        check, default, checked = known[field]
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
        own = result.__dict__
        for field, value in self.__dict__.items():
            # Numbers, texts and tuples of numbers never change: a copy may share them.
            own[field] = value if type(value) in _CONSTANT else copy.deepcopy(value, memo)
        return result

    def values(self) -> dict[str, Any]:
        """The fields as MJCF's attributes hold them, each under its name."""
        own = self.__dict__
        return {field: own[field] for field in fields_of(type(self))}

    def record(self) -> dict[str, Any]:
        """The fields as plain data, lists for tuples: what the engine is handed."""
        values = self.values().items()
        return {field: list(v) if isinstance(v, tuple) else v for field, v in values}

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


def made(kind: type[E], values: Mapping[str, Any]) -> E:
    """`kind(**values)`, without looking at the fields one by one that keep their defaults."""
    element = object.__new__(kind)
    own = element.__dict__
    for field, (check, default, checked) in (_CHECKS.get(kind) or _checks_of(kind)).items():
        if field in values:
            value = values[field]
            own[field] = checked if value is default else check(element, field, value)
        elif default is dataclasses.MISSING:
            return kind(**values)  # which says what is missing
        else:
            own[field] = checked
    return element


def fields_of(kind: type[Element]) -> tuple[str, ...]:
    """The names of the fields of an element class, in order."""
    if kind not in _FIELDS:
        specs = dataclasses.fields(kind)  # type: ignore[arg-type]
        _FIELDS[kind] = tuple(spec.name for spec in specs)
    return _FIELDS[kind]
