"""`Model`: a compiled scene, constant, which a `Sim` or a `Batch` steps."""

from __future__ import annotations

import copy
import functools
import hashlib
import pickle
import threading
import zlib
from collections import OrderedDict
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stepcore import _core, checks
from stepcore._core import Settings
from stepcore.engine.arrays import Floats, ModelArray
from stepcore.engine.file_lines import with_file_lines
from stepcore.scene.layout import Layout
from stepcore.scene.value_paths import changed

if TYPE_CHECKING:
    from typing import Unpack

    from stepcore.engine.plan.result import Plan
    from stepcore.engine.settings_fields import SettingsFields
    from stepcore.engine.sim import Sim
    from stepcore.scene.scene import Scene

# Compiled scenes that a process keeps for the models sent to it.
KEPT = 16


class Keyframe(NamedTuple):
    """A named state, with defaults for what the scene leaves open.

    time: [s]. qpos: shape (nq,). qvel: shape (nv,). ctrl: shape (nu,).
    """

    name: str
    time: float
    qpos: Floats
    qvel: Floats
    ctrl: Floats


class Model:
    """Compiles a scene.

    scene: the `Scene`. It is copied: later edits do not change the model.
    settings: a `Settings` that replaces the scene's own.
    fields: single fields of `Settings` to change, such as ``dt=0.005``.

    A model is constant, and many Sims can share it. Its arrays are read-only and stand in
    MuJoCo's order; the name of an element without one is "".

    Raises ValueError, naming element, field and limit, for a scene that cannot be compiled.

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

    def __init__(
        self, scene: Scene, settings: Settings | None = None, **fields: Unpack[SettingsFields]
    ) -> None:
        if not hasattr(scene, "to_dict"):
            raise ValueError(f"scene = {checks.shown(scene)}: must be a stepcore.Scene")
        self._scene = copy.deepcopy(scene)
        self._settings = _merged(self._scene.settings, settings, fields)
        self._core = _engine(self._scene)

    @property
    def scene(self) -> Scene:
        """The scene that was compiled. Edits of it do not change the model."""
        return self._scene

    @property
    def settings(self) -> Settings:
        """The settings that a `Sim` of this model has unless it changes them."""
        return self._settings

    @property
    def core(self) -> _core.Model:
        """The engine's own object; for use within stepcore."""
        return self._core

    # Counts.

    @property
    def nq(self) -> int:
        """Length of qpos."""
        return self._core.nq

    @property
    def nv(self) -> int:
        """Length of qvel: the number of dofs."""
        return self._core.nv

    @property
    def nu(self) -> int:
        """Length of ctrl: the number of actuators."""
        return len(self.actuator_names)

    @property
    def na(self) -> int:
        """Length of act; no actuator has an activation yet, so it is 0."""
        return 0

    @property
    def nbody(self) -> int:
        """The number of bodies, the world included."""
        return len(self.body_names)

    @property
    def njnt(self) -> int:
        """The number of joints."""
        return len(self.joint_names)

    @property
    def ngeom(self) -> int:
        """The number of geoms."""
        return len(self.geom_names)

    @property
    def nsite(self) -> int:
        """The number of sites."""
        return len(self.site_names)

    # Names, in the order of the arrays.

    @functools.cached_property
    def names(self) -> dict[str, tuple[str, ...]]:
        """Names by kind: "body", "joint", "geom", "site", "actuator", "equality", "key"."""
        return {kind: tuple(names) for kind, names in self._core.names().items()}

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the bodies, the world first."""
        return self.names["body"]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.names["joint"]

    def element_name(self, kind: str, index: int, part: int = -1) -> str:
        """What an element is called: "spring of joint `knee`", "contact `floor`/`foot`".

        kind, index, part: as in `Sim.rows`, `Sim.contacts` and a `SimulationError`; part -1 is
        the whole element. An unknown kind or an index too large is a ValueError.
        """
        return self._core.element_name(kind, index, part)

    def element_force(self, kind: str, ctrl: Floats, qpos: Floats, qvel: Floats) -> Floats:
        """Generalised force of all elements of one kind at many states, shape (…, nv) [N or N·m].

        kind: "spring", "damper" or "actuator". ctrl, qpos, qvel: shapes (…, nu), (…, nq), (…, nv),
        with the same leading axes.
        """
        states = int(np.prod(np.shape(qvel)[:-1], dtype=int))
        flat = [
            np.ascontiguousarray(array, float).reshape(states, count)
            for array, count in ((ctrl, self.nu), (qpos, self.nq), (qvel, self.nv))
        ]
        force = self._core.element_force(kind, *flat)
        return force.reshape(np.shape(qvel))

    @property
    def geom_names(self) -> tuple[str, ...]:
        """Names of the geoms."""
        return self.names["geom"]

    @property
    def site_names(self) -> tuple[str, ...]:
        """Names of the sites."""
        return self.names["site"]

    @property
    def actuator_names(self) -> tuple[str, ...]:
        """Names of the actuators."""
        return self.names["actuator"]

    @property
    def key_names(self) -> tuple[str, ...]:
        """Names of the keyframes."""
        return self.names["key"]

    def index(self, kind: str, name: str | int) -> int:
        """Returns the index of an element.

        kind: "body", "joint", "geom", "site", "actuator", "equality" or "key".
        name: its name, or an index, which may be negative.

        Raises ValueError, with the nearest names, if there is no such element.
        """
        names = self.names[kind]
        if isinstance(name, str):
            if name and name in names:
                return names.index(name)
            raise ValueError(f'no {kind} is named "{name}"{checks.nearest(name, names)}')
        try:
            index = range(len(names))[name]
        except (TypeError, IndexError):
            limit = f"the name of a {kind} or an index below {len(names)}"
            raise ValueError(f"{kind} = {checks.shown(name)}: must be {limit}") from None
        return index

    # Arrays.

    @functools.cached_property
    def _arrays(self) -> dict[str, NDArray[Any]]:
        lists = self._core.addresses().items()
        addresses = {name: np.array(entries, dtype=np.int32) for name, entries in lists}
        addresses["pair_geoms"] = np.array(self._core.pairs(), dtype=np.int32).reshape(-1, 2)
        return {name: _frozen(array) for name, array in (self._core.tables() | addresses).items()}

    qpos0 = ModelArray("Positions in the pose in which the scene is described, shape (nq,).")
    body_mass = ModelArray("Mass of each body [kg], shape (nbody,).")
    body_ipos = ModelArray("Centre of mass in the body's frame [m], shape (nbody, 3).")
    body_inertia = ModelArray(
        "Inertia about the centre of mass, in the body's axes [kg·m²], shape (nbody, 3, 3)."
    )
    body_parent = ModelArray("Index of each body's parent, shape (nbody,).")
    body_invweight0 = ModelArray(
        "Mean inverse mass [1/kg] and inverse inertia [1/(kg·m²)] at qpos0, shape (nbody, 2)."
    )
    dof_invweight0 = ModelArray(
        "Diagonal of the inverse mass matrix at qpos0, averaged over each joint, shape (nv,)."
    )
    jnt_qposadr = ModelArray("Index in qpos at which each joint begins, shape (njnt,).")
    jnt_dofadr = ModelArray("Index in qvel at which each joint begins, shape (njnt,).")
    jnt_body = ModelArray("Index of the body that each joint moves, shape (njnt,).")
    jnt_range = ModelArray(
        "Lower and upper limit of each joint [rad or m], ±inf without one, shape (njnt, 2)."
    )
    jnt_axis = ModelArray("Axis of each joint in the body's frame, a unit vector, shape (njnt, 3).")
    jnt_pos = ModelArray("Anchor of each joint in the body's frame [m], shape (njnt, 3).")
    geom_size = ModelArray("Sizes of each geom in MuJoCo's convention [m], shape (ngeom, 3).")
    geom_body = ModelArray("Index of each geom's body, shape (ngeom,).")
    site_body = ModelArray("Index of each site's body, shape (nsite,).")
    actuator_joint = ModelArray("Index of the joint that each actuator drives, shape (nu,).")
    actuator_ctrlrange = ModelArray(
        "Range to which each control is clamped, ±inf without one, shape (nu, 2)."
    )
    actuator_gear = ModelArray("Gear of each actuator for each dof of its joint, shape (nu, 6).")
    actuator_gain = ModelArray("Force per unit of control, before the gear, shape (nu,).")
    actuator_bias = ModelArray(
        "Force at control 0, and per unit of length and of velocity, before the gear, "
        "shape (nu, 3). A damping ratio is converted to the damping that it stands for."
    )
    actuator_forcerange = ModelArray(
        "Range to which each force is clamped before the gear [N or N·m], ±inf without one, "
        "shape (nu, 2)."
    )
    pair_geoms = ModelArray("The two geoms of each pair that can ever collide, shape (npair, 2).")
    pair_solref = ModelArray("The solref that the geoms of each pair have together, (npair, 2).")
    pair_friction = ModelArray("Coefficient of sliding friction of each pair, shape (npair,).")
    pair_invweight0 = ModelArray(
        "Sum of both bodies' mean inverse mass of each pair at qpos0 [1/kg], shape (npair,)."
    )

    @functools.cached_property
    def jnt_type(self) -> tuple[str, ...]:
        """Type of each joint: "free", "ball", "slide" or "hinge"."""
        return tuple(self._core.joint_types())

    @functools.cached_property
    def geom_type(self) -> tuple[str, ...]:
        """Type of each geom: "plane", "sphere", "capsule", "ellipsoid", "cylinder" or "box"."""
        return tuple(self._core.geom_types())

    @functools.cached_property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of geoms that can ever collide, by name ("#index" for a geom without one)."""
        names = [name or f"#{i}" for i, name in enumerate(self.geom_names)]
        return tuple((names[a], names[b]) for a, b in self._core.pairs())

    @functools.cached_property
    def keys(self) -> tuple[Keyframe, ...]:
        """The keyframes, with defaults for what they leave open."""
        states = zip(self.key_names, self._core.keys(), strict=True)
        return tuple(
            Keyframe(name, time, *(_frozen(np.array(x, dtype=float)) for x in arrays))
            for name, (time, *arrays) in states
        )

    def plan(self, *, sim: Sim | None = None, time: bool = False) -> Plan:
        """Lists what a step does and what it leaves out, and why; see `stepcore.plan`."""
        from stepcore.engine.plan import planned

        return planned(self, sim, time)

    # Copies.

    def with_values(self, values: Mapping[str, Any]) -> Model:
        """Compiles the scene again with some values changed.

        values: a dict from "kind/name/field" to the value, such as ``{"geom/box/friction": 0.4,
            "body/arm/mass": 2.0, "joint/knee/damping": 1.0}``; "gravity" is a path as well. A
            single number sets the first entry of a vector. The mass of a body that gets it from
            its geoms scales those geoms.

        Raises ValueError, with the nearest names, for an unknown kind, name or field, and for a bad
        value.
        """
        mass = dict(zip(self.body_names, self.body_mass.tolist(), strict=True))
        return Model(changed(self._scene, values, mass), self._settings)

    def with_settings(
        self, settings: Settings | None = None, **fields: Unpack[SettingsFields]
    ) -> Model:
        """Returns the same model with other settings, without compiling again."""
        other = copy.copy(self)
        other._settings = _merged(self._settings, settings, fields)
        return other

    @functools.cached_property
    def _pickled(self) -> bytes:
        """The scene without its file's own text, which no step needs."""
        scene = copy.copy(self._scene)
        scene._source = None
        return zlib.compress(pickle.dumps(scene))

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (self._pickled, self._settings)

    def __deepcopy__(self, memo: dict[int, Any]) -> Model:
        # Nothing of a model can change, so a copy may share all of it.
        return copy.copy(self)

    def __copy__(self) -> Model:
        other = object.__new__(Model)
        other.__dict__.update(self.__dict__)
        return other

    def __repr__(self) -> str:
        counts = {
            "nq": self.nq,
            "nv": self.nv,
            "nu": self.nu,
            "nbody": self.nbody,
            "ngeom": self.ngeom,
            "pairs": len(self.pairs),
        }
        name = f' "{self._scene.name}"' if self._scene.name else ""
        shown = ", ".join(f"{key} {count}" for key, count in counts.items())
        return f"<Model{name}: {shown}; {self._settings!r}>"


