"""`World`: the common base of `Sim` and `Batch`: state, readouts, named views and reset."""

from __future__ import annotations

import importlib
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from stepcore import _core, checks
from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats, ReadOnly, StateArray, numbers, readout
from stepcore.engine.tables import RayHits
from stepcore.engine.views import (
    ActuatorView,
    BodyView,
    GeomView,
    JointView,
    SensorView,
    SiteView,
    TendonView,
)

if TYPE_CHECKING:
    from stepcore._core import Settings
    from stepcore.engine.model import Model


# The arrays of a keyframe, in the order of its fields.
OF_KEYS = ("qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat")


def compiled(model: Any) -> Model:
    """Return a model unchanged, or compile a scene or any argument of `stepcore.load`."""
    if isinstance(getattr(model, "core", None), _core.Model):
        same: Model = model
        return same
    if isinstance(model, (str, os.PathLike)) or type(model).__name__ in ("MjModel", "MjSpec"):
        # The engine must not import the readers, which are a higher layer.
        model = importlib.import_module("stepcore").load(model)
    if not hasattr(model, "compile") or not hasattr(model, "to_dict"):
        limit = "a stepcore.Model, a stepcore.Scene or the path of an MJCF file"
        raise ValueError(f"model = {checks.shown(model)}: must be {limit}")
    fresh: Model = model.compile()
    return fresh


