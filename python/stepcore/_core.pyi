"""The engine as compiled. `stepcore.Model`, `Sim` and `Batch` are built on it; of its names
only `Settings` and `SimulationError` are meant to be used directly (as `stepcore.Settings`)."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypedDict, Unpack, final

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.replay import Replay
from stepcore.signatures import SettingsFields

__all__ = [
    "VECTORS",
    "Batch",
    "EnergyWarning",
    "Linearizers",
    "Model",
    "Settings",
    "Sim",
    "SimulationError",
    "compile",
    "empty_caches",
    "end_threads",
    "integrators",
    "linear_step",
    "noise",
    "quantile",
]

# The vector instructions that this module was compiled for.
VECTORS: Literal["avx2", "sse2", "neon", "none"]

_Floats = NDArray[np.float64]
# Kind, index, part; part -1 is the whole element.
_Element = tuple[str, int, int]
_Integrator = Literal[
    "explicit", "semi-implicit", "euler", "implicitfast", "implicit", "discrete", "midpoint", "rk4"
]
_Solver = Literal["pgs", "newton"]
_Acceleration = Literal["none", "momentum"]
_Precision = Literal["f32", "f64"]
_Law = Literal["solref", "lesson", "relaxed", "rigid", "penalty"]
_Cone = Literal["pyramidal", "elliptic"]

def integrators() -> dict[str, dict[str, Any]]:
    """Return what each integrator does, by name: "stages", where in a step it evaluates forces
    ("start", "middle", "four"); "damping" ("joints", "all", None), "turning" (bias forces: of
    "free bodies", "trees", None) and "stiffness" (bool), which it takes at the end of the step."""

def linear_step(
    integrator: str,
    dt: float,
    x: _Floats,
    rates: _Floats,
    mass: _Floats,
    damping: _Floats,
    stiffness: _Floats,
) -> _Floats | None:
    """A x of one step of x' = J x; None where a matrix is singular."""

def noise(keys: NDArray[np.uint64], drawn: NDArray[np.uint64], width: int, normal: bool) -> _Floats:
    """The next `width` numbers of each stream, flat: normal, or evenly between 0 and 1."""

def quantile(shares: _Floats) -> _Floats:
    """Quantiles of the standard normal distribution, shape (n,)."""

class EnergyWarning(UserWarning):
    """Without the setting `ledger`: a Sim has far more energy than its scene can have gained.

    The text says by which step, which element it came from and which dt would have been stable.
    The run goes on. It is said once a Sim: its energies are not looked at after that.
    """

class SimulationError(RuntimeError):
    """The motion stopped being finite, or (with `ledger`) has more energy than it can have.

    The last finite state is kept. The text is the post-mortem, one paragraph.
    """

    step: int
    """Number of steps before the failure."""
    time: float
    """Time of the last finite state [s]."""
    world: int
    """Index of the world in a Batch, 0 in a Sim."""
    element: str
    """Name of the element that most of the energy came from."""
    element_id: tuple[str, int, int] | None
    """The same as (kind, index, part); None if no single element stands out."""
    gained: bool
    """True for too much energy, False for a next step that is not finite."""
    shares: dict[str, float]
    """Share of the energy injected in the last steps by name of the element, largest first."""
    share_ids: list[tuple[str, int, int]]
    """(kind, index, part) of each element in `shares`, in the same order."""
    growth: float | None
    """Rate at which kinetic and spring energy grew [1/s], or None."""
    stable_dt: float | None
    """A time step that would have been stable [s], or None if none is known."""
    replay: Replay
    """The failure, which can be saved and run again."""

