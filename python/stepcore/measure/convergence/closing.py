"""How sweeps close in on the solution of the rows, at one state of a motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.measure.convergence.theory import Theory, speeds, theory

# Numbers of sweeps at which the residual is read; and the distance besides.
SWEEPS = tuple(2**k for k in range(13))
BETWEEN = (*range(33), *(2**k * n // 4 for k in range(5, 12) for n in (5, 6, 7)))
# The solution is swept to this residual, over the speeds in the rows, or so many row updates.
ROUNDING, DEAREST = 1e-12, 4e6
# Beyond this, over the speeds in the rows, it is too far off to measure distances to it.
FAR = 1e-8
# What is left of an error, over its start, is read down to here: rounding is far below.
READABLE = 1e-9
# Rows that let go late change the slope: it is read from this share of the sweeps on.
LATE = 0.6


@dataclass(frozen=True)
class Moment:
    """A state along the motion. start: which one; snapshot: as of `Sim.state`; residual: that
    of the step from there [m/s]."""

    start: int
    time: float
    snapshot: bytes
    residual: float = 0.0


@dataclass(frozen=True)
class Push:
    """A contact, limit or other element that has rows, after the settings' own sweeps.

    residual: of its worst row [m/s]. force, solved: what it carries, and what it carries once
    converged [N or N·m]: of a contact the normal force, of a connection its size. missing: the
    difference in its worst row as a speed, weighed as residuals are [m/s].
    """

    name: str
    residual: float
    force: float
    solved: float
    missing: float


@dataclass(frozen=True)
class Closing:
    """Sweeps at one moment, under one time step.

    sweeps: their numbers. cold, warm: the residual after each [m/s], from no impulses and from
    those that the motion carried. contraction: what one sweep leaves of the distance to the
    solution, measured, in the end; None with a single row or where nothing could be read.
    pushes: by name of row, after the settings' own sweeps.
    """

    start: int
    time: float
    dt: float
    rows: int
    sweeps: tuple[int, ...]
    cold: tuple[float, ...] = ()
    warm: tuple[float, ...] = ()
    contraction: float | None = None
    theory: Theory = field(default_factory=Theory)
    pushes: tuple[Push, ...] = ()


def closing(model: Model, settings: Settings, most: int, moment: Moment) -> Closing:
    """Measures one moment; most: sweeps."""
    own = _at(model, settings, moment)
    own.forward()
    counts = tuple(n for n in SWEEPS if n <= most)
    here = Closing(moment.start, moment.time, settings.dt, len(own.rows), counts)
    if not len(own.rows):
        return here
    plain = settings.replace(
        solver="pgs", sweeps=1, tolerance=0.0, warm_start=False, precision="f64"
    )
    speed = _speed(own)
    solution = _at(model, converged(settings, speed, len(own.rows)), moment)
    solution.forward()
    target, mass = np.array(solution.qacc), solution.mass_matrix()

    def swept(n: int, **changes: Any) -> Sim:
        sim = _at(model, plain.replace(sweeps=n, **changes), moment)
        sim.forward()
        return sim

    def distance(sim: Sim) -> float:
        away = (np.array(sim.qacc) - target) * settings.dt
        return math.sqrt(max(float(away @ mass @ away), 0.0))

    # What momentum leaves is no power of anything: distances are those of plain sweeps.
    far = solution.residual > FAR * speed
    read = sorted({*(n for n in BETWEEN if n < most), *counts})
    sims = [swept(n, acceleration="none") for n in read]
    left = [sim.residual if far else distance(sim) for sim in sims]
    cold = [swept(n).residual for n in counts]
    warm = [swept(n, warm_start=True).residual for n in counts]
    return replace(
        here,
        cold=tuple(cold),
        warm=tuple(warm),
        contraction=contraction(read, left) if len(own.rows) > 1 else None,
        theory=theory(solution),
        pushes=pushes(own, solution),
    )


def pushes(own: Sim, solution: Sim) -> tuple[Push, ...]:
    """Row by row what two solves of the same state differ in."""
    rows, others = own.rows, solution.rows
    coupling, about = own._core.coupling()
    residual, weight = speeds(own), np.sqrt(np.diagonal(coupling) / about[:, 1])
    missing = np.abs(rows["impulse"] - others["impulse"]) * weight
    found = []
    for name in dict.fromkeys(rows["name"].tolist()):
        at = np.flatnonzero(rows["name"] == name)
        force, solved = (_force(r[at], about[at[0], 3]) for r in (rows, others))
        worst = float(residual[at].max()), float(missing[at].max())
        found.append(Push(name, worst[0], force, solved, worst[1]))
    return tuple(found)


def _force(rows: np.ndarray, set: float) -> float:
    """What the rows of one name carry together."""
    if rows["kind"][0] != "contact":
        return float(np.linalg.norm(rows["force"])) if len(rows) > 1 else float(rows["force"][0])
    # All edges of a pyramid push along the normal; of a cone the first row does.
    return float(rows["force"].sum() if set == 0 else rows["force"][0])


def contraction(sweeps: Sequence[int], left: Sequence[float]) -> float | None:
    """What a sweep leaves in the end: the mean slope over the last that can be read.

    left: of the distance, after each number of sweeps, the first of which is 0.

    >>> print(f"{contraction((0, 1, 2, 4, 8), [0.5**n for n in (0, 1, 2, 4, 8)]):.3f}")
    0.500
    """
    most = max(left, default=0.0)
    if not most > 0 or not math.isfinite(most):
        return None
    pairs = list(zip(sweeps, left, strict=True))
    readable = [(n, e) for n, e in pairs if e >= READABLE * most]
    if readable[-1][0] == 0:
        # One sweep is all it takes.
        return left[1] / most
    late = [pair for pair in readable if pair[0] >= LATE * readable[-1][0]]
    n, e = np.transpose(late if len(late) > 1 else readable[-2:])
    e = np.log(e)
    n = n - n.mean()
    return float(np.exp(n @ e / (n @ n)))


def converged(settings: Settings, speed: float, rows: int) -> Settings:
    """The same settings with the rows solved to rounding.

    speed: of what the rows see [m/s]; rows: how many at once.
    """
    rest: dict[str, Any] = {"precision": "f64", "acceleration": "none"}
    if settings.law == "solref":
        return settings.replace(solver="newton", sweeps=1000, tolerance=0.0, **rest)
    most = int(max(1000, DEAREST / max(rows, 1)))
    return settings.replace(solver="pgs", sweeps=most, tolerance=ROUNDING * speed, **rest)


def _speed(sim: Sim) -> float:
    """The largest speed in the rows, or that which gravity gives in a step [m/s]."""
    rows = sim.rows
    seen = np.abs(np.concatenate([rows["velocity"], rows["target"]])).max(initial=0.0)
    fall = float(np.linalg.norm(sim.model.scene.gravity)) * sim.settings.dt
    return max(float(seen), fall, 1e-300)


def _at(model: Model, settings: Settings, moment: Moment) -> Sim:
    sim = Sim(model, settings)
    sim.restore(moment.snapshot)
    return sim
