"""The residual history of one state: how sweeps approach the solution of its rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.converged import converged_settings
from stepcore.measure.convergence.theory import SweepTheory, speeds, theory

# Numbers of sweeps at which the residual is read, and the distance to the solution too; numbers in
# between at which only the distance is read.
SWEEPS = tuple(2**k for k in range(13))
BETWEEN = (*range(33), *(2**k * n // 4 for k in range(5, 12) for n in (5, 6, 7)))
# The solution's residual relative to the speeds in the rows; or at most so many row updates.
ROUNDING, MOST_UPDATES = 1e-12, 4e6
# Beyond this residual, relative to the speeds in the rows, distances to the solution mean nothing.
UNSOLVED = 1e-8
# Distances are read down to this share of the first: rounding is far below.
READABLE = 1e-9
# Rows that separate late change the slope: it is read from this share of the sweeps on.
LATE = 0.6


@dataclass(frozen=True)
class MotionState:
    """A state of the motion. start: which one; time [s]; snapshot: as of `Sim.state`; residual: of
    the step from there [m/s]."""

    start: int
    time: float
    snapshot: bytes
    residual: float = 0.0


@dataclass(frozen=True)
class RowForce:
    """The rows of one element (a contact, a limit …) after the settings' own sweeps.

    missing: the impulse that is missing in its worst row, as a speed weighted as residuals are
        [m/s].
    residual: the residual of its worst row [m/s].
    force, solved: its force and its converged force [N or N·m]; the normal force of a contact, the
        magnitude of a connection.
    states: the number of states in which it has rows.
    """

    name: str
    missing: float
    residual: float
    force: float
    solved: float
    states: int = 1


@dataclass(frozen=True)
class ResidualHistory:
    """The residual by sweeps at one state of the motion, under one time step.

    sweeps: the numbers of sweeps.
    cold, warm: the residual after each number [m/s], from zero impulses and from those of the step
        before.
    contraction: the measured share of the distance to the solution that a sweep leaves in the end;
        None with a single row, or if it cannot be read.
    forces: the force of each element after the settings' own sweeps.
    """

    start: int
    time: float
    dt: float
    rows: int
    sweeps: tuple[int, ...]
    cold: tuple[float, ...] = ()
    warm: tuple[float, ...] = ()
    contraction: float | None = None
    theory: SweepTheory = field(default_factory=SweepTheory)
    forces: tuple[RowForce, ...] = ()


def residual_history(
    model: Model, settings: Settings, most: int, state: MotionState
) -> ResidualHistory:
    """Measures one state, up to `most` sweeps."""
    # Of a motion that diverges, some states are too large to multiply.
    with np.errstate(over="ignore", invalid="ignore"):
        return _history(model, settings, most, state)


def _history(model: Model, settings: Settings, most: int, state: MotionState) -> ResidualHistory:
    own = _at(model, settings, state)
    own.forward()
    counts = tuple(n for n in SWEEPS if n <= most)
    history = ResidualHistory(state.start, state.time, settings.dt, len(own.rows), counts)
    if not len(own.rows):
        return history
    plain = settings.replace(
        solver="pgs", sweeps=1, tolerance=0.0, warm_start=False, precision="f64"
    )
    speed = _speed(own)
    solution = _at(model, solved(settings, speed, len(own.rows)), state)
    solution.forward()
    target, mass = np.array(solution.qacc), solution.mass_matrix()

    def swept(n: int, **changes: Any) -> Sim:
        sim = _at(model, plain.replace(sweeps=n, **changes), state)
        sim.forward()
        return sim

    def size(acceleration: np.ndarray) -> float:
        change = acceleration * settings.dt
        return math.sqrt(max(float(change @ mass @ change), 0.0))

    def distance(sim: Sim) -> float:
        return size(np.array(sim.qacc) - target)

    # Distances are of plain sweeps: accelerated ones do not shrink geometrically.
    unsolved = solution.residual > UNSOLVED * speed
    read = sorted({*(n for n in BETWEEN if n < most), *counts})
    sims = [swept(n, acceleration="none") for n in read]
    left = [sim.residual if unsolved else distance(sim) for sim in sims]
    rounding = ROUNDING * (speed if unsolved else size(target))
    return replace(
        history,
        cold=tuple(swept(n).residual for n in counts),
        warm=tuple(swept(n, warm_start=True).residual for n in counts),
        contraction=contraction(read, left, rounding) if len(own.rows) > 1 else None,
        theory=theory(solution),
        forces=row_forces(own, solution),
    )


def row_forces(own: Sim, solution: Sim) -> tuple[RowForce, ...]:
    """By element, the difference between two solves of the same state."""
    rows, others = own.rows, solution.rows
    coupling, about = own._core.coupling()
    residual, weight = speeds(own), np.sqrt(np.diagonal(coupling) / about[:, 1])
    missing = np.abs(rows["impulse"] - others["impulse"]) / about[:, 4] * weight
    forces = []
    elements = zip(rows["kind"].tolist(), rows["index"].tolist(), strict=True)
    for kind, index in dict.fromkeys(elements):
        at = np.flatnonzero((rows["kind"] == kind) & (rows["index"] == index))
        force, converged = (_force(r[at], about[at[0], 3]) for r in (rows, others))
        worst = float(missing[at].max()), float(residual[at].max())
        forces.append(RowForce(str(rows["name"][at[0]]), *worst, force, converged))
    return tuple(forces)


def _force(rows: np.ndarray, cone: float) -> float:
    """The force of an element's rows together."""
    if rows["kind"][0] != "contact":
        return float(np.linalg.norm(rows["force"])) if len(rows) > 1 else float(rows["force"][0])
    # All edges of a pyramid push along the normal; of a cone the first row does.
    return float(rows["force"].sum() if cone == 0 else rows["force"][0])


