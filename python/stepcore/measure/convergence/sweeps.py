"""Measures how sweeps converge at one state of a motion, and computes the theoretical rate.

Once the active rows and the sticking contacts no longer change, a sweep of projected Gauss-Seidel
is linear. Let K = J M⁻¹ Jᵀ + c for these rows, D the diagonal blocks of K, and L the part below D.
Then a sweep multiplies the error by I − (D + L)⁻¹ K. The spectral radius of that matrix is the
asymptotic share of the error that a sweep leaves (Varga, "Matrix Iterative Analysis").
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore._core import Settings
from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.engine.run_settings import converged_settings
from stepcore.engine.sim import Sim, unwatched

# Numbers of sweeps after which the residual and the distance to the solution are read; and
# intermediate numbers after which only the distance is read.
SWEEPS = tuple(2**k for k in range(13))
BETWEEN = (*range(33), *(2**k * n // 4 for k in range(5, 12) for n in (5, 6, 7)))
# The solution is swept to this residual, relative to the rows' speeds, or up to this number of row
# updates.
ROUNDING, MOST_UPDATES = 1e-12, 4e6
# Above this residual, relative to the rows' speeds, the solution is not usable as a reference.
UNSOLVED = 1e-8
# Least readable distance, relative to the largest; far above rounding.
READABLE = 1e-9
# Start of the slope's range, as a share of the sweeps: rows that separate late change the slope.
LATE = 0.6
# Largest number of rows for eigenvalues: more rows take seconds.
MOST_ROWS = 300
# Least distance of an impulse from its bounds to count as inside, relative to the largest impulse.
INSIDE = 1e-9
# Eigenvalues of K below this, relative to the largest, belong to row combinations without effect.
IDLE = 1e-11
# Relative difference below which masses and couplings are equal.
SAME = 1e-9


@dataclass(frozen=True)
class MotionState:
    """A state of the motion.

    start: the index of the start.
    time: the time [s].
    snapshot: the state as `Sim.state` returns it.
    residual: the residual of the step from this state [m/s].
    """

    start: int
    time: float
    snapshot: bytes
    residual: float = 0.0


@dataclass(frozen=True)
class RowForce:
    """The rows of one element (a contact, a limit …) after the shipped sweeps.

    missing: the missing impulse of the element's worst row, as a speed [m/s], weighted like
        residuals.
    residual: the residual of the element's worst row [m/s].
    force, solved: the force and the converged force [N or N·m]: the normal force of a contact, the
        magnitude for a connection.
    states: the number of states in which the element has rows.
    """

    name: str
    missing: float
    residual: float
    force: float
    solved: float
    states: int = 1


@dataclass(frozen=True)
class SweepTheory:
    """The theoretical share of the error that a sweep leaves.

    radius: the spectral radius of a sweep's linear map; None, with the reason in `why`, if a sweep
        is not linear at this state.
    closed, formula: value and text of the closed form, if the scene has one. The closed form
        applies to rigid rows; soft rows have a smaller radius.
    """

    radius: float | None = None
    why: str = ""
    formula: str = ""
    closed: float | None = None


@dataclass(frozen=True)
class ResidualHistory:
    """The residual by sweeps at one state of the motion, under one time step.

    sweeps: the numbers of sweeps.
    cold, warm: the residual after each number [m/s], from zero impulses and from those of the
        previous step.
    contraction: the measured asymptotic share of the distance to the solution that a sweep leaves;
        None for a single row, or if not measurable.
    forces: the force of each element after the shipped sweeps.
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


# A diverging motion has states whose products overflow.
@np.errstate(over="ignore", invalid="ignore")
def residual_history(
    model: Model, settings: Settings, most: int, state: MotionState
) -> ResidualHistory:
    """Measure the residual at one state, up to `most` sweeps."""
    shipped = _at(model, settings, state)
    shipped.forward()
    counts = tuple(n for n in SWEEPS if n <= most)
    history = ResidualHistory(state.start, state.time, settings.dt, len(shipped.rows), counts)
    if not len(shipped.rows):
        return history
    plain = settings.replace(
        solver="pgs",
        sweeps=1,
        tolerance=0.0,
        cost_tolerance=0.0,
        warm_start=False,
        precision="f64",
    )
    speed = _speed(shipped)
    tolerance = 0.0 if settings.law == "solref" else ROUNDING * speed
    most_sweeps = int(max(1000, MOST_UPDATES / len(shipped.rows)))
    exact = converged_settings(settings, sweeps=most_sweeps, tolerance=tolerance)
    solution = _at(model, exact, state)
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

    # Use plain sweeps, because the distances of accelerated sweeps do not shrink geometrically.
    unsolved = solution.residual > UNSOLVED * speed
    read = sorted({*(n for n in BETWEEN if n < most), *counts})
    sims = [swept(n, acceleration="none") for n in read]
    left = [sim.residual if unsolved else distance(sim) for sim in sims]
    rounding = ROUNDING * (speed if unsolved else size(target))
    return replace(
        history,
        cold=tuple(swept(n).residual for n in counts),
        warm=tuple(swept(n, warm_start=True).residual for n in counts),
        contraction=contraction(read, left, rounding) if len(shipped.rows) > 1 else None,
        theory=theory(solution),
        forces=row_forces(shipped, solution),
    )


