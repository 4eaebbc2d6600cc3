"""`World`: state arrays and readouts of one world of a model, or of many.

`Sim` and `Batch` stand on it (see `Stepped`). The views of single elements and the recording of a
run need only this.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

from stepcore import checks
from stepcore.engine.arrays import Floats, Readout, StateArray

if TYPE_CHECKING:
    from stepcore._core import Settings
    from stepcore.engine.model_data import ModelData


class World(checks.KnownNames, ABC):
    """One world of a model, or many. Shapes are of one; those of a `Batch` have n in front."""

    qpos = StateArray("Positions [m or rad], shape (nq,); quaternions w x y z.")
    qvel = StateArray("Velocities [m/s or rad/s], shape (nv,).")
    act = StateArray("Activations of actuators, shape (na,): the states of filters and integrators.")
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
    ten_length = Readout("Length of each tendon [m, or the unit of its joints], shape (ntendon,).")
    ten_velocity = Readout("Rate of each tendon's length, shape (ntendon,).")
    ten_J = Readout(
        "Derivative of each tendon's length by the dofs, its moment arms, shape (ntendon, nv)."
    )
    ten_force = Readout(
        "Force of each tendon's spring and damper, positive where it lengthens it [N], "
        "shape (ntendon,)."
    )
    bias = Readout(
        "Coriolis, centrifugal and gravity forces [N or N·m], shape (nv,); on the left-hand side "
        "of the equation of motion, M qacc + bias = forces."
    )
    passive = Readout(
        "Forces of springs and dampers of joints and tendons [N or N·m], shape (nv,)."
    )

    # Of the last step or forward().
    qacc = Readout("Accelerations of the last solve [m/s² or rad/s²], shape (nv,).")
    constraint_force = Readout(
        "Force of all constraint rows on the dofs, Jᵀλ/dt [N or N·m], shape (nv,)."
    )
    actuator_force = Readout("Force of each actuator before its gear [N or N·m], shape (nu,).")

    _core: Any

    def _own(self, core: Any) -> None:
        """Takes over a `_core.Sim` or `_core.Batch`; its state arrays are views of its memory."""
        self._core = core
        self._arrays = {
            "qpos": core.qpos,
            "qvel": core.qvel,
            "act": core.act,
            "ctrl": core.ctrl,
            "qfrc_applied": core.qfrc_applied,
            "xfrc_applied": core.xfrc_applied,
        }

    @property
    @abstractmethod
    def model(self) -> ModelData:
        """The model, with the settings in use."""

    @abstractmethod
    def step(self, n: int = 1) -> None:
        """Takes n steps."""

    @property
    def settings(self) -> Settings:
        """The `Settings` in use."""
        return self.model.settings

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
        jacobian: Floats = self._core.jacobian(self.model.index("body", body))
        return jacobian
