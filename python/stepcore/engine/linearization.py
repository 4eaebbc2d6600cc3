"""`Linearization`: the linear map of a step about one state; of many worlds, `Linearizations`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from stepcore import _core
from stepcore.engine.arrays import Floats
from stepcore.engine.parameters import Column, columns, models_around

if TYPE_CHECKING:
    from stepcore.engine.model import Model

AXES = {
    "slide": ("",),
    "hinge": ("",),
    "ball": (" turn x", " turn y", " turn z"),
    "free": (" x", " y", " z", " turn x", " turn y", " turn z"),
}


@dataclass(eq=False, repr=False)
class Linearization:
    """A step linearised about one state: x⁺ = A x + B u + P p to first order.

    x = (dq, dv, dw, dc) is a small change of position, velocity, activation and past controls, and
    u is a small change of ctrl. dq has nv entries [m or rad] and changes qpos as a velocity dq does
    in one second: a ball or free joint rotates by a rotation vector in its body's axes. dw has na
    entries, and dc has the entries of ctrl_history, in scenes with late controls.

    A: shape (n, n), where n is the number of entries of x. B: shape (n, nu). dt: the time step [s].
    P: shape (n, number of parameters), by changes p of the parameters.
    labels: names of the dofs. controls: names of the actuators. parameters: their paths.
    degenerate: names of the elements at which A and B are one-sided, because the state is exactly
    at a corner of the element's law (a row at its switch, a bound reached); usually empty.
    degenerate_ids: (kind, index, part) of each such element.

    >>> from stepcore import Scene, Sim
    >>> scene = Scene()
    >>> cart = scene.add_body("cart")
    >>> _ = scene.add_joint(cart, "slide", name="rail", axis=(1, 0, 0), stiffness=100.0)
    >>> _ = scene.add_geom(cart, "sphere", 0.1, mass=1.0)
    >>> step = Sim(scene, dt=0.1, integrator="semi-implicit").linearize()
    >>> step.A.round(12).tolist()
    [[0.0, 0.1], [-10.0, 1.0]]
    >>> step.labels
    ('rail',)
    >>> round(step.spectral_radius, 6)
    1.0
    """

    A: Floats
    B: Floats
    dt: float
    labels: tuple[str, ...]
    controls: tuple[str, ...] = ()
    degenerate: tuple[str, ...] = ()
    degenerate_ids: tuple[tuple[str, int, int], ...] = ()
    P: Floats = field(default=None)  # type: ignore[arg-type]
    parameters: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.P is None:
            self.P = np.zeros((len(self.A), 0))

    @property
    def nv(self) -> int:
        """The number of dofs; x begins with twice as many entries."""
        return len(self.labels)

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """Eigenvalues of A, largest first, shape (n,): factors of the modes per step."""
        values: NDArray[np.complex128] = np.linalg.eigvals(self.A).astype(complex)
        return values[np.argsort(-np.abs(values), kind="stable")]

    @property
    def spectral_radius(self) -> float:
        """The largest absolute eigenvalue of A. Above 1, a perturbation grows."""
        return float(np.abs(self.eigenvalues).max(initial=0.0))

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as plain data."""
        # Imported here so that the engine alone does not load the reports.
        from stepcore.report.table import jsonable

        plain: dict[str, Any] = jsonable(vars(self) | {"spectral_radius": self.spectral_radius})
        return plain

    def __repr__(self) -> str:
        count = f"{self.nv} dofs, {len(self.controls)} controls"
        count += f", {len(self.parameters)} parameters" if self.parameters else ""
        radius = f"spectral radius {self.spectral_radius:.6g}"
        sides = f"; one-sided at: {', '.join(self.degenerate)}" if self.degenerate else ""
        return f"<Linearization: {count}; a step of {self.dt:g} s; {radius}{sides}>"


