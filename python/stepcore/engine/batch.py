"""`Batch`: many worlds of one model, stepped together, in lanes and over threads."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import _core, checks
from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import Floats, StateArray, numbers, snapshot
from stepcore.engine.sim import Momentum
from stepcore.engine.stepped import Stepped, compiled
from stepcore.engine.tables import contact_table, row_table
from stepcore.engine.views import BodyView, GeomView, JointView, SiteView

if TYPE_CHECKING:
    from typing import Unpack

    from stepcore.engine.model import Model
    from stepcore.engine.settings_fields import SettingsFields
    from stepcore.scene.scene import Scene


class Rollout(NamedTuple):
    """States after every step: qpos (n, steps, nq), qvel (n, steps, nv), act (n, steps, na)."""

    qpos: Floats
    qvel: Floats
    act: Floats


# A batch of fewer worlds × dofs than this is stepped faster by one thread than by several, because
# waking a thread takes some 20 µs a step (measured: 64 worlds of a half cheetah lose 25 %, 512 gain
# 40 % on two cores).
WORTH_THREADS = 2000

# What the other worlds do when one fails.
ON_FAILURE = ("stop", "go on")


class Batch(Stepped):
    """`n` worlds of a model; the arrays of a `Sim` with a leading world axis.

    model: a `Model`, or a `Scene` to compile. n: how many worlds. threads: how many step at once.
    lanes: eight worlds share a processor's vector registers; False: one by one; the results are
    the same bits, as they are at any number of threads. (Single precision runs one by one.)
    settings, overrides: as for a `Sim`.

    A batch keeps only `qacc` of its worlds' last solves; what else is read of them (`contacts`,
    `rows`, `residual`, `constraint_force`, `actuator_force`) is computed again, with the same
    bits, at the price of a step that is not shared over lanes and threads.

    on_failure: "stop": if a world fails (see `Sim.step`), SimulationError names it, and all stand
    before the first step in which one did. "go on": the others go on, with the same bits as if
    nothing had happened; a world that failed stands in its last finite state, `failures` has its
    error, and it moves again when its qpos or qvel are written (or by `reset` or `restore`).

    All worlds have the same time.

    >>> from stepcore import Batch, Scene
    >>> scene = Scene()
    >>> ball = scene.add_body("ball")
    >>> _ = scene.add_joint(ball, "slide")
    >>> _ = scene.add_geom(ball, "sphere", 0.1, mass=1.0)
    >>> batch = Batch(scene, 3, dt=0.01)
    >>> batch.qvel[:, 0] = [0.0, 1.0, 2.0]
    >>> batch.step(10)
    >>> batch.qvel[:, 0].round(3).tolist()
    [-0.981, 0.019, 1.019]
    """

    qpos = StateArray("Positions, shape (n, nq); quaternions w x y z.")
    qvel = StateArray("Velocities, shape (n, nv).")
    act = StateArray("States of actuators, shape (n, na): none has one yet.")
    ctrl = StateArray("Controls, shape (n, nu); held during a step.")
    qfrc_applied = StateArray("Forces on the dofs [N or N·m], shape (n, nv); held during a step.")
    xfrc_applied = StateArray(
        "Force [N] on each body's centre of mass and moment [N·m], in world axes, "
        "shape (n, nbody, 6)."
    )

    def __init__(
        self,
        model: Model | Scene,
        n: int,
        threads: int | None = None,
        *,
        lanes: bool = True,
        on_failure: str = "stop",
        settings: Settings | None = None,
        **overrides: Unpack[SettingsFields],
    ) -> None:
        self._model = compiled(model).with_settings(settings, **overrides)
        self._lanes = checks.flag("Batch", "lanes", lanes)
        self._threads = _threads(threads, n, self._model.nv)
        self._on_failure: str = checks.one_of(*ON_FAILURE)("Batch", "on_failure", on_failure)
        self._failures: dict[int, SimulationError] = {}
        own, goes_on = self._model.settings, self._on_failure == "go on"
        self._core = _core.Batch(self._model.core, own, n, self._threads, self._lanes, goes_on)
        self._own(self._core)

    def __len__(self) -> int:
        """The number of worlds."""
        return len(self.qpos)

    @property
    def time(self) -> float:
        """Time of all worlds [s]: where it was set or restored, plus dt for each step since."""
        return self._core.time

    @time.setter
    def time(self, value: float) -> None:
        self._core.time = value

    def step(self, n: int = 1) -> None:
        """Advances every world by n steps, without the GIL; raises what `Sim.step` raises."""
        with self._told():
            self._core.step(n)

    def forward(self) -> None:
        """Place, detect and solve at the present states; nothing moves."""
        with self._told():
            self._core.forward()

    def rollout(self, ctrl: ArrayLike) -> Rollout:
        """Steps with given controls and keeps every state.

        ctrl: shape (n, steps, nu), a row for every step. The last one stays in `ctrl`.
        """
        table = numbers("ctrl", ctrl)
        if table.ndim != 3:
            limit = f"({len(self)}, steps, {self._model.nu})"
            raise ValueError(f"ctrl has shape {table.shape}: must be {limit}")
        with self._told():
            qpos, qvel = self._core.rollout(table)
        return Rollout(qpos, qvel, np.zeros((*qpos.shape[:2], 0)))

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Gives an error the replay of the world that failed."""
        try:
            yield
        except SimulationError as error:
            self._explain(error)
            raise

    @property
    def failures(self) -> dict[int, SimulationError]:
        """The errors of worlds that failed while the others went on, by world."""
        known = self._failures
        failed, new = self._core.failures(list(known))
        for error in new:
            self._explain(error)
        errors = {error.world: error for error in new}
        self._failures = {world: known.get(world) or errors[world] for world in failed}
        return dict(self._failures)

    def _restart(self, time: float) -> None:
        self._core.restart(time)

    def state(self) -> tuple[bytes, ...]:
        """A complete snapshot of every world; each is also one of a `Sim`."""
        return tuple(self._core.state())

    def restore(self, state: tuple[bytes, ...]) -> None:
        """Goes back to a `state`; continuing is bit-identical.

        Raises ValueError for anything else, and leaves everything as it was.
        """
        try:
            worlds = list(state)
        except TypeError:
            worlds = [state]  # type: ignore[list-item]
        self._core.restore([snapshot(state, world) for world in worlds])

    # The present states.

    @property
    def xmat(self) -> Floats:
        """Orientation of each body's frame as a matrix, shape (n, nbody, 3, 3)."""
        return self._core.xmat

    @property
    def geom_xmat(self) -> Floats:
        """Orientation of each geom, shape (n, ngeom, 3, 3)."""
        return self._core.geom_xmat

    def mass_matrix(self) -> Floats:
        """The mass matrices, armature included, shape (n, nv, nv)."""
        return self._core.mass_matrix()

    @property
    def bias(self) -> Floats:
        """Coriolis, centrifugal and gravity forces (on the left-hand side), shape (n, nv)."""
        return self._core.bias

    @property
    def passive(self) -> Floats:
        """Forces of joint springs and dampers, shape (n, nv)."""
        return self._core.passive

    @property
    def momentum(self) -> Momentum:
        """Linear and angular momentum of each world, shape (n, 3) each; see `Sim.momentum`."""
        both = self._core.momentum
        return Momentum(both[:, 0], both[:, 1])

    def jacobian(self, body: str | int) -> Floats:
        """How a body's frame moves with qvel, shape (n, 6, nv); see `Sim.jacobian`."""
        return self._core.jacobian(self._model.index("body", body))

    # The last step or forward().

    @property
    def constraint_force(self) -> Floats:
        """Force of all rows together on the dofs, Jᵀλ/dt, shape (n, nv)."""
        return self._core.constraint_force

    @property
    def actuator_force(self) -> Floats:
        """Force of each actuator, before its gear, shape (n, nu)."""
        return self._core.actuator_force

    @property
    def contacts(self) -> list[NDArray[Any]]:
        """Contacts of each world, n structured arrays; see `Sim.contacts`."""
        names = self._model.geom_names
        return [contact_table(names, *table) for table in self._core.contacts()]

    @property
    def rows(self) -> list[NDArray[Any]]:
        """Rows of each world, n structured arrays; see `Sim.rows`."""
        return [row_table(self.settings.dt, *table) for table in self._core.rows()]

    @property
    def residual(self) -> Floats:
        """How far each world's last solve was from the rows' laws [m/s], shape (n,)."""
        return self._core.residual

    # By name.

    def body(self, name: str | int) -> BodyView:
        """A body's part of the arrays, worlds first; ValueError for an unknown name."""
        return BodyView(self, self._model.index("body", name))

    def joint(self, name: str | int) -> JointView:
        """A joint's part of the arrays, worlds first."""
        return JointView(self, self._model.index("joint", name))

    def geom(self, name: str | int) -> GeomView:
        """A geom's part of the arrays, worlds first."""
        return GeomView(self, self._model.index("geom", name))

    def site(self, name: str | int) -> SiteView:
        """A site's part of the arrays, worlds first."""
        return SiteView(self, self._model.index("site", name))

    @property
    def qacc(self) -> Floats:
        """Accelerations of the last solve, shape (n, nv)."""
        return self._core.qacc

    @property
    def xpos(self) -> Floats:
        """Position of each body's frame at the present state [m], shape (n, nbody, 3)."""
        return self._core.xpos

    @property
    def xquat(self) -> Floats:
        """Orientation of each body's frame at the present state, shape (n, nbody, 4)."""
        return self._core.xquat

    @property
    def geom_xpos(self) -> Floats:
        """Position of each geom at the present state [m], shape (n, ngeom, 3)."""
        return self._core.geom_xpos

    @property
    def site_xpos(self) -> Floats:
        """Position of each site at the present state [m], shape (n, nsite, 3)."""
        return self._core.site_xpos

    @property
    def energy(self) -> Floats:
        """Kinetic and potential energy at the present state [J], shape (n, 2)."""
        return self._core.energy

    @property
    def overlap(self) -> Floats:
        """Deepest overlap of two geoms that can touch, at the present state [m], shape (n,)."""
        return self._core.overlap

    def __reduce__(self) -> tuple[Any, ...]:
        how = (self._threads, self._lanes, self._on_failure)
        return _restored, (self._model, len(self), *how, self.state())

    def __repr__(self) -> str:
        scene = self._model.scene.name
        name = f' of "{scene}"' if scene else ""
        return f"<Batch{name}: {len(self)} worlds, time {self.time:g} s; {self.settings!r}>"


def _threads(threads: int | None, n: int, nv: int) -> int:
    """How many threads step a batch; None is one a core where the work is worth waking them."""
    if threads is None and checks.number(n) is not None and n * nv < WORTH_THREADS:
        return 1
    return checks.threads(threads)


def _restored(
    model: Model, n: int, threads: int, lanes: bool, on_failure: str, state: tuple[bytes, ...]
) -> Batch:
    batch = Batch(model, n, threads, lanes=lanes, on_failure=on_failure)
    batch.restore(state)
    return batch
