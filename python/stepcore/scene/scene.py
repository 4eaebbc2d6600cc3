"""`Scene`: the model to simulate, built by hand or read from MJCF by `stepcore.load`."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

from stepcore import checks, files
from stepcore.scene import asset_files, frames, length_ranges
from stepcore.scene.element import belongs, field_rows
from stepcore.scene.elements import (
    GRAVITY,
    WHOLE,
    Actuator,
    Body,
    ContactOverride,
    Element,
    Equality,
    Features,
    Geom,
    HField,
    Joint,
    Key,
    LengthRange,
    MassRules,
    Mesh,
    Pair,
    Sensor,
    Site,
    Tendon,
    make_element,
)
from stepcore.scene.elements.sensor import OBJECTS
from stepcore.scene.layout import LISTS, Layout, relabelled
from stepcore.scene.names import Names
from stepcore.scene.records import check_scene, essence, plain
from stepcore.signatures import takes_settings

if TYPE_CHECKING:
    from typing import Self, Unpack

    from numpy.typing import ArrayLike

    from stepcore import _core
    from stepcore._core import Settings
    from stepcore.engine.model import Model
    from stepcore.engine.sim import Sim
    from stepcore.mjcf.nodes import Source
    from stepcore.scene import fields as of
    from stepcore.scene.fields import Numbers, Vector
    from stepcore.signatures import SettingsFields
    from stepcore.viewing.live import View

E = TypeVar("E", bound=Element)
T = TypeVar("T")


class _Checked(Generic[T]):
    """A descriptor of a value of the whole scene that is checked on assignment."""

    def __init__(self, check: checks.Check, doc: str) -> None:
        self._check, self.__doc__ = check, doc

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, scene: None, owner: type) -> Self: ...
    @overload
    def __get__(self, scene: Scene, owner: type) -> T: ...
    def __get__(self, scene: Scene | None, owner: type) -> Self | T:
        if scene is None:
            return self
        value: T = getattr(scene, f"_{self._name}")
        return value

    def __set__(self, scene: Scene, value: Vector | float) -> None:
        setattr(scene, f"_{self._name}", self._check("scene", self._name, value))


class Scene(checks.KnownNames):
    """A description of bodies, joints, geoms and forces, in SI units.

    gravity: acceleration [m/s²], shape (3,).
    name: any text.

    The ``add_…`` methods add elements in any order. Elements refer to each other by name or by the
    object that ``add_…`` returned. Their fields can be read and assigned. Names, defaults and
    conventions are MuJoCo's; `Body`, `Joint`, `Geom`, `Mesh`, `HField`, `Site`, `Tendon`,
    `Actuator`, `Equality`, `Pair` and `Key` document the fields with their units.

    Every assignment is checked. A bad value raises a ValueError that names the element, the field,
    the value and the limit. An unknown name raises a ValueError that lists the nearest names.

    bodies, joints, geoms, meshes, hfields, sites, tendons, sensors, actuators, equalities, pairs,
        keys: lists of the elements; ``bodies[0]`` is the world.
    excludes: pairs of bodies that do not collide, except for geoms in `pairs`.
    contact_override: contact parameters that replace the parameters of every contact
        (`ContactOverride`).
    mass_rules: how body masses follow from geoms (`MassRules`: MJCF's ``<compiler>``).
    lengthrange: how `compile` finds the length range of muscles that do not give a range
        (`LengthRange`: MJCF's ``<lengthrange>``); `compile` runs a simulation for this.
    features: the physical effects that the model includes (`Features`: MJCF's ``<flag>``).
    options: the fields of `Settings` that the scene sets; see `settings`.
    ignored: elements of the file that cannot change the motion, one line each.
    notes: translations made by the reader, one line each.
    without: kinds of elements that were left out of the file on purpose, with their number; see
        `stepcore.load`.
    fused: name of each body of the file that the reader merged into another body (fixed links of a
        URDF, MJCF's ``fusestatic``), with the name of that other body; see `stepcore.load`.

    >>> scene = Scene()
    >>> ball = scene.add_body("ball", pos=(0, 0, 1))
    >>> _ = scene.add_joint(ball, "free")
    >>> _ = scene.add_geom(ball, "sphere", 0.1, mass=1.0)
    >>> _ = scene.add_geom("world", "plane", name="floor")
    >>> scene
    <Scene: 1 body, 1 joint (nq 7, nv 6), 2 geoms>
    """

    _attributes = (
        *("name", "bodies", "joints", "geoms", "sites", "tendons", "actuators", "equalities"),
        *("sensors", "keys", "meshes", "hfields", "excludes", "pairs", "contact_override"),
        *("mass_rules", "lengthrange", "features", "density", "viscosity", "wind", "magnetic"),
        *("options", "ignored", "notes", "without", "fused"),
    )

    def __init__(self, gravity: Vector = GRAVITY, name: str = "") -> None:
        for field, value in (WHOLE | {"gravity": gravity}).items():
            setattr(self, field, value)
        self.name = checks.text("scene", "name", name)
        self.bodies: list[Body] = [Body(name="world")]
        self.joints: list[Joint] = []
        self.geoms: list[Geom] = []
        self.meshes: list[Mesh] = []
        self.hfields: list[HField] = []
        self.sites: list[Site] = []
        self.tendons: list[Tendon] = []
        self.sensors: list[Sensor] = []
        self.actuators: list[Actuator] = []
        self.equalities: list[Equality] = []
        self.keys: list[Key] = []
        self.excludes: list[tuple[Body, Body]] = []
        self.pairs: list[Pair] = []
        self.contact_override = ContactOverride()
        self.mass_rules = MassRules()
        self.lengthrange = LengthRange()
        self.features = Features()
        self.options: dict[str, Any] = {}
        self.ignored: list[str] = []
        self.notes: list[str] = []
        self.without: list[str] = []
        self.fused: dict[str, str] = {}
        # The MJCF source text, so that saving can keep it.
        self._source: Source | None = None
        self._powered = False  # whether motors were made that its file does not have
        # The last compiled model and the hash of its scene: a cache of `Model`.
        self._compiled: tuple[bytes, _core.Model] | None = None
        # An index of each list: building a large scene needs no linear searches.
        self._names: dict[str, Names] = {}

    gravity = _Checked[frames.Vec](
        checks.vector(3), "Gravitational acceleration [m/s²], shape (3,)."
    )
    density = _Checked[float](
        checks.real(low=0), "Density of the fluid around the bodies [kg/m³], >= 0."
    )
    viscosity = _Checked[float](
        checks.real(low=0), "Viscosity of the fluid around the bodies [Pa·s], >= 0."
    )
    wind = _Checked[frames.Vec](
        checks.vector(3), "Velocity of the fluid around the bodies [m/s], shape (3,)."
    )
    magnetic = _Checked[frames.Vec](
        checks.vector(3), "Magnetic flux, which magnetometers read [T], shape (3,)."
    )

    @property
    def world(self) -> Body:
        """The world: the root of the body tree, which does not move."""
        return self.bodies[0]

    def body(self, name: str | Body) -> Body:
        """Return the body with this name; raise ValueError with the nearest names otherwise."""
        return self._find(self.bodies, "body", name)

    def joint(self, name: str | Joint) -> Joint:
        """Return the joint with this name."""
        return self._find(self.joints, "joint", name)

    def geom(self, name: str | Geom) -> Geom:
        """Return the geom with this name."""
        return self._find(self.geoms, "geom", name)

    def mesh(self, name: str | Mesh) -> Mesh:
        """Return the mesh with this name."""
        return self._find(self.meshes, "mesh", name)

    def hfield(self, name: str | HField) -> HField:
        """Return the height field with this name."""
        return self._find(self.hfields, "hfield", name)

    def site(self, name: str | Site) -> Site:
        """Return the site with this name."""
        return self._find(self.sites, "site", name)

    def tendon(self, name: str | Tendon) -> Tendon:
        """Return the tendon with this name."""
        return self._find(self.tendons, "tendon", name)

    def sensor(self, name: str | Sensor) -> Sensor:
        """Return the sensor with this name."""
        return self._find(self.sensors, "sensor", name)

    def actuator(self, name: str | Actuator) -> Actuator:
        """Return the actuator with this name."""
        return self._find(self.actuators, "actuator", name)

    def equality(self, name: str | Equality) -> Equality:
        """Return the equality with this name."""
        return self._find(self.equalities, "equality", name)

    def pair(self, name: str | Pair) -> Pair:
        """Return the explicit pair with this name."""
        return self._find(self.pairs, "pair", name)

    def key(self, name: str | Key) -> Key:
        """Return the keyframe with this name."""
        return self._find(self.keys, "key", name)

    def _find(self, elements: Sequence[E], kind: str, name: object) -> E:
        """Return the element with this name, or the given element if the list contains it."""
        element: E | None = self._names.setdefault(kind, Names()).find(elements, name)
        if element is not None:
            return element
        if isinstance(name, str):
            names = [e.name for e in elements]  # type: ignore[attr-defined]
            raise ValueError(self._no_such(kind, name, names))
        if isinstance(name, Element):
            raise ValueError(f"{name} is not a {kind} of this scene")
        limit = f"a name or a {kind.capitalize()}"
        raise ValueError(f"{kind} = {checks.shown(name)}: must be {limit}")

    def _no_such(self, noun: str, name: str, names: Sequence[str]) -> str:
        """Return the error text for an unknown name: the nearest names.

        For the name of a fused body the text names the body that contains it now.
        """
        text = f"no {noun} is named {checks.quoted(name)}"
        if "body" not in noun.split() or name not in self.fused:
            return text + checks.nearest(name, names)
        into = self.fused[name]
        owner = f"body {checks.quoted(into)}" if into else "a body without a name"
        return (
            f"{text}: nothing moves it against {owner}, of which it is a part; "
            "load(..., fuse=False) keeps it a body of its own"
        )

    # Settings.

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_compiled": None}

    @property
    def settings(self) -> Settings:
        """The scene's `Settings`: its `options`, and defaults for all other fields.

        Raises ValueError for an option that is not a field of `Settings`, or is out of range.
        """
        from stepcore._core import Settings

        for field in self.options:
            if not isinstance(field, str):
                raise ValueError(f"settings: {checks.shown(field)} must be the name of a field")
        return Settings(**self.options)

    @settings.setter
    def settings(self, value: Settings) -> None:
        if not hasattr(value, "as_dict"):
            raise checks.refuse("scene", "settings", value, "a Settings (with_settings: or a dict)")
        self.options = value.as_dict()

    @takes_settings
    def with_settings(
        self,
        settings: Settings | Mapping[str, Any] | None = None,
        **fields: Unpack[SettingsFields],
    ) -> Self:
        """Return a copy of the scene with other settings.

        settings: a `Settings`, which replaces all fields, or a dict of fields.
        fields: single fields of `Settings`.

        Raises ValueError for an unknown field, or a value outside its limits.
        """
        scene = copy.deepcopy(self)
        values = {**settings, **fields} if isinstance(settings, Mapping) else fields
        if settings is not None and not isinstance(settings, Mapping):
            scene.settings = settings
        if "tolerance" in values:
            # A tolerance given as an argument replaces the file's.
            scene.options.pop("cost_tolerance", None)
        scene.options.update(values)
        _ = scene.settings  # Raises for unknown fields and bad values.
        return scene

    # Elements are added.

    def add_body(
        self,
        name: str = "",
        parent: str | Body = "world",
        pos: Vector = frames.ORIGIN,
        quat: Vector = frames.IDENTITY,
        **fields: Unpack[of.BodyFields],
    ) -> Body:
        """Add a body.

        name: unique among bodies, or "".
        parent: the parent body, as a name or a `Body`.
        pos, quat: position [m] and orientation (w x y z) in the parent's frame.
        fields: of `Body`: mass [kg], ipos [m], inertia [kg·m²], iquat, gravcomp, mocap, sleep.
            Without a mass, mass, centre of mass and inertia follow from the body's geoms. A mass
            without an inertia is a point mass.
        """
        optional = {field: value for field, value in fields.items() if value is not None}
        arguments = {"name": name, "parent": self.body(parent), "pos": pos, "quat": quat}
        with self._naming():
            body = _make(Body, optional, **arguments)
            body.check_mass()
        return self._append(self.bodies, body)

    def add_joint(
        self, body: str | Body, type: str = "hinge", **fields: Unpack[of.JointFields]
    ) -> Joint:
        """Add a joint between a body and its parent.

        body: the body that the joint moves, as a name or a `Body`.
        type: "hinge", "slide", "ball" or "free".
        fields: of `Joint`: name, pos [m], axis, range [rad or m], ref, …
        """
        return self._add(self.joints, Joint, fields, body=body, type=type)

    def add_geom(
        self,
        body: str | Body = "world",
        type: str = "sphere",
        size: Numbers = (0.0, 0.0, 0.0),
        *,
        fromto: Vector | None = None,
        mesh: str | Mesh | None = None,
        hfield: str | HField | None = None,
        **fields: Unpack[of.GeomFields],
    ) -> Geom:
        """Add a shape to a body.

        body: the body that the geom is fixed to, as a name or a `Body`.
        type, size: see `Geom`.
        fromto: both end points of a capsule, cylinder, box or ellipsoid [m], shape (6,), in place
            of pos, quat and every size but the first.
        mesh, hfield: as names or objects; see `Geom`.
        fields: of `Geom`: name, pos [m], quat, mass [kg], density [kg/m³], friction, …
        """
        arguments = {"body": body, "type": type, "size": size, "mesh": mesh, "hfield": hfield}
        arguments = self._resolved(Geom, arguments)
        with self._naming():
            geom = _make(Geom, fields, **arguments)
            if fromto is not None:
                _place(geom, fromto, fields)
        return self._append(self.geoms, geom)

    def add_mesh(
        self,
        name: str = "",
        vertices: ArrayLike | None = None,
        faces: ArrayLike | None = None,
        *,
        file: str | os.PathLike[str] | None = None,
        **fields: Unpack[of.MeshFields],
    ) -> Mesh:
        """Add a mesh that geoms can refer to. Only the convex hull of a mesh collides.

        name: unique among meshes; "" takes the name of the file.
        vertices, faces: [m], shape (n, 3), and indices of vertices, shape (m, 3); see `Mesh`.
        file: in place of vertices and faces, an STL (binary or text), OBJ or MSH file. The file is
            read at once.
        fields: of `Mesh`: scale, refpos [m], refquat, inertia, maxhullvert.

        Raises ValueError for a file that is damaged, is no regular file or has more than 256 MiB,
        FileNotFoundError and IsADirectoryError.
        """
        arrays: dict[str, Any] = {"vertices": vertices, "faces": faces}
        checks.word("name", name)
        if (file is None) == (vertices is None) or (file is not None and faces is not None):
            raise ValueError(f"mesh {checks.quoted(name)}: needs either vertices or a file")
        if file is not None:
            file = files.as_path("file", file)
            surface = asset_files.read_mesh(file)
            arrays["vertices"], arrays["faces"] = surface.vertices, surface.faces
            self.notes += asset_files.notes(file, surface)
            arrays["file"] = file
            name = name or os.path.splitext(os.path.basename(file))[0]
        return self._add(self.meshes, Mesh, fields, name=name, **arrays)

    def add_hfield(
        self,
        name: str = "",
        elevation: ArrayLike | None = None,
        *,
        size: Vector,
        file: str | os.PathLike[str] | None = None,
    ) -> HField:
        """Add a height field that geoms of fixed bodies can refer to.

        name: unique among height fields; "" takes the name of the file.
        elevation, size: see `HField`.
        file: in place of the elevation: a PNG image (read with pillow), or MuJoCo's binary format.

        Raises the errors of `add_mesh`.
        """
        checks.word("name", name)
        if (file is None) == (elevation is None):
            raise ValueError(f"hfield {checks.quoted(name)}: needs either an elevation or a file")
        arrays: dict[str, Any] = {"elevation": elevation}
        if file is not None:
            file = files.as_path("file", file)
            arrays = {"elevation": asset_files.read_hfield(file), "file": file}
            name = name or os.path.splitext(os.path.basename(file))[0]
        return self._add(self.hfields, HField, {}, name=name, size=size, **arrays)

    def add_site(self, body: str | Body = "world", **fields: Unpack[of.SiteFields]) -> Site:
        """Add a site, a named frame on a body.

        body: the body that the site is fixed to, as a name or a `Body`.
        fields: of `Site`: name, pos [m], quat, type, size [m].
        """
        return self._add(self.sites, Site, fields, body=body)

    def add_tendon(
        self,
        name: str = "",
        path: Iterable[Any] = (),
        joints: Mapping[str | Joint, float] | None = None,
        **fields: Unpack[of.TendonFields],
    ) -> Tendon:
        """Add a fixed tendon over joints, or a spatial tendon through sites and around geoms.

        name: unique among tendons, or "".
        joints: the joints of a fixed tendon, with their coefficients.
        path: in place of joints, the stops of a spatial tendon: a site; (a geom, a side site or
            None) for a sphere or cylinder; a `Pulley`, which starts a branch. Sites and geoms are
            names or `Site` and `Geom` objects; a name alone means a site.
        fields: of `Tendon`: range, stiffness [N/m], damping [N·s/m], springlength, …

        >>> from stepcore import Scene, Sim
        >>> scene = Scene()
        >>> ball = scene.add_body("ball", pos=(0, 0, -1))
        >>> _ = scene.add_joint(ball, "slide", axis=(0, 0, 1))
        >>> _ = scene.add_geom(ball, "sphere", 0.1, mass=1.0)
        >>> hook, knot = scene.add_site(name="hook"), scene.add_site(ball, name="knot")
        >>> _ = scene.add_tendon("rope", ["hook", "knot"], stiffness=100)
        >>> float(Sim(scene).tendon("rope").length)
        1.0
        """
        coefficients = checks.mapping(
            "joints", {} if joints is None else joints, "joints and coefficients"
        )
        stops = [self._stop(stop) for stop in path]
        stops += [(self.joint(joint), coef) for joint, coef in coefficients.items()]
        return self._add(self.tendons, Tendon, fields, name=name, path=stops)

    def _stop(self, stop: Any) -> Any:
        match stop:
            case str():
                return self.site(stop)
            case (str() as geom, sidesite) | (Geom() as geom, sidesite):
                return self.geom(geom), None if sidesite is None else self.site(sidesite)
        return stop

    def add_sensor(
        self,
        type: str,
        object: str | Element | None = None,
        reference: str | Element | None = None,
        **fields: Unpack[of.SensorFields],
    ) -> Sensor:
        """Add a sensor.

        type: "accelerometer", "touch", "jointpos", and so on; docs/sensors.md lists the types.
        object, reference: the ends that the type needs, as names or elements; see `Sensor`.
        fields: of `Sensor`: name, cutoff, objtype, reftype, data, reduce, num, noise.
        """
        checks.one_of(*OBJECTS)("Sensor", "type", type)
        kinds = zip(OBJECTS[type], (("object", object), ("reference", reference)), strict=True)
        ends = {end: self._end(kind, end, name) for kind, (end, name) in kinds}
        return self._add(self.sensors, Sensor, fields, type=type, **ends)

    def _end(self, kinds: Sequence[str], role: str, name: object) -> Element | None:
        """Return the element of these kinds with this name; return an element unchanged.

        Raises ValueError for an unknown name, with the nearest names, and for a name that elements
        of several kinds have.
        """
        if name is None or isinstance(name, Element):
            return name
        if not kinds:
            raise ValueError(f"{role} = {checks.shown(name)}: a sensor of this type has none")
        every: list[Any] = [end for kind in kinds for end in getattr(self, LISTS[kind])]
        matches: list[Element] = [end for end in every if name and end.name == name]
        if len(matches) == 1:
            return matches[0]
        words = " or ".join(kinds)
        if matches:
            role = " and ".join(type(end).__name__.lower() for end in matches)
            raise ValueError(
                f"{checks.shown(name)} is the name of a {role}: give the object itself"
            )
        if not isinstance(name, str):
            raise ValueError(
                f"{role} = {checks.shown(name)}: must be the name of a {words}, or one"
            )
        raise ValueError(self._no_such(words, name, [end.name for end in every]))

    def add_actuator(
        self,
        joint: str | Joint | None = None,
        type: str = "motor",
        **fields: Unpack[of.ActuatorFields],
    ) -> Actuator:
        """Add an actuator on a joint or another transmission target.

        joint: a name or a `Joint`; a field of `Actuator` may name another target in its place.
        type: "motor", "position", "velocity" and so on; see `Actuator`.
        fields: of `Actuator`: name, gear, kp, kv, dampratio, ctrlrange, forcerange [N or N·m], …
        """
        return self._add(self.actuators, Actuator, fields, joint=joint, type=type)

    def add_equality(
        self,
        type: str = "connect",
        body1: str | Body | None = None,
        body2: str | Body | None = None,
        anchor: Vector = frames.ORIGIN,
        **fields: Unpack[of.EqualityFields],
    ) -> Equality:
        """Add a constraint between two bodies, two joints or two tendons.

        type: "connect", "weld", "joint" or "tendon"; see `Equality`.
        body1, body2: names or `Body` objects of a connect or weld; None for body2 is the world.
        anchor: the shared point [m], shape (3,).
        fields: of `Equality`: name, active, site1, site2, joint1, joint2, relpose, polycoef, …
        """
        bodies = {"body1": body1, "body2": body2}
        return self._add(self.equalities, Equality, fields, type=type, anchor=anchor, **bodies)

    def add_key(self, name: str = "", **fields: Unpack[of.KeyFields]) -> Key:
        """Add a keyframe, a named state.

        name: unique among keyframes, or "".
        fields: of `Key`: time [s], qpos, qvel, act and ctrl in the compiled model's order.
        """
        return self._add(self.keys, Key, fields, name=name)

    def add_pair(
        self, geom1: str | Geom, geom2: str | Geom, **fields: Unpack[of.PairFields]
    ) -> Pair:
        """Add a pair of geoms that can collide, with contact parameters for this pair.

        geom1, geom2: names or `Geom` objects. Masks and `exclude` do not apply to the pair.
        fields: of `Pair`: name, condim, friction, solref, solimp, margin [m], gap [m], …
        """
        return self._add(self.pairs, Pair, fields, geom1=geom1, geom2=geom2)

    def exclude(self, body1: str | Body, body2: str | Body) -> None:
        """Exclude collisions between the geoms of two bodies, except for explicit pairs."""
        self.excludes.append((self.body(body1), self.body(body2)))

    def _resolved(self, kind: type[Element], fields: Mapping[str, Any]) -> dict[str, Any]:
        """Return fields with the elements for the names of references; None is a default."""
        rows, resolved = field_rows(kind), dict(fields)
        for field, value in fields.items():
            refers = rows[field].type.refers if field in rows else ()
            if refers and value is None and rows[field].default is not dataclasses.MISSING:
                del resolved[field]
            elif len(refers) == 1 and isinstance(value, str):
                resolved[field] = getattr(self, refers[0].lower())(value)
        return resolved

    @contextlib.contextmanager
    def _naming(self) -> Iterator[None]:
        """Re-raise errors about an element with the name that the whole scene gives the element."""
        try:
            yield
        except checks.ElementError as error:
            raise self._named(error) from None

    def _named(self, error: checks.ElementError) -> checks.ElementError:
        return relabelled(self, error)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy, and register the copy as the owner of the copied elements."""
        self.__dict__.update(state)
        for elements in state.values():
            if isinstance(elements, list):
                for element in elements:
                    if isinstance(element, Element):
                        belongs(element, self)

    def _add(self, into: list[E], kind: type[E], fields: Mapping[str, Any], **fixed: Any) -> E:
        resolved, fixed = (self._resolved(kind, part) for part in (fields, fixed))
        with self._naming():
            element = _make(kind, resolved, **fixed)
        return self._append(into, element)

    def _append(self, into: list[E], element: E) -> E:
        name = element.name  # type: ignore[attr-defined]
        names = self._names.setdefault(type(element).__name__.lower(), Names())
        if name and names.taken(into, name):
            raise checks.ElementError(element, "the name is used twice")
        into.append(element)
        belongs(element, self)
        return element

    def compile(self) -> Model:
        """Compile the scene to a `Model`.

        Raises ValueError for a scene that cannot be compiled, and names the element. Raises
        ValueError if the model and one world do not fit into memory, and names the largest demand.
        """
        from stepcore.engine.model import Model

        return Model(self)

    def view(self, *, host: str = "localhost", port: int = 8080, wait: bool | None = None) -> View:
        """Open a live view of the scene, from its first keyframe; see `Sim.view`.

        Raises the errors of `compile`.
        """
        return self._begun().view(host=host, port=port, wait=wait)

    def _begun(self) -> Sim:
        """Return a `Sim` of the scene, at the first keyframe if the scene has one."""
        from stepcore.engine.sim import Sim

        sim = Sim(self)
        if sim.model.keys:
            sim.reset(key=0)
        return sim

    def to_dict(self) -> dict[str, Any]:
        """Return the scene as plain data for the engine, with indices for references.

        Raises ValueError for errors that need the whole scene to be detected: a range on a free
        joint, a plane on a moving body, a key of the wrong length, a name used twice.
        """
        layout = Layout(self)
        check_scene(layout)
        data = plain(layout)
        length_ranges.fill_ranges(self, data)
        return data

    def to_mjcf(self) -> str:
        """Return the scene, with its settings, as an MJCF text.

        Angles are in radians, numbers are exact and defaults are left out. Settings that MJCF lacks
        are written to ``<custom>``, which `stepcore.loads` reads: ``loads(scene.to_mjcf()) ==
        scene``. Elements of the scene's file that only draw or sense are not written; a comment
        counts them.

        Raises ValueError for a scene that MJCF cannot express: a scene that cannot be compiled, a
        world with a mass or another name, a name with control characters.

        >>> scene = Scene(gravity=(0, 0, -1.62))
        >>> ball = scene.add_body("ball", pos=(0, 0, 1))
        >>> _ = scene.add_joint(ball, "free")
        >>> _ = scene.add_geom(ball, "sphere", 0.1)
        >>> scene.options["integrator"] = "midpoint"
        >>> print(scene.to_mjcf())
        <mujoco>
          <compiler angle="radian"/>
          <option gravity="0 0 -1.62"/>
          <worldbody>
            <body name="ball" pos="0 0 1">
              <joint type="free"/>
              <geom size="0.1"/>
            </body>
          </worldbody>
          <custom>
            <text name="stepcore" data="integrator=midpoint"/>
          </custom>
        </mujoco>
        <BLANKLINE>
        """
        from stepcore.mjcf.writer import written

        return written(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the scene to an MJCF file, so that ``load(path) == scene``.

        A scene that was read from a file, and whose settings or name alone have changed, keeps the
        file's own text with includes, comments and meshes; only ``<option>``, ``<flag>`` and
        ``<custom>`` are edited. (If the text names other files, `path` must be in their folder.)
        Every other scene is written as by `to_mjcf`.

        Raises the errors of `to_mjcf`, and OSError.
        """
        from stepcore.mjcf.writer import save

        save(self, path)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Scene):
            return NotImplemented
        if self.options != other.options:
            from stepcore._core import Settings

            default = Settings().as_dict()
            if default | self.options != default | other.options:
                return False
        return essence(Layout(self)) == essence(Layout(other))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        layout = Layout(self)
        order = dict.fromkeys((*list(LISTS)[:7], "sensor", *LISTS))
        counts = {kind: len(getattr(self, LISTS[kind])) for kind in order}
        counts["body"] -= 1
        # Imported here because only printing needs it.
        from stepcore.report.units import counted

        always = ("body", "joint")
        parts = [counted(n, kind) for kind, n in counts.items() if n or kind in always]
        if self.joints:
            parts[1] += f" (nq {layout.nq}, nv {layout.nv})"
        options = [f"{key}={value!r}" for key, value in self.options.items()]
        name = f" {checks.quoted(self.name)}" if self.name else ""
        return f"<Scene{name}: {', '.join(parts)}{'; ' + ', '.join(options) if options else ''}>"

    def _repr_html_(self) -> str | None:
        """Return HTML for a notebook, with a picture of the scene if a picture can be drawn."""
        from stepcore.viewing.notebook import html_picture

        return html_picture(self, len(self.geoms), self._begun)


def _place(geom: Geom, fromto: Vector, fields: Mapping[str, Any]) -> None:
    both = [field for field in ("pos", "quat") if field in fields]
    if both:
        raise checks.ElementError(geom, f"{both[0]} and fromto are both given")
    ends = checks.vector(6)(geom, "fromto", fromto)
    try:
        geom.size, geom.pos, geom.quat = frames.from_to(geom.type, ends, geom.size[0])
    except ValueError as error:
        raise checks.ElementError(geom, str(error)) from None


def _make(kind: type[E], fields: Mapping[str, Any], **fixed: Any) -> E:
    rows = field_rows(kind)
    for field in fields:
        if field not in rows:
            near = checks.nearest(field, rows)
            raise ValueError(f"a {kind.__name__.lower()} has no field {checks.quoted(field)}{near}")
    if fixed.keys() & fields.keys():
        return kind(**fixed, **fields)  # Raises a TypeError that names the repeated field.
    return make_element(kind, {**fixed, **fields})