@final
class Settings:
    """How a scene is simulated; immutable. Every field is a keyword argument with a default; a bad
    value is a ValueError that names the field and its limit."""

    def __new__(
        cls,
        *,
        dt: float = 0.002,
        accuracy: float | str | None = None,
        integrator: _Integrator = "euler",
        solver: _Solver = "newton",
        acceleration: _Acceleration = "none",
        sweeps: int | Literal["auto"] = 100,
        tolerance: float = 1e-10,
        cost_tolerance: float = 0.0,
        warm_start: bool = True,
        precision: _Precision = "f64",
        max_contacts: int = 0,
        ledger: bool = False,
        law: _Law = "solref",
        beta: float = 0.2,
        softness: float = 0.0,
        restitution: float = 0.0,
        slop: float = 0.0,
        max_recovery_speed: float | Literal["auto", "none"] = "auto",
        penalty_stiffness: float = 1e5,
        penalty_damping_ratio: float = 0.1,
        cone: _Cone = "pyramidal",
        impratio: float = 1.0,
        noslip_iterations: int = 0,
        noslip_tolerance: float = 0.0,
        stiction: bool = False,
        sleep: bool = False,
        sleep_tolerance: float = 1e-3,
        sleep_time: float = 0.5,
        refsafe: bool = True,
    ) -> Settings: ...
    def replace(self, **fields: Unpack[SettingsFields]) -> Settings:
        """Returns a copy with some fields changed."""

    def as_dict(self) -> dict[str, Any]:
        """Returns all fields by name."""

    def __eq__(self, value: object, /) -> bool: ...
    def __ne__(self, value: object, /) -> bool: ...
    def __hash__(self) -> int: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...
    @property
    def dt(self) -> float:
        """Time step [s], > 0."""

    @property
    def accuracy(self) -> float | None:
        """The largest error that a second of motion may add to the position of a body [m], or None
        for steps of a fixed length: each step of `dt` is then made of as many shorter ones as this
        takes."""

    @property
    def integrator(self) -> str:
        """Integrator: "explicit", "semi-implicit", "euler" (semi-implicit with implicit joint
        damping), "implicitfast", "implicit", "discrete", "midpoint" or "rk4"."""

    @property
    def solver(self) -> str:
        """Solver of the constraint rows: "pgs" (projected Gauss-Seidel) or "newton"."""

    @property
    def acceleration(self) -> str:
        """Acceleration of projected Gauss-Seidel: "none" or "momentum"."""

    @property
    def sweeps(self) -> Any:
        """Maximum number of sweeps, or Newton iterations, in a solve.

        "auto" iterates until the residual is within the tolerance, which must be > 0, or at
        rounding, at most 10 000 times; under "rigid", "lesson" and "relaxed" a proximal method then
        goes on with what is left.
        """

    @property
    def tolerance(self) -> float:
        """Residual at which a solve stops [m/s], >= 0; 0 always takes all sweeps. Given without a
        cost_tolerance, it replaces the one that the file asks for."""

    @property
    def cost_tolerance(self) -> float:
        """MuJoCo's tolerance: with a number of sweeps, a solve under "solref" stops after a sweep
        or a Newton step that lowers the cost by less than this share of the trace of the mass
        matrix [m²/s⁴], >= 0; 0 for none, as in scenes that are not MJCF files. Newton's impulses
        then agree with the velocities to that tolerance, else to rounding."""

    @property
    def warm_start(self) -> bool:
        """Whether a solve starts from the impulses and the acceleration of the last step."""

    @property
    def precision(self) -> str:
        """Precision of the computation: "f64" or "f32"."""

    @property
    def max_contacts(self) -> int:
        """Number of contacts to reserve memory for; more are allowed."""

    @property
    def ledger(self) -> bool:
        """Whether the energy balance is checked every 64 steps and recorded for a post-mortem."""

    @property
    def law(self) -> str:
        """Constraint law: "solref" (MuJoCo's), "lesson", "relaxed", "rigid" or "penalty"."""

    @property
    def beta(self) -> float:
        """Fraction of a constraint violation that a step corrects, in (0, 1]."""

    @property
    def softness(self) -> float:
        """Regulariser of the rows under "lesson" and "relaxed" [1/kg], >= 0."""

    @property
    def restitution(self) -> float:
        """Fraction of the normal speed after an impact under "rigid", in [0, 1]."""

    @property
    def slop(self) -> float:
        """Overlap that is not corrected under "rigid" [m], >= 0."""

    @property
    def max_recovery_speed(self) -> float | Literal["auto", "none"]:
        """The fastest that a contact pushes an overlap apart [m/s], > 0; "none" for no limit.

        "auto" is 3 m/s under "lesson", "relaxed" and "rigid", and no limit under "solref".
        "penalty" has none.
        """

    @property
    def penalty_stiffness(self) -> float:
        """Contact stiffness under "penalty" [N/m], > 0."""

    @property
    def penalty_damping_ratio(self) -> float:
        """Damping ratio of a contact under "penalty", >= 0."""

    @property
    def cone(self) -> str:
        """Friction cone: "pyramidal" or "elliptic"."""

    @property
    def impratio(self) -> float:
        """Ratio of frictional to normal impedance, > 0."""

    @property
    def noslip_iterations(self) -> int:
        """Sweeps over friction rows alone, with a regulariser of 0, after each solve under
        "solref": MuJoCo's noslip. 0 for none.
        """

    @property
    def noslip_tolerance(self) -> float:
        """MuJoCo's noslip_tolerance: noslip stops after a sweep that lowers the cost by less than
        this share of the trace of the mass matrix [m²/s⁴], >= 0; 0 for none, as in scenes that are
        not MJCF files."""

    @property
    def stiction(self) -> bool:
        """Whether friction under "solref" holds a contact that sticks by a tangential spring as
        stiff as the contact's solref, instead of letting it creep. Other laws have no creep.
        """

    @property
    def sleep(self) -> bool:
        """Whether islands at rest sleep: they stand still and make no rows until something touches
        them. Runs one world at a time, with integrators that evaluate forces once a step.
        """

    @property
    def sleep_tolerance(self) -> float:
        """Speed below which every dof of a tree must be for it to sleep [m/s], >= 0; turning counts
        as the speed at the reach of its body (MuJoCo's dof_length).
        """

    @property
    def sleep_time(self) -> float:
        """Time for which a whole island must have been as slow before it sleeps [s], >= 0. A file
        with MJCF's flag "sleep" has MuJoCo's 10 time steps.
        """

    @property
    def refsafe(self) -> bool:
        """Whether the time constants of solref are at least 2 dt."""

