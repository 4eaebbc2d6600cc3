"""`Elements`: the named elements of a scene, in either engine, of which quantities are read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np

from stepcore import checks
from stepcore.engine.axes import POSITIONS, VELOCITIES
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.trajectory import OF_WORLDS, recordable

# The parts of a position.
PARTS = ("x", "y", "z")
# The kinds of series, with what follows the name of the element.
KINDS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(("body", "site", "geom"), ("", *PARTS)),
    "joint": ("", "velocity"),
    "actuator": ("force",),
    **dict.fromkeys(("tendon", "sensor", "contact"), ("",)),
}
WHOLE = ("com", "energy")
FORMS = (
    "body/NAME, site/NAME, geom/NAME, joint/NAME, joint/NAME/velocity, actuator/NAME/force, "
    "tendon/NAME, sensor/NAME, contact/A, contact/A/B, com, energy"
)
# The units of sensors by type; other types have several, or none.
_UNITS = {
    "N": "touch force actuatorfrc jointlimitfrc tendonactuatorfrc tendonlimitfrc",
    "N·m": "torque",
    "m": "rangefinder distance framepos subtreecom fromto tendonpos",
    "m/s": "velocimeter framelinvel subtreelinvel tendonvel",
    "rad/s": "gyro frameangvel ballangvel",
    "m/s²": "accelerometer framelinacc",
    "rad/s²": "frameangacc",
    "J": "e_potential e_kinetic",
}
SENSOR_UNITS = {kind: unit for unit, kinds in _UNITS.items() for kind in kinds.split()}


class Source(NamedTuple):
    """A reading: the sum of some entries of an array; of "contacts" by sets of geoms.

    Without indices it is the whole array, one reading of each entry.

    indices: of the entries. geoms: of the first element, and of the other one or None for any.
    """

    array: str
    indices: tuple[int, ...] = ()
    geoms: tuple[frozenset[int], frozenset[int] | None] = (frozenset(), None)


class Series(NamedTuple):
    """A series of an element: a reading; or a point of a moving body, or one of its coordinates.

    body: None for a reading, −1 for the centre of mass of all bodies. offset: of the point from the
    body's frame [m], (3,).
    """

    name: str
    unit: str = "m"
    source: Source = Source("")
    body: int | None = None
    offset: Any = None
    axis: int | None = None


@dataclass(frozen=True, eq=False)
class Elements:
    """The elements of a scene.

    names: of the elements, by kind. moving: indices of the bodies that move.
    joints: type, first coordinate and first dof of each. forces: the units of the actuators.
    points: the body, and the position in its frame [m], of each body, site and geom, by kind.
    sensors: type, first value and number of values of each. tendons: the units of their lengths.
    shape: returns the shape of an array by its name; ValueError for one that cannot be recorded.
    """

    names: Mapping[str, Sequence[str]]
    moving: Sequence[int]
    joints: Sequence[tuple[str, int, int]]
    forces: Sequence[str]
    points: Mapping[str, Sequence[tuple[int, np.ndarray]]]
    sensors: Sequence[tuple[str, int, int]]
    tendons: Sequence[str]
    shape: Callable[[str], tuple[int, ...]]

    def find(self, path: str) -> list[Series]:
        """Return the series of a path or pattern.

        Raises ValueError for a path of another form, and for elements that the scene lacks or that
        do not move, with the nearest names.
        """
        kind, slash, rest = path.partition("/")
        if path == "energy":
            return [Series(path, "J", Source(path, (0, 1)))]
        if kind == "com":
            if rest and rest not in PARTS:
                raise ValueError(f"quantity: {path}: must be com, com/x, com/y or com/z")
            return [Series(path, body=-1, axis=PARTS.index(rest) if rest else None)]
        if kind not in KINDS or not rest:
            near = checks.nearest(path if slash else kind, [*KINDS, *WHOLE, "motion"])
            shown = checks.quoted(checks.cut(path))
            raise ValueError(f"quantity: {shown} is no series{near}; the forms are {FORMS}")
        if kind == "contact":
            return [self._contact(path, rest)]
        indices, part = self._split(path, kind, rest)
        if kind in self.points:
            return list(self._points(path, kind, indices, part))
        return list(getattr(self, f"_{kind}")(path, indices, part))

    def _split(self, path: str, kind: str, rest: str) -> tuple[list[int], str]:
        """Return the indices of the elements that a path names, and its part."""
        parts = KINDS[kind]
        head, _, last = rest.rpartition("/")
        if "" in parts and (indices := self._named(kind, rest)):
            return indices, ""
        if last in parts and head and (indices := self._named(kind, head)):
            return indices, last
        if "" not in parts and self._named(kind, rest):
            raise ValueError(f"quantity: {path}: must be {path}/{parts[0]}")
        wanted = head if last in parts and head else rest
        names = [name for name in self.names[kind] if name]
        near = checks.nearest(wanted, names) if names else f": the scene has no {kind}"
        raise ValueError(f"quantity: {path}: no {kind} is named {checks.quoted(wanted)}{near}")

    def _named(self, kind: str, pattern: str) -> list[int]:
        """Return the indices of the elements with a name, or else that match a pattern."""
        names = self.names[kind]
        exact = [k for k, name in enumerate(names) if name == pattern]
        return exact or [k for k, name in enumerate(names) if name and fnmatchcase(name, pattern)]

    def _points(self, path: str, kind: str, indices: list[int], part: str) -> Iterator[Series]:
        """Yield the points that move; of a pattern, others are left out."""
        moving = [k for k in indices if self.points[kind][k][0] in self.moving]
        if not moving:
            raise ValueError(f"quantity: {path}: it does not move")
        for k in moving:
            body, offset = self.points[kind][k]
            name = "/".join(filter(None, (kind, self.names[kind][k], part)))
            axis = PARTS.index(part) if part else None
            yield Series(name, body=body, offset=offset, axis=axis)

    def _joint(self, path: str, indices: list[int], part: str) -> Iterator[Series]:
        scalar = [k for k in indices if self.joints[k][0] in ("hinge", "slide")]
        if not scalar:
            kind = self.joints[indices[0]][0]
            raise ValueError(
                f"quantity: {path}: a {kind} joint has no single position: name its body"
            )
        for k in scalar:
            kind, qpos, dof = self.joints[k]
            units, array = (VELOCITIES, "qvel") if part else (POSITIONS, "qpos")
            name = "/".join(filter(None, ("joint", self.names["joint"][k], part)))
            yield Series(name, units[kind][0], Source(array, (dof if part else qpos,)))

    def _actuator(self, path: str, indices: list[int], part: str) -> Iterator[Series]:
        for k in indices:
            name = f"actuator/{self.names['actuator'][k]}/{part}"
            yield Series(name, self.forces[k], Source("actuator_force", (k,)))

    def _tendon(self, path: str, indices: list[int], part: str) -> Iterator[Series]:
        for k in indices:
            name = f"tendon/{self.names['tendon'][k]}"
            yield Series(name, self.tendons[k], Source("ten_length", (k,)))

    def _sensor(self, path: str, indices: list[int], part: str) -> Iterator[Series]:
        for k in indices:
            kind, first, count = self.sensors[k]
            for place in range(count):
                name = f"sensor/{self.names['sensor'][k]}" + f".{place}" * (count > 1)
                source = Source("sensordata", (first + place,))
                yield Series(name, SENSOR_UNITS.get(kind, ""), source)

    def _contact(self, path: str, rest: str) -> Series:
        """Return the normal force between two elements; their names may have slashes."""
        parts = rest.split("/")
        for cut in range(len(parts), 0, -1):
            first, second = "/".join(parts[:cut]), "/".join(parts[cut:])
            geoms, others = self._geoms(first), self._geoms(second) if second else None
            if geoms and (others or not second):
                both = frozenset(geoms), None if others is None else frozenset(others)
                return Series(path, "N", Source("contacts", geoms=both))
        lost = next(name for name in (parts[0], rest) if not self._geoms(name))
        names = [name for kind in ("geom", "body") for name in self.names[kind] if name]
        near = checks.nearest(lost, names)
        raise ValueError(f"quantity: {path}: no geom or body is named {checks.quoted(lost)}{near}")

    def _geoms(self, name: str) -> list[int]:
        """Return the geoms of a name or pattern: geoms, or else all geoms of bodies."""
        if geoms := self._named("geom", name):
            return geoms
        bodies = self._named("body", name)
        return [k for k, (body, _) in enumerate(self.points["geom"]) if body in bodies]


def elements_of(model: Model, moving: Sequence[int]) -> Elements:
    """Return the elements of stepcore's model; moving: the bodies that move."""
    sim = unwatched(Sim(model))
    sim.forward()
    frames = sim.xpos, sim.xmat
    points = {
        kind: [
            (int(body), frames[1][body].T @ (place - frames[0][body]))
            for body, place in zip(bodies, places, strict=True)
        ]
        for kind, bodies, places in (
            ("geom", model.geom_body, sim.geom_xpos),
            ("site", model.site_body, sim.site_xpos),
        )
    }
    points["body"] = [(k, np.zeros(3)) for k in range(model.nbody)]
    qpos, dofs = model.jnt_qposadr.tolist(), model.jnt_dofadr.tolist()
    firsts = np.cumsum([0, *model.sensor_dim]).tolist()
    driven = [model.jnt_type[k] if k >= 0 else "" for k in model.actuator_joint.tolist()]
    return Elements(
        names=model.names | {"sensor": model.sensor_names},
        moving=moving,
        joints=list(zip(model.jnt_type, qpos, dofs, strict=True)),
        forces=["N·m" if kind == "hinge" else "N" for kind in driven],
        points=points,
        sensors=list(zip(model.sensor_type, firsts[:-1], model.sensor_dim.tolist(), strict=True)),
        tendons=["" if tendon.fixed else "m" for tendon in model.scene.tendons],
        shape=lambda name: np.shape(getattr(sim, recordable((name,), OF_WORLDS)[0])),
    )


def contact_force(source: Source, pairs: np.ndarray, forces: np.ndarray) -> float:
    """Return the sum of normal forces between two sets of geoms [N].

    pairs: the geoms of each contact, (contacts, 2). forces: the normal forces [N], (contacts,).
    """
    first, others = source.geoms
    total = 0.0
    for (one, two), force in zip(pairs.tolist(), forces.tolist(), strict=True):
        for mine, other in ((one, two), (two, one)):
            if mine in first and (others is None or other in others):
                total += force
                break
    return total


def contact_forces(sim: Sim, sources: Sequence[Source]) -> np.ndarray:
    """Return the normal forces of contacts in a Sim, (sources,), [N]."""
    table = sim.contacts
    pairs = np.stack([table["geom1"], table["geom2"]], axis=-1)
    forces = np.abs((table["force"] * table["normal"]).sum(axis=-1))
    return np.array([contact_force(source, pairs, forces) for source in sources])


def path_in_words(path: str) -> str:
    """Return a path in backquotes, as results name elements."""
    return f"`{path}`"
