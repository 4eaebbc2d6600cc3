"""What a `Sim` and a `Batch` share beyond a `World`: the model, views by name, resetting."""

from __future__ import annotations

import importlib
import os
from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stepcore import _core, checks
from stepcore.engine.arrays import Floats
from stepcore.engine.views import (
    ActuatorView,
    BodyView,
    GeomView,
    JointView,
    SensorView,
    SiteView,
    TendonView,
)
from stepcore.engine.world import World

if TYPE_CHECKING:
    from stepcore._core import SimulationError
    from stepcore.engine.arrays import Floats
    from stepcore.engine.model import Model


# The arrays that a keyframe has, in its order.
OF_KEYS = ("qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat")


def compiled(model: Any) -> Model:
    """The model, or the compiled model of a scene or of what `stepcore.load` takes."""
    if isinstance(getattr(model, "core", None), _core.Model):
        return model  # type: ignore[no-any-return]
    if isinstance(model, (str, os.PathLike)) or type(model).__name__ in ("MjModel", "MjSpec"):
        # The readers stand above the engine; it knows them by their public name alone.
        model = importlib.import_module("stepcore").load(model)
    if not hasattr(model, "compile") or not hasattr(model, "to_dict"):
        limit = "a stepcore.Model, a stepcore.Scene or the path of an MJCF file"
        raise ValueError(f"model = {checks.shown(model)}: must be {limit}")
    own: Model = model.compile()
    return own


class Stepped(World):
    """A world, or many, with its `Model`: views by name, resetting, and the replay of a failure."""

    _model: Model

    @abstractmethod
    def _restart(self, time: float) -> None:
        """Sets the time and forgets the warm-start impulses."""

    def _explain(self, error: SimulationError) -> None:
        """Gives an error its `replay`: the failure, to be saved and run again."""
        # Only a failure needs the post-mortem.
        from stepcore.engine.replay import attach

        qpos, qvel = self._arrays["qpos"], self._arrays["qvel"]
        if qpos.ndim > 1:
            qpos, qvel = qpos[error.world], qvel[error.world]
        attach(error, self._model_of(error.world), qpos, qvel)

    def _model_of(self, world: int) -> Model:
        """The model of one of the worlds."""
        return self._model

    @property
    def model(self) -> Model:
        """The `Model`, with the settings in use."""
        return self._model

    def body(self, name: str | int) -> BodyView:
        """Returns a view of one body; ValueError with the nearest names for an unknown one."""
        return BodyView(self, self._model.index("body", name))

    def joint(self, name: str | int) -> JointView:
        """Returns a view of one joint; see `body`."""
        return JointView(self, self._model.index("joint", name))

    def geom(self, name: str | int) -> GeomView:
        """Returns a view of one geom; see `body`."""
        return GeomView(self, self._model.index("geom", name))

    def site(self, name: str | int) -> SiteView:
        """Returns a view of one site; see `body`."""
        return SiteView(self, self._model.index("site", name))

    def tendon(self, name: str | int) -> TendonView:
        """Returns a view of one tendon; see `body`."""
        return TendonView(self, self._model.index("tendon", name))

    def sensor(self, name: str | int) -> SensorView:
        """Returns a view of one sensor; see `body`."""
        return SensorView(self, self._model.index("sensor", name))

    @property
    def sensordata(self) -> Floats:
        """Values of all sensors in their order, shape (nsensordata,); `Model.sensor_dim` tells how
        many each has.

        They belong to the last `step` or `forward`: to the state from which it started, before the
        step moved anything, as MuJoCo's do after mj_step. They are computed when they are read,
        those that tell of forces by solving once more. Before the first of these, and after
        `restore` and `reset`, they are those of the present state.
        """
        values: Floats = self._core.sensordata()
        return values

    def actuator(self, name: str | int) -> ActuatorView:
        """Returns a view of one actuator; see `body`."""
        return ActuatorView(self, self._model.index("actuator", name))

    def reset(self, key: str | int | None = None) -> None:
        """Resets to the scene's initial pose at rest and time 0, or to a keyframe.

        key: the name or index of a keyframe. Controls become the keyframe's, else 0; applied forces
        become 0 and warm-start impulses are forgotten; mocap bodies stand where the keyframe, else
        the scene, has them, and `eq_active` is the scene's.

        Raises ValueError, with the nearest names, for an unknown keyframe.
        """
        values, time = self._initial(key)
        self._write(values)
        self._restart(time)

    def _initial(self, key: str | int | None) -> tuple[dict[str, Sequence[float] | Floats], float]:
        """The arrays of one world after a reset, and its time."""
        state = None if key is None else self._model.keys[self._model.index("key", key)]
        given: dict[str, Sequence[float] | Floats] = dict(self._model.core.initial())
        if state is not None:
            given |= zip(OF_KEYS, state[2:], strict=True)
        return given, 0.0 if state is None else state.time

    def _write(
        self, values: dict[str, Sequence[float] | Floats], worlds: Any = slice(None)
    ) -> None:
        """Writes one world's arrays into all worlds, or into some of them."""
        for name, numbers in values.items():
            if len(numbers):
                self._arrays[name].reshape(-1, len(numbers))[worlds] = numbers