@final
class Model:
    """A compiled scene; constant."""

    @property
    def nq(self) -> int: ...
    @property
    def nv(self) -> int: ...
    @property
    def na(self) -> int: ...
    def names(self) -> dict[str, list[str]]: ...
    def element_name(self, kind: str, index: int, part: int = ...) -> str:
        """What an element is called; `part` -1 is the whole element."""
    def element_words(self, kind: str, index: int, part: int = ...) -> tuple[str, str, str]:
        """The parts of that: noun, owner and label, as in "spring", "joint", "`knee`"."""

    def element_force(
        self, kind: str, ctrl: _Floats, act: _Floats, qpos: _Floats, qvel: _Floats
    ) -> _Floats:
        """Force of all springs, dampers or actuators on the dofs at n states, shape (n, nv)."""

    def touches(
        self, geom1: int, geom2: int, qpos: _Floats, numbers: str
    ) -> tuple[NDArray[np.bool_], _Floats, _Floats, _Floats, _Floats]:
        """exists, dist, pos, normal and feature of two geoms' contacts at positions (n, nq)."""

    def geom_hull(self, geom: int) -> tuple[list[float], list[int]] | None:
        """Vertices and triangles of a geom's convex hull, flat; None where it has none."""

    def tables(self) -> dict[str, _Floats]: ...
    def addresses(self) -> dict[str, list[int]]: ...
    def joint_types(self) -> list[str]: ...
    def sensor_types(self) -> list[str]: ...
    def geom_types(self) -> list[str]: ...
    def pairs(self) -> list[tuple[int, int]]: ...
    def pair(self, index: int) -> tuple[int, int, int, float, list[float], float]: ...
    def heap(self) -> list[tuple[str, str, int]] | None: ...
    def plan(self) -> dict[str, Any]: ...
    def entries(
        self, settings: Settings
    ) -> list[tuple[str, str, str, str, list[int], int, bool, str, str | None]]: ...
    def keys(self) -> list[tuple[float, list[list[float]]]]:
        """Time of every keyframe and its qpos, qvel, act, ctrl, mocap_pos and mocap_quat, defaults
        filled in."""

    def initial(self) -> list[tuple[str, list[float]]]:
        """Every array that is the user's to write, by name, as it is initially: its numbers one
        after the other."""

def compile(scene: dict[str, Any]) -> Model:
    """Compiles a scene given as plain data: what `Scene.to_dict` returns."""

