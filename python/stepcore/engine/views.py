"""Views of one element: ``sim.body("torso").xpos``, ``sim.joint("knee").qpos``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from stepcore.checks import KnownNames, quoted
from stepcore.engine.arrays import Floats, fill
from stepcore.scene.layout import DOFS, QPOS

if TYPE_CHECKING:
    from stepcore.engine.world import World


class Entry:
    """The entry of a view's element in an array; `writable`: whether it can be assigned."""

    def __init__(self, array: str, doc: str, writable: bool = False) -> None:
        self.array, self.__doc__, self.writable = array, doc, writable

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, view: Any, owner: type | None = None) -> Floats:
        if view is None:
            return self  # type: ignore[return-value]
        array: Floats = getattr(view._sim, self.array)
        return array[(*view._sim._lead, view._at(self.array), ...)]

    def __set__(self, view: Any, value: ArrayLike) -> None:
        if not self.writable:
            raise AttributeError(f"{self.name} of a {view.kind} is read-only")
        fill(self.__get__(view), f"{self.name} of {view._label}", value)


class _View(KnownNames):
    """One element of a `Sim`, or of all worlds of a `Batch` (shapes then begin with n)."""

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
        """Name of the element, "" for an unnamed element."""
        return self._sim.model.names[self.kind][self.index]

    @property
    def _label(self) -> str:
        return f'{self.kind} "{self.name}"' if self.name else f"{self.kind} {self.index}"

    def _at(self, array: str) -> int | slice:
        return self._index

    def __repr__(self) -> str:
        return f"<{self.kind} {self.index} {quoted(self.name)} of {self._sim!r}>"


class _Frame(_View):
    """A view of an element with a moving frame; the engine has its Jacobian as `_jacobian`."""

    _jacobian = ""

    @property
    def jacobian(self) -> Floats:
        """Jacobian of the frame, shape (6, nv); see `Sim.jacobian`."""
        jacobian: Floats = getattr(self._sim._core, self._jacobian)(self.index)
        return jacobian

    @property
    def velocity(self) -> Floats:
        """Linear [m/s], then angular [rad/s] velocity of the frame at its origin, shape (6,)."""
        velocity: Floats = self.jacobian @ self._sim.qvel[..., None]
        return velocity[..., 0]


class BodyView(_Frame):
    """One body of a `Sim`, or of all worlds of a `Batch` (shapes then begin with n)."""

    kind = "body"
    _jacobian = "jacobian"
    xpos = Entry("xpos", "Position of the body's frame [m], shape (3,).")
    xquat = Entry("xquat", "Orientation of the body's frame as a quaternion w x y z, shape (4,).")
    xmat = Entry("xmat", "Orientation of the body's frame as a rotation matrix, shape (3, 3).")
    subtree_com = Entry(
        "subtree_com", "Centre of mass of the body with all that hangs on it [m], shape (3,)."
    )
    xfrc_applied = Entry(
        "xfrc_applied",
        "Force on its centre of mass [N] and moment [N·m], shape (6,); can be written.",
        writable=True,
    )

    @property
    def mass(self) -> float:
        """Mass of the body [kg]."""
        return float(self._sim.model.body_mass[self.index])


class JointView(_View):
    """One joint; see `BodyView`. qpos, qvel and qfrc_applied can be written."""

    kind = "joint"
    qpos = Entry(
        "qpos",
        "Positions [m or rad]: 7 for a free joint, 4 for a ball, 1 for a slide or hinge.",
        writable=True,
    )
    qvel = Entry(
        "qvel",
        "Velocities [m/s or rad/s]: 6 for a free joint, 3 for a ball, 1 for a slide or hinge.",
        writable=True,
    )
    qacc = Entry("qacc", "Accelerations of the last solve [m/s² or rad/s²].")
    qfrc_applied = Entry("qfrc_applied", "Applied forces on its dofs [N or N·m].", writable=True)
    constraint_force = Entry(
        "constraint_force",
        "Forces of all constraint rows on its dofs in the last solve [N or N·m].",
    )
    qfrc_bias = Entry("bias", "Coriolis, centrifugal and gravity forces on its dofs.")
    qfrc_passive = Entry("passive", "Forces of springs and dampers on its dofs.")
    qfrc_constraint = Entry("constraint_force", "MuJoCo's name for `constraint_force`.")

    @property
    def type(self) -> str:
        """Type of the joint: "free", "ball", "slide" or "hinge"."""
        return self._sim.model.jnt_type[self.index]

    def _at(self, array: str) -> slice:
        model, position = self._sim.model, array == "qpos"
        start = int((model.jnt_qposadr if position else model.jnt_dofadr)[self.index])
        return slice(start, start + (QPOS if position else DOFS)[self.type])


class GeomView(_View):
    """One geom; see `BodyView`."""

    kind = "geom"
    xpos = Entry("geom_xpos", "Position of the geom [m], shape (3,).")
    xmat = Entry("geom_xmat", "Orientation of the geom as a rotation matrix, shape (3, 3).")


class SiteView(_Frame):
    """One site; see `BodyView`."""

    kind = "site"
    _jacobian = "site_jacobian"
    xpos = Entry("site_xpos", "Position of the site [m], shape (3,).")
    xmat = Entry("site_xmat", "Orientation of the site as a rotation matrix, shape (3, 3).")


class TendonView(_View):
    """One tendon; see `BodyView`."""

    kind = "tendon"
    length = Entry("ten_length", "Length [m, or the unit of its joints], shape ().")
    velocity = Entry("ten_velocity", "Rate of the length, shape ().")
    jacobian = Entry("ten_J", "Derivative of the length by the dofs, its moment arms, shape (nv,).")
    force = Entry(
        "ten_force",
        "Force of its spring and damper along it, positive where it lengthens it [N], shape ().",
    )


class SensorView(_View):
    """One sensor; see `BodyView`."""

    kind = "sensor"

    @property
    def type(self) -> str:
        """Type of the sensor, such as "accelerometer"."""
        kind: str = self._sim.model.sensor_type[self.index]
        return kind

    @property
    def data(self) -> Floats:
        """Values of this sensor only, shape (size,); see `Sim.sensordata`."""
        values: Floats = self._sim._core.sensordata(self.index)
        return values


class ActuatorView(_View):
    """One actuator; see `BodyView`. ctrl and act can be written."""

    kind = "actuator"
    ctrl = Entry("ctrl", "Control, shape (1,).", writable=True)
    act = Entry("act", "Activation, shape (1,), or (0,) without one.", writable=True)
    length = Entry("actuator_length", "Length along which it pulls, times its gear [m or rad].")
    velocity = Entry("actuator_velocity", "Rate of its length, times its gear [m/s or rad/s].")
    force = Entry("actuator_force", "Force of the last solve, before the gear [N or N·m].")

    def _at(self, array: str) -> int | slice:
        if array == "act":
            start = int(self._sim.model.actuator_actadr[self.index])
            return slice(start, start + 1) if start >= 0 else slice(0, 0)
        return slice(self.index, self.index + 1) if array == "ctrl" else self.index
