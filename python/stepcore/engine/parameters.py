"""Values of a model that differ from world to world of a `Batch`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore.engine.arrays import Floats, numbers
from stepcore.engine.compilation import compile_data
from stepcore.engine.model import Model
from stepcore.scene.elements import Body
from stepcore.scene.records import Variation
from stepcore.scene.value_paths import WHOLE, find

if TYPE_CHECKING:
    from stepcore import _core


class ModelVariation(Variation):
    """A model compiled many times with other values of the same paths, as `with_values` does.

    `data` makes a scene, `compiled` compiles it.
    """

    def __init__(self, model: Model, paths: Iterable[str]) -> None:
        super().__init__(model.scene, paths, model.masses())

    def compiled(self, data: dict[str, Any] | ValueError) -> _core.Model:
        """The engine's model of `data`; raises the error if it is one. Any thread may ask."""
        return compile_data(self.scene, data)


class Parameters(Mapping[str, Floats]):
    """Values of a batch's model that differ from world to world, as arrays by path: `Batch.param`.

    Paths are those of `Model.with_values`: "geom/floor/friction", "body/arm/mass",
    "joint/knee/damping", "actuator/motor/gainprm", "gravity". An array has one row for each world:
    shape (n,) for a number, or for the first entry of a vector, (n, k) for a vector of k entries;
    a single number is that of all worlds. Assigning compiles the model for every different row, so
    constants that follow, such as the masses that contacts are weighed with, are those of the
    world, and a world computes the bits of a `Sim` of ``model.with_values`` with its row.
    `update` assigns several paths and compiles once. States, controls and impulses stay;
    what is read of the last step is that of the present state until the next.

    Reading gives the array that was assigned, or the model's own value in every world. Writing into
    that array changes nothing: assign it. ``del`` and `clear` go back to the model's own values.
    Iterating lists the paths that were assigned.

    Worlds of equal rows share vector lanes; a batch most of whose worlds have a row of their own
    steps them one by one.

    A value that cannot be is a ValueError that names path, world, value and limit; nothing changes
    then.

    >>> import numpy as np
    >>> import stepcore as sc
    >>> batch = sc.Batch(sc.lesson.drop(), 3)
    >>> batch.param["gravity"] = [[0, 0, -1.0], [0, 0, -2.0], [0, 0, -3.0]]
    >>> batch.reset("start")
    >>> batch.step()
    >>> (batch.qvel[:, 0] / batch.settings.dt).round(9).tolist()
    [-1.0, -2.0, -3.0]
    """

    def __init__(self, model: Model, core: _core.Batch, n: int) -> None:
        self._base, self._core, self._n = model, core, n
        self._columns: dict[str, Floats] = {}
        self._variants = Variants(model, {}, n)

    def __getitem__(self, path: str) -> Floats:
        if path in self._columns:
            return self._columns[path].copy()
        return np.stack([_own(self._base, path)] * self._n)

    def __setitem__(self, path: str, values: ArrayLike) -> None:
        self.update({path: values})

    def __delitem__(self, path: str) -> None:
        _own(self._base, path)
        self._take({key: column for key, column in self._columns.items() if key != path})

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __contains__(self, path: object) -> bool:
        return path in self._columns

    def update(self, values: Mapping[str, ArrayLike]) -> None:
        """Assigns several paths at once; see the class."""
        if not isinstance(values, Mapping):
            raise ValueError(f"values = {checks.shown(values)}: must be a dict of paths and arrays")
        new = {path: self._column(path, given) for path, given in values.items()}
        self._take(self._columns | new)

    def clear(self) -> None:
        """Goes back to the model's own values in all worlds."""
        self._take({})

    def model_of(self, world: int) -> Model:
        """The model of a world."""
        return self._variants.model(world)

    def initial(self) -> list[tuple[list[int], dict[str, Any]]]:
        """Worlds whose initial arrays differ from the model's, with these arrays."""
        return self._variants.initial()

    def columns(self) -> dict[str, Floats]:
        """What was assigned, by path."""
        return dict(self._columns)

    def _column(self, path: str, given: ArrayLike) -> Floats:
        """One row for each world, of a shape that the value can have."""
        own, name = _own(self._base, path), f"param[{checks.shown(path)}]"
        table = numbers(name, given)
        if np.ndim(given) == 0:
            table = np.repeat(table, self._n)
        if table.shape not in ((self._n,), (self._n, *own.shape)):
            entries = f" or ({self._n}, {own.size})" if own.ndim else ""
            limit = f"a number or of shape ({self._n},){entries}, one row for each world"
            raise ValueError(f"{name} has shape {table.shape}: must be {limit}")
        bad = ~np.isfinite(table.reshape(self._n, -1)).all(axis=1)
        if bad.any():
            world = int(np.flatnonzero(bad)[0])
            raise ValueError(f"{name}[{world}] = {checks.shown(table[world])}: must be finite")
        column = table.copy()
        column.flags.writeable = False
        return column

    def _take(self, columns: dict[str, Floats]) -> None:
        variants = Variants(self._base, columns, self._n)
        for world, error in variants.errors().items():
            raise ValueError(f"param, world {world}: {checks.one_line(error)}") from None
        self._core.set_models(variants.models, variants.model_of)
        self._columns, self._variants = columns, variants

    def __repr__(self) -> str:
        paths = ", ".join(f'"{path}"' for path in self._columns)
        return f"<Parameters of {self._n} worlds: {paths or 'none'}>"