def empty_caches() -> None:
    """Gives back the memory that compiling keeps for models to come.

    These are hulls of meshes (at most some 100 MB), and which pairs of geoms never meet. The next
    model is compiled as the first one was.
    """

def end_threads() -> None:
    """Called by Python when the program ends: no thread takes the GIL back after that."""

class _World:
    """What one world and many have alike; of many every array has a leading world axis."""

    time: float
    def arrays(self) -> list[tuple[str, _Floats]]:
        """The arrays that are the user's to write, each with its name."""
    def readout(self, name: str) -> _Floats:
        """What is computed from the present state or kept of the last solve; AttributeError for an
        unknown name."""
    def step(self, n: int) -> None: ...
    def forward(self) -> None: ...
    def go_to_last_stage(self) -> None: ...
    def sensordata(self, sensor: int | None = None) -> _Floats: ...
    def inverse(self, qacc: _Floats | None = None) -> _Floats: ...
    def rays(
        self,
        rays: _Floats,
        excluded: int | None = None,
        groups: Sequence[bool] | None = None,
        moving: bool = False,
    ) -> tuple[_Floats, list[int], _Floats]:
        """Distances, geoms and normals; each ray is an origin and a direction."""
    def jacobian(self, body: int) -> _Floats: ...
    def site_jacobian(self, site: int) -> _Floats: ...
    def point_jacobian(self, body: int, point: Sequence[float]) -> _Floats: ...

class _Asked(TypedDict):
    """A motion: `steps` steps, with samples of what `names` says (of the start, if `first`, and
    after each `every` steps), under rows of controls that are held for `hold` steps each. A world
    of a batch fails where a body is further than `bound` from its start [m]; steps within an
    accuracy do where they have evaluated forces `most` times."""

    names: list[str]
    steps: int
    every: int
    hold: int
    first: bool
    bound: float
    most: int

@final
class Sim(_World):
    """One world. Its arrays are views of memory that belongs to it."""
    def __new__(cls, model: Model, settings: Settings, threads: int | None = None) -> Sim: ...
    def follow(self, asked: _Asked, ctrl: _Floats | None = None) -> tuple[list[_Floats], list[int]]:
        """See `Batch.follow`; ctrl: shape (1, rows, nu)."""
    def balance(self) -> None:
        """Balances the ledger at the present state."""
    def unwatch(self) -> None:
        """Energies are not looked at any more, but by the ledger of the settings."""
    def taped_step(self) -> tuple[float, float, list[tuple[_Element, float]]]:
        """Steps once: kinetic and spring energy before and after; energy that elements injected."""
    def forget(self) -> None:
        """Forgets the impulses of the last step."""
    def linearize(self, parameters: Sequence[Sequence[Model]]) -> tuple[_Floats, list[_Element]]:
        """A (as many columns as rows), B (nu columns) and a column for each parameter, given by the
        models around its value, over their distance; and where they are one-sided."""
    def element_slopes(self) -> tuple[list[_Element], _Floats, list[float], _Floats]:
        """Elements that act at the present state, forces (n, nv), energies [J], and the entries of
        their slopes in the columns (nth element, dof, dof, stiffness, damping)."""
    def count(self, n: int) -> list[tuple[str, int]]:
        """Floating-point operations of the next n steps, by stage."""
    @property
    def nbytes(self) -> int: ...
    def state(self) -> bytes: ...
    def last(self) -> bytes | None:
        """What the last solve began with and gave."""
    def restore(self, state: bytes, last: bytes | None) -> None: ...
    def coupling(self) -> tuple[_Floats, _Floats]:
        """J H⁻¹ Jᵀ of the rows; by row: 1/s, mass, friction, and 0 for an interval, 1 for a
        convex cone, 2 and 3 for a Coulomb cone, round or box."""
    @property
    def residual(self) -> float: ...
    @property
    def unrecovered(self) -> float: ...
    @property
    def decrement(self) -> float: ...
    @property
    def sweeps_done(self) -> int: ...
    @property
    def row_updates(self) -> int: ...
    @property
    def evaluations(self) -> int: ...
    @property
    def stretches(self) -> tuple[float, tuple[float, int | None] | None]: ...
    @property
    def asleep(self) -> list[bool]: ...
    @property
    def most_rows(self) -> int: ...
    @property
    def contacts_grown(self) -> int: ...
    def tendon_paths(self) -> list[list[list[float]]]:
        """The ways of all tendons, by stretch: points (n, 3), flat."""
    def element_forces(self) -> tuple[list[_Element], _Floats]:
        """Elements that push, and the generalised force of each, shape (n, nv)."""
    def contacts(self) -> tuple[list[_Element], list[tuple[int, int]], _Floats]:
        """Elements, geoms, and dist, pos, normal, force in the columns of one array."""
    def rows(self) -> tuple[list[_Element], list[str], list[int], _Floats]:
        """Elements, names, blocks; impulse, velocity, target, regulariser, residual, lo, hi."""

