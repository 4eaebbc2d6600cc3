"""Fields of elements from MJCF's attributes, and back, by the table of their class."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stepcore.scene.element import Element, table


def given(kind: type[Element], values: Mapping[str, Any], *skip: str) -> dict[str, Any]:
    """The fields of an element class that these attributes give, but for those to `skip`."""
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
    """The attributes of an element whose fields differ from their defaults."""
    attributes, rows = {}, table(type(element))
    for name, value in element.values().items():
        row = rows[name]
        if value is not row.checked and name not in skip and value != row.default:
            attributes[name] = value if row.type.write is None else row.type.write(value)
    return attributes
