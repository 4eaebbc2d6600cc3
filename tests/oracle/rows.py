"""Stage 3a, rows: what must be true at the end of the step, as (J, t, c, set).

With w = J v + c lambda - t, an interval row asks for lambda in [lo, hi] and w = 0,
or w pushing against the bound that lambda rests on. A contact with friction is
a row for the normal in [0, inf), and one for each way of friction, two tangents,
torsion and two ways of rolling, that are solved together within their
coefficients times the normal impulse.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import detect, equalities, ways
from .detect import Contact, contact_jacobian, friction_jacobian
from .model import Model
from .place import Placed
from .rotation import Array, to_vector, unit
from .settings import Settings
from .world import World

INF = float("inf")
UNMOVED = 1e-24  # A times mass below this is rounding
WEIGHTLESS = 2.0**-35  # the least c of a normal that nothing can move, beside A of its tangents
# Nearer than this share of the size of what meets, a row stays: whether the guess of bodies at
# rest on each other overlaps is rounding.
NEAR = 1 / 1024


@dataclass
class Row:
    """One row; `key` names it, so that the next step can start from its impulse."""

    key: tuple[str | int, ...]
    J: Array  # shape (nv,)
    dofs: Array  # which dofs it may touch, shape (nv,)
    t: float = 0.0  # target velocity [m/s]
    c: float = 0.0  # regulariser [1/kg]
    soft: float = 0.0  # what the law adds to the denominator only [1/kg]
    lo: float = 0.0
    hi: float = INF
    gap: float = 0.0  # the distance that a contact's normal holds [m]


# (i, None): row i alone; (i, friction): row i is the normal of a contact, and those after it are
# its ways of friction, with these coefficients.
Block = tuple[int, tuple[float, ...] | None]


@dataclass
class Rows:
    """The system of one step: n rows over nv dofs."""

    rows: list[Row]
    blocks: list[Block]
    J: Array  # (n, nv)
    W: Array  # M^-1 J^T, (nv, n)
    A: Array  # diagonal of J M^-1 J^T, (n,)
    t: Array
    c: Array
    s: Array  # denominator of each row's update
    lo: Array
    hi: Array
    mass: Array  # of the trees each row touches [kg], (n,)


@dataclass(frozen=True)
class Near:
    """How near a row that may only push is."""

    phi: float  # the distance that it holds [m or rad]
    before: float  # its velocity at the start
    gained: float  # what the guess adds to it
    closing: bool  # the guess overlaps
    arrives: bool = True  # on the other shape, and not on its way past it
    far: bool = False  # still further away than the shapes are large


def push_target(settings: Settings, near: Near, bounces: bool, most: float = INF) -> float:
    """Target velocity of a row that may only push; `most`: the fastest that an overlap recovers.

    A row that only is near asks for what the guess does anyway: no overlap at the end.
    """
    phi, dt, rigid = near.phi, settings.dt, settings.law == "rigid"
    e = settings.restitution if bounces and rigid else 0.0
    arrive = -phi / dt  # do not stop early
    hold = -settings.beta * min(phi + (settings.slop if rigid else 0.0), 0.0) / dt
    hold = min(hold, most)
    if not near.closing:
        return arrive if phi > 0 else hold
    if rigid:
        # After stages an impact is at the start of the step: the smooth motion follows it.
        back = -e * near.before + (near.gained if settings.stages else 0.0)
        return arrive if e == 0 and phi > 0 and near.arrives else max(back, hold)
    return arrive if near.far and near.arrives else hold


def softness(settings: Settings) -> tuple[float, float]:
    """What softness means to a law: (regulariser c, addition to the denominator).

    Rows after stages have half of the impulse that it goes by: see `halves`.
    """
    soft = settings.softness * (2 if settings.stages else 1)
    return {"lesson": (soft, 0.0), "relaxed": (0.0, soft), "rigid": (0.0, 0.0)}[settings.law]


def build(
    world: World, placed: Placed, contacts: list[Contact], M: Array, v: Array, guess: Array
) -> Rows:
    """All rows in order: equality, friction loss, limits, contacts."""
    rows: list[Row] = []
    blocks: list[Block] = []
    on = world.model.scene["features"]
    if on["constraint"] and world.settings.law != "penalty":
        makers: list[tuple[bool, Iterable[Row]]] = [
            (on["equality"], equality_rows(world, world.qpos, placed, guess)),
            (on["frictionloss"], friction_loss_rows(world)),
            (on["limit"], limit_rows(world, v, guess)),
        ]
        for wanted, single in makers:
            if wanted:
                for row in single:
                    blocks.append((len(rows), None))
                    rows.append(row)
        for made, friction in contact_rows(world, placed, contacts, M, v, guess):
            blocks.append((len(rows), friction))
            rows += made
    return assemble(world, rows, blocks, M)


def assemble(world: World, rows: list[Row], blocks: list[Block], M: Array) -> Rows:
    """The rows' numbers side by side, with W = M^-1 J^T."""
    model, halves = world.model, 2 if world.settings.stages else 1
    J = np.array([row.J for row in rows]).reshape(len(rows), model.nv)
    W = np.linalg.solve(M, J.T) if rows else J.T
    A = np.einsum("ij,ji->i", J, W)
    t, c, soft, lo, hi = (
        np.array([getattr(row, name) for row in rows]) for name in ("t", "c", "soft", "lo", "hi")
    )
    mass = np.array([model.mass_of(row.dofs) for row in rows])
    for first, friction in blocks:
        # A normal that nothing can move: its load is t/c, without end, and so is its friction.
        if friction is not None and A[first] * mass[first] < UNMOVED and c[first] == 0.0:
            own = A[first + 1 : first + 1 + len(friction)] * ways.scales(friction) ** 2
            most = max(A[first], own.max())
            c[first] = halves * WEIGHTLESS * (most if most > 0.0 else 1.0 / mass[first])
    return Rows(rows, blocks, J, W, A, t, c, A + c + soft, lo, hi, mass)


