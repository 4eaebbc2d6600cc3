"""The engine as compiled. `stepcore.Model`, `Sim` and `Batch` are built on it; of its names
only `Settings` and `SimulationError` are meant to be used directly (as `stepcore.Settings`)."""

from typing import Any, Literal, Unpack, final

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.replay import Replay
from stepcore.engine.settings_fields import SettingsFields

__all__ = ["Batch", "Model", "Settings", "Sim", "SimulationError", "compile"]

_Floats = NDArray[np.float64]
# Kind, index, part; part -1 is the whole element.
_Element = tuple[str, int, int]
_Integrator = Literal["explicit", "semi-implicit", "euler", "implicitfast", "midpoint", "rk4"]
_Solver = Literal["pgs", "newton"]
_Acceleration = Literal["none", "momentum"]
_Precision = Literal["f32", "f64"]
_Law = Literal["solref", "lesson", "relaxed", "rigid", "penalty"]
_Cone = Literal["pyramidal", "elliptic"]

class SimulationError(RuntimeError):
    """A run left the finite numbers, or has energy that it cannot have gained (`ledger`).

    The last finite state is kept; the text is the post-mortem, one paragraph.
    """

    step: int
    """Steps done before it."""
    time: float
    """Time of the last finite state [s]."""
    world: int
    """Its index in a Batch, 0 in a Sim."""
    element: str
    """The element that drove it, by name."""
    element_id: tuple[str, int, int] | None
    """The same as (kind, index, part); None where no single element stands out."""
    gained: bool
    """Energy that cannot have been gained; False: something is not finite in the next step."""
    shares: dict[str, float]
    """Part of the energy fed in over the last steps, by element's name, the largest first."""
    share_ids: list[tuple[str, int, int]]
    """(kind, index, part) of each element in `shares`, in the same order."""
    growth: float | None
    """Rate at which the energy of motion and springs grew [1/s]."""
    stable_dt: float | None
    """A step that would have been stable [s], where one is known."""
    replay: Replay
    """The failure, to be saved and run again."""

@final
class Settings:
    """How a scene is computed; immutable. A bad value is a ValueError naming field and limit."""

    def __new__(
        cls,
        *,
        dt: float = 0.002,
        integrator: _Integrator = "euler",
        solver: _Solver = "newton",
        acceleration: _Acceleration = "none",
        sweeps: int | Literal["auto"] = 100,
        tolerance: float = 1e-10,
        warm_start: bool = True,
        precision: _Precision = "f64",
        max_contacts: int = 0,
        ledger: bool = False,
        law: _Law = "solref",
        beta: float = 0.2,
        softness: float = 0.0,
        restitution: float = 0.0,
        slop: float = 0.0,
        penalty_stiffness: float = 1e5,
        penalty_damping_ratio: float = 0.1,
        cone: _Cone = "pyramidal",
        impratio: float = 1.0,
        refsafe: bool = True,
    ) -> Settings: ...
    def replace(self, **fields: Unpack[SettingsFields]) -> Settings:
        """A copy with some fields changed, checked as a whole."""

    def as_dict(self) -> dict[str, Any]:
        """Every field by name."""

    def __eq__(self, value: object, /) -> bool: ...
    def __ne__(self, value: object, /) -> bool: ...
    def __hash__(self) -> int: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...
    @property
    def dt(self) -> float:
        """Time step [s], > 0."""

    @property
    def integrator(self) -> str:
        """How velocities and positions advance."""

    @property
    def solver(self) -> str:
        """How the rows are solved: "pgs" or "newton"."""

    @property
    def acceleration(self) -> str:
        """What speeds up projected Gauss-Seidel: "none" or "momentum"."""

    @property
    def sweeps(self) -> Any:
        """The most sweeps, or Newton iterations, of one solve; "auto": until the residual is
        within the tolerance (which must be > 0) or at rounding, at most 10 000."""

    @property
    def tolerance(self) -> float:
        """A solve stops at this residual [m/s], >= 0; 0: after all sweeps."""

    @property
    def warm_start(self) -> bool:
        """Start from the last step's impulses."""

    @property
    def precision(self) -> str:
        """The number computed with: "f64" or "f32"."""

    @property
    def max_contacts(self) -> int:
        """Contacts to reserve room for."""

    @property
    def ledger(self) -> bool:
        """Balance the account of energy every 64 steps, and keep what a post-mortem needs."""

    @property
    def law(self) -> str:
        """What a violated constraint asks for."""

    @property
    def beta(self) -> float:
        """Share of a violation undone in a step, in (0, 1]."""

    @property
    def softness(self) -> float:
        """Regulariser of rows under "lesson" and "relaxed" [1/kg], >= 0."""

    @property
    def restitution(self) -> float:
        """Share of the normal speed kept in an impact under "rigid", in [0, 1]."""

    @property
    def slop(self) -> float:
        """Overlap left alone under "rigid" [m], >= 0."""

    @property
    def penalty_stiffness(self) -> float:
        """Spring of a contact under "penalty" [N/m], > 0."""

    @property
    def penalty_damping_ratio(self) -> float:
        """Damping ratio of a contact under "penalty", >= 0."""

    @property
    def cone(self) -> str:
        """The set of friction forces: "pyramidal" or "elliptic"."""

    @property
    def impratio(self) -> float:
        """Ratio of frictional to normal impedance, > 0."""

    @property
    def refsafe(self) -> bool:
        """Keep the time constants of solref at 2 dt or above."""