class Linearizations(Sequence[Linearization]):
    """Steps of many worlds, each linearised about its state: a `Linearization` of each by index.

    A, B, P: the matrices of all worlds, with the worlds as the first axis.
    parameters: paths of the parameters of P.

    >>> from stepcore import Batch, lesson
    >>> linear = Batch(lesson.spring(), 3, dt=0.01).linearize()
    >>> linear.A.shape, linear[2].labels
    ((3, 2, 2), ('spring',))
    """

    def __init__(self, model: Model, steps: LinearSteps, by: Sequence[Column] = ()) -> None:
        self.A, self.B, self.P = (matrix[:, 0] for matrix in steps[:3])
        self.parameters = tuple(column.label for column in by)
        self._model, self._degenerate = model, steps.degenerate

    def __len__(self) -> int:
        return len(self.A)

    @cached_property
    def _labels(self) -> tuple[str, ...]:
        model = self._model
        return tuple(
            name + axis
            for name, kind in zip(model.called("joint"), model.jnt_type, strict=True)
            for axis in AXES[kind]
        )

    @overload
    def __getitem__(self, index: int) -> Linearization: ...
    @overload
    def __getitem__(self, index: slice) -> list[Linearization]: ...
    def __getitem__(self, index: int | slice) -> Linearization | list[Linearization]:
        """Return the linearisation of a world, or a list of linearisations for a slice."""
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        world = range(len(self))[index]
        ids = tuple(element for other, _, element in self._degenerate if other == world)
        return Linearization(
            self.A[world],
            self.B[world],
            self._model.settings.dt,
            self._labels,
            self._model.called("actuator"),
            tuple(self._model.element_name(*element) for element in ids),
            ids,
            self.P[world],
            self.parameters,
        )

    def __repr__(self) -> str:
        size = "×".join(str(n) for n in self.A.shape[1:])
        return f"<Linearizations of {len(self)} worlds, each {size}>"


class LinearSteps(NamedTuple):
    """Linearised steps of worlds: A, B and P, each of shape (worlds, steps, size of x, …).

    degenerate: (world, step, element) wherever the matrices are one-sided.
    """

    A: Floats
    B: Floats
    P: Floats
    degenerate: list[tuple[int, int, tuple[str, int, int]]]


def linear_step(model: Model, core: Any, by: Sequence[Column]) -> LinearSteps:
    """Linearise the next step of a `_core.Sim`, also by these parameters."""
    around = models_around(model, by)
    with _named_parameters(by):
        numbers, degenerate = core.linearize(around)
    apart = np.array([column.spacing for column in by])
    return _split(numbers[None, None], apart, [(0, 0, element) for element in degenerate])


@contextmanager
def _named_parameters(by: Sequence[Column]) -> Iterator[None]:
    """Replace the numbers of parameters in errors of the core by labels."""
    try:
        yield
    except ValueError as error:
        match = re.match(r"parameter = (\d+): (.*)", str(error))
        if match is None:
            raise
        raise ValueError(f"parameters: {by[int(match[1])].label}: {match[2]}") from None


def _split(numbers: Floats, apart: Floats, degenerate: list[tuple[int, int, Any]]) -> LinearSteps:
    split = numbers.shape[-2]
    last = numbers.shape[-1] - apart.shape[-1]
    by_values = numbers[..., last:] / apart
    return LinearSteps(numbers[..., :split], numbers[..., split:last], by_values, degenerate)


class LinearWorlds:
    """Worlds whose steps are linearised together, on several threads.

    models: the model of each world; they differ in values only. first: index of the first world.
    """

    def __init__(self, models: Sequence[Model], threads: int, first: int = 0) -> None:
        self.models, self.first = models, first
        different = {id(model): model for model in self.models}
        self.different = list(different.values())
        number = {key: k for k, key in enumerate(different)}
        self.of = [number[id(model)] for model in self.models]
        cores = [model.core for model in self.different]
        settings = self.models[0].settings
        self.core = _core.Linearizers(cores, self.of, settings, threads, first)
        self._by: tuple[list[str], list[Any], Floats] | None = None

    def _around(self, by: Sequence[Column]) -> tuple[list[Any], Floats]:
        """Return the models around parameters, by model; and their distances in value, by world."""
        labels = [column.label for column in by]
        if self._by is None or self._by[0] != labels:
            around, apart = [], np.zeros((len(self.different), len(by)))
            for k, model in enumerate(self.different):
                try:
                    labelled = columns(model, labels)
                except ValueError as error:
                    world = self.first + self.of.index(k)
                    raise ValueError(f"{error} (world {world})") from None
                around.append(models_around(model, labelled))
                apart[k] = [column.spacing for column in labelled]
            self._by = labels, around, apart[self.of]
        return self._by[1:]

    def linear(self, states: Mapping[str, Floats], by: Sequence[Column]) -> LinearSteps:
        """Linearise a step at each of these states, arrays of shape (worlds, steps, …)."""
        around, apart = self._around(by)
        contiguous = {name: np.ascontiguousarray(rows) for name, rows in states.items()}
        with _named_parameters(by):
            numbers, degenerate = self.core.linearize(around, contiguous)
        steps = numbers.shape[1]
        sided = [(*divmod(nth, steps), element) for nth, element in degenerate]
        return _split(numbers, apart[:, None, None], sided)