class World(checks.KnownNames, ABC):
    """One world of a model, or many. A `Batch` adds a leading axis n to the shapes given here."""

    qpos = StateArray("Positions [m or rad], shape (nq,); quaternions w x y z.")
    qvel = StateArray("Velocities [m/s or rad/s], shape (nv,).")
    act = StateArray("Activations of actuators, shape (na,): states of filters and integrators.")
    ctrl_history = StateArray(
        "Past controls of the actuators with a delay, shape (nhistory,): each one's `nsample` last "
        "controls, the newest first. A step puts the present one in front; initially 0."
    )
    ctrl = StateArray("Controls, shape (nu,), constant during a step.")
    qfrc_applied = StateArray(
        "Applied forces on the dofs [N or N·m], shape (nv,), constant during a step."
    )
    xfrc_applied = StateArray(
        "Force on each body's centre of mass [N] and moment [N·m], in world axes, "
        "shape (nbody, 6), constant during a step."
    )
    eq_active = StateArray(
        "Whether each equality acts, shape (neq,): 1 or True, or 0 where it is left out. Constant "
        "during a step; initially as `Equality.active`.",
        truths=True,
    )
    mocap_pos = StateArray("Positions of mocap bodies [m], shape (nmocap, 3).")
    mocap_quat = StateArray("Orientations of mocap bodies, quaternions w x y z, shape (nmocap, 4).")

    # Readouts of the present state.
    xpos = readout("Position of each body's frame [m], shape (nbody, 3).")
    xquat = readout("Orientation of each body's frame as a quaternion w x y z, shape (nbody, 4).")
    xmat = readout("Orientation of each body's frame as a rotation matrix, shape (nbody, 3, 3).")
    geom_xpos = readout("Position of each geom [m], shape (ngeom, 3).")
    geom_xmat = readout("Orientation of each geom as a rotation matrix, shape (ngeom, 3, 3).")
    site_xpos = readout("Position of each site [m], shape (nsite, 3).")
    ten_length = readout("Length of each tendon [m, or the unit of its joints], shape (ntendon,).")
    ten_velocity = readout("Rate of each tendon's length, shape (ntendon,).")
    ten_J = readout(
        "Derivative of each tendon's length by the dofs, its moment arms, shape (ntendon, nv)."
    )
    ten_force = readout(
        "Force of each tendon's spring and damper, positive where it lengthens it [N], "
        "shape (ntendon,)."
    )
    site_xmat = readout("Orientation of each site as a rotation matrix, shape (nsite, 3, 3).")
    subtree_com = readout(
        "Centre of mass of each body with all that hangs on it [m], shape (nbody, 3)."
    )
    cinert = readout(
        "Inertia of each body about c, the centre of mass of the tree that it is in: "
        "xx, yy, zz, xy, xz, yz [kg·m²], then its mass times the way from c to its own centre "
        "[kg·m], then its mass [kg]; shape (nbody, 10). A tree is all that hangs on one child of "
        "the world, and c is that child's `subtree_com`. Zero for the world."
    )
    cvel = readout(
        "Velocity of each body: angular [rad/s], then linear, of the point of the body at c (see "
        "`cinert`) [m/s], in world axes; shape (nbody, 6)."
    )
    bias = readout(
        "Coriolis, centrifugal and gravity forces [N or N·m], shape (nv,); on the left-hand side "
        "of the equation of motion, M qacc + bias = forces. MuJoCo calls it qfrc_bias."
    )
    actuator_length = readout("Length of each actuator, times its gear [m or rad], shape (nu,).")
    actuator_velocity = readout("Velocity of each actuator, times its gear, shape (nu,).")
    passive = readout(
        "Forces of springs and dampers of joints and tendons [N or N·m], shape (nv,). MuJoCo calls "
        "them qfrc_passive."
    )
    M = readout("MuJoCo's name for `mass_matrix()`: all entries, (nv, nv).", alias="mass_matrix")
    qfrc_bias = readout("MuJoCo's name for `bias`.", alias="bias")
    qfrc_passive = readout("MuJoCo's name for `passive`.", alias="passive")

    # Readouts of the last step or forward().
    qacc = readout("Accelerations of the last solve [m/s² or rad/s²], shape (nv,).")
    constraint_force = readout(
        "Force of all constraint rows on the dofs, Jᵀλ/dt, and of contacts under the law penalty "
        "[N or N·m], shape (nv,). MuJoCo calls it qfrc_constraint."
    )
    qfrc_constraint = readout("MuJoCo's name for `constraint_force`.", alias="constraint_force")
    cacc = readout(
        "Acceleration of each body in the last solve, written as `cvel` is [rad/s², m/s²], shape "
        "(nbody, 6). Gravity counts as an upward acceleration: a body at rest has +9.81. The "
        "linear part is the rate of `cvel`, not of a point that moves along: a sensor gives that."
    )
    cfrc_ext = readout(
        "Applied forces, contacts, body equalities and all that acts along spatial tendons, on "
        "each body in the last solve: moment about c (see `cinert`) [N·m], then force [N], in "
        "world axes; shape (nbody, 6). Forces of fixed tendons and of other actuators count as "
        "the joints' own. Before there was a solve, and after `reset`, of one at "
        "the present state."
    )
    cfrc_int = readout(
        "What each body's parent exerts on it in the last solve, written as `cfrc_ext` is, shape "
        "(nbody, 6)."
    )
    actuator_force = readout("Force of each actuator before its gear [N or N·m], shape (nu,).")

    # The index of all worlds, which precedes the index of an element.
    _lead: tuple[slice, ...] = ()
    _core: Any
    _model: Model

    def _own(self, core: Any) -> None:
        self._core = core
        self._arrays: dict[str, Floats] = dict(core.arrays())

    @property
    def model(self) -> Model:
        """The `Model`, including the settings in use."""
        return self._model

    @abstractmethod
    def step(self, n: int = 1) -> None:
        """Take n steps."""

    @abstractmethod
    def _restart(self, time: float) -> None:
        """Set the time and discard the warm-start impulses."""

    @property
    def settings(self) -> Settings:
        """The `Settings` in use."""
        return self.model.settings

    @property
    def time(self) -> float:
        """Time [s]: the value last set or restored, plus dt for each step since."""
        time: float = self._core.time
        return time

    @time.setter
    def time(self, value: float) -> None:
        self._core.time = value

    def forward(self) -> None:
        """Compute poses, contacts and forces at the present state, without taking a step.

        Raises the same errors as `step`.
        """
        self._call(self._core.forward)

    def mass_matrix(self) -> Floats:
        """Return the mass matrix of the present state, armature included, shape (nv, nv)."""
        matrix: Floats = self._core.readout("mass_matrix")
        return matrix

    def jacobian(self, body: str | int, point: ArrayLike | None = None) -> Floats:
        """Return the Jacobian of a body's frame, shape (6, nv), in world axes.

        point: world position [m] of a point fixed to the body, shape (3,); by default the origin of
            the body's frame.

        Multiplied by qvel, the first three rows give the velocity of the point [m/s] and the last
        three the angular velocity [rad/s]. Raises ValueError for an unknown body. The Jacobian of a
        site is an attribute of `Sim.site`.
        """
        index = self.model.index("body", body)
        place = None if point is None else numbers("point", point)
        if place is not None and (place.shape != (3,) or not np.isfinite(place).all()):
            raise ValueError(f"point = {checks.shown(point)}: must be 3 finite numbers")
        jacobian: Floats = (
            self._core.jacobian(index)
            if place is None
            else self._core.point_jacobian(index, place.tolist())
        )
        return jacobian

    def inverse(self, qacc: ArrayLike | None = None) -> Floats:
        """Compute the forces that cause an acceleration at the present state, shape (nv,).

        qacc: the acceleration [m/s² or rad/s²], shape (nv,); by default from the last solve.

        The result is the generalised force that actuators and applied forces must exert together
        [N or N·m]: M qacc + bias − passive − Jᵀf, where f are the constraint forces that follow
        from the acceleration (MuJoCo's `mj_inverse`). The state does not change.

        Raises ValueError for a qacc of another shape, and under laws other than "solref", which do
        not define f as a function of the acceleration.

        >>> from stepcore import Scene, Sim
        >>> scene = Scene()
        >>> ball = scene.add_body("ball")
        >>> _ = scene.add_joint(ball, "slide", axis=(0, 0, 1))
        >>> _ = scene.add_geom(ball, "sphere", 0.1, mass=2.0)
        >>> Sim(scene).inverse([1.0]).round(2).tolist()
        [21.62]
        """
        tables = () if qacc is None else (self._table("qacc", qacc, self._arrays["qvel"].shape),)
        forces: Floats = self._core.inverse(*(table.ravel() for table in tables))
        return forces

    def ray(
        self,
        origin: ArrayLike,
        direction: ArrayLike,
        *,
        exclude: str | int | None = None,
        groups: Sequence[int] | None = None,
        static: bool = True,
    ) -> RayHits:
        """Return the first geom that each ray hits at the present state.

        origin, direction: start [m] and direction of each ray in world axes, shape (…, 3). They
            broadcast against each other, so that one origin can serve many directions. In a
            `Batch` the first axis is the world, and shape (3,) applies to all worlds.
        exclude: a body whose geoms are ignored.
        groups: the groups (0 to 5) whose geoms can be hit; None means all groups.
        static: False ignores geoms that are fixed to the world.

        The rules are as in MuJoCo's `mj_ray`: a ray that starts inside a geom hits the surface
        from within, a plane is hit from the front and within its size, and a mesh is hit at its
        triangles. Visual-only meshes and height fields of a file are not in the scene, so rays
        pass through them.

        Raises ValueError for shapes that do not broadcast, a direction of zero length and an
        unknown body.

        >>> from stepcore import Scene, Sim
        >>> scene = Scene()
        >>> _ = scene.add_geom("world", "sphere", 0.5, name="ball")
        >>> hits = Sim(scene).ray((0, 0, 2), [(0, 0, -1), (1, 0, 0)])
        >>> hits.distance.tolist(), hits.geom.tolist()
        ([1.5, -1.0], [0, -1])
        """
        worlds = self._arrays["qpos"].shape[:-1]
        excluded = None if exclude is None else self.model.index("body", exclude)
        ends = [_vectors("origin", origin), _vectors("direction", direction)]
        if not ends[1].any(axis=-1).all():
            raise ValueError("direction = (0, 0, 0): must have a length")
        # The axes of rays after the axis of the worlds.
        further = (1,) * max(max(end.ndim for end in ends) - 1, 1)
        try:
            *lead, _ = np.broadcast_shapes(*(end.shape for end in ends), (*worlds, *further))
        except ValueError:
            shapes = " and ".join(str(end.shape) for end in ends)
            first = f", with {worlds[0]} worlds first" if worlds else ""
            limit = f"must have shapes that broadcast{first}"
            raise ValueError(f"origin and direction have shapes {shapes}: {limit}") from None
        rays = np.concatenate([np.broadcast_to(end, (*lead, 3)) for end in ends], axis=-1)
        fixed = not checks.flag("ray", "static", static)
        distance, geom, normal = self._core.rays(rays.ravel(), excluded, _groups(groups), fixed)
        met = np.array(geom, dtype=np.int64).reshape(lead)
        return RayHits(distance.reshape(lead), met, normal.reshape((*lead, 3)))

    # Views by name.

    def body(self, name: str | int) -> BodyView:
        """Return a view of one body; raise ValueError with the nearest names if there is none."""
        return BodyView(self, self._model.index("body", name))

    def joint(self, name: str | int) -> JointView:
        """Return a view of one joint; see `body`."""
        return JointView(self, self._model.index("joint", name))

    def geom(self, name: str | int) -> GeomView:
        """Return a view of one geom; see `body`."""
        return GeomView(self, self._model.index("geom", name))

    def site(self, name: str | int) -> SiteView:
        """Return a view of one site; see `body`."""
        return SiteView(self, self._model.index("site", name))

    def tendon(self, name: str | int) -> TendonView:
        """Return a view of one tendon; see `body`."""
        return TendonView(self, self._model.index("tendon", name))

    def sensor(self, name: str | int) -> SensorView:
        """Return a view of one sensor; see `body`."""
        return SensorView(self, self._model.index("sensor", name))

    @property
    def sensordata(self) -> Floats:
        """Values of all sensors in model order, shape (nsensordata,).

        `Model.sensor_dim` gives the number of values of each sensor. The values describe the state
        at the start of the last `step` or `forward`, before the step moved anything, as in MuJoCo
        after mj_step. The values are computed on access. Force sensors read the solve of the step;
        they need one more solve in a `Batch`, with `sleep`, and under "rk4" and "midpoint".
        Before the first step or `forward`, and after `reset`, the values describe the
        present state.
        """
        values: Floats = self._core.sensordata()
        return values

    def actuator(self, name: str | int) -> ActuatorView:
        """Return a view of one actuator; see `body`."""
        return ActuatorView(self, self._model.index("actuator", name))

    # Resetting and failing.

    def reset(self, key: str | int | None = None) -> None:
        """Reset to the scene's initial pose at rest and time 0, or to a keyframe.

        key: the name or index of a keyframe.

        Controls are set to the keyframe's, or to 0 without a keyframe. Applied forces become 0 and
        warm-start impulses are discarded. Mocap bodies take the poses of the keyframe, or of the
        scene without a keyframe. `eq_active` takes the values of the scene.

        Raises ValueError, with the nearest names, for an unknown keyframe.
        """
        values, time = self._initial(key)
        self._write(values)
        self._restart(time)

    def _initial(self, key: str | int | None) -> tuple[dict[str, Sequence[float] | Floats], float]:
        """Return the arrays of one world after a reset, and the time."""
        initial: dict[str, Sequence[float] | Floats] = dict(self._model.core.initial())
        if key is None:
            return initial, 0.0
        state = self._model.keys[self._model.index("key", key)]
        return initial | dict(zip(OF_KEYS, state[2:], strict=True)), state.time

    def _write(
        self, values: dict[str, Sequence[float] | Floats], worlds: Any = slice(None)
    ) -> None:
        """Write one world's arrays into all worlds, or into some worlds; all of them or none."""
        locked = [name for name in values if not self._arrays[name].flags.writeable]
        if locked:
            raise ValueError(f"{locked[0]} is read-only: its flags.writeable must be True")
        for name, row in values.items():
            if len(row):
                self._arrays[name].reshape(-1, len(row))[worlds] = row

    def _call(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """Call the engine; a SimulationError gets its `replay`, which can be run again."""
        try:
            return call(*arguments)
        except SimulationError as error:
            self._explain(error)
            raise

    def _explain(self, error: SimulationError) -> None:
        # Imported here because only failures need the post-mortem.
        from stepcore.engine.replay import attach

        qpos, qvel = self._arrays["qpos"], self._arrays["qvel"]
        if qpos.ndim > 1:
            qpos, qvel = qpos[error.world], qvel[error.world]
        attach(error, self._model_of(error.world), qpos, qvel)

    def _model_of(self, world: int) -> Model:
        return self._model

    def _table(self, name: str, value: ArrayLike, *shapes: tuple[int, ...]) -> Floats:
        """Return an argument as a table of finite numbers, of one of these shapes."""
        table = numbers(name, value)
        if table.shape not in shapes:
            limit = " or ".join(map(str, shapes))
            raise ValueError(f"{name} has shape {table.shape}: must be {limit}")
        if not np.isfinite(table).all():
            raise ValueError(f"{name}: must be finite")
        return table


# The arrays that can be recorded: the state, the inputs and the readouts.
READINGS = tuple(
    name for name, value in vars(World).items() if isinstance(value, StateArray | ReadOnly)
)


def _vectors(name: str, value: ArrayLike) -> Floats:
    table = numbers(name, value)
    if table.ndim == 0 or table.shape[-1] != 3:
        raise ValueError(f"{name} has shape {table.shape}: must be (…, 3)")
    if not np.isfinite(table).all():
        raise ValueError(f"{name}: must be finite")
    return table


def _groups(groups: Sequence[int] | None) -> list[bool] | None:
    """Return, for each group of geoms, whether it can be hit; None for all."""
    if groups is None:
        return None
    seen = checks.as_list(groups) or [None]
    if any(isinstance(group, bool) or group not in range(6) for group in seen):
        raise checks.refuse("ray", "groups", groups, "integers from 0 to 5")
    return [group in seen for group in range(6)]
