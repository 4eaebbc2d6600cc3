"""`Scene`: what is modelled, editable; written by hand or read from MJCF by `stepcore.load`."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from stepcore import checks
from stepcore.scene import frames
from stepcore.scene.elements import (
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
    """Bodies, joints, geoms and what acts on them, in SI units.

    gravity: [m/s²], shape (3,). name: any text.

    ``bodies[0]`` is the world. The ``add_…`` methods take elements in any order, refer to others
    by name or by the object that an earlier ``add_…`` returned, check every value, and return the
    new element, whose fields may be read and assigned. A bad value is a `ValueError` naming the
    element, the field, the value and the limit; an unknown name one that lists the nearest.
    Field names, defaults and conventions are MuJoCo's; see `stepcore.scene.elements`.

    mass_rules, features: MJCF's compiler rules for masses, and its flags.
    options: settings that came with the scene (`Settings` fields); see `settings`.
    ignored: what a file holds that cannot change the motion. notes: what was translated.

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

    def __init__(self, gravity: Sequence[float] = (0.0, 0.0, -9.81), name: str = "") -> None:
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
    def gravity(self, value: Sequence[float]) -> None:
        self._gravity: frames.Vec = checks.vector(3)("scene", "gravity", value)

    @property
    def world(self) -> Body:
        """The body that does not move."""
        return self.bodies[0]

    # What is in the scene.

    def body(self, name: str | Body) -> Body:
        """The body of this name; ValueError with the nearest names if there is none."""
        return _find(self.bodies, "body", name)

    def joint(self, name: str | Joint) -> Joint:
        """The joint of this name."""
        return _find(self.joints, "joint", name)

    def geom(self, name: str | Geom) -> Geom:
        """The geom of this name."""
        return _find(self.geoms, "geom", name)

    def site(self, name: str | Site) -> Site:
        """The site of this name."""
        return _find(self.sites, "site", name)

    def actuator(self, name: str | Actuator) -> Actuator:
        """The actuator of this name."""
        return _find(self.actuators, "actuator", name)

    def equality(self, name: str | Equality) -> Equality:
        """The equality of this name."""
        return _find(self.equalities, "equality", name)

    def key(self, name: str | Key) -> Key:
        """The keyframe of this name."""
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
        """Adds a body at `pos` [m], `quat` in its parent's frame.

        mass [kg], ipos (centre of mass) [m] and inertia about it [kg·m²], 3 or 6 numbers in body
        axes: without a mass all three are taken from the geoms; a mass without an inertia is a
        point mass.
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
        """Adds a "hinge", "slide", "ball" or "free" joint between a body and its parent.

        fields: those of `stepcore.scene.elements.Joint` (name, pos, axis, range, damping, …).
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

        size: [m]; see `stepcore.scene.elements.Geom`, whose fields (name, pos, mass, …) may all be
        given.
        fromto: two end points [m], shape (6,), in place of pos, quat and all but the first size.
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
        """Adds a named place: name, pos [m], quat."""
        return self._add(self.sites, Site, fields, body=self.body(body))

    def add_actuator(
        self, joint: str | Joint, type: str = "motor", **fields: Unpack[ActuatorFields]
    ) -> Actuator:
        """Adds a "motor", a "position" or "velocity" servo, or a "general" actuator on a joint.

        fields: those of `stepcore.scene.elements.Actuator` (name, gear, kp, kv, dampratio,
        ctrlrange, forcerange, …).
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
        """Makes two bodies share the point `anchor` [m], given in the frame of `body1`.

        fields: name, active, solref, solimp.
        """
        ends = {"body1": self.body(body1), "body2": self.body(body2)}
        return self._add(self.equalities, Equality, fields, type=type, anchor=anchor, **ends)

    def add_key(self, name: str = "", **fields: Unpack[KeyFields]) -> Key:
        """Adds a named state: time [s], qpos, qvel, ctrl in the compiled model's order."""
        return self._add(self.keys, Key, fields, name=name)

    def exclude(self, body1: str | Body, body2: str | Body) -> None:
        """Keeps the geoms of two bodies from colliding with each other."""
        self.excludes.append((self.body(body1), self.body(body2)))

    def _add(self, into: list[E], kind: type[E], fields: Mapping[str, Any], **own: Any) -> E:
        return _append(into, _make(kind, fields, **own))

    # How it is computed.

    @property
    def settings(self) -> Settings:
        """The `Settings` that came with the scene: its `options` over the defaults.

        ValueError for an option that is no field of `Settings`, or outside its limit.
        """
        from stepcore._core import Settings

        return Settings(**self.options)

    @settings.setter
    def settings(self, value: Settings) -> None:
        self.options = value.as_dict()

    def with_settings(
        self,
        settings: Settings | Mapping[str, Any] | None = None,
        **overrides: Unpack[SettingsFields],
    ) -> Scene:
        """A copy of the scene with other settings; a whole `Settings` replaces all of them."""
        scene = copy.deepcopy(self)
        if settings is not None:
            if isinstance(settings, Mapping):
                scene.options.update(settings)
            else:
                scene.options = settings.as_dict()
        scene.options.update(overrides)
        return scene

    def compile(self) -> Model:
        """The compiled `Model`; ValueError if the scene cannot be one."""
        from stepcore.engine.model import Model

        return Model(self)

    def to_dict(self) -> dict[str, Any]:
        """The scene as the engine takes it: plain data in MuJoCo's order, indices for names.

        Raises ValueError for what only the whole scene can show: a range on a free joint, a
        plane on a moving body, a key of the wrong length, a name used twice.
        """
        layout = Layout(self)
        check(layout)
        return plain(layout)

    def to_mjcf(self) -> str:
        """The scene as an MJCF text: all that is modelled, and the settings.

        Angles in radians, numbers exact, defaults left out. Settings that MJCF has no word for
        stand in ``<custom>``, which `stepcore.loads` reads: ``loads(scene.to_mjcf()) == scene``.
        What a file held that only draws or senses is not written; a comment says how much.

        Raises ValueError for a scene that no MJCF file can say: one that cannot be compiled, a
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
        from stepcore.mjcf.write import written

        return written(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the scene as an MJCF file, so that ``load(path) == scene``.

        A scene that was read from a file and differs from it in nothing but settings (and its
        name) keeps the file's own text: includes, comments, meshes and all, with other
        ``<option>``, ``<flag>`` and ``<custom>`` words. If that text names other files, this
        holds for `path` in the directory where they lie. Else the file is `to_mjcf`.

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
