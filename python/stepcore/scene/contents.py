"""`Contents`: the methods of a scene that add elements.

`Scene` derives from `Contents` and adds reading, writing and compiling. Code that reads and fills
scenes, such as `Layout` and the MJCF reader, needs `Contents` alone.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from stepcore import checks, files
from stepcore.scene import frames
from stepcore.scene.element import belongs, table
from stepcore.scene.elements import (
    Actuator,
    Body,
    Element,
    Equality,
    Geom,
    HField,
    Joint,
    Key,
    Mesh,
    Pair,
    Sensor,
    Site,
    Tendon,
    made,
)
from stepcore.scene.elements.sensor import OBJECTS
from stepcore.scene.holdings import Holdings
from stepcore.scene.layout import named

if TYPE_CHECKING:
    from typing import Unpack

    from numpy.typing import ArrayLike

    from stepcore.scene import fields as of
    from stepcore.scene.fields import Numbers, Vector

E = TypeVar("E", bound=Element)

# By kind of element that a sensor can observe: the scene's list of these elements.
_LISTS = {
    **{"site": "sites", "body": "bodies", "geom": "geoms", "joint": "joints"},
    **{"tendon": "tendons", "actuator": "actuators"},
}


class Contents(Holdings):
    """The elements and settings of a `Scene`, which documents them."""

    def add_body(
        self,
        name: str = "",
        parent: str | Body = "world",
        pos: Vector = frames.ORIGIN,
        quat: Vector = frames.IDENTITY,
        *,
        mass: float | None = None,
        inertia: Vector | None = None,
        ipos: Vector | None = None,
        iquat: Vector | None = None,
        gravcomp: float = 0.0,
        mocap: bool = False,
        sleep: str = "auto",
    ) -> Body:
        """Add a body.

        name: unique among bodies, or "".
        parent: the parent body, as a name or a `Body`.
        pos, quat: position [m] and orientation (w x y z) in the parent's frame.
        mass: [kg]; None takes mass, centre of mass and inertia from the body's geoms.
        ipos: centre of mass in the body's frame [m].
        inertia: about the centre of mass, in body axes [kg·m²]: xx yy zz, or xx yy zz xy xz yz.
            A mass without an inertia is a point mass.
        iquat: orientation of the principal axes of the inertia; None computes the axes.
        gravcomp: fraction of the body's weight that a force at the centre of mass compensates.
        mocap: True for a body whose pose is an input.
        sleep: whether the tree may sleep, for the root of a tree: "auto", "never", "allowed" or
            "init".
        """
        weight = {"inertia": inertia, "ipos": ipos, "iquat": iquat}
        fields: dict[str, Any] = {f: value for f, value in weight.items() if value is not None}
        heavy = bool(fields)
        fields |= {"name": name, "parent": self.body(parent), "pos": pos, "quat": quat}
        fields |= {"mass": mass, "gravcomp": gravcomp, "mocap": mocap, "sleep": sleep}
        with self._naming():
            body = Body(**fields)
            if mass is None and heavy:
                raise checks.refuse(body, "mass", None, "given where ipos, inertia or iquat is")
        return self._append(self.bodies, body)

    def add_joint(
        self, body: str | Body, type: str = "hinge", **fields: Unpack[of.JointFields]
    ) -> Joint:
        """Add a joint between a body and its parent.

        body: the body that the joint moves, as a name or a `Body`.
        type: "hinge", "slide", "ball" or "free".
        fields: of `Joint`: name, pos [m], axis, range [rad or m], ref, stiffness [N·m/rad or N/m],
            damping [N·m·s/rad or N·s/m], armature [kg·m² or kg], frictionloss [N·m or N], …
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
        type: "plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box" or "mesh".
        size: [m], up to 3 numbers whose meaning depends on the type; see `Geom`.
        fromto: both end points of a capsule, cylinder, box or ellipsoid [m], shape (6,), in place
            of pos, quat and every size but the first.
        mesh: the mesh of a geom of type "mesh", or the mesh that a primitive is fitted to: a name
            or a `Mesh`.
        hfield: the height field of a geom of type "hfield": a name or an `HField`.
        fields: of `Geom`: name, pos [m], quat, mass [kg], density [kg/m³], friction, condim,
            solref, solimp, …
        """
        own = {"body": body, "type": type, "size": size, "mesh": mesh, "hfield": hfield}
        own = self._resolved(Geom, own)
        with self._naming():
            geom = _make(Geom, fields, **own)
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
        vertices: [m], shape (n, 3).
        faces: indices of vertices, counter-clockwise from outside, shape (m, 3); None takes the
            faces of the convex hull.
        file: in place of vertices and faces, an STL (binary or text), OBJ or MSH file. The file is
            read at once.
        fields: of `Mesh`: scale, refpos [m], refquat, inertia, maxhullvert.

        Raises ValueError for a file that is damaged, is no regular file or has more than 256 MiB,
        FileNotFoundError and IsADirectoryError.
        """
        given: dict[str, Any] = {"vertices": vertices, "faces": faces}
        checks.word("name", name)
        if (file is None) == (vertices is None) or (file is not None and faces is not None):
            raise ValueError(f"mesh {checks.quoted(name)}: needs either vertices or a file")
        if file is not None:
            from stepcore.scene import mesh_files

            file = files.path("file", file)
            surface = mesh_files.read(file)
            given["vertices"], given["faces"] = surface.vertices, surface.faces
            self.notes += mesh_files.notes(file, surface)
            given["file"] = file
            name = name or os.path.splitext(os.path.basename(file))[0]
        return self._add(self.meshes, Mesh, fields, name=name, **given)

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
        elevation: heights of any scale, shape (rows, columns), the first row at the largest y.
        size: half sizes along x and y, height of the highest point, depth of the base [m].
        file: in place of the elevation: a PNG image (read with pillow), or MuJoCo's binary format.

        Raises the errors of `add_mesh`.
        """
        checks.word("name", name)
        if (file is None) == (elevation is None):
            raise ValueError(f"hfield {checks.quoted(name)}: needs either an elevation or a file")
        given: dict[str, Any] = {"elevation": elevation}
        if file is not None:
            from stepcore.scene import hfield_files

            file = files.path("file", file)
            given = {"elevation": hfield_files.read(file), "file": file}
            name = name or os.path.splitext(os.path.basename(file))[0]
        return self._add(self.hfields, HField, {}, name=name, size=size, **given)

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
        fields: of `Tendon`: range, stiffness [N/m], damping [N·s/m], springlength, frictionloss
            [N], armature [kg], …

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
        stops = [self._stop(stop) for stop in path]
        if joints is not None:
            stops += [(self.joint(joint), coef) for joint, coef in joints.items()]
        return self._add(self.tendons, Tendon, fields, name=name, path=stops)

    def _stop(self, stop: Any) -> Any:
        """Return a stop of a tendon's path with names replaced by elements."""
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

        type: "accelerometer", "touch", "jointpos", "framepos", "contact" and so on; docs/sensors.md
            lists the types.
        object: the observed element, as a name or an object: a site, body, geom, joint, tendon or
            actuator, as the type needs.
        reference: the reference frame, or the second end of a distance or a contact.
        fields: of `Sensor`: name, cutoff, objtype, reftype, data, reduce, num, noise.
        """
        checks.one_of(*OBJECTS)("Sensor", "type", type)
        kinds = zip(OBJECTS[type], (("object", object), ("reference", reference)), strict=True)
        ends = {end: self._end(of, end, name) for of, (end, name) in kinds}
        return self._add(self.sensors, Sensor, fields, type=type, **ends)

    def _end(self, kinds: Sequence[str], what: str, name: object) -> Element | None:
        """Return the element of these kinds with this name; return an element unchanged.

        Raises ValueError for an unknown name, with the nearest names, and for a name that elements
        of several kinds have.
        """
        if name is None or isinstance(name, Element):
            return name
        if not kinds:
            raise ValueError(f"{what} = {checks.shown(name)}: a sensor of this type has none")
        every: list[Any] = [end for kind in kinds for end in getattr(self, _LISTS[kind])]
        matches: list[Element] = [end for end in every if name and end.name == name]
        if len(matches) == 1:
            return matches[0]
        words = " or ".join(kinds)
        if matches:
            what = " and ".join(type(end).__name__.lower() for end in matches)
            raise ValueError(
                f"{checks.shown(name)} is the name of a {what}: give the object itself"
            )
        if not isinstance(name, str):
            raise ValueError(
                f"{what} = {checks.shown(name)}: must be the name of a {words}, or one"
            )
        raise ValueError(self._no_such(words, name, [end.name for end in every]))

    def add_actuator(
        self,
        joint: str | Joint | None = None,
        type: str = "motor",
        **fields: Unpack[of.ActuatorFields],
    ) -> Actuator:
        """Add an actuator on a joint or another transmission target.

        joint: a name or a `Joint`.
        type: "motor", "position", "velocity", "intvelocity", "damper", "cylinder", "muscle",
            "adhesion", "pid", "dcmotor", "input", "orientation" or "general".
        jointinparent, tendon, site and refsite, cranksite and slidersite, body: in place of the
            joint, as names or elements; see `Actuator`.
        feeds: the pid, dcmotor or orientation that an "input" feeds.
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

        type: "connect" (two bodies share a point), "weld" (two bodies share a frame), "joint" (the
            position of a hinge or slide is a polynomial of another's, or constant) or "tendon" (the
            same for lengths of tendons).
        body1, body2: names or `Body` objects of a connect or weld; None for body2 is the world.
        anchor: the shared point [m], shape (3,); see `Equality`.
        site1, site2: two sites in place of bodies and anchor.
        joint1, joint2, tendon1, tendon2: the joints of a joint equality, the tendons of a tendon
            equality.
        fields: of `Equality`: name, active, relpose, torquescale, polycoef, solref, solimp.
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
        """Add a pair of geoms that can collide, with contact parameters of the pair's own.

        geom1, geom2: names or `Geom` objects. Masks and `exclude` do not apply to the pair.
        fields: of `Pair`: name, condim, friction, solref, solimp, solreffriction, margin [m], gap
            [m].
        """
        return self._add(self.pairs, Pair, fields, geom1=geom1, geom2=geom2)

    def exclude(self, body1: str | Body, body2: str | Body) -> None:
        """Exclude collisions between the geoms of two bodies, except for explicit pairs."""
        self.excludes.append((self.body(body1), self.body(body2)))

    def _resolved(self, kind: type[Element], fields: Mapping[str, Any]) -> dict[str, Any]:
        """Return fields with the elements for the names of references; None is left out there."""
        rows, found = table(kind), dict(fields)
        for field, value in fields.items():
            refers = rows[field].type.refers if field in rows else ()
            if refers and value is None:
                del found[field]
            elif len(refers) == 1 and isinstance(value, str):
                found[field] = getattr(self, refers[0].lower())(value)
        return found

    @contextlib.contextmanager
    def _naming(self) -> Iterator[None]:
        """Re-raise errors about an element with the name that the whole scene gives the element."""
        try:
            yield
        except checks.ElementError as error:
            raise self._named(error) from None

    def _named(self, error: checks.ElementError) -> checks.ElementError:
        return named(self, error)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy, and register the copy as the owner of the copied elements."""
        self.__dict__.update(state)
        for elements in state.values():
            if isinstance(elements, list):
                for element in elements:
                    if isinstance(element, Element):
                        belongs(element, self)

    def _add(self, into: list[E], kind: type[E], fields: Mapping[str, Any], **own: Any) -> E:
        given, own = (self._resolved(kind, part) for part in (fields, own))
        with self._naming():
            element = _make(kind, given, **own)
        return self._append(into, element)

    def _append(self, into: list[E], element: E) -> E:
        names = self._names_of(type(element).__name__.lower())
        name = element.name  # type: ignore[attr-defined]
        if name and names.taken(into, name):
            raise checks.ElementError(element, "the name is used twice")
        into.append(element)
        names.added(into, element)
        belongs(element, self)
        return element


def _place(geom: Geom, fromto: Vector, fields: Mapping[str, Any]) -> None:
    """Set a geom's size and pose from its two end points."""
    both = [field for field in ("pos", "quat") if field in fields]
    if both:
        raise checks.ElementError(geom, f"{both[0]} and fromto are both given")
    ends = checks.vector(6)(geom, "fromto", fromto)
    try:
        geom.size, geom.pos, geom.quat = frames.from_to(geom.type, ends, geom.size[0])
    except ValueError as error:
        raise checks.ElementError(geom, str(error)) from None


def _make(kind: type[E], fields: Mapping[str, Any], **own: Any) -> E:
    """Return a new element; raise ValueError with the nearest name for an unknown field."""
    known = table(kind)
    for field in fields:
        if field not in known:
            near = checks.nearest(field, known)
            raise ValueError(f"a {kind.__name__.lower()} has no field {checks.quoted(field)}{near}")
    if own.keys() & fields.keys():
        return kind(**own, **fields)  # Raises a TypeError that names the repeated field.
    return made(kind, {**own, **fields})
