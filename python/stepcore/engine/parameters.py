"""Values of a model by path, which differ from world to world or are variables of derivatives."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore.engine.arrays import Floats, frozen, numbers
from stepcore.engine.compilation import compile_data
from stepcore.scene.elements import Body
from stepcore.scene.records import Variation
from stepcore.scene.value_paths import WHOLE, find, present

if TYPE_CHECKING:
    from stepcore import _core
    from stepcore.engine.model import Model

# The model is compiled at these multiples of a fraction of a value around it. The derivative of
# 1/p³ then has a relative error of 2e-12, and of 1e-12 from rounding.
AROUND = (-2, -1, 1, 2)
SPACING = 2.0**-11
# Impedances are clamped at 0.0001 and 0.9999; the models around a value must be inside.
CLAMPED = 0.00011
ENTRY = re.compile(r"(.*)\[(\d+)\]")


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
    value = present(element, field)
    if field == "mass" and isinstance(element, Body) and value is None:
        value = model.body_mass[model.index("body", element.name)]
    table = np.asarray(value if value is not None else 0.0)
    if isinstance(value, bool) or table.dtype.kind not in "fiu" or table.ndim > 1:
        raise ValueError(f"param[{checks.shown(path)}]: its value is no number and no vector")
    return table.astype(np.float64)


class Rows(np.ndarray[Any, np.dtype[np.float64]]):
    """The array of a path, one row for each world; assigning to rows assigns the parameter."""

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

    The paths are as in `Model.with_values`: "geom/floor/friction", "body/arm/mass",
    "joint/knee/damping", "actuator/motor/gainprm", "gravity". An array has one row for each world:
    shape (n,) for a number or for the first entry of a vector, (n, k) for a vector of k entries. A
    single number applies to all worlds.

    Assignment compiles the model for every distinct row, so derived constants, such as the inverse
    masses of contacts, also follow the world's values. Each world is bit-identical to a `Sim` of
    ``model.with_values`` with the world's row. `update` assigns several paths and compiles once.
    States, controls and impulses do not change. Until the next step, readouts of the last step
    describe the present state.

    Reading returns a copy of the assigned array, or the value in the model for every world.
    ``param[path][worlds] = values`` assigns rows of this array, as a reset does: only the models of
    these worlds are compiled, and only their lanes are rewritten. ``del`` and `clear` restore the
    values of the model. Iteration yields the assigned paths.

    Worlds of distinct rows share vector lanes, as long as each value is zero in all of them or in
    none. Assigning an array again compiles only the models of worlds with new values.

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
        assigned = self._columns.get(path)
        base = own_value(self._base, path)
        column = np.stack([base] * self._n) if assigned is None else assigned.copy()
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
        checks.mapping("values", values, "paths and arrays")
        new = {path: self._column(path, value) for path, value in values.items()}
        self._take(self._columns | new)

    def clear(self) -> None:
        """Restore the values of the model in all worlds."""
        self._take({})

    def models(self) -> list[Model]:
        """Return the model of each world: the same list until a parameter is set."""
        return self._variants.by_world

    def columns(self) -> dict[str, Floats]:
        """Return the assigned arrays by path."""
        return dict(self._columns)

    def _column(self, path: str, value: ArrayLike) -> Floats:
        """Return a checked array with one row for each world."""
        base, name = own_value(self._base, path), f"param[{checks.shown(path)}]"
        table = numbers(name, value)
        if np.ndim(value) == 0:
            table = np.repeat(table, self._n)
        if table.shape not in ((self._n,), (self._n, *base.shape)):
            entries = f" or ({self._n}, {base.size})" if base.ndim else ""
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


class Variants:
    """The models compiled for all distinct rows of a table of parameters.

    model_of: for each world, the index of its row's model.
    before: another table, whose models are reused for equal rows.
    """

    def __init__(
        self,
        model: Model,
        columns: Mapping[str, Floats],
        n: int,
        before: Variants | None = None,
    ) -> None:
        self._base, self._columns = model, columns
        parts = [column.reshape(n, -1) for column in columns.values()]
        table = np.concatenate([np.zeros((n, 0)), *parts], axis=1)
        every, size = table.tobytes(), table[0].nbytes
        rows = [every[world * size : (world + 1) * size] for world in range(n)]
        # The index of the model and the first world of each row.
        places: dict[bytes, int] = {}
        self.model_of = [places.setdefault(row, len(places)) for row in rows]
        first = dict(zip(reversed(rows), range(n - 1, -1, -1), strict=True))
        self._layout = [(path, column.shape[1:]) for path, column in columns.items()]
        kept: dict[bytes, _core.Model | ValueError] = {}
        self._variation: ModelVariation | None = None
        # The initial arrays of each row that differ from the base model's.
        self._initial: dict[bytes, dict[str, Any]] = {}
        if before is not None and before._layout == self._layout:
            kept, self._variation = before._made, before._variation
            self._initial = {row: a for row, a in before._initial.items() if row in places}
        new = [row for row in places if row not in kept]
        kept = kept | dict(zip(new, self._compiled([first[row] for row in new]), strict=True))
        self._made: dict[bytes, _core.Model | ValueError] = {row: kept[row] for row in places}
        self._models: dict[int, Model] = {}

    @property
    def models(self) -> list[Any]:
        """The engine's models, or the errors of rejected rows."""
        return list(self._made.values())

    def _compiled(self, worlds: list[int]) -> list[_core.Model | ValueError]:
        """Compile the models of these worlds, several at a time."""
        if not self._columns or not worlds:
            return [self._base.core] * len(worlds)
        variation = self._variation or ModelVariation(self._base, self._columns)
        self._variation = variation

        def tried(make: Callable[[Any], Any], argument: Any) -> Any:
            try:
                return make(argument)
            except ValueError as error:
                return error

        # Scenes are created one after another, while the engine compiles earlier ones.
        scenes = (
            tried(lambda index: variation.data(self.values(index)), world) for world in worlds
        )
        compiled = partial(tried, variation.compiled)
        if len(worlds) == 1:
            return list(map(compiled, scenes))
        # Imported here because only parameters need Python threads.
        from concurrent.futures import ThreadPoolExecutor

        with ThreadPoolExecutor(checks.threads(None)) as pool:
            return list(pool.map(compiled, scenes))

    def errors(self) -> dict[int, ValueError]:
        """Return the error of each world whose values are rejected."""
        models = self.models
        refused = {index for index, model in enumerate(models) if isinstance(model, ValueError)}
        return {
            world: models[index] for world, index in enumerate(self.model_of) if index in refused
        }

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
        if index not in self._models:
            self._models[index] = self._base.with_values(self.values(world))
        return self._models[index]

    @cached_property
    def by_world(self) -> list[Model]:
        """The model of each world."""
        return [self.model(world) for world in range(len(self.model_of))]

    def initial(self) -> list[tuple[list[int], dict[str, Any]]]:
        """Return the worlds whose initial arrays differ from the model's, with these arrays."""
        base = dict(self._base.core.initial())
        for row, model in self._made.items():
            if row not in self._initial:
                changed = base if isinstance(model, ValueError) else dict(model.initial())
                self._initial[row] = {} if changed == base else changed
        arrays = [self._initial[row] for row in self._made]
        worlds: dict[int, list[int]] = {k: [] for k, changed in enumerate(arrays) if changed}
        for world, index in enumerate(self.model_of if worlds else ()):
            if index in worlds:
                worlds[index].append(world)
        return [(some, arrays[index]) for index, some in worlds.items()]


