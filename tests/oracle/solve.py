"""Stage 3b, solve: projected Gauss-Seidel over the rows, and how far it is from the answer."""

from __future__ import annotations

import numpy as np

from . import ways
from .rotation import Array
from .rows import Rows
from .settings import Settings

# Where sweeps "auto" gives up, as in the engine.
AUTO_MOST = 10_000


def solve(
    system: Rows, guess: Array, impulse: Array, settings: Settings
) -> tuple[Array, Array, int]:
    """Sweep until the residual is small enough: (velocity, impulses, sweeps done)."""
    impulse = impulse.copy()
    v = guess + system.W @ impulse
    limit = AUTO_MOST if settings.sweeps == "auto" else int(settings.sweeps)
    done = 0
    while done < limit and system.rows:
        sweep(system, v, impulse, settings.cone)
        done += 1
        if settings.tolerance > 0 and residual(system, v, impulse, settings) <= settings.tolerance:
            break
    return v, impulse, done


def sweep(system: Rows, v: Array, impulse: Array, cone: str) -> None:
    """Visit every row once, in order; v and impulse change in place."""
    for i, friction in system.blocks:
        update_row(system, i, v, impulse)
        if friction is not None:
            update_friction(system, i, friction, v, impulse, cone)


def update_row(system: Rows, i: int, v: Array, impulse: Array) -> None:
    """The impulse that makes this row true by itself, within its bounds."""
    if system.A[i] <= 0:
        return  # nothing can move along this row
    wanted = system.t[i] - system.J[i] @ v - system.c[i] * impulse[i]
    new = min(max(impulse[i] + wanted / system.s[i], system.lo[i]), system.hi[i])
    v += system.W[:, i] * (new - impulse[i])
    impulse[i] = new


def update_friction(
    system: Rows, i: int, friction: tuple[float, ...], v: Array, impulse: Array, cone: str
) -> None:
    """The rows after i together: the impulse within the bound that leaves the least sliding."""
    own = slice(i + 1, i + 1 + len(friction))
    scale, bound = ways.scales(friction), friction[0] * impulse[i]
    A = system.J[own] @ system.W[:, own]
    g = (system.J[own] @ v - A @ impulse[own]) * scale
    A = A * np.outer(scale, scale)
    if len(friction) == 2:
        new = (in_disc if cone == "elliptic" else in_box)(A, g, bound)
    else:
        new = (ways.in_ball if cone == "elliptic" else ways.in_cube)(A, g, bound)
    new = new * scale
    v += system.W[:, own] @ (new - impulse[own])
    impulse[own] = new


def free_minimum(A: Array, g: Array) -> Array:
    """Minimiser of x A x / 2 + g x; where A is singular, the shortest one."""
    (a, b), (_, d) = A
    det = float(a * d - b * b)
    if det > 1e-14 * a * d:
        return np.array([b * g[1] - d * g[0], b * g[0] - a * g[1]]) / det
    # At most one direction can move: A is (a + d) times the projection on it.
    trace = a + d
    return -(A @ g) / trace**2 if trace > 0 else np.zeros(2)


def in_disc(A: Array, g: Array, bound: float) -> Array:
    """The minimiser over |x| <= bound.

    On the rim x = -(A + m I)^-1 g with the multiplier m > 0 that gives |x| = bound.
    1/|x| is a concave, almost straight function of m, so Newton from m = 0 climbs
    to the root and never passes it.
    """
    if bound <= 0:
        return np.zeros(2)
    x = free_minimum(A, g)
    if x @ x <= bound * bound:
        return x
    m = 0.0
    for _ in range(50):
        if m > 0:
            x = shifted(A, g, m)
        length = np.sqrt(x @ x)
        slope = -(x @ shifted(A, x, m)) if m > 0 else -(x @ free_minimum(A, x))
        step = (length / bound - 1) * length**2 / slope
        m += step
        if step <= 1e-15 * m:
            break
    x = shifted(A, g, m)
    return x * (bound / np.sqrt(x @ x))


