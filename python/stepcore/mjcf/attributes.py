"""Convert MJCF attributes to element fields and back, by the table of the element class."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stepcore.scene.element import Element, table


def given(kind: type[Element], values: Mapping[str, Any], *skip: str) -> dict[str, Any]:
    """Return the fields of an element class that these attributes give, except those in `skip`."""
    fields: dict[str, Any] = {}
    rows = table(kind)
    for name, value in values.items():
        row = rows.get(name)
        if row is None or name in skip or row.type.attribute is None:
            continue
        if row.poly:
            value, *higher = value
            if any(higher):
                fields[row.poly] = tuple(higher)
        elif row.type.read is not None:
            value = row.type.read(value)
        fields[name] = value
    return fields


def changed(element: Element, *skip: str) -> dict[str, Any]:
    """Return the attributes for the fields of an element that differ from their defaults."""
    attributes, rows = {}, table(type(element))
    for name, value in element.values().items():
        row = rows[name]
        if value is not row.checked and name not in skip and value != row.default:
            attributes[name] = value if row.type.write is None else row.type.write(value)
    return attributes