@final
class Model:
    """A compiled scene; constant."""

    @property
    def nq(self) -> int: ...
    @property
    def nv(self) -> int: ...
    def names(self) -> dict[str, list[str]]: ...
    def element_name(self, kind: str, index: int, part: int = ...) -> str:
        """What an element is called; `part` -1 is the whole element."""

    def element_force(self, kind: str, ctrl: _Floats, qpos: _Floats, qvel: _Floats) -> _Floats:
        """Force of all springs, dampers or actuators on the dofs at n states, shape (n, nv)."""

    def tables(self) -> dict[str, _Floats]: ...
    def addresses(self) -> dict[str, list[int]]: ...
    def joint_types(self) -> list[str]: ...
    def geom_types(self) -> list[str]: ...
    def pairs(self) -> list[tuple[int, int]]: ...
    def plan(self) -> dict[str, Any]: ...
    def keys(self) -> list[tuple[float, list[float], list[float], list[float]]]: ...

def compile(scene: dict[str, Any]) -> Model:
    """Compiles a scene given as plain data: what `Scene.to_dict` returns."""

@final
class Sim:
    """One world. Its arrays are views of memory that belongs to it."""

    time: float
    def __new__(cls, model: Model, settings: Settings) -> Sim: ...
    @property
    def qpos(self) -> _Floats: ...
    @property
    def qvel(self) -> _Floats: ...
    @property
    def ctrl(self) -> _Floats: ...
    @property
    def qfrc_applied(self) -> _Floats: ...
    @property
    def xfrc_applied(self) -> _Floats: ...
    def step(self, n: int) -> None: ...
    def balance(self) -> None:
        """Balances the ledger at the present state."""

    def taped_step(self) -> tuple[float, float, list[tuple[_Element, float]]]:
        """Steps once: energy of motion and springs before and after, what each element fed in."""

    def forward(self) -> None: ...
    def forget(self) -> None:
        """Forgets the impulses of the last step."""

    def linearize(self) -> _Floats:
        """A (2 nv, 2 nv) and B (2 nv, nu) side by side."""

    def count(self, n: int) -> list[tuple[str, int]]:
        """Floating-point operations of the next n steps, by stage."""

    @property
    def nbytes(self) -> int: ...
    def state(self) -> bytes: ...
    def restore(self, state: bytes) -> None: ...
    @property
    def xpos(self) -> _Floats: ...
    @property
    def xquat(self) -> _Floats: ...
    @property
    def xmat(self) -> _Floats: ...
    @property
    def geom_xpos(self) -> _Floats: ...
    @property
    def geom_xmat(self) -> _Floats: ...
    @property
    def site_xpos(self) -> _Floats: ...
    @property
    def bias(self) -> _Floats: ...
    @property
    def passive(self) -> _Floats: ...
    @property
    def energy(self) -> _Floats: ...
    @property
    def momentum(self) -> _Floats: ...
    @property
    def overlap(self) -> _Floats: ...
    def mass_matrix(self) -> _Floats: ...
    def jacobian(self, body: int) -> _Floats: ...
    @property
    def qacc(self) -> _Floats: ...
    @property
    def constraint_force(self) -> _Floats: ...
    @property
    def actuator_force(self) -> _Floats: ...
    def coupling(self) -> tuple[_Floats, _Floats]:
        """J H⁻¹ Jᵀ of the rows; by row: 1/s, mass, friction, and 0 for an interval, 1 for a
        convex cone, 2 and 3 for a Coulomb cone, round or box."""

    @property
    def residual(self) -> float: ...
    @property
    def decrement(self) -> float: ...
    @property
    def sweeps_done(self) -> int: ...
    @property
    def row_updates(self) -> int: ...
    @property
    def contacts_grown(self) -> int: ...
    def element_forces(self) -> tuple[list[_Element], _Floats]:
        """Elements that push, and the generalised force of each, shape (n, nv)."""

    def contacts(self) -> tuple[list[_Element], list[tuple[int, int]], _Floats]:
        """Elements, geoms, and dist, pos, normal, force in the columns of one array."""

    def rows(self) -> tuple[list[_Element], list[str], list[int], _Floats]:
        """Elements, names, blocks; impulse, velocity, target, regulariser, residual, lo, hi."""

