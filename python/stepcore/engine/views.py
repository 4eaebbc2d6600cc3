"""Views of a `Sim` or a `Batch` by element name: ``sim.body("torso").xpos``,
``sim.joint("knee").qpos``. Those of a `Batch` have its world axis in front."""

from __future__ import annotations

from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from stepcore.checks import KnownNames
from stepcore.engine.arrays import Floats, fill
from stepcore.scene.layout import DOFS, QPOS

if TYPE_CHECKING:
    from stepcore.engine.batch import Batch
    from stepcore.engine.sim import Sim


class _View(KnownNames):
    kind = ""

    def __init__(self, sim: Sim | Batch, index: int) -> None:
        self._sim = sim
        self._index = index

    @property
    def index(self) -> int:
        """Where the element stands in the arrays."""
        return self._index

    @property
    def name(self) -> str:
        """The element's name, "" if it has none."""
        return self._sim.model.names[self.kind][self.index]

    @property
    def _label(self) -> str:
        return f'{self.kind} "{self.name}"' if self.name else f"{self.kind} {self.index}"

    def __repr__(self) -> str:
        return f'<{self.kind} {self.index} "{self.name}" of {self._sim!r}>'


class BodyView(_View):
    """One body of a `Sim`."""

    kind = "body"

    @property
    def xpos(self) -> Floats:
        """Position of its frame [m], shape (3,)."""
        return self._sim.xpos[..., self.index, :]

    @property
    def xquat(self) -> Floats:
        """Orientation of its frame, w x y z, shape (4,)."""
        return self._sim.xquat[..., self.index, :]

    @property
    def xmat(self) -> Floats:
        """Orientation of its frame, shape (3, 3)."""
        return self._sim.xmat[..., self.index, :, :]

    @property
    def velocity(self) -> Floats:
        """Velocity of its origin [m/s], then angular [rad/s], in world axes, shape (6,)."""
        velocity: Floats = self.jacobian @ self._sim.qvel[..., None]
        return velocity[..., 0]

    @property
    def jacobian(self) -> Floats:
        """How its frame moves with qvel, shape (6, nv); see `Sim.jacobian`."""
        return self._sim.jacobian(self.index)

    @property
    def mass(self) -> float:
        """[kg], the same in every world."""
        return float(self._sim.model.body_mass[self.index])

    @property
    def xfrc_applied(self) -> Floats:
        """Its force [N] and moment [N·m], yours to write, shape (6,)."""
        return self._sim.xfrc_applied[..., self.index, :]

    @xfrc_applied.setter
    def xfrc_applied(self, value: ArrayLike) -> None:
        fill(self.xfrc_applied, f"xfrc_applied of {self._label}", value)


class JointView(_View):
    """One joint of a `Sim`: views of the state arrays, yours to write."""

    kind = "joint"

    @property
    def type(self) -> str:
        """ "free", "ball", "slide" or "hinge"."""
        return self._sim.model.jnt_type[self.index]

    @property
    def _dofs(self) -> slice:
        start = int(self._sim.model.jnt_dofadr[self.index])
        return slice(start, start + DOFS[self.type])

    @property
    def qpos(self) -> Floats:
        """Its positions: 7 of a free joint, 4 of a ball, 1 of a slide or hinge."""
        start = int(self._sim.model.jnt_qposadr[self.index])
        return self._sim.qpos[..., start : start + QPOS[self.type]]

    @qpos.setter
    def qpos(self, value: ArrayLike) -> None:
        fill(self.qpos, f"qpos of {self._label}", value)

    @property
    def qvel(self) -> Floats:
        """Its velocities: 6, 3 or 1."""
        return self._sim.qvel[..., self._dofs]

    @qvel.setter
    def qvel(self, value: ArrayLike) -> None:
        fill(self.qvel, f"qvel of {self._label}", value)

    @property
    def qacc(self) -> Floats:
        """Its accelerations in the last solve."""
        return self._sim.qacc[..., self._dofs]

    @property
    def qfrc_applied(self) -> Floats:
        """The forces applied to it."""
        return self._sim.qfrc_applied[..., self._dofs]

    @qfrc_applied.setter
    def qfrc_applied(self, value: ArrayLike) -> None:
        fill(self.qfrc_applied, f"qfrc_applied of {self._label}", value)

    @property
    def constraint_force(self) -> Floats:
        """The forces of all rows on it in the last solve."""
        return self._sim.constraint_force[..., self._dofs]


class GeomView(_View):
    """One geom of a `Sim`."""

    kind = "geom"

    @property
    def xpos(self) -> Floats:
        """Its position [m], shape (3,)."""
        return self._sim.geom_xpos[..., self.index, :]

    @property
    def xmat(self) -> Floats:
        """Its orientation, shape (3, 3)."""
        return self._sim.geom_xmat[..., self.index, :, :]


class SiteView(_View):
    """One site of a `Sim`."""

    kind = "site"

    @property
    def xpos(self) -> Floats:
        """Its position [m], shape (3,)."""
        return self._sim.site_xpos[..., self.index, :]
