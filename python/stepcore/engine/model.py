"""`Model`: a compiled scene, immutable, stepped by a `Sim` or a `Batch`."""

from __future__ import annotations

import copy
import functools
import math
import operator
import pickle
import zlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import _core, checks
from stepcore._core import Settings
from stepcore.engine.arrays import (
    Floats,
    constant,
    element_names,
    frozen,
    number_of,
    numbers,
)
from stepcore.engine.compilation import bare, compiled_once, compiled_pickle
from stepcore.engine.run_settings import in_metres
from stepcore.engine.tables import ContactPair, Keyframe, Touches
from stepcore.scene import gc_pause
from stepcore.scene.value_paths import changed_scene
from stepcore.signatures import refuse_unknown_settings, takes_settings

if TYPE_CHECKING:
    from typing import Unpack

    from stepcore.engine.plan import Plan
    from stepcore.engine.sim import Sim
    from stepcore.scene.scene import Scene
    from stepcore.signatures import SettingsFields


class Model(checks.KnownNames):
    """A compiled scene.

    scene: the `Scene`, which is copied, so that later edits do not change the model.
    settings: a `Settings` that replaces the settings of the scene.
    fields: single fields of `Settings` to change, such as ``dt=0.005``.

    A model is immutable, and many Sims can share it. The arrays of a model are read-only and follow
    MuJoCo's order. The name of an unnamed element is "".

    Raises ValueError, which names element, field and limit, for a scene that cannot be compiled.

    >>> from stepcore import Scene
    >>> scene = Scene()
    >>> arm = scene.add_body("arm", pos=(0, 0, 1))
    >>> _ = scene.add_joint(arm, "hinge", name="elbow", axis=(0, 1, 0))
    >>> _ = scene.add_geom(arm, "capsule", 0.05, fromto=(0, 0, 0, 0.4, 0, 0), name="rod", mass=2.0)
    >>> model = scene.compile()
    >>> model.nq, model.body_names, model.jnt_type
    (1, ('world', 'arm'), ('hinge',))
    >>> model.with_values({"geom/rod/mass": 3.0}).body_mass.tolist()
    [0.0, 3.0]
    """

    @takes_settings
    def __init__(
        self, scene: Scene, settings: Settings | None = None, **fields: Unpack[SettingsFields]
    ) -> None:
        if not hasattr(scene, "to_dict"):
            raise ValueError(f"scene = {checks.shown(scene)}: must be a stepcore.Scene")
        refuse_unknown_settings(Model, fields)
        with gc_pause.paused():
            self._scene = copy.deepcopy(scene)
            merged = _merged(self._scene, self._scene.settings, settings, fields)
            self._core, self._settings = compiled_once(scene, self._scene), merged

    @property
    def scene(self) -> Scene:
        """The scene that was compiled. Editing this scene does not change the model."""
        return self._scene

    def plan(self, *, sim: Sim | None = None, time: bool = False) -> Plan:
        """List the work that a step does and omits, with the reasons; see `stepcore.plan`."""
        from stepcore.engine.plan import planned

        return planned(self, sim, time)

    def touches(
        self,
        geom1: int | str,
        geom2: int | str,
        qpos: ArrayLike,
        *,
        precision: Literal["f64", "f32"] = "f64",
        lanes: bool = False,
    ) -> Touches:
        """Return the contact points and the signed distance of two geoms at given positions.

        The collision test is the same as in a step, evaluated at every given pose and any distance.
        Nothing is stepped, and margins and exclusions are ignored.

        geom1, geom2: names or indices. The normal points from `geom1` to `geom2`.
        qpos: shape (…, nq), such as (nq,) for one pose or (n, nq) for many.
        precision: the floating-point precision, as in `Settings`.
        lanes: whether eight poses (sixteen in f32) are computed at a time, as in a `Batch`. The
            results are bit-identical.

        Raises ValueError for an unknown name, for an unsupported pair of shapes, and for a
        qpos that is not finite or has another shape.

        >>> import stepcore as sc
        >>> scene = sc.Scene()
        >>> ball = scene.add_body("ball")
        >>> _ = scene.add_joint(ball, "slide", axis=(0, 0, 1))
        >>> _ = scene.add_geom(ball, "sphere", 0.5, name="ball", mass=1.0)
        >>> _ = scene.add_geom(scene.world, "plane", (0, 0, 1), name="floor")
        >>> touches = scene.compile().touches("floor", "ball", [[0.4], [2.0]])
        >>> touches.dist[:, 0].round(12).tolist()
        [-0.1, 1.5]
        """
        first, second = self.index("geom", geom1), self.index("geom", geom2)
        positions = numbers("qpos", qpos)
        if positions.ndim == 0 or positions.shape[-1] != self.nq:
            raise ValueError(f"qpos has shape {positions.shape}: must be (…, {self.nq})")
        if not np.isfinite(positions).all():
            raise ValueError("qpos has entries that are not finite: every entry must be")
        if precision not in ("f64", "f32"):
            raise ValueError(f"precision = {checks.shown(precision)}: must be 'f64' or 'f32'")
        leading = positions.shape[:-1]
        flat = positions.reshape(math.prod(leading), self.nq)
        how = precision + " lanes" * checks.flag_of("lanes", lanes)
        contacts = self._core.touches(first, second, flat, how)
        return Touches(*(array.reshape(leading + array.shape[1:]) for array in contacts))  # type: ignore[arg-type]

    @property
    def settings(self) -> Settings:
        """The default settings of a `Sim` of this model."""
        return self._settings

    @property
    def core(self) -> _core.Model:
        """The engine's model, for use within stepcore."""
        return self._core

    # Counts.

    nu = number_of("actuator", "Length of ctrl: the number of actuators.")
    nbody = number_of("body", "The number of bodies, the world included.")
    njnt = number_of("joint", "The number of joints.")
    ngeom = number_of("geom", "The number of geoms.")
    nsite = number_of("site", "The number of sites.")
    ntendon = number_of("tendon", "The number of tendons.")

    @property
    def nq(self) -> int:
        """Length of qpos."""
        return self._core.nq

    @property
    def nv(self) -> int:
        """Length of qvel: the number of dofs."""
        return self._core.nv

    @property
    def na(self) -> int:
        """Length of act: the number of activations."""
        return self._core.na

    @functools.cached_property
    def npair(self) -> int:
        """The number of pairs of geoms that can collide."""
        return sum(self.heap.values()) if self.is_heap else len(self._core.pairs())

    @functools.cached_property
    def is_heap(self) -> bool:
        """Whether pairs of geoms are found during the run, because too many pairs can collide.

        Compilation lists up to 2000 pairs in `pairs`, or up to 20,000 if fewer than eight trees
        move. A model with more pairs is called a pile.
        """
        return self._core.heap() is not None

    @functools.cached_property
    def heap(self) -> dict[tuple[str, str], int]:
        """The number of pairs that can collide, by geom types; empty unless `is_heap`."""
        return {(first, second): count for first, second, count in self._core.heap() or ()}

    # Names, in the order of the arrays.

    @functools.cached_property
    def names(self) -> dict[str, tuple[str, ...]]:
        """Names of "body", "joint", "geom", "site", "tendon", "actuator", "equality", "key"."""
        return {kind: tuple(names) for kind, names in self._core.names().items()}

    body_names = element_names("Names of the bodies, the world first.")
    joint_names = element_names("Names of the joints.")
    geom_names = element_names("Names of the geoms.")
    site_names = element_names("Names of the sites.")
    tendon_names = element_names("Names of the tendons.")
    sensor_names = element_names("Names of the sensors.")
    actuator_names = element_names("Names of the actuators.")
    key_names = element_names("Names of the keyframes.")

    def element_name(self, kind: str, index: int, part: int = -1) -> str:
        """Return the full name of an element: "spring of joint `knee`", "contact `floor`/`foot`".

        kind, index, part: as in `Sim.rows`, `Sim.contacts` and a `SimulationError`. A part of -1
            means the whole element.

        Raises ValueError for an unknown kind or an index that is too large.
        """
        index, part = checks.count("index", index, 0), checks.count("part", part, -1)
        return self._core.element_name(checks.word("kind", kind), index, part)

    def element_words(self, kind: str, index: int, part: int = -1) -> tuple[str, str, str]:
        """Return noun, owner and label of an element's name: "spring", "joint", "`knee`"."""
        return self._core.element_words(kind, index, part)

    def called(self, kind: str) -> tuple[str, ...]:
        """Return the display names of all elements of a kind, in their order.

        The display name is the name of the element. For an unnamed element it is the index with the
        body or joint, which helps to find the element in the file: "geom 15 of body `jaw`".

        kind: as in `names`.

        Raises ValueError for an unknown kind.
        """
        if checks.word("kind", kind) not in self._called:
            nearest = checks.nearest(kind, self._called, limit=len(self._called))
            raise ValueError(f"kind: no elements are called {checks.quoted(kind)}{nearest}")
        return self._called[kind]

    @functools.cached_property
    def _called(self) -> dict[str, tuple[str, ...]]:
        return {
            kind: tuple(name or self.element_name(kind, k) for k, name in enumerate(names))
            for kind, names in self.names.items()
        }

    def element_force(
        self, kind: str, ctrl: Floats, act: Floats, qpos: Floats, qvel: Floats
    ) -> Floats:
        """Compute the total force of all elements of one kind, shape (…, nv) [N or N·m].

        The force is the generalised force at each of many states.

        kind: "spring", "damper" or "actuator".
        ctrl, act, qpos, qvel: shapes (…, nu), (…, na), (…, nq), (…, nv), with the same leading
            axes.
        """
        inputs = {"ctrl": (ctrl, self.nu), "act": (act, self.na), "qpos": (qpos, self.nq)}
        leading = np.shape(numbers("qvel", qvel))[:-1]
        flat = []
        for name, (value, count) in (inputs | {"qvel": (qvel, self.nv)}).items():
            array = numbers(name, value)
            if array.shape != (*leading, count):
                raise ValueError(f"{name} has shape {array.shape}: must be {(*leading, count)}")
            flat.append(array.reshape(math.prod(leading), count))
        force = self._core.element_force(checks.word("kind", kind), *flat)
        return force.reshape((*leading, self.nv))

    def root(self, body: int) -> int:
        """Return the index of a body's root, a child of the world; 0 for the world itself."""
        parents, body = self.body_parent, self.index("body", body)
        while body and parents[body]:
            body = int(parents[body])
        return body

    def index(self, kind: str, name: str | int) -> int:
        """Return the index of an element.

        kind: "body", "joint", "geom", "site", "tendon", "sensor", "actuator", "equality" or "key".
        name: the element's name, or an index, which may be negative.

        Raises ValueError, with the nearest names, if there is no such element.
        """
        names = self.names.get(kind) if isinstance(kind, str) else None
        if names is None:
            limit = f"one of {', '.join(self.names)}"
            raise ValueError(f"kind = {checks.shown(kind)}: must be {limit}")
        if isinstance(name, str):
            if name and name in names:
                return names.index(name)
            raise ValueError(self.scene._no_such(kind, name, names))
        try:
            return range(len(names))[operator.index(name)]
        except (TypeError, IndexError):
            limit = f"must be the name of a {kind} or an index below {len(names)}"
            if not names:
                # Imported here because only errors need it.
                from stepcore.report.units import plural

                limit = f"the model has no {plural('keyframe' if kind == 'key' else kind)}"
            raise ValueError(f"{kind} = {checks.shown(name)}: {limit}") from None

    # Arrays.

    @functools.cached_property
    def _arrays(self) -> dict[str, NDArray[Any]]:
        lists = self._core.addresses().items()
        addresses = {name: np.array(entries, dtype=np.int32) for name, entries in lists}
        return {name: frozen(array) for name, array in (self._core.tables() | addresses).items()}

    @functools.cached_property
    def pair_geoms(self) -> NDArray[Any]:
        """The two geoms of each pair that can ever collide, shape (npair, 2)."""
        if self.is_heap:
            raise ValueError(
                f"pairs: this model is a heap, whose {self.npair} pairs of geoms that could meet "
                "are not listed: contact_pair(index) tells of one, Sim.contacts which touch now"
            )
        return frozen(np.array(self._core.pairs(), dtype=np.int32).reshape(-1, 2))

    def contact_pair(self, index: int) -> ContactPair:
        """Return the two geoms of a contact pair, and the parameters that their contacts share.

        index: as in `Sim.contacts`.

        Raises ValueError if no pair has this index.
        """
        first, second, condim, friction, solref, invweight = self._core.pair(
            checks.count("index", index, 0)
        )
        return ContactPair((first, second), condim, friction, (solref[0], solref[1]), invweight)

    qpos0 = constant("Positions in the pose in which the scene is described, shape (nq,).")
    body_mass = constant("Mass of each body [kg], shape (nbody,).")
    body_ipos = constant("Centre of mass in the body's frame [m], shape (nbody, 3).")
    body_iquat = constant(
        "Orientation of the principal axes of the inertia in the body's frame, shape (nbody, 4)."
    )
    body_inertia = constant(
        "Inertia about the centre of mass, in the body's axes [kg·m²], shape (nbody, 3, 3)."
    )
    body_parent = constant("Index of each body's parent, shape (nbody,).")
    body_invweight0 = constant(
        "Mean inverse mass [1/kg] and inverse inertia [1/(kg·m²)] at qpos0, shape (nbody, 2)."
    )
    dof_invweight0 = constant(
        "Diagonal of the inverse mass matrix at qpos0, averaged over each joint, shape (nv,)."
    )
    jnt_qposadr = constant("Index in qpos at which each joint begins, shape (njnt,).")
    jnt_dofadr = constant("Index in qvel at which each joint begins, shape (njnt,).")
    jnt_body = constant("Index of the body that each joint moves, shape (njnt,).")
    jnt_range = constant(
        "Lower and upper limit of each joint [rad or m], ±inf without one, shape (njnt, 2)."
    )
    jnt_axis = constant("Axis of each joint in the body's frame, a unit vector, shape (njnt, 3).")
    jnt_pos = constant("Anchor of each joint in the body's frame [m], shape (njnt, 3).")
    geom_size = constant("Sizes of each geom in MuJoCo's convention [m], shape (ngeom, 3).")
    geom_body = constant("Index of each geom's body, shape (ngeom,).")
    sensor_dim = constant("How many numbers each sensor gives, shape (nsensor,).")
    site_body = constant("Index of each site's body, shape (nsite,).")
    tendon_length0 = constant("Length of each tendon at qpos0, shape (ntendon,).")
    tendon_invweight0 = constant(
        "J M⁻¹ Jᵀ of each tendon's moment arms J at qpos0, shape (ntendon,)."
    )
    tendon_lengthspring = constant(
        "Lengths between which each tendon's spring is slack, shape (ntendon, 2)."
    )
    tendon_range = constant(
        "Shortest and longest length of each tendon, ±inf without a limit, shape (ntendon, 2)."
    )
    actuator_joint = constant("Index of the joint that each actuator drives, shape (nu,).")
    actuator_ctrlrange = constant(
        "Range to which each control is clamped, ±inf without one, shape (nu, 2)."
    )
    actuator_actrange = constant(
        "Range to which each activation is clamped, ±inf without one, shape (nu, 2)."
    )
    actuator_actadr = constant(
        "Index in act of each actuator's activation, -1 without one, shape (nu,)."
    )
    actuator_gear = constant("Gear of each actuator for each dof of its joint, shape (nu, 6).")
    actuator_gain = constant("Force per unit of control, before the gear, shape (nu,).")
    actuator_bias = constant(
        "Force at control 0, and per unit of length and of velocity, before the gear, "
        "shape (nu, 3). A damping ratio is converted to the damping that it stands for."
    )
    actuator_forcerange = constant(
        "Range to which each force is clamped before the gear [N or N·m], ±inf without one, "
        "shape (nu, 2)."
    )

    @functools.cached_property
    def sensor_type(self) -> tuple[str, ...]:
        """Type of each sensor: "accelerometer", "touch" and so on."""
        return tuple(self._core.sensor_types())

    @functools.cached_property
    def jnt_type(self) -> tuple[str, ...]:
        """Type of each joint: "free", "ball", "slide" or "hinge"."""
        return tuple(self._core.joint_types())

    @functools.cached_property
    def geom_type(self) -> tuple[str, ...]:
        """Type of each geom: "plane", "hfield", "sphere", "capsule", …; see `Geom`."""
        return tuple(self._core.geom_types())

    def geom_hull(self, geom: str | int) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the convex hull that a mesh collides with, in the frame of its geom.

        geom: a name or an index.

        Returns the vertices [m], shape (n, 3), and the triangles as indices of vertices,
        counter-clockwise from outside, shape (m, 3). Both are empty for a geom without a hull.
        """
        index = self.index("geom", geom)
        vertices, triangles = self._core.geom_hull(index) or ((), ())
        return np.reshape(vertices, (-1, 3)), np.reshape(np.array(triangles, int), (-1, 3))

    @functools.cached_property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of geoms that can ever collide, each geom by its display name (see `called`)."""
        names = self.called("geom")
        return tuple((names[a], names[b]) for a, b in self.pair_geoms.tolist())

    @functools.cached_property
    def keys(self) -> tuple[Keyframe, ...]:
        """The keyframes. Values that a keyframe omits have their defaults."""
        states = zip(self.key_names, self._core.keys(), strict=True)
        return tuple(
            Keyframe(name, time, *(frozen(np.array(x, dtype=float)) for x in arrays))
            for name, (time, arrays) in states
        )

    # Copies.

    def with_values(self, values: Mapping[str, Any]) -> Model:
        """Compile the scene again with some values changed, and return the new model.

        values: a dict from "kind/name/field" to the value, such as ``{"geom/box/friction": 0.4,
            "body/arm/mass": 2.0, "joint/knee/damping": 1.0}``; "gravity" is also a path. A single
            number sets the first entry of a vector. If the mass of a body comes from its geoms, a
            new mass scales these geoms.

        Raises ValueError, with the nearest names, for an unknown kind, name or field, and for an
        invalid value.
        """
        return Model(changed_scene(self._scene, values, self.masses()), self._settings)

    def masses(self) -> dict[str, float]:
        """Return the mass of each body [kg], by name."""
        return dict(zip(self.body_names, self.body_mass.tolist(), strict=True))

    @takes_settings
    def with_settings(
        self, settings: Settings | None = None, **fields: Unpack[SettingsFields]
    ) -> Model:
        """Return this model with other settings, without compiling it again."""
        refuse_unknown_settings(self.with_settings, fields)
        _ = self.warned
        other = copy.copy(self)
        other._settings = _merged(self._scene, self._settings, settings, fields)
        return other

    @functools.cached_property
    def warned(self) -> set[tuple[Any, ...]]:
        """The settings whose pitfalls were reported; copies with other settings share this set."""
        return set()

    @functools.cached_property
    def around(self) -> dict[str, list[_core.Model]]:
        """The compiled models around the value of each parameter; later copies share the dict."""
        return {}

    @functools.cached_property
    def _pickled(self) -> bytes:
        return zlib.compress(bare(self._scene))

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (self._pickled, self._settings)

    def __deepcopy__(self, memo: dict[int, Any]) -> Model:
        # A model is immutable, so a copy can share all its data.
        return copy.copy(self)

    def __copy__(self) -> Model:
        other = object.__new__(Model)
        other.__dict__.update(self.__dict__)
        return other

    def __repr__(self) -> str:
        name = f" {checks.quoted(self._scene.name)}" if self._scene.name else ""
        sizes = f"nq {self.nq}, nv {self.nv}, nu {self.nu}, nbody {self.nbody}, ngeom {self.ngeom}"
        return f"<Model{name}: {sizes}, pairs {self.npair}; {self._settings!r}>"

    def _repr_html_(self) -> str | None:
        from stepcore.engine.sim import Sim
        from stepcore.viewing.notebook import html_picture

        return html_picture(self, self.ngeom, lambda: Sim(self))


def _unpickled(pickled: bytes, settings: Settings) -> Model:
    model = object.__new__(Model)
    model._scene, model._settings = pickle.loads(zlib.decompress(pickled)), settings
    model._core = compiled_pickle(pickled)
    model.__dict__["_pickled"] = pickled
    return model


def _merged(
    scene: Scene, present: Settings, replacement: Settings | None, fields: SettingsFields
) -> Settings:
    if replacement is not None and not isinstance(replacement, Settings):
        raise ValueError(f"settings = {checks.shown(replacement)}: must be a stepcore.Settings")
    return (present if replacement is None else replacement).replace(**in_metres(scene, fields))