@final
class Batch:
    """Many worlds; every array has a leading world axis."""

    time: float
    def __new__(
        cls,
        model: Model,
        settings: Settings,
        n: int,
        threads: int,
        lanes: bool,
        goes_on: bool,
    ) -> Batch: ...
    @property
    def qpos(self) -> _Floats: ...
    @property
    def qvel(self) -> _Floats: ...
    @property
    def ctrl(self) -> _Floats: ...
    @property
    def qfrc_applied(self) -> _Floats: ...
    @property
    def xfrc_applied(self) -> _Floats: ...
    def step(self, n: int) -> None: ...
    def forward(self) -> None: ...
    def rollout(self, ctrl: _Floats) -> tuple[_Floats, _Floats]: ...
    def failures(self, known: list[int]) -> tuple[list[int], list[SimulationError]]:
        """The worlds that failed while the others went on; errors of those that are not known."""

    def restart(self, time: float) -> None:
        """Sets the time of all worlds and forgets the impulses of the last step."""

    def state(self) -> list[bytes]: ...
    def restore(self, states: list[bytes]) -> None: ...
    @property
    def qacc(self) -> _Floats: ...
    @property
    def xpos(self) -> _Floats: ...
    @property
    def xquat(self) -> _Floats: ...
    @property
    def geom_xpos(self) -> _Floats: ...
    @property
    def site_xpos(self) -> _Floats: ...
    @property
    def energy(self) -> _Floats: ...
    @property
    def xmat(self) -> _Floats: ...
    @property
    def geom_xmat(self) -> _Floats: ...
    @property
    def bias(self) -> _Floats: ...
    @property
    def passive(self) -> _Floats: ...
    @property
    def momentum(self) -> _Floats: ...
    @property
    def overlap(self) -> _Floats: ...
    def mass_matrix(self) -> _Floats: ...
    def jacobian(self, body: int) -> _Floats: ...
    @property
    def constraint_force(self) -> _Floats: ...
    @property
    def actuator_force(self) -> _Floats: ...
    @property
    def residual(self) -> _Floats: ...
    def contacts(self) -> list[tuple[list[_Element], list[tuple[int, int]], _Floats]]:
        """`Sim.contacts` of every world."""

    def rows(self) -> list[tuple[list[_Element], list[str], list[int], _Floats]]:
        """`Sim.rows` of every world."""