class _CompiledScenes:
    """The last scenes that this process compiled for models sent to it, by their pickle.

    Compiling is deterministic and takes longer than unpickling: a worker that gets a model again
    and again, under whatever settings, compiles it once.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._models: OrderedDict[bytes, _core.Model] = OrderedDict()

    def get(self, pickled: bytes, scene: Scene) -> _core.Model:
        """The compiled model of a scene, which is what was pickled."""
        key = hashlib.blake2b(pickled, digest_size=16).digest()
        with self._lock:
            if key in self._models:
                self._models.move_to_end(key)
                return self._models[key]
        model = _engine(scene)
        with self._lock:
            self._models[key] = model
            while len(self._models) > KEPT:
                self._models.popitem(last=False)
        return model


_compiled_scenes = _CompiledScenes()


def _unpickled(pickled: bytes, settings: Settings) -> Model:
    model = object.__new__(Model)
    model._scene, model._settings = pickle.loads(zlib.decompress(pickled)), settings
    model._core = _compiled_scenes.get(pickled, model._scene)
    model.__dict__["_pickled"] = pickled
    return model


def _engine(scene: Scene) -> _core.Model:
    """The engine's model; an error about an element of a file gets its file and line."""
    try:
        return _core.compile(scene.to_dict())
    except checks.ElementError as error:
        place = getattr(error.owner, "place", "")
        if not place:
            raise
        raise checks.ElementError(f"{place}: {error.owner}", error.text) from None
    except ValueError as error:
        raise with_file_lines(error, Layout(scene)) from None


def _merged(own: Settings, given: Settings | None, fields: SettingsFields) -> Settings:
    if given is not None and not isinstance(given, Settings):
        raise ValueError(f"settings = {checks.shown(given)}: must be a stepcore.Settings")
    return (own if given is None else given).replace(**fields)


def _frozen(array: Any) -> Any:
    array.flags.writeable = False
    return array