def _value(model: Model, path: str, row: Any) -> Any:
    """Convert a row of an array to a value of the scene."""
    value = row.tolist()
    if path not in WHOLE and isinstance(value, float) and value.is_integer():
        element, field = find(model.scene, path)
        if isinstance(getattr(element, field), int):
            return int(value)
    return value


# Derivatives with respect to values.


@dataclass(frozen=True)
class Column:
    """A number of a model by which a step is differentiated.

    path: as in `Model.with_values`. entry: the index in a vector; None for a number.
    value: the number in the model.
    """

    path: str
    entry: int | None
    value: float

    @property
    def label(self) -> str:
        """The path, with the entry of a vector: "geom/floor/friction[0]"."""
        return self.path if self.entry is None else f"{self.path}[{self.entry}]"

    @property
    def is_clamped(self) -> bool:
        """Whether it is an impedance or its midpoint, which steps clamp to 0.0001 … 0.9999."""
        return _is_impedance(self.path) and self.entry in (0, 1, 3)

    @property
    def spacing(self) -> float:
        """The distance between the values around the model's value."""
        near = min(self.value, 1.0 - self.value) if self.is_clamped else abs(self.value)
        return near * SPACING

    def check(self) -> None:
        """Raise ValueError for a number by which no step is differentiated."""
        limit = None
        if self.value == 0 or not np.isfinite(self.value):
            limit = "finite and not zero: what is zero is left out of a step"
        elif self.is_clamped and not CLAMPED < self.value < 1 - CLAMPED:
            limit = f"between {CLAMPED} and {1 - CLAMPED}: steps clamp it"
        if limit:
            raise ValueError(f"parameters: {self.label} = {self.value:g}: must be {limit}")


