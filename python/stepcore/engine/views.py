"""Views of one element: ``sim.body("torso").xpos``, ``sim.joint("knee").qpos``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from stepcore.checks import KnownNames, quoted
from stepcore.engine.arrays import Floats, fill
from stepcore.scene.layout import DOFS, QPOS

if TYPE_CHECKING:
    from stepcore.engine.world import World


class _View(KnownNames):
    kind = ""

    def __init__(self, sim: World, index: int) -> None:
        self._sim = sim
        self._index = index

    @property
    def index(self) -> int:
        """Index of the element in the arrays."""
        return self._index

    @property
    def name(self) -> str:
        """Name of the element, "" if it has none."""
        return self._sim.model.names[self.kind][self.index]

    @property
    def _label(self) -> str:
        return f'{self.kind} "{self.name}"' if self.name else f"{self.kind} {self.index}"

    def __repr__(self) -> str:
        return f"<{self.kind} {self.index} {quoted(self.name)} of {self._sim!r}>"


class BodyView(_View):
    """One body of a `Sim`, or of all worlds of a `Batch` (shapes then begin with n)."""

    kind = "body"

    @property
    def xpos(self) -> Floats:
        """Position of the body's frame [m], shape (3,)."""
        return self._sim.xpos[..., self.index, :]

    @property
    def xquat(self) -> Floats:
        """Orientation of the body's frame as a quaternion w x y z, shape (4,)."""
        return self._sim.xquat[..., self.index, :]

    @property
    def xmat(self) -> Floats:
        """Orientation of the body's frame as a rotation matrix, shape (3, 3)."""
        return self._sim.xmat[..., self.index, :, :]

    @property
    def velocity(self) -> Floats:
        """Velocity of the frame's origin [m/s], then its angular velocity [rad/s], shape (6,)."""
        velocity: Floats = self.jacobian @ self._sim.qvel[..., None]
        return velocity[..., 0]

    @property
    def jacobian(self) -> Floats:
        """Jacobian of the body's frame, shape (6, nv); see `Sim.jacobian`."""
        return self._sim.jacobian(self.index)

    @property
    def subtree_com(self) -> Floats:
        """Centre of mass of the body with all that hangs on it [m], shape (3,)."""
        return self._sim.subtree_com[..., self.index, :]

    @property
    def mass(self) -> float:
        """Mass of the body [kg]."""
        return float(self._sim.model.body_mass[self.index])

    @property
    def xfrc_applied(self) -> Floats:
        """Force on its centre of mass [N] and moment [N·m], shape (6,); can be written."""
        return self._sim.xfrc_applied[..., self.index, :]

    @xfrc_applied.setter
    def xfrc_applied(self, value: ArrayLike) -> None:
        fill(self.xfrc_applied, f"xfrc_applied of {self._label}", value)


class JointView(_View):
    """One joint of a `Sim`, or of all worlds of a `Batch` (shapes then begin with n).

    qpos, qvel and qfrc_applied can be written.
    """

    kind = "joint"

    @property
    def type(self) -> str:
        """Type of the joint: "free", "ball", "slide" or "hinge"."""
        return self._sim.model.jnt_type[self.index]

    @property
    def _dofs(self) -> slice:
        start = int(self._sim.model.jnt_dofadr[self.index])
        return slice(start, start + DOFS[self.type])

    @property
    def qpos(self) -> Floats:
        """Positions [m or rad]: 7 for a free joint, 4 for a ball, 1 for a slide or hinge."""
        start = int(self._sim.model.jnt_qposadr[self.index])
        return self._sim.qpos[..., start : start + QPOS[self.type]]

    @qpos.setter
    def qpos(self, value: ArrayLike) -> None:
        fill(self.qpos, f"qpos of {self._label}", value)

    @property
    def qvel(self) -> Floats:
        """Velocities [m/s or rad/s]: 6 for a free joint, 3 for a ball, 1 for a slide or hinge."""
        return self._sim.qvel[..., self._dofs]

    @qvel.setter
    def qvel(self, value: ArrayLike) -> None:
        fill(self.qvel, f"qvel of {self._label}", value)

    @property
    def qacc(self) -> Floats:
        """Accelerations of the last solve [m/s² or rad/s²]."""
        return self._sim.qacc[..., self._dofs]

    @property
    def qfrc_applied(self) -> Floats:
        """Applied forces on its dofs [N or N·m]."""
        return self._sim.qfrc_applied[..., self._dofs]

    @qfrc_applied.setter
    def qfrc_applied(self, value: ArrayLike) -> None:
        fill(self.qfrc_applied, f"qfrc_applied of {self._label}", value)

    @property
    def constraint_force(self) -> Floats:
        """Forces of all constraint rows on its dofs in the last solve [N or N·m]."""
        return self._sim.constraint_force[..., self._dofs]