def row_forces(shipped: Sim, solution: Sim) -> tuple[RowForce, ...]:
    """Return the difference between two solves of the same state, by element."""
    rows, others = shipped.rows, solution.rows
    coupling, about = shipped._core.coupling()
    residual, weight = speeds(shipped), np.sqrt(np.diagonal(coupling) / about[:, 1])
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
    """Return the total force of an element's rows."""
    if rows["kind"][0] != "contact":
        return float(np.linalg.norm(rows["force"])) if len(rows) > 1 else float(rows["force"][0])
    # All edges of a pyramid push along the normal; of a cone, only the first row.
    return float(rows["force"].sum() if cone == 0 else rows["force"][0])


def contraction(
    sweeps: Sequence[int], left: Sequence[float], rounding: float = 0.0
) -> float | None:
    """Return the share of the distance that a sweep leaves: the mean slope of the last readings.

    sweeps: the numbers of sweeps, the first of which is 0.
    left: the distance after each number of sweeps.
    rounding: the distance below which a reading is rounding.

    None if no distance is above `rounding`: rows that barely touch have impulses of rounding.

    >>> print(f"{contraction((0, 1, 2, 4, 8), [0.5**n for n in (0, 1, 2, 4, 8)]):.3f}")
    0.500
    """
    most = max(left, default=0.0)
    if not most > rounding or not math.isfinite(most):
        return None
    pairs = list(zip(sweeps, left, strict=True))
    readable = [(n, e) for n, e in pairs if e >= max(READABLE * most, rounding)]
    if readable[-1][0] == 0:
        # One sweep solves the system.
        return left[1] / most
    late = [pair for pair in readable if pair[0] >= LATE * readable[-1][0]]
    n, e = np.transpose(late if len(late) > 1 else readable[-2:])
    e = np.log(e)
    n = n - n.mean()
    return float(np.exp(n @ e / (n @ n)))


def _speed(sim: Sim) -> float:
    """Return the largest speed along the rows, or gravity's gain in a step if larger [m/s]."""
    rows = sim.rows
    along = np.abs(np.concatenate([rows["velocity"], rows["target"]])).max(initial=0.0)
    fall = float(np.linalg.norm(sim.model.scene.gravity)) * sim.settings.dt
    return max(float(along), fall, 1e-300)


def _at(model: Model, settings: Settings, state: MotionState) -> Sim:
    sim = unwatched(Sim(model, settings))
    sim.restore(state.snapshot)
    return sim


def speeds(sim: Sim) -> Floats:
    """Return the residuals of the last solve's rows as speeds [m/s], as in `sim.residual`."""
    rows = sim.rows
    if not len(rows):
        return np.zeros(0)
    coupling, about = sim._core.coupling()
    a = np.diagonal(coupling)
    # In a cone, torsion and rolling are solved in the units of sliding.
    unit = about[:, 4]
    denominator = a + rows["regulariser"] * unit**2
    for block in np.unique(rows["block"][about[:, 3] > 0]):
        at = rows["block"] == block
        denominator[at] = denominator[at].max()
    safe = np.where(denominator > 0, denominator, 1.0)
    return rows["residual"] * unit / safe * np.sqrt(a / about[:, 1])


def theory(solved: Sim) -> SweepTheory:
    """Return the theory for the state of a Sim whose last solve has converged."""
    rows = solved.rows
    if not len(rows):
        return SweepTheory(why="there are no rows")
    if len(rows) > MOST_ROWS:
        return SweepTheory(why=f"{len(rows)} rows are too many for a matrix (most: {MOST_ROWS})")
    coupling, about = solved._core.coupling()
    parts, why = _parts(rows, about)
    formula, closed = closed_form(solved)
    if why:
        return SweepTheory(None, why, formula, closed)
    regulariser = rows["regulariser"] * about[:, 4] ** 2
    radius = spectral_radius(coupling, regulariser, 1 / about[:, 0], parts)
    return SweepTheory(radius, "", formula, closed)


