"""`Model`: a scene once compiled: constant, and what a `Sim` or a `Batch` steps."""

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
from stepcore.engine.arrays import Floats
from stepcore.engine.file_lines import with_file_lines
from stepcore.scene.layout import Layout
from stepcore.scene.value_paths import changed

if TYPE_CHECKING:
    from typing import Unpack

    from stepcore.engine.plan.result import Plan
    from stepcore.engine.settings_fields import SettingsFields
    from stepcore.engine.sim import Sim
    from stepcore.scene.scene import Scene

Ints = NDArray[np.int32]

# Compiled scenes that a process keeps for the models sent to it.
KEPT = 16


class Keyframe(NamedTuple):
    """A named state with its defaults filled in: time [s], qpos (nq,), qvel (nv,), ctrl (nu,)."""

    name: str
    time: float
    qpos: Floats
    qvel: Floats
    ctrl: Floats


class Model:
    """A compiled scene.

    scene: the `Scene` to compile; it is copied, so that later edits do not reach the model.
    settings: a `Settings` in place of the scene's own. overrides: single settings fields.

    Raises ValueError for a scene that cannot be compiled, naming element, field and limit.
    Elements stand in MuJoCo's order; arrays are read-only; names are "" where none was given.

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
        self, scene: Scene, settings: Settings | None = None, **overrides: Unpack[SettingsFields]
    ) -> None:
        if not hasattr(scene, "to_dict"):
            raise ValueError(f"scene = {checks.shown(scene)}: must be a stepcore.Scene")
        self._scene = copy.deepcopy(scene)
        self._settings = _merged(self._scene.settings, settings, overrides)
        self._core = _engine(self._scene)

    @property
    def scene(self) -> Scene:
        """The scene that was compiled. Editing it does not change the model."""
        return self._scene

    @property
    def settings(self) -> Settings:
        """The settings that a `Sim` of this model starts from."""
        return self._settings

    @property
    def core(self) -> _core.Model:
        """The compiled model as the engine has it."""
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
        """Length of act: no actuator has a state of its own yet."""
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
        """Names by kind: body, joint, geom, site, actuator, equality, key."""
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
        """Where the element of this name stands; ValueError with the nearest if there is none.

        kind: "body", "joint", "geom", "site", "actuator", "equality" or "key".
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

    # Tables.

    @functools.cached_property
    def _tables(self) -> dict[str, Floats]:
        return {name: _frozen(table) for name, table in self._core.tables().items()}

    @functools.cached_property
    def _addresses(self) -> dict[str, Ints]:
        lists = self._core.addresses().items()
        return {name: _frozen(np.array(entries, dtype=np.int32)) for name, entries in lists}

    @property
    def qpos0(self) -> Floats:
        """qpos of the pose in which the scene is described, shape (nq,)."""
        return self._tables["qpos0"]

    @property
    def body_mass(self) -> Floats:
        """[kg], shape (nbody,)."""
        return self._tables["body_mass"]

    @property
    def body_ipos(self) -> Floats:
        """Centre of mass in the body's frame [m], shape (nbody, 3)."""
        return self._tables["body_ipos"]

    @property
    def body_inertia(self) -> Floats:
        """About the centre of mass, in the body's axes [kg·m²], shape (nbody, 3, 3)."""
        return self._tables["body_inertia"]

    @property
    def body_parent(self) -> Ints:
        """Index of the body that carries each body, shape (nbody,)."""
        return self._addresses["body_parent"]

    @property
    def body_invweight0(self) -> Floats:
        """Mean inverse mass [1/kg] and inverse inertia [1/(kg·m²)] at qpos0, shape (nbody, 2)."""
        return self._tables["body_invweight0"]

    @property
    def dof_invweight0(self) -> Floats:
        """Diagonal of the inverse mass matrix at qpos0, a mean for each joint, shape (nv,)."""
        return self._tables["dof_invweight0"]

    @functools.cached_property
    def jnt_type(self) -> tuple[str, ...]:
        """ "free", "ball", "slide" or "hinge" of each joint."""
        return tuple(self._core.joint_types())

    @property
    def jnt_qposadr(self) -> Ints:
        """Where each joint starts in qpos, shape (njnt,)."""
        return self._addresses["jnt_qposadr"]

    @property
    def jnt_dofadr(self) -> Ints:
        """Where each joint starts in qvel, shape (njnt,)."""
        return self._addresses["jnt_dofadr"]

    @property
    def jnt_body(self) -> Ints:
        """The body that each joint moves, shape (njnt,)."""
        return self._addresses["jnt_body"]

    @property
    def jnt_range(self) -> Floats:
        """Lower and upper limit [rad or m], ±inf without one, shape (njnt, 2)."""
        return self._tables["jnt_range"]

    @property
    def jnt_axis(self) -> Floats:
        """Unit axis in the body's frame, shape (njnt, 3)."""
        return self._tables["jnt_axis"]

    @property
    def jnt_pos(self) -> Floats:
        """Anchor in the body's frame [m], shape (njnt, 3)."""
        return self._tables["jnt_pos"]

    @functools.cached_property
    def geom_type(self) -> tuple[str, ...]:
        """ "plane", "sphere", "capsule", "ellipsoid", "cylinder" or "box" of each geom."""
        return tuple(self._core.geom_types())

    @property
    def geom_size(self) -> Floats:
        """MuJoCo's sizes [m], shape (ngeom, 3)."""
        return self._tables["geom_size"]

    @property
    def geom_body(self) -> Ints:
        """The body of each geom, shape (ngeom,)."""
        return self._addresses["geom_body"]

    @property
    def site_body(self) -> Ints:
        """The body of each site, shape (nsite,)."""
        return self._addresses["site_body"]

    @property
    def actuator_joint(self) -> Ints:
        """The joint that each actuator drives, shape (nu,)."""
        return self._addresses["actuator_joint"]

    @property
    def actuator_ctrlrange(self) -> Floats:
        """Range to which controls are clamped, ±inf without one, shape (nu, 2)."""
        return self._tables["actuator_ctrlrange"]

    @property
    def actuator_gear(self) -> Floats:
        """Force per control along each dof of the joint, shape (nu, 6)."""
        return self._tables["actuator_gear"]

    @property
    def actuator_gain(self) -> Floats:
        """Force per control, before the gear, shape (nu,)."""
        return self._tables["actuator_gain"]

    @property
    def actuator_bias(self) -> Floats:
        """Force without control, and per length and velocity, before the gear, shape (nu, 3).

        A damping ratio is already in it as the damping that it stands for.
        """
        return self._tables["actuator_bias"]

    @property
    def actuator_forcerange(self) -> Floats:
        """Range to which forces are clamped before the gear, ±inf without one, shape (nu, 2)."""
        return self._tables["actuator_forcerange"]

    @functools.cached_property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Geoms that can ever meet, by name (or "#index" where there is none)."""
        names = [name or f"#{i}" for i, name in enumerate(self.geom_names)]
        return tuple((names[a], names[b]) for a, b in self._core.pairs())

    @functools.cached_property
    def keys(self) -> tuple[Keyframe, ...]:
        """The keyframes, with what they leave open filled in."""
        states = zip(self.key_names, self._core.keys(), strict=True)
        return tuple(
            Keyframe(name, time, *(_frozen(np.array(x, dtype=float)) for x in arrays))
            for name, (time, *arrays) in states
        )

    def plan(self, *, sim: Sim | None = None, time: bool = False) -> Plan:
        """What a step does and what it leaves out, with the reasons: `stepcore.plan(self, …)`."""
        from stepcore.engine.plan import planned

        return planned(self, sim, time)

    # Copies.

    def with_values(self, values: Mapping[str, Any]) -> Model:
        """A copy with some values of the scene changed, compiled anew.

        values: by "kind/name/field", for instance ``{"geom/box/friction": 0.4, "body/arm/mass":
        2.0, "joint/knee/damping": 1.0}``, or "gravity". A number for a field of several sets its
        first. The mass of a body whose mass comes from its geoms scales those geoms.

        Raises ValueError for an unknown kind, name or field (listing the nearest) or a bad value.
        """
        return Model(changed(self._scene, values, self), self._settings)

    def with_settings(
        self, settings: Settings | None = None, **overrides: Unpack[SettingsFields]
    ) -> Model:
        """The same model with other settings; nothing is compiled again."""
        other = copy.copy(self)
        other._settings = _merged(self._settings, settings, overrides)
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
    """The engine's model; what it refuses is said with file and line where the scene has them."""
    try:
        return _core.compile(scene.to_dict())
    except checks.ElementError as error:
        place = getattr(error.owner, "place", "")
        if not place:
            raise
        raise checks.ElementError(f"{place}: {error.owner}", error.text) from None
    except ValueError as error:
        raise with_file_lines(error, Layout(scene)) from None


def _merged(own: Settings, given: Settings | None, overrides: SettingsFields) -> Settings:
    if given is not None and not isinstance(given, Settings):
        raise ValueError(f"settings = {checks.shown(given)}: must be a stepcore.Settings")
    return (own if given is None else given).replace(**overrides)


def _frozen(array: Any) -> Any:
    array.flags.writeable = False
    return array