class GeomView(_View):
    """One geom of a `Sim`, or of all worlds of a `Batch` (shapes then begin with n)."""

    kind = "geom"

    @property
    def xpos(self) -> Floats:
        """Position of the geom [m], shape (3,)."""
        return self._sim.geom_xpos[..., self.index, :]

    @property
    def xmat(self) -> Floats:
        """Orientation of the geom as a rotation matrix, shape (3, 3)."""
        return self._sim.geom_xmat[..., self.index, :, :]


class SiteView(_View):
    """One site of a `Sim`, or of all worlds of a `Batch` (shapes then begin with n)."""

    kind = "site"

    @property
    def xpos(self) -> Floats:
        """Position of the site [m], shape (3,)."""
        return self._sim.site_xpos[..., self.index, :]

    @property
    def xmat(self) -> Floats:
        """Orientation of the site as a rotation matrix, shape (3, 3)."""
        return self._sim.site_xmat[..., self.index, :, :]

    @property
    def jacobian(self) -> Floats:
        """Jacobian of the site's frame, shape (6, nv); see `Sim.jacobian`."""
        jacobian: Floats = self._sim._core.site_jacobian(self.index)
        return jacobian

    @property
    def velocity(self) -> Floats:
        """Velocity of the site [m/s], then its angular velocity [rad/s], shape (6,)."""
        velocity: Floats = self.jacobian @ self._sim.qvel[..., None]
        return velocity[..., 0]


class TendonView(_View):
    """One tendon of a `Sim`, or of all worlds of a `Batch` (shapes then begin with n)."""

    kind = "tendon"

    @property
    def length(self) -> Floats:
        """Length [m, or the unit of its joints], shape ()."""
        return self._sim.ten_length[..., self.index]

    @property
    def velocity(self) -> Floats:
        """Rate of the length, shape ()."""
        return self._sim.ten_velocity[..., self.index]

    @property
    def jacobian(self) -> Floats:
        """Derivative of the length by the dofs, its moment arms, shape (nv,)."""
        return self._sim.ten_J[..., self.index, :]

    @property
    def force(self) -> Floats:
        """Force of its spring and damper along it, positive where it lengthens it [N], shape ()."""
        return self._sim.ten_force[..., self.index]


class SensorView(_View):
    """One sensor of a `Sim`, or of all worlds of a `Batch` (shapes then begin with n)."""

    kind = "sensor"

    @property
    def type(self) -> str:
        """Type of the sensor, such as "accelerometer"."""
        kind: str = self._sim.model.sensor_type[self.index]
        return kind

    @property
    def data(self) -> Floats:
        """Its values, shape (size,); see `Sim.sensordata`. Only this sensor is computed."""
        values: Floats = self._sim._core.sensordata(self.index)
        return values


class ActuatorView(_View):
    """One actuator of a `Sim`, or of all worlds of a `Batch` (shapes then begin with n).

    ctrl and act can be written.
    """

    kind = "actuator"

    @property
    def ctrl(self) -> Floats:
        """Control, shape (1,)."""
        return self._sim.ctrl[..., self.index : self.index + 1]

    @ctrl.setter
    def ctrl(self, value: ArrayLike) -> None:
        fill(self.ctrl, f"ctrl of {self._label}", value)

    @property
    def act(self) -> Floats:
        """Activation, shape (1,), or (0,) without one."""
        start = int(self._sim.model.actuator_actadr[self.index])
        return self._sim.act[..., start : start + 1] if start >= 0 else self._sim.act[..., :0]

    @act.setter
    def act(self, value: ArrayLike) -> None:
        fill(self.act, f"act of {self._label}", value)

    @property
    def length(self) -> Floats:
        """Length along which it pulls, times its gear [m or rad]."""
        return self._sim.actuator_length[..., self.index]

    @property
    def velocity(self) -> Floats:
        """Rate of its length, times its gear [m/s or rad/s]."""
        return self._sim.actuator_velocity[..., self.index]

    @property
    def force(self) -> Floats:
        """Force of the last solve, before the gear [N or N·m]."""
        return self._sim.actuator_force[..., self.index]
