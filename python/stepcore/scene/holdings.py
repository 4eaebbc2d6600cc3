"""`Holdings`: a scene's lists of elements, its settings, and look-up of elements by name."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

from stepcore import checks
from stepcore.scene import frames
from stepcore.scene.elements import (
    GRAVITY,
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
)
from stepcore.scene.names import Names
from stepcore.signatures import takes_settings

if TYPE_CHECKING:
    from typing import Self, Unpack

    from stepcore import _core
    from stepcore._core import Settings
    from stepcore.mjcf.nodes import Source
    from stepcore.scene.fields import Vector
    from stepcore.signatures import SettingsFields

E = TypeVar("E", bound=Element)
T = TypeVar("T")
# MuJoCo's default.
MAGNETIC: frames.Vec = (0.0, -0.5, 0.0)


class _Checked(Generic[T]):
    """A descriptor of a value of the whole scene that is checked on assignment."""

    def __init__(self, check: checks.Check, doc: str) -> None:
        self._check, self.__doc__ = check, doc

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, scene: None, owner: type) -> Self: ...
    @overload
    def __get__(self, scene: Holdings, owner: type) -> T: ...
    def __get__(self, scene: Holdings | None, owner: type) -> Self | T:
        if scene is None:
            return self
        value: T = getattr(scene, f"_{self._name}")
        return value

    def __set__(self, scene: Holdings, value: Vector | float) -> None:
        setattr(scene, f"_{self._name}", self._check("scene", self._name, value))


class Holdings(checks.KnownNames):
    """The elements and settings of a scene."""

    _attributes = (
        *("name", "bodies", "joints", "geoms", "sites", "tendons", "actuators", "equalities"),
        *("sensors", "keys", "meshes", "hfields", "excludes", "pairs", "contact_override"),
        *("mass_rules", "lengthrange", "features", "density", "viscosity", "wind", "magnetic"),
        *("options", "ignored", "notes", "without", "fused"),
    )

    def __init__(self, gravity: Vector = GRAVITY, name: str = "") -> None:
        self.gravity = gravity
        self.density = 0.0
        self.viscosity = 0.0
        self.wind = frames.ORIGIN
        self.magnetic = MAGNETIC
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

    # Look-up by name.

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
        found: E | None = self._names_of(kind).find(elements, name)
        if found is None:
            raise self._unknown(elements, kind, name)
        return found

    def _unknown(self, elements: Sequence[Element], kind: str, name: object) -> ValueError:
        if isinstance(name, str):
            names = [e.name for e in elements]  # type: ignore[attr-defined]
            return ValueError(self._no_such(kind, name, names))
        if isinstance(name, Element):
            return ValueError(f"{name} is not a {kind} of this scene")
        limit = f"a name or a {kind.capitalize()}"
        return ValueError(f"{kind} = {checks.shown(name)}: must be {limit}")

    def _no_such(self, what: str, name: str, names: Sequence[str]) -> str:
        """Return the error text for an unknown name: the nearest names.

        For the name of a fused body the text names the body that contains it now.
        """
        said = f"no {what} is named {checks.quoted(name)}"
        if "body" not in what.split() or name not in self.fused:
            return said + checks.nearest(name, names)
        into = self.fused[name]
        whole = f"body {checks.quoted(into)}" if into else "a body without a name"
        return (
            f"{said}: nothing moves it against {whole}, of which it is a part; "
            "load(..., fuse=False) keeps it a body of its own"
        )

    def _names_of(self, kind: str) -> Names:
        return self._names.setdefault(kind, Names())

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
        if settings is not None:
            if isinstance(settings, Mapping):
                scene.options.update(settings)
            elif hasattr(settings, "as_dict"):
                scene.options = settings.as_dict()
            else:
                limit = "Settings, or a dict of their fields"
                raise ValueError(f"settings = {checks.shown(settings)}: must be {limit}")
        scene.options.update(fields)
        _ = scene.settings  # Raises for unknown fields and bad values.
        return scene
