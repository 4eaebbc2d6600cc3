"""`Sim`: one world: its state, yours to write, and everything that can be read of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from numpy.typing import ArrayLike, NDArray

from stepcore import _core
from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import Floats, StateArray, snapshot
from stepcore.engine.linearization import Linearization, linearized
from stepcore.engine.stepped import Stepped, compiled
from stepcore.engine.tables import contact_table, row_table
from stepcore.engine.trajectory import Trajectory, record_run
from stepcore.engine.views import BodyView, GeomView, JointView, SiteView

if TYPE_CHECKING:
    from typing import Unpack

    from stepcore.engine.model import Model
    from stepcore.engine.settings_fields import SettingsFields
    from stepcore.scene.scene import Scene


class Energy(NamedTuple):
    """Energy [J]: kinetic, and potential: joint springs, and gravity on every body, fixed ones
    too, zero at the world's origin."""

    kinetic: float
    potential: float

    @property
    def total(self) -> float:
        """Kinetic and potential together [J]."""
        return self.kinetic + self.potential


class Momentum(NamedTuple):
    """Linear [kg·m/s] and angular about the world's origin [kg·m²/s], shape (3,) each."""

    linear: Floats
    angular: Floats


class Sim(Stepped):
    """One world of a model.

    model: a `Model`, or a `Scene` to compile. settings: a `Settings` in place of the model's own.
    overrides: single settings fields, such as ``dt=0.005, solver="pgs"``.

    Raises ValueError for a scene that cannot be compiled and for settings outside their limits.

    The state arrays are float64 whatever the precision, and are checked whenever they are used:
    an entry that is not finite is a ValueError naming it, and nothing is stepped. Poses, energy
    and matrices are those of the present state, and follow when it is written; ``qacc``,
    ``contacts``, ``rows`` and forces are those of the last `step` or `forward`. Only the state
    arrays can be written; a result is read-only.

    >>> from stepcore import Scene, Sim
    >>> scene = Scene()
    >>> ball = scene.add_body("ball", pos=(0, 0, 1))
    >>> _ = scene.add_joint(ball, "free")
    >>> _ = scene.add_geom(ball, "sphere", 0.1, mass=1.0)
    >>> sim = Sim(scene, dt=0.01)
    >>> sim.step(10)
    >>> round(float(sim.qvel[2]), 3)
    -0.981
    """

    qpos = StateArray("Positions, shape (nq,); quaternions w x y z.")
    qvel = StateArray("Velocities, shape (nv,).")
    act = StateArray("States of actuators, shape (na,): none has one yet.")
    ctrl = StateArray("Controls, shape (nu,); held during a step.")
    qfrc_applied = StateArray("Forces on the dofs [N or N·m], shape (nv,); held during a step.")
    xfrc_applied = StateArray(
        "Force [N] on each body's centre of mass and moment [N·m], in world axes, shape (nbody, 6)."
    )

    def __init__(
        self,
        model: Model | Scene,
        settings: Settings | None = None,
        **overrides: Unpack[SettingsFields],
    ) -> None:
        self._model = compiled(model).with_settings(settings, **overrides)
        self._core = _core.Sim(self._model.core, self._model.settings)
        self._own(self._core)

    @property
    def time(self) -> float:
        """Time [s]: where it was set or restored, plus dt for each step since."""
        return self._core.time

    @time.setter
    def time(self, value: float) -> None:
        self._core.time = value

    # Stepping.

    def step(self, n: int = 1) -> None:
        """Advances by n steps, without the GIL.

        Raises ValueError for a state or input that is not finite (nothing is stepped),
        SimulationError if the motion stops being finite, or with the setting ``ledger`` if it has
        energy that it cannot have gained (the last finite state is kept), and KeyboardInterrupt
        between two steps of a long call.
        """
        try:
            self._core.step(n)
        except SimulationError as error:
            self._explain(error)
            raise

    def balance(self) -> None:
        """Balances the account of the setting ``ledger`` now; without a ledger, does nothing.

        A loop of short calls to `step` is looked into every 64 steps; `run`, and a `step` of 128 or
        more, end with this. Raises SimulationError if there is energy that the motion cannot have
        gained.
        """
        try:
            self._core.balance()
        except SimulationError as error:
            self._explain(error)
            raise

    def forward(self) -> None:
        """Place, detect and solve at the present state; nothing moves."""
        try:
            self._core.forward()
        except SimulationError as error:
            self._explain(error)
            raise

    def linearize(self) -> Linearization:
        """The next step as a linear map around the present state; nothing moves.

        Exact: derivatives are carried through the step itself (dual numbers), contacts and solver
        included, with this Sim's own settings, in float64 whatever the precision. ctrl and applied
        forces are held during the step, and so are the impulses from which the solver starts: what
        they would change in the next step is not part of the map. At a state where a law switches
        (a contact that just touches, a limit just reached, a clamp) the derivatives are those of
        one side: of what the step does at this very state.

        Takes about (2 nv + nu)/4 steps of dual numbers, each the work of a few plain ones, and
        working space made anew; runs without the GIL. See docs/linearize.md.

        Raises what `step` raises, and ValueError where the step has an infinite derivative.
        """
        return linearized(self, self._core.linearize())

    def count_flops(self, n: int = 1) -> int:
        """Floating-point operations of the next n steps; nothing moves.

        Counted while a copy takes these very steps in float64: +, −, ×, ÷ and √ are 1 each; a sine
        with its cosine, an arctangent or a power is 20; comparisons, signs and copies are none. The
        count is of the method, not of what a compiler made of it, and the same on every machine.

        Raises what `step` raises.

        >>> from stepcore import Sim, lesson
        >>> sim = Sim(lesson.drop(), dt=0.01)
        >>> sim.count_flops(2) == 2 * sim.count_flops()
        True
        """
        return sum(count for _, count in self._core.count(n))

    def stage_flops(self) -> dict[str, int]:
        """Floating-point operations of the next step by stage; their sum is `count_flops()`.

        place/kinematics (poses), place/inertia (mass matrix), place/factor, place/bias (Coriolis
        and gravity forces), place/forces (springs, actuators), place/guess, detect, solve/rows
        (making them), solve/impulses (sweeps or iterations), commit (the integrator).
        """
        return dict(self._core.count(1))

    @property
    def nbytes(self) -> int:
        """Memory of the engine's state and working space [bytes]; the model, which Sims share, is
        not in it. It grows until the most contacts there have been have room."""
        return self._core.nbytes

    def _restart(self, time: float) -> None:
        self._core.time = time
        self._core.forget()

    def state(self) -> bytes:
        """A complete snapshot: state, inputs, time, step count and warm-start impulses."""
        return self._core.state()

    def restore(self, state: bytes) -> None:
        """Goes back to a `state` of the same model; continuing is bit-identical.

        Raises ValueError for bytes that are not one, and leaves everything as it was.
        """
        self._core.restore(snapshot(state, state))

    def run(
        self,
        duration: float,
        control: Callable[[float, Sim], ArrayLike] | ArrayLike | None = None,
        control_dt: float | None = None,
        record: Sequence[str] = ("qpos", "qvel"),
    ) -> Trajectory:
        """Steps for `duration` [s] and keeps what `record` names at every step.

        control: a function of (time, sim) that returns ctrl, or an array of shape (n, nu) with
            one row a control period; the last row holds to the end. None: ctrl as it stands.
        control_dt: the control period [s], a whole number of steps; one step if None.
        record: names of arrays or numbers of this Sim, such as "qpos", "energy", "residual".

        Raises ValueError for a duration or period that is not a whole number of steps, a control
        of the wrong shape, and a name that cannot be recorded; and what `step` raises.

        >>> from stepcore import Sim, lesson
        >>> sim = Sim(lesson.drop(), dt=0.01)
        >>> trajectory = sim.run(0.05, record=("qpos", "energy"))
        >>> trajectory
        <Trajectory: 0 to 0.05 s, 6 instants; qpos (6, 1), energy (6, 2)>
        """
        return record_run(self, duration, control, control_dt, record)

    # The present state.

    @property
    def xpos(self) -> Floats:
        """Position of each body's frame [m], shape (nbody, 3)."""
        return self._core.xpos

    @property
    def xquat(self) -> Floats:
        """Orientation of each body's frame, w x y z, shape (nbody, 4)."""
        return self._core.xquat

    @property
    def xmat(self) -> Floats:
        """Orientation of each body's frame as a matrix, shape (nbody, 3, 3)."""
        return self._core.xmat

    @property
    def geom_xpos(self) -> Floats:
        """Position of each geom [m], shape (ngeom, 3)."""
        return self._core.geom_xpos

    @property
    def geom_xmat(self) -> Floats:
        """Orientation of each geom, shape (ngeom, 3, 3)."""
        return self._core.geom_xmat

    @property
    def site_xpos(self) -> Floats:
        """Position of each site [m], shape (nsite, 3)."""
        return self._core.site_xpos

    def mass_matrix(self) -> Floats:
        """The mass matrix, armature included, shape (nv, nv)."""
        return self._core.mass_matrix()

    @property
    def bias(self) -> Floats:
        """Coriolis, centrifugal and gravity forces (on the left-hand side), shape (nv,)."""
        return self._core.bias

    @property
    def passive(self) -> Floats:
        """Forces of joint springs and dampers, shape (nv,)."""
        return self._core.passive

    @property
    def energy(self) -> Energy:
        """Kinetic and potential energy [J]: of gravity and joint springs, not of servos."""
        kinetic, potential = self._core.energy
        return Energy(float(kinetic), float(potential))

    @property
    def momentum(self) -> Momentum:
        """Linear and angular momentum of all bodies; armature does not count."""
        linear, angular = self._core.momentum
        return Momentum(linear, angular)

    @property
    def overlap(self) -> float:
        """The deepest overlap of two geoms that can touch [m], 0 where none do."""
        return float(self._core.overlap)

    def jacobian(self, body: str | int) -> Floats:
        """How a body's frame moves with qvel, shape (6, nv), in world axes.

        Three rows for the velocity of its origin, three for its angular velocity.
        """
        return self._core.jacobian(self._model.index("body", body))

    # The last step or forward().

    @property
    def qacc(self) -> Floats:
        """Acceleration of the last solve, shape (nv,)."""
        return self._core.qacc

    @property
    def constraint_force(self) -> Floats:
        """Force of all rows together on the dofs, Jᵀλ/dt, shape (nv,)."""
        return self._core.constraint_force

    @property
    def actuator_force(self) -> Floats:
        """Force of each actuator, before its gear, shape (nu,)."""
        return self._core.actuator_force

    @property
    def contacts(self) -> NDArray[Any]:
        """Contacts, a structured array.

        kind ("contact"), index (of the pair of geoms in the model), part (which contact of the
        pair), geom1, geom2 (indices), name1, name2 ("" where none was given), dist [m] (negative:
        overlap), pos [m], normal (from geom 1 to geom 2), force (on geom 2, in world axes [N];
        zero where there is no row).
        """
        return contact_table(self._model.geom_names, *self._core.contacts())

    @property
    def rows(self) -> NDArray[Any]:
        """Rows in the order in which they are solved, a structured array.

        kind ("connect", "friction loss", "limit", "contact"), index (of the equality; of the joint
        under friction loss and limit; of the pair of geoms), part (which dof of the joint; 0 for
        the lower bound, 1 for the upper one; which contact of the pair; -1 for the whole
        element), name (`Model.element_name` of these), block (rows of one block are solved
        together), impulse [N·s], velocity (J v when the step began), target, regulariser,
        residual (s|δ|, in the row's unit of velocity), lo and hi (its bounds),
        force (impulse/dt [N]).
        """
        return row_table(self.settings.dt, *self._core.rows())

    def delassus(self) -> Floats:
        """How the rows of the last solve push each other, J M⁻¹ Jᵀ, shape (rows, rows) [1/kg].

        Entry (i, j) is the velocity that an impulse of 1 on row j gives row i, in the order of
        `rows`; regularisers are not in it.

        >>> from stepcore import Sim, lesson
        >>> sim = Sim(lesson.stack(masses=(1.0, 4.0)))
        >>> sim.qvel[:] = -0.1, -0.2
        >>> sim.forward()
        >>> print(sim.delassus())
        [[ 1.   -1.  ]
         [-1.    1.25]]
        """
        return self._core.coupling()[0]

    @property
    def residual(self) -> float:
        """How far the last solve was from the rows' laws: the worst row, a speed [m/s]."""
        return self._core.residual

    @property
    def sweeps_done(self) -> int:
        """Sweeps, or Newton iterations, of the last solve."""
        return self._core.sweeps_done

    @property
    def row_updates(self) -> int:
        """Updates of single rows since this Sim was made."""
        return self._core.row_updates

    @property
    def decrement(self) -> float:
        """Newton's last decrement, relative; 0 under pgs."""
        return self._core.decrement

    @property
    def contacts_grown(self) -> int:
        """How often the list of contacts had to grow; 0 where `max_contacts` was enough."""
        return self._core.contacts_grown

    # By name.

    def body(self, name: str | int) -> BodyView:
        """A body's part of the arrays; ValueError with the nearest names for an unknown one."""
        return BodyView(self, self._model.index("body", name))

    def joint(self, name: str | int) -> JointView:
        """A joint's part of the arrays."""
        return JointView(self, self._model.index("joint", name))

    def geom(self, name: str | int) -> GeomView:
        """A geom's part of the arrays."""
        return GeomView(self, self._model.index("geom", name))

    def site(self, name: str | int) -> SiteView:
        """A site's part of the arrays."""
        return SiteView(self, self._model.index("site", name))

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self._model, self.state())

    def __repr__(self) -> str:
        scene = self._model.scene.name
        name = f' of "{scene}"' if scene else ""
        return f"<Sim{name}: time {self.time:g} s; {self.settings!r}>"


def _restored(model: Model, state: bytes) -> Sim:
    sim = Sim(model)
    sim.restore(state)
    return sim