def equality_rows(world: World, qpos: Array, placed: Placed, guess: Array | None) -> Iterator[Row]:
    """Equalities: what each of their rows holds stays zero.

    guess: where stages have held them already, they only keep what it has of their velocity.
    """
    model, settings = world.model, world.settings
    c, soft = softness(settings)
    for index, equality in enumerate(model.scene["equalities"]):
        if not equality["active"]:
            continue
        tied = equalities.tied(model, placed, qpos, index)
        for k, phi in enumerate(tied.phi):
            t = -settings.beta * phi / settings.dt
            if guess is not None and settings.connects_inside:
                t = float(tied.J[k] @ guess)
            key = (equalities.KINDS[equality["kind"]], index, k)
            yield Row(key, tied.J[k], tied.dofs, t, c, soft, -INF, INF)


def friction_loss_rows(world: World) -> Iterator[Row]:
    """Dry friction in a joint: any impulse up to dt times the loss, against the motion."""
    model = world.model
    for joint in model.joints:
        for dof in range(joint["dof"], joint["dof"] + joint["width"]):
            if joint["frictionloss"] > 0:
                bound = (
                    world.settings.dt * joint["frictionloss"] / (2 if world.settings.stages else 1)
                )
                unit_row = np.eye(model.nv)[dof]
                yield Row(("friction loss", dof, 0), unit_row, unit_row > 0, lo=-bound, hi=bound)


def limit_rows(world: World, v: Array, guess: Array) -> Iterator[Row]:
    """The sides of joint ranges that the guess violates."""
    model, settings = world.model, world.settings
    c, soft = softness(settings)
    for index, joint in enumerate(model.joints):
        if joint["range"] is None:
            continue
        for side, phi, J in sides(model, joint, world.qpos):
            closing = bool(phi + settings.dt * (J @ guess) < 0)
            low, high = joint["range"]
            if closing or phi <= NEAR * (high - low):
                near = Near(phi, float(J @ v), float(J @ (guess - v)), closing)
                t = push_target(settings, near, bounces=False)
                yield Row(("limit", index, side), J, J != 0, t, c, soft)


def sides(model: Model, joint: dict[str, Any], qpos: Array) -> Iterator[tuple[int, float, Array]]:
    """Distance to each bound of a joint's range, and its Jacobian."""
    low, high = joint["range"]
    at, dof = joint["qpos"], joint["dof"]
    J = np.zeros(model.nv)
    if joint["kind"] == "ball":
        turn = to_vector(unit(qpos[at : at + 4]))
        angle = np.sqrt(turn @ turn)
        if angle > 0:
            J[dof : dof + 3] = -turn / angle
            yield 1, high - angle, J
    elif joint["kind"] in ("slide", "hinge"):
        J[dof] = 1.0
        yield 0, qpos[at] - low, J
        yield 1, high - qpos[at], -J


