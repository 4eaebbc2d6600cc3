"""What a `Sim` and a `Batch` share: model and settings, state arrays, readouts, views by name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore import _core, checks
from stepcore.engine.arrays import Floats, Readout, StateArray
from stepcore.engine.views import BodyView, GeomView, JointView, SiteView

if TYPE_CHECKING:
    from stepcore._core import Settings, SimulationError
    from stepcore.engine.model import Model
    from stepcore.scene.scene import Scene


def compiled(model: Model | Scene) -> Model:
    """The model, or the compiled model of a scene; ValueError for anything else."""
    if isinstance(getattr(model, "core", None), _core.Model):
        return model  # type: ignore[return-value]
    if not hasattr(model, "compile") or not hasattr(model, "to_dict"):
        limit = "a stepcore.Model or a stepcore.Scene"
        raise ValueError(f"model = {checks.shown(model)}: must be {limit}")
    return model.compile()


class Stepped(checks.KnownNames, ABC):
    """One world of a model, or many. Shapes are of one; those of a `Batch` have n in front."""

    qpos = StateArray("Positions [m or rad], shape (nq,); quaternions w x y z.")
    qvel = StateArray("Velocities [m/s or rad/s], shape (nv,).")
    act = StateArray("Activations of actuators, shape (na,); no actuator has one yet, so na is 0.")
    ctrl = StateArray("Controls, shape (nu,), constant during a step.")
    qfrc_applied = StateArray(
        "Applied forces on the dofs [N or N·m], shape (nv,), constant during a step."
    )
    xfrc_applied = StateArray(
        "Force on each body's centre of mass [N] and moment [N·m], in world axes, "
        "shape (nbody, 6), constant during a step."
    )

    # Of the present state.
    xpos = Readout("Position of each body's frame [m], shape (nbody, 3).")
    xquat = Readout("Orientation of each body's frame as a quaternion w x y z, shape (nbody, 4).")
    xmat = Readout("Orientation of each body's frame as a rotation matrix, shape (nbody, 3, 3).")
    geom_xpos = Readout("Position of each geom [m], shape (ngeom, 3).")
    geom_xmat = Readout("Orientation of each geom as a rotation matrix, shape (ngeom, 3, 3).")
    site_xpos = Readout("Position of each site [m], shape (nsite, 3).")
    bias = Readout(
        "Coriolis, centrifugal and gravity forces [N or N·m], shape (nv,); on the left-hand side "
        "of the equation of motion, M qacc + bias = forces."
    )
    passive = Readout("Forces of joint springs and dampers [N or N·m], shape (nv,).")

    # Of the last step or forward().
    qacc = Readout("Accelerations of the last solve [m/s² or rad/s²], shape (nv,).")
    constraint_force = Readout(
        "Force of all constraint rows on the dofs, Jᵀλ/dt [N or N·m], shape (nv,)."
    )
    actuator_force = Readout("Force of each actuator before its gear [N or N·m], shape (nu,).")

    _model: Model
    _core: Any

    def _own(self, core: Any) -> None:
        """Takes over a `_core.Sim` or `_core.Batch`; its state arrays are views of its memory."""
        self._core = core
        self._arrays = {
            "qpos": core.qpos,
            "qvel": core.qvel,
            "act": np.zeros((*core.qpos.shape[:-1], 0)),
            "ctrl": core.ctrl,
            "qfrc_applied": core.qfrc_applied,
            "xfrc_applied": core.xfrc_applied,
        }

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
        attach(error, self._model, qpos, qvel)

    @property
    def model(self) -> Model:
        """The `Model`, with the settings in use."""
        return self._model

    @property
    def settings(self) -> Settings:
        """The `Settings` in use."""
        return self._model.settings

    @property
    def time(self) -> float:
        """Time [s]: the value last set or restored, plus dt for each step since then."""
        time: float = self._core.time
        return time

    @time.setter
    def time(self, value: float) -> None:
        self._core.time = value

    def mass_matrix(self) -> Floats:
        """Returns the mass matrix of the present state, armature included, shape (nv, nv)."""
        matrix: Floats = self._core.mass_matrix()
        return matrix

    def jacobian(self, body: str | int) -> Floats:
        """Returns the Jacobian of a body's frame, shape (6, nv), in world axes.

        Times qvel, its first three rows give the velocity of the frame's origin [m/s] and the last
        three its angular velocity [rad/s]. Raises ValueError for an unknown body.
        """
        jacobian: Floats = self._core.jacobian(self._model.index("body", body))
        return jacobian

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

    def reset(self, key: str | int | None = None) -> None:
        """Resets to the scene's initial pose at rest and time 0, or to a keyframe.

        key: the name or index of a keyframe. Controls become the keyframe's, else 0; applied forces
        become 0 and warm-start impulses are forgotten.

        Raises ValueError, with the nearest names, for an unknown keyframe.
        """
        state = None if key is None else self._model.keys[self._model.index("key", key)]
        for array in self._arrays.values():
            array[...] = 0.0
        self._arrays["qpos"][...] = self._model.qpos0 if state is None else state.qpos
        if state is not None:
            self._arrays["qvel"][...] = state.qvel
            self._arrays["ctrl"][...] = state.ctrl
        self._restart(0.0 if state is None else state.time)
