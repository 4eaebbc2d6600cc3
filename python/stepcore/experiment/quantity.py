"""`Quantity`: the quantity of interest, whose error a measurement reports; by default the motion.

A series is a reading of one element over time, such as the position of a site. Its error from one
start is the RMS over the samples that can be predicted, as for the motion. A scalar is one number
of a run, such as the largest force; its error is the difference of that number. Forces and sensors
are read after the step that ends at a sample, as `Sim.contacts` and `Sim.sensordata` are. Several
quantities are judged together by `Measures`.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stepcore import checks
from stepcore.engine.control import ControlError
from stepcore.engine.coordinates import rotated
from stepcore.engine.norm import Matter, Tracks, arc, distances, largest, rms, vector_norm
from stepcore.experiment.elements import PARTS, Elements, Source, path_in_words
from stepcore.report import units

MOTION = "motion"
# Numbers of a run, from the samples of a series: (starts, n) and the time between samples [s].
REDUCTIONS: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "max": lambda series, dt: series.max(axis=1),
    "min": lambda series, dt: series.min(axis=1),
    "mean": lambda series, dt: series.mean(axis=1),
    "final": lambda series, dt: series[:, -1],
    "integral": lambda series, dt: series.sum(axis=1) * dt,
    "range": lambda series, dt: np.ptp(series, axis=1),
}


@dataclass(frozen=True)
class Quantity:
    """A quantity of interest, by its name.

    name: "motion", the positions and orientations of all bodies (the default); or

    - a series of an element: "body/NAME", "site/NAME" and "geom/NAME" (position, and rotation as
      arc length at the body's radius of gyration), each with "/x", "/y" or "/z" for one coordinate;
      "joint/NAME", "joint/NAME/velocity", "actuator/NAME/force", "tendon/NAME", "sensor/NAME",
      "contact/A" and "contact/A/B" (the sum of normal forces on a geom or body, from any other or
      from one other); "com", the centre of mass of all bodies; "energy". A pattern such as
      "joint/*" is the RMS over all elements that match;
    - a scalar of a run: max(…), min(…), mean(…), final(…), integral(…) or range(…) of a series.

    function: a function that returns one number, or True or False, of each run, (n,). Its
        parameters name the arrays that it reads, of all runs at once: "qpos", "xpos", "ctrl" and
        others that `Sim.run` records, each of shape (n, samples, …) with a sample at the end of
        each control period; and "time", (samples,).
    entry: of a function that returns a dict of several numbers of each run, the key of one.
    parts: several quantities, which are judged together; `Quantity.of` makes it of a list.

    On the command line it is --quantity:

        stepcore trade robot.xml --quantity "max(contact/foot)" --error 2N
        stepcore trade robot.xml --quantity site/tip --error 1mm --quantity com/z --error 5mm
        stepcore trade robot.xml --quantity walk.py:distance

    Raises ValueError for a name of another form. Elements are looked up when a study begins.

    >>> Quantity("max(contact/foot)").reduction, Quantity("site/tip").series
    ('max', 'site/tip')
    >>> Quantity.of(["site/tip", "actuator/elbow/force"]).name
    'site/tip, actuator/elbow/force'
    """

    name: str = MOTION
    function: Callable[..., Any] | None = None
    entry: str | None = None
    parts: tuple[Quantity, ...] = ()
    reduction: str = field(init=False, compare=False, repr=False)
    series: str = field(init=False, compare=False, repr=False)

    # Whether it is the return of episodes of a task, which it plays: `stepcore.gymnasium.Return`.
    plays = False
    # The episodes in words.
    words = ""

    def play(self, settings: Any, starts: Sequence[int], farthest: float) -> tuple[np.ndarray, str]:
        """Return the number of an episode from each start, and the first failure."""
        raise NotImplementedError

    def __post_init__(self) -> None:
        if self.function is not None or self.parts:
            object.__setattr__(self, "reduction", "")
            object.__setattr__(self, "series", "")
            return
        name = checks.word("quantity", self.name).strip()
        match = re.fullmatch(r"(\w+)\((.+)\)", name)
        reduction, series = match.groups() if match else ("", name)
        if reduction and reduction not in REDUCTIONS:
            near = checks.nearest(reduction, REDUCTIONS, limit=len(REDUCTIONS))
            raise ValueError(f"quantity: no reduction is called {checks.quoted(reduction)}{near}")
        if reduction and series == MOTION:
            raise ValueError(f"quantity: {name}: the motion has no {reduction}; name an element")
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "reduction", reduction)
        object.__setattr__(self, "series", series.strip())

    @classmethod
    def of(cls, quantity: Wanted) -> Quantity:
        """Return a quantity, or the one of a name, a function or a list; None is the motion."""
        if isinstance(quantity, Quantity):
            return quantity
        if callable(quantity):
            return cls(getattr(quantity, "__name__", type(quantity).__name__), quantity)
        if isinstance(quantity, (list, tuple)) and quantity:
            parts = tuple(cls.of(part) for part in quantity)
            if len(parts) > 1 and any(part.plays for part in parts):
                raise ValueError("quantity: the return of a task must be the only quantity")
            names = [part.name for part in parts]
            if len(set(names)) < len(names):
                twice = next(name for name in names if names.count(name) > 1)
                raise ValueError(f"quantity: {twice}: must be named once")
            return parts[0] if len(parts) == 1 else cls(", ".join(names), parts=parts)
        if quantity is not None and not isinstance(quantity, str):
            limit = "a name, a function of runs, a Quantity, or a list of these"
            raise checks.refuse("study", "quantity", quantity, limit)
        return cls(quantity or MOTION)

    @property
    def is_motion(self) -> bool:
        return self.name == MOTION and self.function is None

    @property
    def is_scalar(self) -> bool:
        """Whether it is one number of a run; of several quantities, whether each is."""
        if self.parts:
            return all(part.is_scalar for part in self.parts)
        return bool(self.reduction) or self.function is not None

    @property
    def has_scalars(self) -> bool:
        """Whether it is one number of a run, or has a part that is."""
        return self.is_scalar or any(part.is_scalar for part in self.parts)


# The forms of a quantity as an argument.
Wanted = Quantity | str | Callable[..., Any] | Sequence[Any] | None


@dataclass(frozen=True, eq=False)
class Column:
    """A series of numbers: one reading of `Tracks.readings`, by its place."""

    name: str
    unit: str
    place: int = 0

    def values(self, tracks: Tracks) -> np.ndarray:
        """Return the series, (starts, n)."""
        assert tracks.readings is not None
        return tracks.readings[:, :, self.place]

    def apart(self, a: Tracks, b: Tracks) -> np.ndarray:
        """Return the distance of two series at every sample, (starts, n)."""
        return np.abs(self.values(a) - self.values(b))


@dataclass(frozen=True, eq=False)
class Point(Column):
    """The pose of a point of a moving body, or one of its coordinates; or the centre of mass.

    place: of the body among the moving ones. offset: of the point from the body's centre of mass,
    in the body's axes [m], (3,). radius: at which rotations count [m]. axis: a coordinate, or
    None. shares: the bodies' shares of the mass, (bodies,), for the centre of mass of all.
    """

    offset: Any = None
    radius: float = 0.0
    axis: int | None = None
    shares: Any = None

    def positions(self, tracks: Tracks) -> np.ndarray:
        """Return the positions of the point [m], (starts, n, 3)."""
        if self.shares is not None:
            return np.asarray(np.einsum("b,snbk->snk", self.shares, tracks.com))
        quat = tracks.quat[:, :, [self.place]]
        moved = tracks.com[:, :, [self.place]] + rotated(quat, self.offset[None])
        return np.asarray(moved[:, :, 0])

    def values(self, tracks: Tracks) -> np.ndarray:
        if self.axis is None:
            also = ", ".join(f"{self.name}/{part}" for part in PARTS)
            raise ValueError(f"quantity: {self.name} is a position, not a number: use {also}")
        return self.positions(tracks)[..., self.axis]

    def apart(self, a: Tracks, b: Tracks) -> np.ndarray:
        if self.axis is not None:
            return super().apart(a, b)
        far = vector_norm(self.positions(a) - self.positions(b))
        turned = 0.0 if self.shares is not None else arc(a.quat, b.quat)[:, :, self.place]
        return np.asarray(np.hypot(far, self.radius * turned))


@dataclass(frozen=True, eq=False)
class Measure:
    """A quantity of one scene: its distance between two motions, its unit and its range.

    quantity: the quantity. matter: the moving bodies. columns: its series; none for the motion.
    sources: the readings that the engine makes for it; first: the index of the first one.
    times: of the samples [s], (n,). arrays: name and shape of the arrays that a function reads.
    """

    quantity: Quantity
    matter: Matter
    columns: tuple[Column, ...] = ()
    sources: tuple[Source, ...] = ()
    times: np.ndarray = field(default_factory=lambda: np.ones(1))
    arrays: tuple[tuple[str, tuple[int, ...]], ...] = ()
    first: int = 0
    parts: tuple[Measure, ...] = ()
    _seen: dict[str, bool] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls, quantity: Quantity, matter: Matter, elements: Callable[[], Elements], first: int = 0
    ) -> Measure:
        """Look up the elements of a quantity; first: the index of its first reading.

        Raises ValueError for elements that the scene lacks, with the nearest names, and for
        elements with different units.
        """
        if quantity.parts:
            return Measures.of(quantity, matter, elements)
        if quantity.is_motion or quantity.plays:
            return cls(quantity, matter)
        if quantity.function is not None:
            arrays = tuple((name, elements().shape(name)) for name in parameters(quantity))
            recorded = tuple(Source(name) for name, _ in arrays)
            return cls(quantity, matter, (), recorded, arrays=arrays, first=first)
        columns, sources = list[Column](), list[Source]()
        for element in elements().find(quantity.series):
            if element.body is None:
                columns.append(Column(element.name, element.unit, first + len(sources)))
                sources.append(element.source)
            elif element.body < 0:
                shares = matter.mass / matter.mass.sum()
                columns.append(Point(element.name, "m", shares=shares, axis=element.axis))
            else:
                place = matter.moving.index(element.body)
                offset = element.offset - matter.ipos[place]
                radius = float(matter.gyration[place])
                columns.append(Point(element.name, "m", place, offset, radius, element.axis))
        kinds = dict.fromkeys(column.unit for column in columns)
        if len(kinds) > 1:
            both = " and ".join(unit or "no unit" for unit in kinds)
            raise ValueError(f"quantity: {quantity.series} has elements with {both}: name one kind")
        if quantity.reduction and quantity.reduction != "final":
            for column in columns:
                if isinstance(column, Point) and column.axis is None:
                    column.values(_NOTHING)
        return cls(quantity, matter, tuple(columns), tuple(sources), first=first)

    def sampled(self, times: np.ndarray) -> Measure:
        """Return the measure of motions with samples at these times [s], (n,)."""
        return replace(self, times=times)

    @property
    def width(self) -> int:
        """The number of readings at a sample."""
        return sum(math.prod(shape) for _, shape in self.arrays) or len(self.sources)

    @property
    def unit(self) -> str:
        """The unit of the quantity and of its errors; "" without one."""
        if self.quantity.is_motion:
            return "m"
        if self.quantity.function is not None:
            return ""
        unit = self.columns[0].unit
        if self.quantity.reduction == "integral":
            return INTEGRALS.get(unit, f"{unit}·s")
        return unit

    def words(self, value: float) -> str:
        """Format an error in the unit of the quantity."""
        return units.amount_in(value, self.unit)

    def parse(self, owner: str, name: str, value: object, whole: float) -> float:
        """Return an error in the unit of the quantity; see `units.amount`."""
        if self.quantity.is_motion:
            return units.length(owner, name, value, whole)
        of = f"{path_in_words(self.quantity.name)}'s range"
        return units.amount(owner, name, value, self.unit, whole, of)

    @property
    def error_words(self) -> str:
        """The measured error in a few words."""
        if self.quantity.is_motion:
            return "RMS position error"
        kind = "error" if self.quantity.is_scalar else "RMS error"
        return f"{kind} of {self.quantity.name}"

    @property
    def allowed_errors(self) -> tuple[float, ...]:
        """Of several quantities, the allowed error of each."""
        return ()

    @property
    def in_unit(self) -> str:
        """The unit behind a name on an axis or in a heading: " [m]"; "" without a unit."""
        return f" [{self.unit}]" if self.unit else ""

    def apart(self, a: Tracks, b: Tracks) -> np.ndarray:
        """Return the distance at every sample, of every body or element, (starts, n, k).

        A scalar of a run has one sample. The distance is infinite where a run has ended.
        """
        if self.quantity.is_motion:
            return distances(a, b, self.matter)
        if self.quantity.plays:
            raise ValueError("quantity: the return of a task is measured by `trade` alone")
        if self.quantity.function is not None:
            far = np.abs(self.numbers(a) - self.numbers(b))[:, None, None]
            return np.where(np.isnan(far), np.inf, far)
        with np.errstate(over="ignore", invalid="ignore"):
            far = np.stack([self._apart(column, a, b) for column in self.columns], axis=-1)
        far[np.isnan(far)] = np.inf
        return far

    def _apart(self, column: Column, a: Tracks, b: Tracks) -> np.ndarray:
        name = self.quantity.reduction
        if not name:
            return column.apart(a, b)
        if name == "final":
            return column.apart(a, b)[:, -1:]
        return np.abs(self._reduced(column, a) - self._reduced(column, b))[:, None]

    def _reduced(self, column: Column, tracks: Tracks) -> np.ndarray:
        """Return the number of a column in each run, (starts,)."""
        dt = float(self.times[0])
        return np.asarray(REDUCTIONS[self.quantity.reduction](column.values(tracks), dt))

    @property
    def binary(self) -> bool:
        """Whether the numbers are True or False; known after the first runs."""
        return bool(self._seen.get("binary"))

    @property
    def binaries(self) -> tuple[bool, ...]:
        """`binary`, of each quantity."""
        return (self.binary,)

    def mark(self, binaries: Sequence[bool]) -> None:
        """Take over `binaries` of runs that another process made."""
        self._seen["binary"] = self.binary or binaries[0]

    def numbers(self, tracks: Tracks, starts: Sequence[int] | None = None) -> np.ndarray:
        """Return the number of each run, (starts,); NaN of a run that failed.

        starts: indices of the starts, for errors. Raises ValueError for a series, which has no
        single number, and for a function that returns anything but a number of each run.
        """
        quantity, ran = self.quantity, np.isfinite(tracks.com).all(axis=(1, 2, 3))
        numbers = np.full(len(tracks), np.nan)
        if quantity.function is None:
            numbers[ran] = self._reduced(self.columns[0], tracks)[ran]
            return numbers
        if ran.any():
            numbers[ran] = self._called(tracks, ran)
        bad = np.flatnonzero(ran & ~np.isfinite(numbers))
        if len(bad):
            which = bad[0] if starts is None else starts[int(bad[0])]
            text = f"quantity: {quantity.name} is not finite in the run from start {which}"
            raise ControlError(text)
        return numbers

    def check_scalar(self) -> None:
        """Raise ValueError unless the quantity is one number of a run."""
        if not self.quantity.is_scalar or len(self.columns) > 1:
            shown = checks.quoted(self.quantity.name)
            raise ValueError(
                f"quantity: {shown} is not one number of a run: use max(…), min(…), mean(…), "
                "final(…), integral(…) or range(…) of one element, or a function of runs"
            )

    def _called(self, tracks: Tracks, ran: np.ndarray) -> np.ndarray:
        """Call the user's function with the runs that did not fail."""
        function, name = self.quantity.function, self.quantity.name
        assert function is not None and tracks.readings is not None
        count, arrays, first = int(ran.sum()), dict[str, np.ndarray](), self.first
        for array, shape in self.arrays:
            size = math.prod(shape)
            part = tracks.readings[ran, :, first : first + size]
            arrays[array], first = part.reshape(count, -1, *shape), first + size
        if "time" in inspect.signature(function).parameters:
            arrays["time"] = self.times
        try:
            returned = function(**arrays)
            numbers = np.asarray(self._entry(returned))
        except ControlError:
            raise
        except Exception as error:
            text = f"{type(error).__name__}: {checks.one_line(error)}"
            raise ControlError(f"quantity: {name} raised {text}") from error
        if numbers.shape != (count,) or numbers.dtype.kind not in "bif":
            limit = f"one number, or True or False, of each of {count} runs, shape ({count},)"
            kind = f"{numbers.dtype} of shape {numbers.shape}"
            raise ControlError(f"quantity: {name} returned {kind}: must return {limit}")
        self._seen["binary"] = numbers.dtype.kind == "b"
        return numbers.astype(float)

    def _entry(self, returned: Any) -> Any:
        """Return the numbers in what a function returned: itself, or the entry of a dict."""
        name, entry = self.quantity.name, self.quantity.entry
        if not isinstance(returned, Mapping):
            if entry is None:
                return returned
            raise ControlError(f"quantity: {name} returned no dict, so it has no entry {entry}")
        if entry in returned:
            return returned[entry]
        if entry is None:
            names = ", ".join(map(str, returned))
            raise ControlError(
                f"quantity: {name} returned a dict: name an entry of {names}, as in "
                f"{name}:{next(iter(returned), 'ENTRY')}"
            )
        near = checks.nearest(entry, [str(key) for key in returned])
        raise ControlError(f"quantity: {name} has no entry {checks.quoted(entry)}{near}")

    def error(self, a: Tracks, b: Tracks, scored: np.ndarray | None = None) -> np.ndarray:
        """Return the RMS distance over samples and elements, (starts,).

        scored: the samples that count, (starts, n); by default all. A scalar needs all.
        """
        return rms(self.apart(a, b), None if self.quantity.is_scalar else scored)

    def largest(self, a: Tracks, b: Tracks, scored: np.ndarray | None = None) -> np.ndarray:
        """Return the largest distance at any sample that counts, (starts,)."""
        return largest(self.apart(a, b), None if self.quantity.is_scalar else scored)

    def range(self, tracks: Tracks) -> float:
        """Return the range of the series over a motion: of the element with the largest one.

        A series that stays constant counts by its value. Raises ValueError if it is always 0.
        """
        if self.quantity.function is not None:
            return _most(np.abs(self.numbers(tracks))) or 1.0
        widths = list[float]()
        for column in self.columns:
            if isinstance(column, Point) and column.axis is None:
                still = tracks.at(0)
                widths.append(_most(column.apart(tracks, still)))
            else:
                values = column.values(tracks)
                finite = values[np.isfinite(values)]
                width = float(np.ptp(finite)) if finite.size else np.nan
                widths.append(max(width, 1e-3 * _most(np.abs(values))))
        width = float(np.nanmax(widths)) if np.isfinite(widths).any() else np.nan
        if width == 0:
            raise ValueError(
                f"quantity: {self.quantity.series} is constant in this motion, so it has no error: "
                "name another quantity, or give a motion that changes it"
            )
        return width


@dataclass(frozen=True, eq=False)
class Measures(Measure):
    """Several quantities: an error is the largest of theirs, each relative to its allowed error.

    allowed: the allowed error of each quantity, in its unit; empty until they are requested.
    """

    allowed: tuple[float, ...] = ()

    @classmethod
    def of(
        cls, quantity: Quantity, matter: Matter, elements: Callable[[], Elements], first: int = 0
    ) -> Measures:
        parts = list[Measure]()
        for part in quantity.parts:
            parts.append(Measure.of(part, matter, elements, first))
            first += parts[-1].width
        sources = tuple(source for part in parts for source in part.sources)
        return cls(quantity, matter, (), sources, parts=tuple(parts))

    def sampled(self, times: np.ndarray) -> Measure:
        return replace(self, times=times, parts=tuple(p.sampled(times) for p in self.parts))

    @property
    def unit(self) -> str:
        return ""

    @property
    def requested(self) -> str:
        """The allowed errors in words."""
        return ", ".join(
            f"{part.words(error)} of {part.quantity.name}"
            for part, error in zip(self.parts, self.allowed_errors, strict=True)
        )

    def words(self, value: float) -> str:
        return self.requested if value == 1 else f"{value:.3g}× the allowed error"

    def parse(self, owner: str, name: str, value: object, whole: float) -> float:
        return units.amount(owner, name, value, "", 1.0, "the allowed error")

    @property
    def error_words(self) -> str:
        return "largest relative error"

    @property
    def allowed_errors(self) -> tuple[float, ...]:
        if not self.allowed:
            raise ValueError(
                f"quantity: {self.quantity.name}: several quantities need an error of each "
                "(error=[…]), which `trade` and `Study.run` take"
            )
        return self.allowed

    def _relative(self, errors: Iterable[np.ndarray]) -> np.ndarray:
        return np.max(
            [e / most for e, most in zip(errors, self.allowed_errors, strict=True)], axis=0
        )

    def errors(self, a: Tracks, b: Tracks, scored: np.ndarray | None = None) -> np.ndarray:
        """Return the error of each quantity in its unit, (quantities, starts)."""
        return np.stack([part.error(a, b, scored) for part in self.parts])

    def error(self, a: Tracks, b: Tracks, scored: np.ndarray | None = None) -> np.ndarray:
        return self._relative(self.errors(a, b, scored))

    def largest(self, a: Tracks, b: Tracks, scored: np.ndarray | None = None) -> np.ndarray:
        return self._relative([part.largest(a, b, scored) for part in self.parts])

    @property
    def binaries(self) -> tuple[bool, ...]:
        return tuple(part.binary for part in self.parts)

    def mark(self, binaries: Sequence[bool]) -> None:
        for part, binary in zip(self.parts, binaries, strict=True):
            part.mark([binary])

    def numbers(self, tracks: Tracks, starts: Sequence[int] | None = None) -> np.ndarray:
        """Return the numbers of each run, (starts, quantities)."""
        return np.stack([part.numbers(tracks, starts) for part in self.parts], axis=1)

    def check_scalar(self) -> None:
        for part in self.parts:
            part.check_scalar()


def parameters(quantity: Quantity) -> list[str]:
    """Return the names of the arrays that a function reads, apart from "time".

    Raises ValueError for parameters that cannot be arrays.
    """
    assert quantity.function is not None
    kinds = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    taken = inspect.signature(quantity.function).parameters.values()
    if not taken or any(parameter.kind not in kinds for parameter in taken):
        limit = "its parameters must name the arrays that it reads, such as qpos and time"
        raise ValueError(f"quantity: {quantity.name}: {limit}")
    return [parameter.name for parameter in taken if parameter.name != "time"]


# The unit of an integral over time, where it has a name.
INTEGRALS = {"m/s": "m", "rad/s": "rad", "W": "J"}
_NOTHING = Tracks(np.zeros((0, 0, 0, 3)), np.zeros((0, 0, 0, 4)))


def _most(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.max()) if finite.size else np.nan
