"""The types of the keywords of `Scene.add_joint` and its like, from the tables of the elements.

    python benches/keyword_types.py

Writes python/stepcore/scene/fields.pyi, which editors and type checkers read.
"""

from __future__ import annotations

import inspect
from pathlib import Path

from stepcore import Scene
from stepcore.scene import elements
from stepcore.scene.element import Row, field_rows

STUB = Path(__file__).parent.parent / "python" / "stepcore" / "scene" / "fields.pyi"
KINDS = (
    *("Body", "Joint", "Geom", "Mesh", "Site", "Sensor", "Tendon", "Actuator", "Equality", "Pair"),
    "Key",
)
HEAD = '''"""The keyword fields of `Scene.add_joint` and its like: python benches/keyword_types.py.

What each means stands in `stepcore.scene.elements`.
"""

from collections.abc import Sequence
from typing import Any, TypedDict

from numpy.typing import NDArray

from stepcore.scene.elements import Actuator, Body, Joint, Site, Tendon

# What is checked when it is assigned: one number stands for a first entry where that is said.
Vector = Sequence[float] | NDArray[Any]
Numbers = float | Vector
'''


def given(row: Row) -> str:
    """The type of what is given for a field; for a reference a name, or the element."""
    return row.type.annotation or " | ".join(("str", *row.type.refers, "None"))


def text() -> str:
    """The text of the stub."""
    parts = [HEAD]
    for kind in KINDS:
        named = inspect.signature(getattr(Scene, f"add_{kind.lower()}")).parameters
        rows = field_rows(getattr(elements, kind)).values()
        lines = [f"    {row.name}: {given(row)}" for row in rows if row.name not in named]
        parts.append("\n".join([f"class {kind}Fields(TypedDict, total=False):", *lines, ""]))
    return "\n".join(parts)


if __name__ == "__main__":
    STUB.write_text(text())