class Variants:
    """A model compiled with the values of each row of a table of parameters.

    models: the different ones, as the engine has them. model_of: the index of each world's.
    """

    def __init__(self, model: Model, columns: Mapping[str, Floats], n: int) -> None:
        self._base, self._columns = model, columns
        self.models: list[_core.Model] = []
        self.model_of: list[int] = [0] * n
        self._refused: dict[int, ValueError] = {}
        self._made: dict[int, Model] = {}
        if not columns:
            self.models.append(model.core)
            return
        rows = np.concatenate([column.reshape(n, -1) for column in columns.values()], axis=1)
        known: dict[bytes, int] = {}
        first: list[int] = []
        for world in range(n):
            row = rows[world].tobytes()
            if row not in known:
                known[row] = len(first)
                first.append(world)
            self.model_of[world] = known[row]
        self._compile(first)

    def _compile(self, worlds: list[int]) -> None:
        """Compiles the model of each of these worlds, several at a time."""
        # Only parameters need threads of Python.
        from concurrent.futures import ThreadPoolExecutor

        variation = ModelVariation(self._base, self._columns)
        with ThreadPoolExecutor(checks.threads(None)) as pool:
            # A variation makes one scene after the other; the engine compiles them meanwhile.
            compiled = [
                pool.submit(variation.compiled, self._data(variation, world)) for world in worlds
            ]
            for index, result in enumerate(compiled):
                try:
                    self.models.append(result.result())
                except ValueError as error:
                    self._refused[index] = error
                    self.models.append(self._base.core)

    def _data(self, variation: Any, world: int) -> Any:
        """The plain data of a world's scene, or why there is none."""
        try:
            return variation.data(self.values(world))
        except ValueError as error:
            return error

    def errors(self) -> dict[int, ValueError]:
        """By world, why its values are refused."""
        refused = self._refused
        return {w: refused[index] for w, index in enumerate(self.model_of) if index in refused}

    def values(self, world: int) -> dict[str, Any]:
        """A world's row, as `Model.with_values` takes it."""
        return {
            path: _value(self._base, path, column[world]) for path, column in self._columns.items()
        }

    def model(self, world: int) -> Model:
        """A world's model."""
        if not self._columns:
            return self._base
        index = self.model_of[world]
        if index not in self._made:
            self._made[index] = self._base.with_values(self.values(world))
        return self._made[index]

    def initial(self) -> list[tuple[list[int], dict[str, Any]]]:
        """Worlds whose initial arrays differ from the model's, with these arrays."""
        own = dict(self._base.core.initial())
        different = {}
        for index, model in enumerate(self.models):
            if model is not self._base.core and (arrays := dict(model.initial())) != own:
                different[index] = arrays
        if not different:
            return []
        worlds: dict[int, list[int]] = {index: [] for index in different}
        for world, index in enumerate(self.model_of):
            if index in worlds:
                worlds[index].append(world)
        return [(worlds[index], arrays) for index, arrays in different.items()]


def _own(model: Model, path: str) -> Floats:
    """The model's value of a path, a number or a vector; ValueError for a path without numbers."""
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


def _value(model: Model, path: str, row: Any) -> Any:
    """A row of an array as the scene takes it."""
    value = row.tolist()
    if path not in WHOLE and isinstance(value, float) and value.is_integer():
        element, field = find(model.scene, path)
        if isinstance(getattr(element, field), int):
            return int(value)
    return value