def columns(model: Model, parameters: Sequence[str]) -> list[Column]:
    """Return the columns of parameters; raise ValueError also for a value that is zero.

    See `named_columns`.
    """
    named = named_columns(model, parameters)
    for column in named:
        column.check()
    return named


def named_columns(model: Model, parameters: Sequence[str]) -> list[Column]:
    """Return the columns of parameters; a vector has one for each nonzero entry.

    An impedance's power of 1 or 2 is also omitted, because steps compute it differently.

    Raises ValueError for an unknown path.
    """
    names = checks.as_list(parameters) if not isinstance(parameters, str) else [parameters]
    if names is None or not all(isinstance(name, str) for name in names):
        raise ValueError(f"parameters = {checks.shown(parameters)}: must be paths of values")
    by_label: dict[str, Column] = {}
    for name in names:
        for path in _expanded(model, name):
            by_label |= {column.label: column for column in _columns(model, path)}
    return list(by_label.values())


def split_entry(name: str) -> tuple[str, int | None]:
    """Return the path and the entry of "path[3]"; None for a path alone."""
    match = ENTRY.fullmatch(name)
    return (name, None) if match is None else (match[1], int(match[2]))


def _expanded(model: Model, name: str) -> list[str]:
    """Return the paths that match a pattern such as "actuator/*/gain"."""
    parts = name.split("/")
    if "*" not in name or name in WHOLE or len(parts) < 3:
        return [name]
    kind, pattern, field = parts[0], "/".join(parts[1:-1]), parts[-1]
    # The world has no mass.
    named = model.names.get(kind, ())[kind == "body" :]
    matches = fnmatch.filter(filter(None, named), pattern)
    if kind == "joint":
        # "All joints" excludes free joints, whose friction, damping and armature are rarely meant.
        kinds = dict(zip(named, model.jnt_type, strict=True))
        matches = [match for match in matches if kinds[match] != "free"] or matches
    if not matches:
        raise ValueError(f"parameters: no {kind} is named {checks.quoted(pattern)}")
    return [f"{kind}/{match}/{field}" for match in matches]


def _is_impedance(path: str) -> bool:
    return path.rpartition("/")[2].startswith("solimp")


def _columns(model: Model, path: str) -> Iterator[Column]:
    path, wanted = split_entry(path)
    value = own_value(model, path)
    if wanted is not None and wanted >= value.size * value.ndim:
        has = f"has {value.size} entries, and no" if value.ndim else "is a number and has no entry"
        raise ValueError(f"parameters: {path} {has} [{wanted}]")
    if not value.ndim or wanted is not None:
        entries = [wanted]
    else:
        entries = [int(k) for k in np.flatnonzero(value)] or list(range(len(value)))
        if _is_impedance(path) and value[-1] in (1.0, 2.0):
            entries.remove(len(value) - 1)
    for entry in entries:
        yield Column(path, entry, float(value if entry is None else value[entry]))


def models_around(model: Model, by: Sequence[Column]) -> list[list[_core.Model]]:
    """Return the compiled models around the value of each parameter, which the model keeps."""
    if by and model.is_heap:
        raise ValueError(
            f"parameters: {by[0].label}: a model with {model.npair} pairs of geoms that could meet "
            "looks for them in every step, which is not differentiated by values: exclude "
            "what never meets, until 2000 are left"
        )
    kept = model.around
    new = [column for column in by if column.label not in kept]
    if new:
        variation = ModelVariation(model, dict.fromkeys(column.path for column in new))
    for column in new:
        around: list[_core.Model] = []
        for k in AROUND:
            value = own_value(model, column.path)
            value[() if column.entry is None else column.entry] = column.value + k * column.spacing
            # Values between two valid values, or closer to zero, are valid too.
            checked = k == max(AROUND)
            try:
                data = variation.data({column.path: value.tolist()}, checked=checked)
                around.append(variation.compiled(data))
            except ValueError as error:
                raise ValueError(f"parameters: {column.label}: {error}") from None
        kept[column.label] = around
    return [kept[column.label] for column in by]
