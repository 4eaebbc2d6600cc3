"""`Element`: a record whose fields are checked whenever they are assigned."""

from __future__ import annotations

import dataclasses
import typing
from typing import Any, ClassVar

from stepcore import checks

_CHECKS: dict[type, dict[str, checks.Check]] = {}


def _checks_of(kind: type[Element]) -> dict[str, checks.Check]:
    """The check of each field of an element class, read once from its annotations."""
    if kind not in _CHECKS:
        hints = typing.get_type_hints(kind, include_extras=True)
        _CHECKS[kind] = {field: hints[field].__metadata__[0] for field in fields_of(kind)}
    return _CHECKS[kind]


class Element:
    """Base of all elements: checked assignment, a label for messages, a short ``repr``."""

    # Its place in the file that it was read from, "file:line"; set by the reader.
    place: ClassVar[str] = ""

    def __setattr__(self, field: str, value: object) -> None:
        known = _checks_of(type(self))
        if field not in known:
            raise AttributeError(
                f"{self} has no field {checks.quoted(field)}{checks.nearest(field, known)}"
            )
        object.__setattr__(self, field, known[field](self, field, value))

    def values(self) -> dict[str, Any]:
        """The fields as MJCF's attributes hold them, each under its name."""
        return {field: getattr(self, field) for field in fields_of(type(self))}

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


def fields_of(kind: type[Element]) -> list[str]:
    """The names of the fields of an element class, in order."""
    return [spec.name for spec in dataclasses.fields(kind)]  # type: ignore[arg-type]
