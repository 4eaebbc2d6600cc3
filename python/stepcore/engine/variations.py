"""A model with some of its values changed, compiled; and the values it has."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore import checks
from stepcore.engine.arrays import Floats
from stepcore.engine.compilation import compile_data
from stepcore.scene.elements import Body
from stepcore.scene.records import Variation
from stepcore.scene.value_paths import WHOLE, find

if TYPE_CHECKING:
    from stepcore import _core
    from stepcore.engine.model import Model


class ModelVariation(Variation):
    """A model that is compiled many times with different values of the same paths.

    `data` creates the plain data of a scene, and `compiled` compiles the data.
    """

    def __init__(self, model: Model, paths: Iterable[str]) -> None:
        super().__init__(model.scene, paths, model.masses())

    def compiled(self, data: dict[str, Any] | ValueError) -> _core.Model:
        """Compile `data` on any thread; raise the error if `data` is an error."""
        return compile_data(self.scene, data)


def own_value(model: Model, path: str) -> Floats:
    """Return the model's value of a path, a number or a vector; else raise ValueError."""
    scene = model.scene
    if path in WHOLE:
        return np.asarray(getattr(scene, path), dtype=np.float64)
    element, field = find(scene, path)
    value = getattr(element, field)
    if field == "mass" and isinstance(element, Body) and value is None:
        value = model.body_mass[model.index("body", element.name)]
    table = np.asarray(value if value is not None else 0.0)
    if isinstance(value, bool) or table.dtype.kind not in "fiu" or table.ndim > 1:
        raise ValueError(f"param[{checks.shown(path)}]: its value is no number and no vector")
    return table.astype(np.float64)
