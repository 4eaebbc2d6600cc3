"""`Sim`: one world of a model, with its state, its step and its readouts."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import _core, checks
from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import Floats, snapshot, snapshot_with
from stepcore.engine.element import Element, ElementSlopes, element_slopes
from stepcore.engine.error_bar import ErrorBar, FinerRun
from stepcore.engine.linearization import Linearization, Linearizations, linear_step
from stepcore.engine.parameters import columns
from stepcore.engine.pitfalls import warn_of_pitfalls
from stepcore.engine.tables import Energy, Momentum, contact_table, contacts_of_body, row_table
from stepcore.engine.trajectory import Trajectory, record_run, whole_steps
from stepcore.engine.unsolved import UnsolvedWarning
from stepcore.engine.world import World, compiled
from stepcore.signatures import refuse_unknown_settings, takes_settings

if TYPE_CHECKING:
    import os
    from typing import Unpack

    from stepcore.engine.model import Model
    from stepcore.scene.scene import Scene
    from stepcore.signatures import SettingsFields
    from stepcore.viewing.live import View


class Sim(World):
    """A simulation of one world of a model.

    model: a `Model`, a `Scene`, which is compiled, or any argument of `stepcore.load`, such as the
        path of an MJCF file.
    settings: a `Settings` that replaces the settings of the model.
    threads: the number of threads that share the work of each step, from 1 to 1024. The results are
        bit-identical for any number. Several threads speed up piles of hundreds of bodies or more
        (`Model.is_heap`); one thread does all other work.
    error_bar: whether to estimate `error` by a simultaneous finer run: with a tenth of the
        ``accuracy``, or with a quarter of ``dt`` and rows solved to rounding. A run then takes 2 to
        5 times as long, or 4 to 10 times. The motion is the same.
    fields: single fields of `Settings` to change, such as ``dt=0.005, solver="pgs"``.

    The state arrays (qpos, qvel, ctrl, qfrc_applied, xfrc_applied) can be written, in place or by
    assignment. They are float64 at every precision and are checked before each use: an entry that
    is not finite raises a ValueError that names the entry, and nothing is stepped.

    All other attributes are read-only. Poses, energy, momentum and matrices describe the present
    state and are recomputed when the state is written. ``qacc``, ``contacts``, ``rows``,
    ``residual`` and the forces describe the last `step` or `forward`.

    Raises ValueError for a scene that cannot be compiled, and for settings or threads outside
    their limits.

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

    @takes_settings
    def __init__(
        self,
        model: Model | Scene | str | os.PathLike[str],
        settings: Settings | None = None,
        *,
        threads: int = 1,
        error_bar: bool = False,
        **fields: Unpack[SettingsFields],
    ) -> None:
        refuse_unknown_settings(Sim, fields)
        self._model = compiled(model).with_settings(settings, **fields)
        self._threads = checks.count("threads", threads)
        warn_of_pitfalls(self._model, stacklevel=4)
        self._own(_core.Sim(self._model.core, self._model.settings, self._threads))
        checks.one_of(True, False)("Sim", "error_bar", error_bar)
        self._finer = FinerRun(self) if error_bar else None

    # Stepping.

    def step(self, n: int = 1) -> None:
        """Take n steps, with the GIL released (a single step of a few microseconds keeps it).

        With the setting ``accuracy``, steps are adaptive: each step of dt is divided as needed.

        Raises ValueError if a state or input is not finite; no step is taken then. Raises
        SimulationError if the motion becomes non-finite or, with the setting ``ledger``, has more
        energy than is physically possible; the last finite state is kept. Without ``ledger``, a
        large excess of energy gives one warning (`EnergyWarning`). Ctrl-C interrupts between steps,
        and within a long step, which is then discarded.
        """
        if self._finer is not None:
            self._finer.step(n)
            return
        # Equivalent to `_call` with one frame less, which takes as long as a small model's step.
        try:
            self._core.step(n)
        except SimulationError as error:
            self._explain(error)
            raise

    def advance(self, duration: float) -> None:
        """Advance by a time [s], a whole number of steps; raise the same errors as `step`.

        Raises ValueError for a duration that is not a whole number of steps.

        >>> from stepcore import Sim, lesson
        >>> sim = Sim(lesson.drop(), dt=0.01)
        >>> sim.advance(0.5)
        >>> sim.time
        0.5
        """
        self.step(whole_steps("duration", duration, self.settings.dt))

    def balance(self) -> None:
        """Check the energy balance; do nothing without the setting ``ledger``.

        The balance is also checked every 64 steps, and at the end of `run` and of a `step` with n
        >= 128. Raises SimulationError if the motion has more energy than is physically possible.
        """
        self._call(self._core.balance)

    def linearize(self, parameters: Sequence[str] = ()) -> Linearization:
        """Linearise the next step about the present state, without taking the step.

        parameters: paths of values of the model, as in `Model.with_values`, by which the step is
            also differentiated: "body/torso/mass", "geom/floor/friction[0]", "actuator/*/gain". The
            path of a vector means all its nonzero entries.

        The derivatives are exact: dual numbers are propagated through the step, contacts and solver
        included, with the settings of this Sim and in float64. Controls, applied forces and the
        solver's initial impulses are constant in the map. If a law switches at the state (a contact
        that just touches, a limit just reached, a clamped control), the derivatives are one-sided:
        they describe the branch that the step takes at this state. `degenerate` of the result names
        the elements that are exactly at a switch.

        Derivatives by a parameter include all constants that the compiler derives from it, by the
        models at four nearby values, which are compiled once.

        The cost is about (2 nv + nu + parameters)/8 steps in dual numbers, each a few times as
        expensive as a plain step; the first call allocates the workspace, which is kept. The GIL is
        released. See docs/linearize.md.

        Raises the same errors as `step`, and ValueError if the step has an infinite derivative, and
        for a parameter that is unknown, zero, or changes more than numbers of the model.
        """
        by = columns(self._model, parameters)
        step = linear_step(self._model, self._core, by)
        return Linearizations(self._model, step, by)[0]

    def element_slopes(self) -> dict[Element, ElementSlopes]:
        """Compute stiffness, damping, force and energy of every active element.

        The derivatives are exact, as in `linearize`: dual numbers are propagated through the forces
        and through the solve of the constraint rows with the present active set. Gravity is an
        element, and so is the gyroscopic torque of each spinning body, which is a part of `bias`.

        The cost is nv/2 calls of `forward` in dual numbers. Raises the same errors as `forward`,
        and ValueError if a force has an infinite derivative.
        """
        return element_slopes(self._model, self._core)

    def count_flops(self, n: int = 1) -> int:
        """Return the number of floating-point operations of the next n steps, without stepping.

        A copy takes these steps in float64. The operations +, −, ×, ÷ and √ count as 1 each, a sine
        with its cosine, an arctangent or a power as 20, and comparisons, signs and copies as 0. The
        count describes the method, not the compiled code, and is the same on every machine.

        Raises the same errors as `step`.

        >>> from stepcore import Sim, lesson
        >>> sim = Sim(lesson.drop(), dt=0.01)
        >>> sim.count_flops(2) == 2 * sim.count_flops()
        True
        """
        return sum(count for _, count in self._core.count(n))

    def stage_flops(self) -> dict[str, int]:
        """Return the floating-point operations of the next step by stage; see `count_flops`.

        The stages are place/kinematics (poses), place/inertia (mass matrix), place/factor (its
        factorisation), place/bias (Coriolis and gravity forces), place/forces (springs, actuators),
        place/guess (unconstrained velocity), detect (contacts), solve/rows (assembly),
        solve/impulses (sweeps or iterations) and commit (integration).
        """
        return dict(self._core.count(1))

    @property
    def nbytes(self) -> int:
        """Memory of this Sim's state and workspace [bytes], which grows with its contacts."""
        return self._core.nbytes

    def _restart(self, time: float) -> None:
        self._core.time = time
        self._core.forget()

    def state(self) -> bytes:
        """Return a complete snapshot: state, inputs, time, step count and warm-start impulses.

        Equal snapshots continue identically. A snapshot also has the state at which the last solve
        started: after `restore`, in a copy and after unpickling, ``qacc``, contacts, rows and
        forces describe that solve. Plain bytes with the same content restore the state alone.
        """
        return snapshot_with(self._core.state(), self._core.last())

    def restore(self, state: bytes) -> None:
        """Restore a snapshot from `state`; the motion then continues bit-identically.

        Raises ValueError for bytes that are no snapshot of this model; nothing changes then.
        """
        self._core.restore(*snapshot(state, state))

    def copy(self) -> Sim:
        """Return another Sim of the same model, settings and state; both continue bit-identically.

        >>> from stepcore import Sim, lesson
        >>> sim = Sim(lesson.drop(), dt=0.01)
        >>> other = sim.copy()
        >>> other.step(10)
        >>> sim.time, round(other.time, 6)
        (0.0, 0.1)
        """
        return _restored(*self.__reduce__()[1])

    def run(
        self,
        duration: float,
        control: Callable[[float, Sim], ArrayLike] | ArrayLike | None = None,
        control_dt: float | None = None,
        record: Sequence[str] = ("qpos", "qvel"),
    ) -> Trajectory:
        """Simulate for a given duration and record quantities at every step.

        duration: the simulated time [s], a whole number of steps.
        control: a function of (time, sim) that returns ctrl, or an array of shape (n, nu) with one
            row for each control period. The last row applies until the end. None leaves ctrl
            unchanged.
        control_dt: the control period [s], a whole number of steps; by default one step.
        record: names of attributes of this Sim, such as "qpos", "energy" or "residual".

        Raises ValueError for a duration or period that is not a whole number of steps, a control
        of the wrong shape, or a name that cannot be recorded; and the same errors as `step`. Warns
        (`UnsolvedWarning`) if, during half of the run, the residual exceeds the speed that gravity
        adds in one step; with ``sweeps="auto"``, if it ever does.

        >>> from stepcore import Sim, lesson
        >>> sim = Sim(lesson.drop(), dt=0.01)
        >>> trajectory = sim.run(0.05, record=("qpos", "energy"))
        >>> trajectory
        <Trajectory: 0 to 0.05 s, 6 instants; qpos (6, 1), energy (6, 2)>
        """
        trajectory = record_run(self, duration, control, control_dt, record)
        self.balance()
        if trajectory.unsolved:
            warnings.warn(UnsolvedWarning(trajectory.unsolved), stacklevel=2)
        return trajectory

    def view(self, *, host: str = "localhost", port: int = 8080, wait: bool | None = None) -> View:
        """Open a live view of a copy of this Sim, which continues from the present state.

        The view can pause, step, reset, load keyframes and go back in time. Sliders set the
        controls. Contacts, forces, energy and the residual are shown. This Sim is unchanged.

        host, port, wait: see `stepcore.view`.

        Needs the extra "view".
        """
        from stepcore.viewing.live import announced, view_sim

        return announced(view_sim(self, host, port), wait)

    # The present state.

    @property
    def energy(self) -> Energy:
        """Kinetic and potential energy [J], with gravity and joint springs but without servos."""
        kinetic, potential = self._core.readout("energy")
        return Energy(float(kinetic), float(potential))

    @property
    def momentum(self) -> Momentum:
        """Linear [kg·m/s] and angular [kg·m²/s] momentum of all bodies, without armature."""
        linear, angular = self._core.readout("momentum")
        return Momentum(linear, angular)

    @property
    def overlap(self) -> float:
        """The deepest overlap of two collidable geoms at the present state [m]; 0 if none."""
        return float(self._core.readout("overlap"))

    @property
    def error(self) -> ErrorBar:
        """The estimated error in position [m] since the state was last written: RMS and largest.

        The error is the distance from a finer run under the same inputs (`error_bar=True`), in the
        norm of all measurements (`stepcore.engine.norm`): the distance between centres of mass of a
        body, combined with its rotation times the radius of gyration. It is inf if the error is
        unknown; see `predictable_until`.

        >>> from stepcore import Sim, lesson
        >>> sim = Sim(lesson.spring(), dt=0.01, error_bar=True)
        >>> sim.reset("start")
        >>> sim.step(100)
        >>> 0.01 < sim.error.largest < 0.1
        True
        """
        return self._judge().error

    @property
    def body_error(self) -> Floats:
        """The estimated error of each body in position [m], shape (nbody,); see `error`."""
        return self._judge().errors()

    @property
    def predictable_until(self) -> float:
        """The time from which the error is unknown [s]; inf while it is known.

        From then on the distance from the finer run exceeds a tenth of the scene's lengths, or the
        finer run has failed: either the step is far too long, or the motion amplifies every error.
        `stepcore.predict` distinguishes these cases.
        """
        return self._judge().until

    def _judge(self) -> FinerRun:
        if self._finer is None:
            raise ValueError("error: not measured; ask for it with Sim(…, error_bar=True)")
        return self._finer.judged()

    # The last step or forward().

    def element_forces(self) -> dict[tuple[str, int], Floats]:
        """Return the generalised force of every element [N or N·m] in the last solve.

        The keys are (kind, index) as in `rows` and `contacts`, with the further kinds "spring",
        "damper", "actuator", "gravity", "qfrc_applied" and "xfrc_applied". The values have shape
        (nv,).
        """
        elements, forces = self._core.element_forces()
        return {
            (kind, index): force for (kind, index, _), force in zip(elements, forces, strict=True)
        }

    @property
    def contacts(self) -> NDArray[Any]:
        """Contacts of the last solve, a structured array with the fields below.

        The array is empty from a `reset` to the next `step` or `forward`; `overlap` describes the
        present state.

        - kind ("contact"), index (the argument of `Model.contact_pair`), part (the number of the
          contact within its pair);
        - geom1, geom2: indices; name1, name2: names, or "geom 15 of body `jaw`";
        - dist [m], negative for an overlap; pos [m]; normal, a unit vector from geom 1 to geom 2;
        - force: on geom 2, in world axes [N]; zero for a contact without a row;
        - torque: of torsion (condim 4) and rolling (condim 6) on geom 2, in world axes [N·m].

        MuJoCo's `mj_contactForce` gives the same force and torque along the normal and the two
        tangents.
        """
        return contact_table(self._model.called("geom"), *self._core.contacts())

    def contacts_of(self, body: str | int) -> NDArray[Any]:
        """Return the entries of `contacts` in which a geom of this body takes part.

        Bodies that are fixed to this body are not included. Raises ValueError for an unknown body.
        """
        return contacts_of_body(self.contacts, self._model, body)

    def tendon_path(self, tendon: str | int) -> list[Floats]:
        """Return the path of a spatial tendon in the world at the present state [m].

        The result is a list with an array of shape (n, 3) for each segment between consecutive
        sites: the two sites and, where the tendon wraps a geom, points of the wrapped arc. The
        count n of a segment never changes. The list is empty for a fixed tendon. Raises ValueError
        for an unknown tendon.
        """
        return self.tendon_paths()[self._model.index("tendon", tendon)]

    def tendon_paths(self) -> list[list[Floats]]:
        """Return the paths of all tendons at the present state; see `tendon_path`."""
        paths = self._core.tendon_paths()
        return [[np.reshape(way, (-1, 3)) for way in path] for path in paths]

    @property
    def rows(self) -> NDArray[Any]:
        """Constraint rows of the last solve in solver order, a structured array with the fields

        - kind: "connect", "weld", "joint equality", "friction loss", "limit" or "contact", or
          "tendon friction loss" or "tendon limit";
          index: of the equality, the joint (friction loss, limit) or the pair of geoms; part: the
          dof of the joint, the bound of a limit (0 lower, 1 upper) or the contact of the pair, -1
          for a whole element;
        - name: `Model.element_name` of the element; block: rows of one block are solved together;
        - impulse [N·s or N·m·s], force (impulse/dt), lo and hi (bounds of the impulse);
        - velocity: J v at the start of the step; target; regulariser;
        - residual: violation of the row's law in the row's unit of velocity.
        """
        return row_table(self.settings.dt, *self._core.rows())

    def delassus(self) -> Floats:
        """Return the Delassus matrix of the last solve, J M⁻¹ Jᵀ [1/kg], shape (rows, rows).

        Entry (i, j) is the velocity of row i that a unit impulse on row j causes, in the order of
        `rows`, without regularisers.

        >>> from stepcore import Sim, lesson
        >>> sim = Sim(lesson.stack(masses=(1.0, 4.0)))
        >>> sim.qvel[:] = -0.1, -0.2
        >>> sim.forward()
        >>> print(sim.delassus())
        [[ 1.   -1.  ]
         [-1.    1.25]]
        """
        coupling, rows = self._core.coupling()
        unit = rows[:, 4]
        delassus: Floats = coupling / (unit[:, None] * unit)
        return delassus

    @property
    def residual(self) -> float:
        """Residual of the last solve [m/s]: the largest violation of a row's law, as a speed."""
        return self._core.residual

    @property
    def unrecovered_overlap(self) -> float:
        """Overlap that `max_recovery_speed` prevented the last solve from removing [m].

        The value is the maximum over all contacts: the additional overlap that the step would
        remove without this limit.
        """
        return self._core.unrecovered

    @property
    def sweeps_done(self) -> int:
        """Number of sweeps, or Newton iterations, of the last solve."""
        return self._core.sweeps_done

    @property
    def asleep(self) -> NDArray[np.bool_]:
        """Whether each body sleeps, shape (nbody,); see `Settings.sleep`."""
        return np.array(self._core.asleep, dtype=bool)

    @property
    def row_updates(self) -> int:
        """Number of updates of single rows since this Sim was created."""
        return self._core.row_updates

    @property
    def most_rows(self) -> int:
        """The largest number of rows in any step since this Sim was created."""
        return self._core.most_rows

    @property
    def decrement(self) -> float:
        """Relative Newton decrement at the end of the last solve; 0 with solver "pgs"."""
        return self._core.decrement

    @property
    def contacts_grown(self) -> int:
        """Number of times that the list of contacts grew; 0 if `max_contacts` was sufficient."""
        return self._core.contacts_grown

    def __reduce__(self) -> tuple[Any, ...]:
        finer = None if self._finer is None else self._finer.kept()
        return _restored, (self._model, self._threads, self.state(), finer)

    def __repr__(self) -> str:
        scene = self._model.scene.name
        name = f" of {checks.quoted(scene)}" if scene else ""
        return f"<Sim{name}: time {self.time:g} s; {self.settings!r}>"

    def _repr_html_(self) -> str | None:
        from stepcore.viewing.notebook import html_picture

        return html_picture(self, self._model.ngeom, lambda: self)


def unwatched(sim: Sim) -> Sim:
    """Disable `EnergyWarning` for a Sim whose motion the caller judges, and return the Sim."""
    sim._core.unwatch()
    return sim


def touching_geoms(sim: Sim) -> tuple[list[tuple[int, int]], Floats]:
    """Return the geoms and the distance [m] of each contact; faster than `Sim.contacts`."""
    _, pairs, numbers = sim._core.contacts()
    return pairs, numbers[:, 0]


def _restored(model: Model, threads: int, state: bytes, finer: Any = None) -> Sim:
    sim = Sim(model, threads=threads, error_bar=finer is not None)
    sim.restore(state)
    if sim._finer is not None:
        sim._finer.go_on(*finer)
    return sim
