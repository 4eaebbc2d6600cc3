"""The convergence of sweeps at states of a motion, and the rows furthest from their solution."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.engine.model import Model
from stepcore.engine.run_settings import converged_settings
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.engines import visits
from stepcore.experiment.schedule import Schedule

# Numbers of sweeps after which the residual and the distance to the solution are measured.
SWEEPS = tuple(2**k for k in range(13))
# ROUNDING: residual of the solution, relative to the rows' speeds. READABLE: the smallest distance
# that is used, relative to the largest one; it is far above the rounding errors that remain in PGS.
# A solution with a residual above READABLE is not used.
ROUNDING, READABLE = 1e-12, 1e-9


@dataclass(frozen=True)
class MotionState:
    """A state of the motion, as `Sim.state` returns it, and the residual of its step [m/s]."""

    start: int
    time: float
    snapshot: bytes
    residual: float = 0.0


@dataclass(frozen=True)
class RowForce:
    """The rows of one element (a contact, a limit …) after the shipped sweeps.

    missing: the missing impulse of the element's worst row, as a speed [m/s].
    force, solved: the force and the converged force [N or N·m]: the normal force of a contact, the
        magnitude for a connection.
    states: the number of states in which the element has rows.
    """

    name: str
    missing: float
    force: float
    solved: float
    states: int = 1


@dataclass(frozen=True)
class ResidualHistory:
    """The residual by sweeps at one state of the motion.

    sweeps: the numbers of sweeps.
    cold, warm: the residual after each number [m/s], from zero impulses and from the impulses of
        the previous step.
    contraction: the asymptotic share of the distance to the solution that a sweep leaves; None for
        a single row, or if not measurable.
    forces: the force of each element after the shipped sweeps.
    """

    start: int
    time: float
    rows: int
    sweeps: tuple[int, ...] = SWEEPS
    cold: tuple[float, ...] = ()
    warm: tuple[float, ...] = ()
    contraction: float | None = None
    forces: tuple[RowForce, ...] = ()


def row_states(
    model: Model, schedule: Schedule, count: int, starts: Sequence[int]
) -> list[MotionState]:
    """Return states with rows, spread over all starts, and the one with the worst residual."""
    some = list(_with_rows(model, schedule, starts))
    if len(some) <= count:
        return some
    even = np.linspace(0, len(some) - 1, count - 1).round().astype(int)
    worst = int(np.argmax([state.residual for state in some]))
    return [some[k] for k in np.unique([*even, worst])]


def _with_rows(model: Model, schedule: Schedule, starts: Sequence[int]) -> Iterator[MotionState]:
    """Yield the states with rows after a step, with the impulses of this step."""
    stepped = unwatched(Sim(model))
    for start, time, sim in visits(model, schedule, starts, schedule.every):
        if not len(sim.rows):
            continue
        stepped.restore(sim.state())
        try:
            stepped.step()
            snapshot = stepped.state()
            stepped.forward()
        except SimulationError:
            continue
        if len(stepped.rows):
            yield MotionState(start, time + model.settings.dt, snapshot, stepped.residual)


# Products of a diverging motion's states overflow.
@np.errstate(over="ignore", invalid="ignore")
def residual_history(model: Model, settings: Settings, state: MotionState) -> ResidualHistory:
    """Measure the residual by sweeps at one state."""

    def at(settings: Settings) -> Sim:
        sim = unwatched(Sim(model, settings))
        sim.restore(state.snapshot)
        sim.forward()
        return sim

    def swept(n: int, **changes: Any) -> Sim:
        plain: dict[str, Any] = {"tolerance": 0.0, "cost_tolerance": 0.0, "warm_start": False}
        plain |= {"solver": "pgs", "precision": "f64", "sweeps": n}
        return at(settings.replace(**plain | changes))

    shipped = at(settings)
    rows, speed = len(shipped.rows), _speed(shipped)
    tolerance = 0.0 if settings.law == "solref" else ROUNDING * speed
    solution = at(converged_settings(settings, tolerance=tolerance))
    target, mass = np.array(solution.qacc), solution.mass_matrix()

    def size(acceleration: np.ndarray) -> float:
        change = acceleration * settings.dt
        return math.sqrt(max(float(change @ mass @ change), 0.0))

    # Use plain sweeps: distances under acceleration do not shrink geometrically.
    unsolved = solution.residual > READABLE * speed
    sims = [swept(n, acceleration="none") for n in (0, *SWEEPS)]
    left = [sim.residual if unsolved else size(np.array(sim.qacc) - target) for sim in sims]
    rounding = ROUNDING * (speed if unsolved else size(target))
    return ResidualHistory(
        state.start,
        state.time,
        rows,
        cold=tuple(swept(n).residual for n in SWEEPS),
        warm=tuple(swept(n, warm_start=True).residual for n in SWEEPS),
        contraction=contraction((0, *SWEEPS), left, rounding) if rows > 1 else None,
        forces=row_forces(shipped, solution),
    )


def row_forces(shipped: Sim, solution: Sim) -> tuple[RowForce, ...]:
    """Return the difference between two solves of the same state, by element."""
    rows, others = shipped.rows, solution.rows
    # The columns are the denominator, the row's mass, friction, the kind of cone, and the unit.
    coupling, about = shipped._core.coupling()
    weight = np.sqrt(np.diagonal(coupling) / about[:, 1])
    missing = np.abs(rows["impulse"] - others["impulse"]) / about[:, 4] * weight
    forces = []
    elements = zip(rows["kind"].tolist(), rows["index"].tolist(), strict=True)
    for kind, index in dict.fromkeys(elements):
        at = np.flatnonzero((rows["kind"] == kind) & (rows["index"] == index))
        reached, converged = (_force(r[at], about[at[0], 3]) for r in (rows, others))
        name = str(rows["name"][at[0]])
        forces.append(RowForce(name, float(missing[at].max()), reached, converged))
    return tuple(forces)


def _force(rows: np.ndarray, cone: float) -> float:
    """Return the total force of an element's rows."""
    if rows["kind"][0] != "contact":
        return float(np.linalg.norm(rows["force"])) if len(rows) > 1 else float(rows["force"][0])
    # All edges of a pyramid push along the normal, but only the first row of a cone does.
    return float(rows["force"].sum() if cone == 0 else rows["force"][0])


def contraction(sweeps: Sequence[int], left: Sequence[float], rounding: float) -> float | None:
    """Return the share of the distance that a sweep leaves, between the last two readings.

    sweeps: the numbers of sweeps; the first is 0. left: the distance after each of them.
    rounding: distances below this are rounding errors. Return None if all are, as for rows that
    barely touch.

    >>> print(f"{contraction((0, 1, 2, 4, 8), [0.5**n for n in (0, 1, 2, 4, 8)], 0.0):.3f}")
    0.500
    """
    most = max(left, default=0.0)
    if not most > rounding or not math.isfinite(most):
        return None
    last = max(k for k, far in enumerate(left) if far >= max(READABLE * most, rounding))
    if last == 0:
        # One sweep solves the system.
        return left[1] / most
    return float((left[last] / left[last - 1]) ** (1 / (sweeps[last] - sweeps[last - 1])))


def _speed(sim: Sim) -> float:
    """Return the largest speed along the rows, or gravity's gain in a step if larger [m/s]."""
    rows = sim.rows
    along = np.abs(np.concatenate([rows["velocity"], rows["target"]])).max(initial=0.0)
    fall = float(np.linalg.norm(sim.model.scene.gravity)) * sim.settings.dt
    return max(float(along), fall, 1e-300)
