"""Model values that differ from world to world of a `Batch`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore.engine.arrays import Floats, frozen, numbers
from stepcore.engine.model import Model
from stepcore.engine.variations import ModelVariation, own_value
from stepcore.scene.value_paths import WHOLE, find

if TYPE_CHECKING:
    from stepcore import _core


# So many models are compiled in the calling thread: starting others takes longer.
FEW = 2


class Rows(np.ndarray[Any, np.dtype[np.float64]]):
    """The array of a path, one row for each world: assigning to some rows assigns the parameter."""

    _assign: Callable[[Floats], None] | None = None

    def __array_finalize__(self, other: object) -> None:
        # Views and results of arithmetic are plain arrays.
        self._assign = None

    def __setitem__(self, rows: Any, values: Any) -> None:
        if self._assign is not None:
            new = np.array(self)
            new[rows] = values
            self._assign(new)
        super().__setitem__(rows, values)


class Parameters(Mapping[str, Floats]):
    """Model values that differ from world to world of a batch, as arrays by path: `Batch.param`.

    The paths are those of `Model.with_values`: "geom/floor/friction", "body/arm/mass",
    "joint/knee/damping", "actuator/motor/gainprm", "gravity". An array has one row for each world:
    shape (n,) for a number or for the first entry of a vector, (n, k) for a vector of k entries. A
    single number applies to all worlds.

    Assignment compiles the model for every distinct row, so derived constants, such as the inverse
    masses of contacts, are also those of the world. Each world is bit-identical to a `Sim` of
    ``model.with_values`` with the world's row. `update` assigns several paths and compiles once.
    States, controls and impulses do not change. Until the next step, readouts of the last step are
    those of the present state.

    Reading returns a copy of the assigned array, or the model's own value in every world.
    ``param[path][worlds] = values`` assigns rows of this array, as a reset does: only the models of
    these worlds are compiled, and only their lanes are rewritten. ``del`` and `clear` restore the
    model's own values. Iteration yields the assigned paths.

    Worlds of distinct rows share vector lanes, as long as each value is zero in all of them or in
    none. Assigning an array again compiles the models of those worlds alone that have new values.

    An invalid value raises a ValueError that names path, world, value and limit; nothing changes
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
        known = self._columns.get(path)
        own = own_value(self._base, path)
        column = np.stack([own] * self._n) if known is None else known.copy()
        rows = column.view(Rows)
        rows._assign = lambda new: self.update({path: new})
        return rows

    def __setitem__(self, path: str, values: ArrayLike) -> None:
        self.update({path: values})

    def __delitem__(self, path: str) -> None:
        own_value(self._base, path)
        self._take({key: column for key, column in self._columns.items() if key != path})

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __contains__(self, path: object) -> bool:
        return path in self._columns

    def update(self, values: Mapping[str, ArrayLike]) -> None:
        """Assign several paths at once; see `Parameters`."""
        if not isinstance(values, Mapping):
            raise ValueError(f"values = {checks.shown(values)}: must be a dict of paths and arrays")
        new = {path: self._column(path, given) for path, given in values.items()}
        self._take(self._columns | new)

    def clear(self) -> None:
        """Restore the model's own values in all worlds."""
        self._take({})

    def model_of(self, world: int) -> Model:
        """Return the model of a world."""
        return self._variants.model(world)

    def models(self) -> list[Model]:
        """Return the model of each world: the same list until a parameter is set."""
        return self._variants.by_world

    def initial(self) -> list[tuple[list[int], dict[str, Any]]]:
        """Return the worlds whose initial arrays differ from the model's, with these arrays."""
        return self._variants.initial()

    def columns(self) -> dict[str, Floats]:
        """Return the assigned arrays by path."""
        return dict(self._columns)

    def _column(self, path: str, given: ArrayLike) -> Floats:
        """Return a checked array with one row for each world."""
        own, name = own_value(self._base, path), f"param[{checks.shown(path)}]"
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
        return frozen(table.copy())

    def _take(self, columns: dict[str, Floats]) -> None:
        variants = Variants(self._base, columns, self._n, self._variants)
        for world, error in variants.errors().items():
            raise ValueError(f"param, world {world}: {checks.one_line(error)}") from None
        self._core.set_models(variants.models, variants.model_of)
        self._columns, self._variants = columns, variants

    def __repr__(self) -> str:
        paths = ", ".join(f'"{path}"' for path in self._columns)
        return f"<Parameters of {self._n} worlds: {paths or 'none'}>"


class Made:
    """A compiled model, and its initial arrays where they differ from those of the base model."""

    def __init__(self, core: _core.Model) -> None:
        self.core = core
        self._initial: dict[str, Any] | None = None

    def initial(self, base: dict[str, Any]) -> dict[str, Any]:
        """Return the initial arrays, or nothing if they are those of the base model."""
        if self._initial is None:
            own = dict(self.core.initial())
            self._initial = {} if own == base else own
        return self._initial


