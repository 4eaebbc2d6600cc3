"""`Scene`: what is modelled; built by hand or read from MJCF by `stepcore.load`."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from stepcore import checks
from stepcore.scene import frames
from stepcore.scene.elements import (
    GRAVITY,
    Actuator,
    Body,
    Element,
    Equality,
    Features,
    Geom,
    Joint,
    Key,
    MassRules,
    Site,
    fields_of,
)
from stepcore.scene.layout import Layout, check, essence, plain

if TYPE_CHECKING:
    import os
    from typing import Unpack

    from stepcore._core import Settings
    from stepcore.engine.model import Model
    from stepcore.engine.settings_fields import SettingsFields
    from stepcore.mjcf.nodes import Source
    from stepcore.scene.fields import (
        ActuatorFields,
        EqualityFields,
        GeomFields,
        JointFields,
        KeyFields,
        Numbers,
        SiteFields,
        Vector,
    )

E = TypeVar("E", bound=Element)


class Scene(checks.KnownNames):
    """Describes bodies, joints, geoms and what acts on them, in SI units.

    gravity: acceleration [m/s²], shape (3,).
    name: any text.

    Elements are added by the ``add_…`` methods, in any order, and refer to each other by name or
    by the object that ``add_…`` returned. Their fields can be read and assigned. Names, defaults
    and conventions are MuJoCo's; `Body`, `Joint`, `Geom`, `Site`, `Actuator`, `Equality` and `Key`
    document the fields with their units.

    Every value is checked when it is given. A bad value raises a ValueError that names the element,
    the field, the value and the limit; an unknown name raises one that lists the nearest names.

    bodies, joints, geoms, sites, actuators, equalities, keys: lists of the elements;
        ``bodies[0]`` is the world.
    excludes: pairs of bodies that do not collide.
    mass_rules: how masses are made from geoms (`MassRules`: MJCF's ``<compiler>``).
    features: what the model takes into account (`Features`: MJCF's ``<flag>``).
    options: the fields of `Settings` that the scene sets; see `settings`.
    ignored: elements of the file that cannot change the motion, one line each.
    notes: what the reader translated, one line each.

    >>> scene = Scene()
    >>> ball = scene.add_body("ball", pos=(0, 0, 1))
    >>> _ = scene.add_joint(ball, "free")
    >>> _ = scene.add_geom(ball, "sphere", 0.1, mass=1.0)
    >>> _ = scene.add_geom("world", "plane", name="floor")
    >>> scene
    <Scene: 1 body, 1 joint (nq 7, nv 6), 2 geoms>
    """

    _attributes = (
        *("name", "bodies", "joints", "geoms", "sites", "actuators", "equalities", "keys"),
        *("excludes", "mass_rules", "features", "options", "ignored", "notes"),
    )

    def __init__(self, gravity: Vector = GRAVITY, name: str = "") -> None:
        self.gravity = gravity
        self.name = checks.text("scene", "name", name)
        self.bodies: list[Body] = [Body(name="world")]
        self.joints: list[Joint] = []
        self.geoms: list[Geom] = []
        self.sites: list[Site] = []
        self.actuators: list[Actuator] = []
        self.equalities: list[Equality] = []
        self.keys: list[Key] = []
        self.excludes: list[tuple[Body, Body]] = []
        self.mass_rules = MassRules()
        self.features = Features()
        self.options: dict[str, Any] = {}
        self.ignored: list[str] = []
        self.notes: list[str] = []
        # The text that the scene was read from, so that saving can keep it.
        self._source: Source | None = None

    @property
    def gravity(self) -> frames.Vec:
        """Gravitational acceleration [m/s²], shape (3,)."""
        return self._gravity

    @gravity.setter
    def gravity(self, value: Vector) -> None:
        self._gravity: frames.Vec = checks.vector(3)("scene", "gravity", value)

    @property
    def world(self) -> Body:
        """The world: the body that everything stands on, which does not move."""
        return self.bodies[0]

    # What is in the scene.

    def body(self, name: str | Body) -> Body:
        """Returns the body of this name; ValueError with the nearest names if there is none."""
        return _find(self.bodies, "body", name)

    def joint(self, name: str | Joint) -> Joint:
        """Returns the joint of this name."""
        return _find(self.joints, "joint", name)

    def geom(self, name: str | Geom) -> Geom:
        """Returns the geom of this name."""
        return _find(self.geoms, "geom", name)

    def site(self, name: str | Site) -> Site:
        """Returns the site of this name."""
        return _find(self.sites, "site", name)

    def actuator(self, name: str | Actuator) -> Actuator:
        """Returns the actuator of this name."""
        return _find(self.actuators, "actuator", name)

    def equality(self, name: str | Equality) -> Equality:
        """Returns the equality of this name."""
        return _find(self.equalities, "equality", name)

    def key(self, name: str | Key) -> Key:
        """Returns the keyframe of this name."""
        return _find(self.keys, "key", name)

    # Adding to it.

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
    ) -> Body:
        """Adds a body.

        name: unique among bodies, or "".
        parent: the body that carries it, as a name or a `Body`.
        pos, quat: its position [m] and orientation (w x y z) in the parent's frame.
        mass: [kg]; without it, mass, centre of mass and inertia come from the body's geoms.
        ipos: centre of mass in the body's frame [m].
        inertia: about the centre of mass, in body axes [kg·m²]: xx yy zz, or xx yy zz xy xz yz.
            A mass without an inertia is a point mass.
        """
        fields: dict[str, Any] = {"name": name, "pos": pos, "quat": quat, "mass": mass}
        if inertia is not None:
            fields["inertia"] = inertia
        if ipos is not None:
            fields["ipos"] = ipos
        body = Body(parent=self.body(parent), **fields)
        if mass is None and len(fields) > 4:
            raise checks.refuse(body, "mass", None, "given where ipos or inertia is")
        return _append(self.bodies, body)

    def add_joint(
        self, body: str | Body, type: str = "hinge", **fields: Unpack[JointFields]
    ) -> Joint:
        """Adds a joint between a body and its parent.

        body: the body that it moves, as a name or a `Body`.
        type: "hinge", "slide", "ball" or "free".
        fields: of `Joint`: name, pos [m], axis, range [rad or m], ref, stiffness [N·m/rad or N/m],
            damping [N·m·s/rad or N·s/m], armature [kg·m² or kg], frictionloss [N·m or N], …
        """
        return self._add(self.joints, Joint, fields, body=self.body(body), type=type)

    def add_geom(
        self,
        body: str | Body = "world",
        type: str = "sphere",
        size: Numbers = (0.0, 0.0, 0.0),
        *,
        fromto: Vector | None = None,
        **fields: Unpack[GeomFields],
    ) -> Geom:
        """Adds a shape to a body.

        body: the body that it is fixed to, as a name or a `Body`.
        type: "plane", "sphere", "capsule", "ellipsoid", "cylinder" or "box".
        size: [m], up to 3 numbers whose meaning depends on the type; see `Geom`.
        fromto: both end points of a capsule, cylinder, box or ellipsoid [m], shape (6,), in place
            of pos, quat and every size but the first.
        fields: of `Geom`: name, pos [m], quat, mass [kg], density [kg/m³], friction, condim,
            solref, solimp, …
        """
        geom = _make(Geom, fields, body=self.body(body), type=type, size=size)
        if fromto is not None:
            both = [field for field in ("pos", "quat") if field in fields]
            if both:
                raise checks.ElementError(geom, f"{both[0]} and fromto are both given")
            ends = checks.vector(6)(geom, "fromto", fromto)
            try:
                geom.size, geom.pos, geom.quat = frames.from_to(type, ends, geom.size[0])
            except ValueError as error:
                raise checks.ElementError(geom, str(error)) from None
        return _append(self.geoms, geom)

    def add_site(self, body: str | Body = "world", **fields: Unpack[SiteFields]) -> Site:
        """Adds a site, a named place on a body.

        fields: of `Site`: name, pos [m], quat.
        """
        return self._add(self.sites, Site, fields, body=self.body(body))

    def add_actuator(
        self, joint: str | Joint, type: str = "motor", **fields: Unpack[ActuatorFields]
    ) -> Actuator:
        """Adds an actuator on a joint.

        joint: a name or a `Joint`.
        type: "motor", "position" (servo), "velocity" (servo) or "general".
        fields: of `Actuator`: name, gear, kp, kv, dampratio, ctrlrange, forcerange [N or N·m], …
        """
        return self._add(self.actuators, Actuator, fields, joint=self.joint(joint), type=type)

    def add_equality(
        self,
        type: str = "connect",
        body1: str | Body = "",
        body2: str | Body = "world",
        anchor: Vector = frames.ORIGIN,
        **fields: Unpack[EqualityFields],
    ) -> Equality:
        """Adds a constraint that holds a point of one body on another.

        type: "connect". body1, body2: names or `Body` objects.
        anchor: the shared point in the frame of body1 [m], shape (3,).
        fields: of `Equality`: name, active, solref, solimp.
        """
        ends = {"body1": self.body(body1), "body2": self.body(body2)}
        return self._add(self.equalities, Equality, fields, type=type, anchor=anchor, **ends)

    def add_key(self, name: str = "", **fields: Unpack[KeyFields]) -> Key:
        """Adds a keyframe, a named state.

        fields: of `Key`: time [s], qpos, qvel and ctrl in the compiled model's order.
        """
        return self._add(self.keys, Key, fields, name=name)

    def exclude(self, body1: str | Body, body2: str | Body) -> None:
        """Excludes collisions between the geoms of two bodies."""
        self.excludes.append((self.body(body1), self.body(body2)))

    def _add(self, into: list[E], kind: type[E], fields: Mapping[str, Any], **own: Any) -> E:
        return _append(into, _make(kind, fields, **own))

    # How it is computed.

    @property
    def settings(self) -> Settings:
        """The scene's `Settings`: its `options`, and defaults for the rest.

        Raises ValueError for an option that is not a field of `Settings` or is outside its limit.
        """
        from stepcore._core import Settings

        return Settings(**self.options)

    @settings.setter
    def settings(self, value: Settings) -> None:
        self.options = value.as_dict()

    def with_settings(
        self,
        settings: Settings | Mapping[str, Any] | None = None,
        **fields: Unpack[SettingsFields],
    ) -> Scene:
        """Returns a copy of the scene with other settings.

        settings: a `Settings`, which replaces them all, or a dict of fields.
        fields: single fields of `Settings`.
        """
        scene = copy.deepcopy(self)
        if settings is not None:
            if isinstance(settings, Mapping):
                scene.options.update(settings)
            else:
                scene.options = settings.as_dict()
        scene.options.update(fields)
        return scene

    def compile(self) -> Model:
        """Compiles the scene; ValueError, naming the element, if it cannot be compiled."""
        from stepcore.engine.model import Model

        return Model(self)

    def to_dict(self) -> dict[str, Any]:
        """Returns the scene as the engine reads it: plain data, with indices for references.

        Raises ValueError for errors that only the whole scene shows: a range on a free joint, a
        plane on a moving body, a key of the wrong length, a name used twice.
        """
        layout = Layout(self)
        check(layout)
        return plain(layout)

    def to_mjcf(self) -> str:
        """Returns the scene, with its settings, as an MJCF text.

        Angles are in radians, numbers are exact and defaults are left out. Settings that MJCF lacks
        stand in ``<custom>``, which `stepcore.loads` reads: ``loads(scene.to_mjcf()) == scene``.
        Elements of the scene's file that only draw or sense are not written; a comment counts them.

        Raises ValueError for a scene that MJCF cannot express: one that cannot be compiled, a world
        with a mass or another name, a name with control characters.

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
        from stepcore.mjcf.write import written

        return written(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the scene to an MJCF file, so that ``load(path) == scene``.

        If the scene was read from a file and only its settings or its name have changed, the file's
        own text is kept, with its includes, comments and meshes; only ``<option>``, ``<flag>`` and
        ``<custom>`` are edited. (If the text names other files, `path` must be in their folder.)
        Otherwise the text is that of `to_mjcf`.

        Raises what `to_mjcf` raises, and OSError.
        """
        from stepcore.mjcf.source_edit import save

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
        counts = [(len(self.bodies) - 1, "body", ""), (len(self.joints), "joint", "")]
        if self.joints:
            counts[1] = (len(self.joints), "joint", f" (nq {layout.nq}, nv {layout.nv})")
        rest: dict[str, Sequence[Element]] = {
            "geom": self.geoms,
            "site": self.sites,
            "actuator": self.actuators,
            "equality": self.equalities,
            "key": self.keys,
        }
        counts += [(len(elements), word, "") for word, elements in rest.items() if elements]
        parts = [f"{n} {word if n == 1 else _plural(word)}{more}" for n, word, more in counts]
        options = [f"{key}={value!r}" for key, value in self.options.items()]
        name = f' "{self.name}"' if self.name else ""
        return f"<Scene{name}: {', '.join(parts)}{'; ' + ', '.join(options) if options else ''}>"


def _plural(word: str) -> str:
    return {"body": "bodies", "equality": "equalities"}.get(word, word + "s")


def _find(elements: Sequence[E], kind: str, name: object) -> E:
    """The element of this name, or the element itself if it is one of these."""
    for element in elements:
        if element is name or (name and element.name == name):  # type: ignore[attr-defined]
            return element
    if isinstance(name, str):
        near = checks.nearest(name, [e.name for e in elements])  # type: ignore[attr-defined]
        text = f'no {kind} is named "{name}"{near}'
    elif isinstance(name, Element):
        text = f"{name} is not a {kind} of this scene"
    else:
        text = f"{kind} = {checks.shown(name)}: must be a name or a {kind.capitalize()}"
    raise ValueError(text)


def _make(kind: type[E], fields: Mapping[str, Any], **own: Any) -> E:
    """A new element; a field that it does not have is a ValueError with the nearest one."""
    known = fields_of(kind)
    for field in fields:
        if field not in known:
            near = checks.nearest(field, known)
            raise ValueError(f'a {kind.__name__.lower()} has no field "{field}"{near}')
    return kind(**own, **fields)


def _append(into: list[E], element: E) -> E:
    name = element.name  # type: ignore[attr-defined]
    if name and any(other.name == name for other in into):  # type: ignore[attr-defined]
        raise checks.ElementError(element, "the name is used twice")
    into.append(element)
    return element