@final
class Linearizers:
    def __new__(
        cls,
        models: Sequence[Model],
        of: Sequence[int],
        settings: Settings,
        threads: int,
        first: int,
    ) -> Linearizers:
        """models: those that differ. of: by world, the number of its model. first: the first
        world's number."""
    def linearize(
        self, parameters: Sequence[Sequence[Sequence[Model]]], states: Mapping[str, _Floats]
    ) -> tuple[_Floats, list[tuple[int, _Element]]]:
        """A, B and P of each state, as in `Sim`, (worlds, states, rows, columns); and where the nth
        are one-sided. parameters: by model. states: arrays of shape (worlds, states, …) by name;
        what is absent is as at the start."""
    @property
    def nbytes(self) -> int: ...

@final
class Batch(_World):
    """Many worlds; every array has a leading world axis."""
    def __new__(
        cls,
        model: Model,
        settings: Settings,
        n: int,
        threads: int,
        lanes: bool | None,
        goes_on: bool,
    ) -> Batch: ...
    @property
    def in_lanes(self) -> bool:
        """Whether worlds are stepped in vector lanes now."""
    @property
    def nbytes(self) -> int:
        """Memory of all worlds, their arrays and working space [bytes]."""
    def step(self, n: int, told: Callable[[int], object] | None = None) -> None:
        """Advances every world by n steps; `told` is called with the count of each portion."""

    def rollout(
        self, ctrl: _Floats, told: Callable[[int], object] | None = None
    ) -> list[_Floats]: ...
    def follow(
        self,
        asked: _Asked,
        ctrl: _Floats | None = None,
        told: Callable[[int], object] | None = None,
    ) -> tuple[list[_Floats], list[int]]:
        """Steps under controls, (n or 1, rows, nu), or those at hand. Returns the samples by name,
        (n, samples, …), and how often forces were evaluated in each world."""
    def unwatch(self) -> None:
        """Energies are not looked at, but by the ledger of the settings."""
    def failures(self, known: list[int]) -> tuple[list[int], list[SimulationError]]:
        """The worlds that failed while the others went on; errors of those that are not known."""
    def restart(self, time: float) -> None:
        """Sets the time of all worlds and forgets the impulses of the last step."""
    def turn_at_every_step(self) -> None:
        """For tests: with lanes "auto", change between lanes and single worlds at every step."""
    def forget(self, worlds: list[int]) -> None:
        """Forgets the impulses, the failures and the last solves of some worlds."""
    def set_models(self, models: list[Model], model_of: list[int]) -> None:
        """Gives the worlds models that differ in numbers only; `model_of`: the index of each."""
    @property
    def asleep(self) -> list[list[bool]]: ...
    def state(self, own: dict[int, tuple[float, int]]) -> list[bytes]:
        """Snapshots; own: worlds with a time of their own, start [s] and steps since."""
    def last(self) -> list[bytes | None]:
        """What the last solve of each world began with and gave."""
    def restore(
        self, states: list[bytes], lasts: list[bytes | None]
    ) -> dict[int, tuple[float, int]]:
        """Restores snapshots, with their `last`; returns `own` as `state` takes it."""
    @property
    def residual(self) -> _Floats: ...
    @property
    def unrecovered(self) -> _Floats: ...
    def contacts(self) -> list[tuple[list[_Element], list[tuple[int, int]], _Floats]]:
        """`Sim.contacts` of every world."""
    def rows(self) -> list[tuple[list[_Element], list[str], list[int], _Floats]]:
        """`Sim.rows` of every world."""