def contraction(
    sweeps: Sequence[int], left: Sequence[float], rounding: float = 0.0
) -> float | None:
    """The share of the distance that a sweep leaves: the mean slope of the last readable ones.

    left: the distance after each number of sweeps, the first of which is 0. rounding: below it a
    distance is none; where all are (rows that only just touch have impulses of rounding), None.

    >>> print(f"{contraction((0, 1, 2, 4, 8), [0.5**n for n in (0, 1, 2, 4, 8)]):.3f}")
    0.500
    """
    most = max(left, default=0.0)
    if not most > rounding or not math.isfinite(most):
        return None
    pairs = list(zip(sweeps, left, strict=True))
    readable = [(n, e) for n, e in pairs if e >= max(READABLE * most, rounding)]
    if readable[-1][0] == 0:
        # One sweep is all it takes.
        return left[1] / most
    late = [pair for pair in readable if pair[0] >= LATE * readable[-1][0]]
    n, e = np.transpose(late if len(late) > 1 else readable[-2:])
    e = np.log(e)
    n = n - n.mean()
    return float(np.exp(n @ e / (n @ n)))


def solved(settings: Settings, speed: float, rows: int, **changes: Any) -> Settings:
    """The same settings with the rows solved to rounding.

    speed: the scale of what the rows see [m/s]; rows: how many at once.
    """
    convex = settings.law == "solref"
    chosen = {
        "newton": 1000,
        "pgs": int(max(1000, MOST_UPDATES / max(rows, 1))),
        "tolerance": 0.0 if convex else ROUNDING * speed,
    }
    return converged_settings(settings, **chosen | changes)


def _speed(sim: Sim) -> float:
    """The largest speed in the rows, or that which gravity gives in a step [m/s]."""
    rows = sim.rows
    seen = np.abs(np.concatenate([rows["velocity"], rows["target"]])).max(initial=0.0)
    fall = float(np.linalg.norm(sim.model.scene.gravity)) * sim.settings.dt
    return max(float(seen), fall, 1e-300)


def _at(model: Model, settings: Settings, state: MotionState) -> Sim:
    sim = unwatched(Sim(model, settings))
    sim.restore(state.snapshot)
    return sim
