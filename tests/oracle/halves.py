"""Equalities within a step, and the second solve after it: `midpoint` and `rk4`.

The stages of a step move the bodies smoothly, with their equalities. Rows then judge the mean
velocity, which moves positions, and a second solve of the same rows gives the last velocity what it
still lacks: a force that lasts through the step changes it by twice as much as the mean.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from . import equalities, place, rows, solve
from .place import Placed
from .rotation import Array
from .rows import Rows
from .world import World


def connections(world: World, qpos: Array, placed: Placed, M: Array) -> Rows | None:
    """The rows of the equalities, None without any."""
    on = world.model.scene["features"]
    if not (world.settings.connects_inside and on["equality"] and on["constraint"]):
        return None
    made = list(rows.equality_rows(world, qpos, placed, None))
    blocks: list[rows.Block] = [(i, None) for i in range(len(made))]
    return rows.assemble(world, made, blocks, M) if made else None


def started(world: World) -> Array:
    """The velocity of the state, made to keep the equalities, shape (nv,)."""
    placed = place.place(world.model, world.qpos)
    system = connections(world, world.qpos, placed, place.mass_matrix(world.model, placed))
    if system is None:
        return world.qvel
    return world.qvel + held(system, system.t - system.J @ world.qvel)


def held(system: Rows, short: Array) -> Array:
    """The least change of the velocities that gives every row what it is short of."""
    impulse = np.linalg.lstsq(system.J @ system.W, short, rcond=1e-12)[0]
    return np.asarray(system.W @ impulse)


def connected(
    world: World, qpos: Array, placed: Placed, M: Array, v: Array, smooth: Array
) -> Array:
    """The acceleration with the forces that keep the equalities, shape (nv,)."""
    system = connections(world, qpos, placed, M)
    if system is None:
        return smooth
    model = world.model
    curving = [
        equalities.curving(model, placed, qpos, v, index)
        for index, equality in enumerate(model.scene["equalities"])
        if equality["active"]
    ]
    return smooth + held(system, -np.concatenate(curving) - system.J @ smooth)


def second(
    world: World,
    system: Rows,
    solved: tuple[Array, Array],
    start: Array,
    last: Array,
    gained: Array,
) -> tuple[Array, Array]:
    """The last velocity, and the impulses that only it has; last: with the first solve's change.

    solved: the mean velocity and the impulses of the first solve, which began at `start`; gained:
    the smooth motion's last velocity less its mean.
    """
    settings, impulses = world.settings, solved[1]
    t, c, s, lo, hi = (x.copy() for x in (system.t, system.c, system.s, system.lo, system.hi))
    bounces = settings.law == "rigid" and settings.restitution > 0
    blocks = []
    for i, friction in system.blocks:
        kind = system.rows[i].key[0]
        if kind in equalities.KINDS.values() and settings.connects_inside:
            t[i] = system.J[i] @ last
            blocks.append((i, friction))
            continue
        if kind in ("contact", "limit") and impulses[i] <= 0:
            continue
        if kind == "contact" and bounces:
            hold = -settings.beta * min(system.rows[i].gap + settings.slop, 0.0) / settings.dt
            t[i] = max(min(hold, t[i]), t[i] + system.J[i] @ gained)
        if c[i] > 0:
            c[i] /= 2
            t[i] -= c[i] * impulses[i]
            s[i] = system.A[i] + c[i]
        blocks.append((i, friction))
    lasting = np.where(
        start < 0,
        np.minimum(np.maximum(start, impulses), 0),
        np.maximum(np.minimum(start, impulses), 0),
    )
    kept = np.zeros(len(lasting), bool)
    for i, friction in blocks:
        kept[i : i + 1 + len(friction or ())] = True
    again = replace(system, blocks=blocks, t=t, c=c, s=s, lo=lo, hi=hi)
    v, impulse, _ = solve.solve(again, last, np.where(kept, lasting, 0.0), settings)
    return v, impulse