def spectral_radius(
    a: Floats, regulariser: Floats, denominator: Floats, parts: list[list[int]]
) -> float:
    """Return the spectral radius of a sweep over blocks of rows; `denominator`: of single rows."""
    if not parts:
        return 0.0
    order = [i for part in parts for i in part]
    K = a[np.ix_(order, order)] + np.diag(regulariser[order])
    lower = np.tril(K)
    at = 0
    for part in parts:
        end = at + len(part)
        if len(part) == 1:
            lower[at, at] = denominator[part[0]]
        else:
            lower[at:end, at:end] = K[at:end, at:end]
        at = end
    left = np.eye(len(order)) - np.linalg.solve(lower, K)
    idle = np.linalg.eigvalsh(K)
    count = int(np.sum(idle < IDLE * idle.max()))
    # A combination of rows without effect never changes, and this error has no consequence.
    values = sorted(np.linalg.eigvals(left), key=lambda value: abs(value - 1))[count:]
    return float(max(map(abs, values), default=0.0))


def _parts(rows: NDArray[np.void], about: Floats) -> tuple[list[list[int]], str]:
    """Return the active rows, grouped as they are solved, or why no linear map exists."""
    impulse, lo, hi = rows["impulse"] / about[:, 4], rows["lo"], rows["hi"]
    near = INSIDE * float(np.abs(impulse).max(initial=0.0))
    parts: list[list[int]] = []
    for block in dict.fromkeys(rows["block"].tolist()):
        at = np.flatnonzero(rows["block"] == block).tolist()
        kind, mu = about[at[0], 3], about[at[0], 2]
        if kind == 0:
            parts += [[i] for i in at if lo[i] + near < impulse[i] < hi[i] - near]
            continue
        normal, tangents = impulse[at[0]], impulse[at[1:]]
        if normal <= near:
            continue
        if kind == 3:
            holds = bool(np.all(np.abs(tangents) < mu * normal * (1 - 1e-6)))
        else:
            holds = float(np.linalg.norm(tangents)) < mu * normal * (1 - 1e-6)
        if tangents.size and not holds:
            return [], f"{rows['name'][at[0]]} slides on its friction cone"
        # A Coulomb contact is solved normal first, a convex contact as one block.
        parts += [at] if kind == 1 else [at[:1], at[1:]] if tangents.size else [at]
    return parts, ""


def closed_form(solved: Sim) -> tuple[str, float | None]:
    """Return the closed form for bodies stacked on a fixed body that touch along normals."""
    model = solved.model
    contacts = [c for c in solved.contacts if np.linalg.norm(c["force"]) > 0]
    pairs = [[int(model.geom_body[c[g]]) for g in ("geom1", "geom2")] for c in contacts]
    masses = _tower(pairs, np.asarray(model.body_mass), set(model.jnt_body.tolist()))
    if masses is None or len(masses) < 2 or not _alone(solved, masses):
        return "", None
    if len(masses) == 2:
        low, top = masses
        text = f"m_top/(m_top + m_bottom) = {top:.4g}/({top:.4g} + {low:.4g})"
        return text, top / (top + low)
    if max(masses) - min(masses) <= SAME * max(masses):
        return f"cos²(π/2N), N = {len(masses)} equal bodies", math.cos(
            math.pi / (2 * len(masses))
        ) ** 2
    return "", None


def _tower(pairs: list[list[int]], mass: Floats, moved: set[int]) -> list[float] | None:
    """Return the masses from the bottom up; None if the contacts do not form one tower."""
    left, below, masses = [list(pair) for pair in pairs], None, []
    while left:
        if below is None:
            next_pairs = [p for p in left if (p[0] in moved) != (p[1] in moved)]
        else:
            next_pairs = [p for p in left if below in p]
        if len(next_pairs) != 1:
            return None
        left.remove(next_pairs[0])
        above = [b for b in next_pairs[0] if b in moved and b != below]
        if len(above) != 1:
            return None
        below = above[0]
        masses.append(float(mass[below]))
    return masses


def _alone(solved: Sim, masses: list[float]) -> bool:
    """Return whether the normals couple like bodies on a line, with no other active row."""
    rows = solved.rows
    if set(rows["kind"][rows["impulse"] != 0]) != {"contact"}:
        return False
    first = np.unique(rows["block"], return_index=True)[1]
    active = [i for i in first if rows["impulse"][i] > 0]
    if len(active) != len(masses):
        return False
    A = solved.delassus()[np.ix_(active, active)]
    inverse = 1 / np.array(masses)
    expected = inverse + np.concatenate([[0.0], inverse[:-1]])
    order = np.argsort(np.diagonal(A))
    if not np.allclose(np.diagonal(A)[order], np.sort(expected), rtol=SAME):
        return False
    # Neighbours share the 1/m of one body, regardless of the normals' directions; others share
    # nothing.
    off = np.sort(np.abs(A[np.triu_indices(len(masses), 1)]))[::-1]
    shared = np.sort(inverse[:-1])[::-1]
    return np.allclose(off[: len(shared)], shared, rtol=SAME) and not np.any(
        off[len(shared) :] > SAME * off[0]
    )
