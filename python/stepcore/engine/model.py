"""`Model`: a compiled scene, constant, which a `Sim` or a `Batch` steps."""

from __future__ import annotations

import copy
import functools
import hashlib
import pickle
import threading
import zlib
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Literal

from numpy.typing import ArrayLike

from stepcore import _core, checks
from stepcore._core import Settings
from stepcore.engine.file_lines import with_file_lines
from stepcore.engine.model_data import ModelData
from stepcore.engine.touches import Touches, touches
from stepcore.scene import collector
from stepcore.scene.layout import Layout, called, named
from stepcore.scene.records import Variation
from stepcore.scene.value_paths import changed
from stepcore.signatures import refuse_unknown, takes_settings

if TYPE_CHECKING:
    from typing import Unpack

    from stepcore.engine.plan.result import Plan
    from stepcore.engine.sim import Sim
    from stepcore.scene.contents import Contents
    from stepcore.scene.scene import Scene
    from stepcore.signatures import SettingsFields

# Compiled scenes that a process keeps for the models sent to it.
KEPT = 16


class Model(ModelData):
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

    @takes_settings
    def __init__(
        self, scene: Scene, settings: Settings | None = None, **fields: Unpack[SettingsFields]
    ) -> None:
        if not hasattr(scene, "to_dict"):
            raise ValueError(f"scene = {checks.shown(scene)}: must be a stepcore.Scene")
        refuse_unknown(Model, fields)
        with collector.held():
            self._scene = copy.deepcopy(scene)
            merged = _merged(self._scene.settings, settings, fields)
            super().__init__(_engine_once(scene, self._scene), merged)

    @property
    def scene(self) -> Scene:
        """The scene that was compiled. Edits of it do not change the model."""
        return self._scene

    def plan(self, *, sim: Sim | None = None, time: bool = False) -> Plan:
        """Lists what a step does and what it leaves out, and why; see `stepcore.plan`."""
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
        """Returns where two geoms touch, and how far apart they are, at given positions.

        It is the test that a step makes of these two geoms, at every pose asked for and at any
        distance: nothing is stepped, and margins and exclusions do not count.

        geom1, geom2: names or indices. The normal points from `geom1` to `geom2`.
        qpos: shape (…, nq), such as (nq,) for one pose or (n, nq) for many.
        precision: the numbers of the computation, as in `Settings`.
        lanes: computes eight poses at a time (sixteen in f32), as a `Batch` does; the same bits.

        Raises ValueError for an unknown name, for a pair of shapes that is not built, and for a
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
        return touches(self, geom1, geom2, qpos, precision, lanes)

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
        return Model(changed(self._scene, values, self.masses()), self._settings)

    def masses(self) -> dict[str, float]:
        """The mass of each body [kg], by name."""
        return dict(zip(self.body_names, self.body_mass.tolist(), strict=True))

    @takes_settings
    def with_settings(
        self, settings: Settings | None = None, **fields: Unpack[SettingsFields]
    ) -> Model:
        """Returns the same model with other settings, without compiling again."""
        refuse_unknown(self.with_settings, fields)
        other = copy.copy(self)
        other._settings = _merged(self._settings, settings, fields)
        return other

    @functools.cached_property
    def _pickled(self) -> bytes:
        return zlib.compress(_bare(self._scene))

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
            "pairs": self.npair,
        }
        name = f" {checks.quoted(self._scene.name)}" if self._scene.name else ""
        shown = ", ".join(f"{key} {count}" for key, count in counts.items())
        return f"<Model{name}: {shown}; {self._settings!r}>"

    def _repr_html_(self) -> str | None:
        """The model as a notebook shows it, with its picture where one can be drawn."""
        from stepcore.engine.sim import Sim
        from stepcore.viewing.notebook import shown

        return shown(self, self.ngeom, lambda: Sim(self))


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


class ModelVariation(Variation):
    """A model compiled many times with other values of the same paths, as `with_values` does.

    `data` makes a scene, `compiled` compiles it.
    """

    def __init__(self, model: Model, paths: Iterable[str]) -> None:
        super().__init__(model.scene, paths, model.masses())

    def compiled(self, data: dict[str, Any] | ValueError) -> _core.Model:
        """The engine's model of `data`; raises the error if it is one. Any thread may ask."""
        return _compiled(self.scene, data)


def _bare(scene: Scene) -> bytes:
    """A pickle of the scene without its file's own text, which no step needs."""
    scene = copy.copy(scene)
    scene._source = None
    return pickle.dumps(scene)


def _engine_once(scene: Scene, copied: Scene) -> _core.Model:
    """The engine's model of a scene, which is kept with it until the scene is edited.

    `stepcore.load` compiles most scenes to warn of their time step, before anybody else does.
    """
    try:
        key = hashlib.blake2b(_bare(scene), digest_size=16).digest()
    except Exception:  # what the pickling of a user's own data raises is of any type
        return _engine(copied)
    if scene._compiled is None or scene._compiled[0] != key:
        scene._compiled = key, _engine(copied)
    model: _core.Model = scene._compiled[1]
    return model


def _engine(scene: Scene) -> _core.Model:
    """The engine's model of a scene."""
    try:
        data: dict[str, Any] | ValueError = scene.to_dict()
    except ValueError as error:
        data = error
    return _compiled(scene, data)


def _compiled(scene: Contents, data: dict[str, Any] | ValueError) -> _core.Model:
    """The engine's model; an error about an element of a file gets its file and line."""
    try:
        if isinstance(data, ValueError):
            raise data
        return _core.compile(data)
    except checks.ElementError as error:
        place = getattr(error.owner, "place", "")
        if not place:
            raise named(scene, error) from None
        raise checks.ElementError(f"{place}: {called(scene, error.owner)}", error.text) from None
    except ValueError as error:
        raise with_file_lines(error, Layout(scene)) from None


def _merged(own: Settings, given: Settings | None, fields: SettingsFields) -> Settings:
    if given is not None and not isinstance(given, Settings):
        raise ValueError(f"settings = {checks.shown(given)}: must be a stepcore.Settings")
    return (own if given is None else given).replace(**fields)