def contact_rows(
    world: World, placed: Placed, contacts: list[Contact], M: Array, v: Array, guess: Array
) -> Iterator[tuple[list[Row], tuple[float, ...] | None]]:
    """A contact whose guess overlaps: its normal, and the ways in which it has friction."""
    model, settings = world.model, world.settings
    c, soft = softness(settings)
    for contact in contacts:
        pair = contact.pair
        J = contact_jacobian(model, placed, contact)
        size, phi, arrives = detect.size(model, pair), contact.dist, True
        closing = bool(phi + settings.dt * (J[0] @ guess) < 0)
        touching = phi <= NEAR * size
        if closing and not touching and "plane" not in detect.kinds(model, pair):
            found = detect.met_ahead(model, placed, contact, guess, settings.dt, NEAR * size)
            if found is None:
                continue
            arrives = found is contact
            contact = found
            J, phi = contact_jacobian(model, placed, found), found.dist
        if not (closing or touching):
            continue
        one, two = (model.scene["geoms"][i]["body"] for i in (pair.geom1, pair.geom2))
        dofs = model.moves[one] | model.moves[two]
        key = ("contact", pair.geom1, pair.geom2, contact.feature)
        gained = float(J[0] @ (guess - v))
        near = Near(phi, float(J[0] @ v), gained, closing, arrives, phi > size)
        most = settings.recovery_limit
        if c > 0 and most < INF:
            # A soft row holds its load by what its target is more than its speed.
            A = J[0] @ np.linalg.solve(M, J[0])
            most += c * max(most - J[0] @ guess, 0.0) / A if A > 0 else 0.0
        t = push_target(settings, near, bounces=True, most=most)
        made = [Row((*key, 0), J[0], dofs, t, c, soft, gap=phi)]
        rub = friction_jacobian(model, placed, contact)
        made += [Row((*key, k), row, dofs, lo=-INF) for k, row in enumerate(rub, 1)]
        yield made, tuple(pair.friction[way] for way in pair.ways()) or None


def penalty_force(
    world: World, placed: Placed, contacts: list[Contact], v: Array, M: Array
) -> Array:
    """The trap: a spring and a damper along the normal of each overlap, and friction, (nv,)."""
    settings = world.settings
    k, ratio = settings.penalty_stiffness, settings.penalty_damping_ratio
    force = np.zeros(world.model.nv)
    for contact in contacts:
        if contact.dist < 0:
            J = contact_jacobian(world.model, placed, contact)
            A = J[0] @ np.linalg.solve(M, J[0])
            damping = 2 * ratio * np.sqrt(k / A) if A > 0 else 0.0
            normal = -k * contact.dist - damping * (J[0] @ v)
            force += J[0] * normal
            if contact.pair.ways():
                force -= penalty_friction(world, placed, contact, v, M, max(normal, 0.0))
    return force


def penalty_friction(
    world: World, placed: Placed, contact: Contact, v: Array, M: Array, normal: float
) -> Array:
    """Friction of a contact that is a spring, against its motion: at most mu times the normal
    force, else a damper, (nv,)."""
    pair, k = contact.pair, world.settings.penalty_stiffness
    found = pair.ways()
    friction = tuple(pair.friction[way] for way in found)
    J = friction_jacobian(world.model, placed, contact) * ways.scales(friction)[:, None]
    A = np.array([row @ np.linalg.solve(M, row) for row in J])
    slides = [a for way, a in zip(found, A, strict=True) if way < 2]
    most = max(slides, default=0.0) or float(A.max())
    if most <= 0:
        return np.zeros(world.model.nv)
    # Turning ends as fast as sliding.
    ease = [1.0 if way < 2 else most / a if a > 0 else 0.0 for way, a in zip(found, A, strict=True)]
    velocity = (J @ v) * ease
    speed, damper, bound = np.sqrt(velocity @ velocity), np.sqrt(k / most) / 4, friction[0] * normal
    if damper * speed > bound:
        damper = bound / speed
    return damper * (J.T @ velocity)
