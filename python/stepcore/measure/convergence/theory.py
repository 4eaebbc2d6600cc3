"""The share of an error that one sweep leaves, from the rows themselves and in closed form.

Once the active rows and the sticking contacts no longer change, a sweep of projected Gauss-Seidel
is linear: with K = J M⁻¹ Jᵀ + c of those rows, and D + L its diagonal blocks and what is below
them, a sweep multiplies the error by I − (D + L)⁻¹ K. The spectral radius of that matrix is the
share that a sweep leaves in the end (Varga, "Matrix Iterative Analysis").
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats
from stepcore.engine.sim import Sim

# No matrix is made of more rows than this: its eigenvalues take seconds.
MOST_ROWS = 300
# An impulse is inside its bounds if it is this far from them, relative to the largest impulse.
INSIDE = 1e-9
# An eigenvalue of K this small, relative to the largest, is a combination of rows without effect.
IDLE = 1e-11
# Masses and couplings that agree to this, relatively, are equal.
SAME = 1e-9


@dataclass(frozen=True)
class SweepTheory:
    """The share of the error that a sweep leaves, from theory.

    radius: the spectral radius of the matrix of the rows; None, with the reason in `why`, if there
        is no such matrix.
    closed, formula: value and text of the closed form, if the scene has one. It holds for rigid
        rows; the radius of soft rows is smaller.
    """

    radius: float | None = None
    why: str = ""
    formula: str = ""
    closed: float | None = None


def speeds(sim: Sim) -> Floats:
    """Residuals of the rows of the last solve as speeds [m/s]; the largest is `sim.residual`."""
    rows = sim.rows
    if not len(rows):
        return np.zeros(0)
    coupling, own = sim._core.coupling()
    a = np.diagonal(coupling)
    # Torsion and rolling in a cone are solved in the measure of sliding.
    unit = own[:, 4]
    denominator = a + rows["regulariser"] * unit**2
    for block in np.unique(rows["block"][own[:, 3] > 0]):
        at = rows["block"] == block
        denominator[at] = denominator[at].max()
    safe = np.where(denominator > 0, denominator, 1.0)
    return rows["residual"] * unit / safe * np.sqrt(a / own[:, 1])


def theory(solved: Sim) -> SweepTheory:
    """At the state of a Sim whose last solve has converged."""
    rows = solved.rows
    if not len(rows):
        return SweepTheory(why="there are no rows")
    if len(rows) > MOST_ROWS:
        return SweepTheory(why=f"{len(rows)} rows are too many for a matrix (most: {MOST_ROWS})")
    coupling, own = solved._core.coupling()
    parts, why = _parts(rows, own)
    formula, closed = closed_form(solved)
    if why:
        return SweepTheory(None, why, formula, closed)
    regulariser = rows["regulariser"] * own[:, 4] ** 2
    radius = spectral_radius(coupling, regulariser, 1 / own[:, 0], parts)
    return SweepTheory(radius, "", formula, closed)


def spectral_radius(
    a: Floats, regulariser: Floats, denominator: Floats, parts: list[list[int]]
) -> float:
    """Of a sweep over `parts`, each solved as a block, a single row by its denominator."""
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
    # A combination without effect stays as it is: an error of no consequence.
    values = sorted(np.linalg.eigvals(left), key=lambda value: abs(value - 1))[count:]
    return float(max(map(abs, values), default=0.0))


def _parts(rows: NDArray[np.void], own: Floats) -> tuple[list[list[int]], str]:
    """The active rows, grouped as they are solved; or why there is no linear map."""
    impulse, lo, hi = rows["impulse"] / own[:, 4], rows["lo"], rows["hi"]
    near = INSIDE * float(np.abs(impulse).max(initial=0.0))
    parts: list[list[int]] = []
    for block in dict.fromkeys(rows["block"].tolist()):
        at = np.flatnonzero(rows["block"] == block).tolist()
        kind, mu = own[at[0], 3], own[at[0], 2]
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
        # A Coulomb contact is solved normal first, a convex one all at once.
        parts += [at] if kind == 1 else [at[:1], at[1:]] if tangents.size else [at]
    return parts, ""


def closed_form(solved: Sim) -> tuple[str, float | None]:
    """The closed form of a tower: bodies stacked on something fixed, touching along normals."""
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
    """The masses from the bottom up; None where the contacts are not those of one tower."""
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
    """Whether the normals couple as those of bodies on one line, and no other row is active."""
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
    # Neighbours share the 1/m of one body, whichever way the normals point; others nothing.
    off = np.sort(np.abs(A[np.triu_indices(len(masses), 1)]))[::-1]
    shared = np.sort(inverse[:-1])[::-1]
    return np.allclose(off[: len(shared)], shared, rtol=SAME) and not np.any(
        off[len(shared) :] > SAME * off[0]
    )