class Variants:
    """The models compiled for all distinct rows of a table of parameters.

    models: the engine's models. model_of: for each world, the index in `models`.
    """

    def __init__(
        self,
        model: Model,
        columns: Mapping[str, Floats],
        n: int,
        before: Variants | None = None,
    ) -> None:
        self._base, self._columns = model, columns
        self.models: list[_core.Model] = []
        self.model_of: list[int] = [0] * n
        self._refused: dict[int, ValueError] = {}
        self._made: dict[int, Model] = {}
        # By row: the engine's model, with the initial arrays that it has of its own; and what makes
        # more of them.
        self._known: dict[bytes, Made] = {}
        self._variation: ModelVariation | None = None
        if not columns:
            self.models.append(model.core)
            return
        kept: dict[bytes, Made] = {}
        if before is not None and before.layout() == self.layout():
            kept, self._variation = before._known, before._variation
        rows = np.concatenate([column.reshape(n, -1) for column in columns.values()], axis=1)
        known: dict[bytes, int] = {}
        new: list[tuple[int, int]] = []
        for world in range(n):
            row = rows[world].tobytes()
            index = known.setdefault(row, len(self.models))
            if index == len(self.models):
                self.models.append(kept[row].core if row in kept else model.core)
                if row not in kept:
                    new.append((index, world))
            self.model_of[world] = index
        self._compile(new)
        for row, index in known.items():
            if index not in self._refused:
                self._known[row] = kept.get(row) or Made(self.models[index])

    def layout(self) -> list[tuple[str, tuple[int, ...]]]:
        """Return the paths and the shapes of their values, in the order of a row."""
        return [(path, column.shape[1:]) for path, column in self._columns.items()]

    def _compile(self, new: list[tuple[int, int]]) -> None:
        """Compile the models at these indices of these worlds, several at a time."""
        if not new:
            return
        variation = self._variation or ModelVariation(self._base, self._columns)
        self._variation = variation
        if len(new) <= FEW:
            for index, world in new:
                try:
                    self.models[index] = variation.compiled(self._data(variation, world))
                except ValueError as error:
                    self._refused[index] = error
            return
        # Imported here because only parameters need Python threads.
        from concurrent.futures import ThreadPoolExecutor

        with ThreadPoolExecutor(checks.threads(None)) as pool:
            # Scenes are created one after another, while the engine compiles earlier ones.
            compiled = [
                (index, pool.submit(variation.compiled, self._data(variation, world)))
                for index, world in new
            ]
            for index, result in compiled:
                try:
                    self.models[index] = result.result()
                except ValueError as error:
                    self._refused[index] = error

    def _data(self, variation: Any, world: int) -> Any:
        """Return the plain data of a world's scene, or the error that prevents it."""
        try:
            return variation.data(self.values(world))
        except ValueError as error:
            return error

    def errors(self) -> dict[int, ValueError]:
        """Return the error of each world whose values are rejected."""
        refused = self._refused
        return {w: refused[index] for w, index in enumerate(self.model_of) if index in refused}

    def values(self, world: int) -> dict[str, Any]:
        """Return a world's row as an argument of `Model.with_values`."""
        return {
            path: _value(self._base, path, column[world]) for path, column in self._columns.items()
        }

    def model(self, world: int) -> Model:
        """Return a world's model."""
        if not self._columns:
            return self._base
        index = self.model_of[world]
        if index not in self._made:
            self._made[index] = self._base.with_values(self.values(world))
        return self._made[index]

    @cached_property
    def by_world(self) -> list[Model]:
        """The model of each world."""
        return [self.model(world) for world in range(len(self.model_of))]

    def initial(self) -> list[tuple[list[int], dict[str, Any]]]:
        """Return the worlds whose initial arrays differ from the model's, with these arrays."""
        own = dict(self._base.core.initial())
        all_arrays = enumerate(made.initial(own) for made in self._known.values())
        different = {index: arrays for index, arrays in all_arrays if arrays}
        if not different:
            return []
        worlds: dict[int, list[int]] = {index: [] for index in different}
        for world, index in enumerate(self.model_of):
            if index in worlds:
                worlds[index].append(world)
        return [(worlds[index], arrays) for index, arrays in different.items()]


def _value(model: Model, path: str, row: Any) -> Any:
    """Convert a row of an array to a value of the scene."""
    value = row.tolist()
    if path not in WHOLE and isinstance(value, float) and value.is_integer():
        element, field = find(model.scene, path)
        if isinstance(getattr(element, field), int):
            return int(value)
    return value