def shifted(A: Array, g: Array, m: float) -> Array:
    """-(A + m I)^-1 g."""
    a, d, b = A[0, 0] + m, A[1, 1] + m, A[0, 1]
    return np.array([b * g[1] - d * g[0], b * g[0] - a * g[1]]) / float(a * d - b * b)


def in_box(A: Array, g: Array, bound: float) -> Array:
    """The minimiser over |x1|, |x2| <= bound: inside, or the best point of the four edges."""
    x = free_minimum(A, g)
    if bound <= 0 or np.max(np.abs(x)) <= bound:
        return x if bound > 0 else np.zeros(2)
    best, least = np.zeros(2), np.inf
    for fixed in (0, 1):
        free = 1 - fixed
        for side in (-bound, bound):
            x = np.zeros(2)
            if A[fixed, fixed] > 0:
                x[fixed] = side
            if A[free, free] > 0:
                along = -(g[free] + A[free, fixed] * x[fixed]) / A[free, free]
                x[free] = min(max(along, -bound), bound)
            cost = float(0.5 * x @ A @ x + g @ x)
            if cost < least:
                best, least = x, cost
    return best


def natural_map(system: Rows, v: Array, impulse: Array, cone: str) -> Array:
    """lambda - proj(lambda - w/s) for every row: zero exactly at the solution, shape (n,)."""
    delta = np.zeros(len(impulse))
    w = system.J @ v + system.c * impulse - system.t
    s = system.A + system.c
    for i, friction in system.blocks:
        if friction is None:
            if system.A[i] > 0:
                moved = impulse[i] - w[i] / s[i]
                delta[i] = impulse[i] - min(max(moved, system.lo[i]), system.hi[i])
            continue
        block, mu = slice(i, i + 1 + len(friction)), friction[0]
        scale = np.array([1.0, *ways.scales(friction)])
        largest = (s[block] * scale**2).max()
        if largest > 0:
            violation, held = w[block] * scale, impulse[block] / scale
            slide = np.abs(violation[1:])
            violation[0] += mu * (np.sqrt(slide @ slide) if cone == "elliptic" else slide.sum())
            moved = held - violation / largest
            square = onto_box if len(friction) == 2 else ways.onto_cube
            project = onto_round if cone == "elliptic" else square
            delta[block] = (held - project(moved, mu)) * scale
    return delta


def onto_round(x: Array, mu: float) -> Array:
    """Nearest point of the cone |x_t| <= mu x_n."""
    side = np.sqrt(x[1:] @ x[1:])
    if side <= mu * x[0]:
        return x
    normal = (x[0] + mu * side) / (1 + mu * mu)
    if normal <= 0:
        return np.zeros(len(x))
    return np.array([normal, *(x[1:] * (mu * normal / side))])


def onto_box(x: Array, mu: float) -> Array:
    """Nearest point of the cone |x_1|, |x_2| <= mu x_n."""
    small, large = sorted(np.abs(x[1:]))
    normal = x[0]
    if large > mu * normal:
        normal = (x[0] + mu * large) / (1 + mu * mu)
        if small > mu * normal:
            normal = (x[0] + mu * (large + small)) / (1 + 2 * mu * mu)
    normal = max(normal, 0.0)
    return np.array([normal, *np.clip(x[1:], -mu * normal, mu * normal)])


def residual_rows(system: Rows, v: Array, impulse: Array, settings: Settings) -> Array:
    """The natural map as a speed, row by row [m/s], shape (n,)."""
    delta = natural_map(system, v, impulse, settings.cone)
    return np.abs(delta) * np.sqrt(np.maximum(system.A, 0.0) / system.mass)


def residual(system: Rows, v: Array, impulse: Array, settings: Settings) -> float:
    """The largest velocity error that the rows still hold [m/s]."""
    return float(residual_rows(system, v, impulse, settings).max()) if system.rows else 0.0
