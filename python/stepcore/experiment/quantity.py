"""`Quantity`: the quantity of interest, whose error a measurement reports; by default the motion.

A series is a reading of one element over time, such as the position of a site. Its error from one
start is the RMS over the samples that can be predicted, as for the motion. A scalar is one number
of a run, such as the largest force; its error is the difference of that number. Forces and sensors
are read after the step that ends at a sample, as `Sim.contacts` and `Sim.sensordata` are.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stepcore import checks
from stepcore.engine.coordinates import rotated
from stepcore.engine.norm import Matter, Tracks, apart, arc, largest, length, rms
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

    Raises ValueError for a name of another form. Elements are looked up when a study begins.

    >>> Quantity("max(contact/foot)").reduction, Quantity("site/tip").series
    ('max', 'site/tip')
    """

    name: str = MOTION
    reduction: str = field(init=False, compare=False, repr=False)
    series: str = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        name = checks.word("quantity", self.name).strip()
        match = re.fullmatch(r"(\w+)\((.+)\)", name)
        reduction, series = match.groups() if match else ("", name)
        if reduction and reduction not in REDUCTIONS:
            near = checks.nearest(reduction, REDUCTIONS, listed=len(REDUCTIONS))
            raise ValueError(f"quantity: no reduction is called {checks.quoted(reduction)}{near}")
        if reduction and series == MOTION:
            raise ValueError(f"quantity: {name}: the motion has no {reduction}; name an element")
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "reduction", reduction)
        object.__setattr__(self, "series", series.strip())

    @classmethod
    def of(cls, quantity: Quantity | str | None) -> Quantity:
        """Return a quantity, or the one of a name; None is the motion."""
        if isinstance(quantity, Quantity):
            return quantity
        if quantity is not None and not isinstance(quantity, str):
            raise checks.refuse("study", "quantity", quantity, "a name, or a Quantity")
        return cls(quantity or MOTION)

    @property
    def is_motion(self) -> bool:
        return self.name == MOTION


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
        far = length(self.positions(a) - self.positions(b))
        turned = 0.0 if self.shares is not None else arc(a.quat, b.quat)[:, :, self.place]
        return np.asarray(np.hypot(far, self.radius * turned))


@dataclass(frozen=True, eq=False)
class Measure:
    """A quantity of one scene: its distance between two motions, its unit and its range.

    quantity: the quantity. matter: the moving bodies. columns: its series; none for the motion.
    sources: the readings that the engine makes for it. pause: the time between samples [s].
    """

    quantity: Quantity
    matter: Matter
    columns: tuple[Column, ...] = ()
    sources: tuple[Source, ...] = ()
    pause: float = 1.0

    @classmethod
    def of(cls, quantity: Quantity, matter: Matter, elements: Callable[[], Elements]) -> Measure:
        """Look up the elements of a quantity.

        Raises ValueError for elements that the scene lacks, with the nearest names, and for
        elements with different units.
        """
        if quantity.is_motion:
            return cls(quantity, matter)
        columns, sources = list[Column](), list[Source]()
        known = elements()
        for one in known.find(quantity.series):
            if one.body is None:
                columns.append(Column(one.name, one.unit, len(sources)))
                sources.append(one.source)
            elif one.body < 0:
                shares = matter.mass / matter.mass.sum()
                columns.append(Point(one.name, "m", shares=shares, axis=one.axis))
            else:
                place = matter.moving.index(one.body)
                offset, radius = one.offset - matter.ipos[place], float(matter.gyration[place])
                columns.append(Point(one.name, "m", place, offset, radius, one.axis))
        kinds = dict.fromkeys(column.unit for column in columns)
        if len(kinds) > 1:
            both = " and ".join(unit or "no unit" for unit in kinds)
            raise ValueError(f"quantity: {quantity.series} has elements with {both}: name one kind")
        made = cls(quantity, matter, tuple(columns), tuple(sources))
        if quantity.reduction and quantity.reduction != "final":
            for column in columns:
                if isinstance(column, Point) and column.axis is None:
                    column.values(_NOTHING)
        return made

    @property
    def unit(self) -> str:
        """The unit of the quantity and of its errors; "" without one."""
        if self.quantity.is_motion:
            return "m"
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
        kind = "error" if self.quantity.reduction else "RMS error"
        return f"{kind} of {self.quantity.name}"

    @property
    def in_unit(self) -> str:
        """The unit behind a name on an axis or in a heading: " [m]"; "" without a unit."""
        return f" [{self.unit}]" if self.unit else ""

    def apart(self, a: Tracks, b: Tracks) -> np.ndarray:
        """Return the distance at every sample, of every body or element, (starts, n, k).

        A scalar of a run has one sample. The distance is infinite where a run has ended.
        """
        if self.quantity.is_motion:
            return apart(a, b, self.matter)
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
        first, second = (REDUCTIONS[name](column.values(one), self.pause) for one in (a, b))
        return np.abs(first - second)[:, None]

    def error(self, a: Tracks, b: Tracks, scored: np.ndarray | None = None) -> np.ndarray:
        """Return the RMS distance over samples and elements, (starts,).

        scored: the samples that count, (starts, n); by default all. A scalar needs all.
        """
        return rms(self.apart(a, b), None if self.quantity.reduction else scored)

    def largest(self, a: Tracks, b: Tracks, scored: np.ndarray | None = None) -> np.ndarray:
        """Return the largest distance at any sample that counts, (starts,)."""
        return largest(self.apart(a, b), None if self.quantity.reduction else scored)

    def range(self, tracks: Tracks) -> float:
        """Return the range of the series over a motion: of the element with the largest one.

        A series that stays constant counts by its value. Raises ValueError if it is always 0.
        """
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


# The unit of an integral over time, where it has a name.
INTEGRALS = {"m/s": "m", "rad/s": "rad", "W": "J"}
_NOTHING = Tracks(np.zeros((0, 0, 0, 3)), np.zeros((0, 0, 0, 4)))


def _most(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.max()) if finite.size else np.nan
