"""Findings on contacts in a run: initial overlap, depth, frictionless sliding."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from stepcore.engine.coordinates import rotated
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.change import Change
from stepcore.experiment.proposal import Proposal
from stepcore.measure.monitors.finding import (
    DEEP,
    HALF,
    LEFT,
    PARTS,
    SEEN,
    TEST_CONTACTS,
    Finding,
    Proposals,
    listed,
    named,
    others,
    worst,
)
from stepcore.measure.monitors.recording import FEWEST, STEADY, Recording, free_bodies, friction_of
from stepcore.measure.monitors.soft_rows import hardest, stiffened
from stepcore.report.units import metres, newtons, percent, speed

# An initial overlap up to this many times the resting depth is the scene's resting state: the feet
# of Go2 start 1.7 and 2.6 times as deep as they rest (scene.xml and scene_mjx.xml). Twice as much
# misses h1's feet, which start in the floor.
RESTS = 3.0


class Contact(NamedTuple):
    """The behaviour of one contact of a pair of geoms.

    depth: the overlap at the start, or at rest [m]. force: the normal force at rest [N].
    speed: of sliding, or of the geoms when they leave their overlap [m/s].
    movable: whether some joint can separate the geoms. settled: whether it came to rest.
    """

    pair: int
    depth: float = 0.0
    force: float = 0.0
    speed: float = 0.0
    movable: bool = True
    settled: bool = True


def contact_findings(run: Recording) -> Iterator[Finding]:
    """Yield the findings on contacts; a run that failed has only its initial overlaps."""
    if not run.model.npair:
        return
    starts = overlaps(run)
    if run.failure is not None:
        yield from _overlaps(run, starts, {})
        return
    late = list(resting(run))
    jammed = _jammed(run, starts, {at.pair: at for at in late if at.settled})
    # An exclude of two bodies covers all pairs of their geoms that no joint can move apart.
    apart = [set(_bodies(run.model, pair)) for pair in jammed]
    fixed = (at.pair for at in starts if not at.movable)
    held = {*jammed, *(pair for pair in fixed if set(_bodies(run.model, pair)) in apart)}
    if jammed:
        stuck = list(jammed.values())
        force = "no joint can move them apart"
        # Across the directions of motion a force is unbounded, except for rounding in the file.
        if stuck[0].force < 1e9:
            force = f"push each other with {newtons(stuck[0].force)} all the time"
        becomes = f", as their joints hold them, and {force}"
        yield _overlapping(run, "overlap", "warning", stuck, "", becomes)
    late = [at for at in late if at.pair not in held]
    rest = sorted((at for at in late if at.settled), key=lambda at: at.depth)
    starts = [at for at in starts if at.pair not in held]
    yield from _overlaps(run, starts, {at.pair: at.depth for at in rest})
    if run.model.settings.law == "solref":
        yield from _depths(run, late)
        known = {at.pair for at in (*starts, *late) if at.depth > DEEP * run.thick(at.pair)}
        yield from _impacts(run, known | held)
    yield from _slides(run, rest)


def resting(run: Recording) -> Iterator[Contact]:
    """Yield contacts whose depth is constant at the end of the run, or that stay deep there."""
    seen = run.contacts
    for (pair, _), late in seen.late():
        depth, force = seen.depth[late], float(seen.force[late].mean())
        if depth.min() > 0 and np.ptp(depth) < STEADY * depth.mean():
            yield Contact(pair, float(depth.mean()), force)
        elif depth.min() > DEEP * run.thick(pair):
            yield Contact(pair, float(depth.max()), force, settled=False)


# Overlaps.


def overlaps(run: Recording) -> list[Contact]:
    """Return the overlaps at the start, with the speeds at which they end, deepest first."""
    contacts = run.at(0).contacts
    found = [_overlap(run, contact) for contact in contacts[contacts["dist"] < 0]]
    return sorted(found, key=lambda overlap: -overlap.depth)


def _overlap(run: Recording, contact: np.void) -> Contact:
    """Return an overlap at the start, with the speed along the normal at which the geoms leave it.

    Free trees are represented by their centres of mass: a leg that straightens moves its foot, but
    does not throw the robot. Only the first separation counts: later ones follow another impact.
    """
    model, sim, normal = run.model, run.at(0), contact["normal"]
    arms, moved, rose = np.zeros((3, model.nv)), *np.zeros((2, len(run)))
    for geom, sign in (("geom1", -1.0), ("geom2", 1.0)):
        body = int(model.geom_body[contact[geom]])
        jacobian, arm = sim.jacobian(body), contact["pos"] - sim.xpos[body]
        arms += sign * (jacobian[:3] + np.cross(jacobian[3:].T, arm).T)
        point = np.array(sim.xmat).reshape(-1, 3, 3)[body].T @ arm
        place = run["xpos"][:, body] + rotated(run["xquat"][:, body], point)
        moved += sign * (place @ normal)
        root = int(run.roots[body])
        rose += sign * (
            (run.centre_of_mass(root) if root in free_bodies(model) else place) @ normal
        )
    # The threshold excludes rounding of a motion across the normal.
    movable = np.abs(normal @ arms).max(initial=0.0) > 1e-9 * np.abs(arms).max(initial=0.0)
    out = int((moved - moved[0] >= -contact["dist"]).argmax())
    left = float(rose[out] - rose[out - 1]) / (run.spacing or 1.0) if out else 0.0
    return Contact(int(contact["index"]), -float(contact["dist"]), 0.0, left, bool(movable))


def _jammed(
    run: Recording, starts: list[Contact], at_rest: Mapping[int, Contact]
) -> dict[int, Contact]:
    """Return pairs that overlap throughout because joints keep the geoms there.

    Both geoms are in one tree; or they are in the world and in a machine fixed to it, and overlap
    beyond the middle of the thinner geom or at all angles of a hinge.
    """
    jammed: dict[int, Contact] = {}
    for start in (start for start in starts if start.pair in at_rest):
        at, roots = at_rest[start.pair], set(run.roots[_bodies(run.model, start.pair)].tolist())
        fixed = 0 in roots and not roots & free_bodies(run.model)
        share = 1.0 if fixed else math.inf
        if len(roots) == 1 or (fixed and _meshed(run, start.pair)):
            share = DEEP
        if min(start.depth, at.depth) > share * run.thick(start.pair):
            jammed.setdefault(at.pair, at)
    return jammed


def _meshed(run: Recording, pair: int) -> bool:
    """Return whether a link on the world overlaps it notably at all angles of its hinge.

    The geom of the world is then the machine's base, unless it is a floor.
    """
    model, link, deep = run.model, max(_bodies(run.model, pair)), DEEP * run.thick(pair)
    joints = np.flatnonzero(model.jnt_body == link)
    turns = [model.jnt_type[joint] for joint in joints] == ["hinge"]
    if not turns or model.body_parent[link] or _floor(model, pair):
        return False
    sim, at = Sim(model), model.jnt_qposadr[joints[0]]
    sim.qpos[:] = run.data["qpos"][0]
    low, high = np.clip(model.jnt_range[joints[0]], -math.pi, math.pi)
    for angle in np.linspace(low, high, 9):
        sim.qpos[at] = angle
        sim.forward()
        mine = sim.contacts["dist"][sim.contacts["index"] == pair]
        if mine.min(initial=0.0) >= -deep:
            return False
    return True


def _overlaps(
    run: Recording, starts: list[Contact], at_rest: Mapping[int, float]
) -> Iterator[Finding]:
    """Yield pairs that overlap at the start and do not rest at that depth."""

    def over(start: Contact) -> float:
        notable = SEEN * run.thick(start.pair)
        if not start.movable:
            return start.depth / (LEFT * notable)
        return start.depth / max(notable, RESTS * at_rest.get(start.pair, 0.0))

    deep = [start for start in starts if over(start) > 1]
    if not deep:
        return
    of, share = deep[0], deep[0].depth / run.thick(deep[0].pair)
    # Thrown further apart than they overlapped: v²/2g > depth.
    thrown = of.speed > (2 * run.gravity * of.depth) ** 0.5
    becomes = f", and are thrown apart at {speed(of.speed)}" if thrown else ""
    if not of.movable:
        becomes = ", and no joint can move them apart"
    by = f" at the start, {percent(share)} of the thinner one's half thickness"
    severity = "error" if share > DEEP and (thrown or not of.movable) else "warning"
    yield _overlapping(run, "overlap at the start", severity, deep, by, becomes)


def _overlapping(
    run: Recording, kind: str, severity: str, found: list[Contact], by: str, becomes: str
) -> Finding:
    """Return a finding on overlaps; its fix is another position or pose, or no contact at all."""
    model, of = run.model, found[0]
    contacts = named(model, "contact", (at.pair for at in found))
    geoms = model.contact_pair(of.pair).geoms
    names = [model.geom_names[geom] for geom in geoms]
    both = f"geoms `{names[0]}` and `{names[1]}`"
    if not all(names):
        both = " and ".join(model.element_name("geom", geom) for geom in geoms)
    also = others(contacts[1:], "pair")
    problem = f"{both} overlap by {metres(of.depth)}{by}{also}{becomes}"
    bodies = _bodies(model, of.pair)
    roots = run.roots[bodies].tolist()
    free = {*roots} & free_bodies(model)
    # The base of a machine may be part of the world; a floor is no base.
    based = "world" in model.scene.fused.values() and not _floor(model, of.pair)
    machine = not free and (all(roots) or based)
    moved = 1 if roots[1] else 0
    # The foot of a robot is moved together with the whole robot.
    base = roots[moved] if roots[moved] in free else bodies[moved]
    mover = model.element_name("body", base)
    fix = f"move {mover} {metres(of.depth)} away, in the model or in the keyframe"
    lines = tuple[str, ...]()
    if kind == "overlap" or machine or (roots[0] == roots[1] and roots[0]):
        lines = _excludes(model, found)
        pose = "start from another pose, or " if of.movable and kind != "overlap" else ""
        more = f" and {len(lines) - 1} more (`stepcore check` lists them)" if lines[1:] else ""
        fix = f"{pose}leave them out with {lines[0]}{more}, or make the geoms smaller"
    what = problem, fix, contacts, of.depth, "m", TEST_CONTACTS
    return Finding(kind, severity, *what, lines=lines[len(lines) == 1 :])


def _bodies(model: Model, pair: int) -> list[int]:
    bodies: list[int] = model.geom_body[list(model.contact_pair(pair).geoms)].tolist()
    return bodies


def _floor(model: Model, pair: int) -> bool:
    return any(model.geom_type[k] in ("plane", "hfield") for k in model.contact_pair(pair).geoms)


def _excludes(model: Model, found: list[Contact]) -> tuple[str, ...]:
    """Return one <exclude> for each two bodies, which leaves out all contacts between them."""
    apart = dict[frozenset[int], str]()
    for bodies in (_bodies(model, at.pair) for at in found):
        first, second = (model.body_names[body] or "…" for body in bodies)
        apart.setdefault(frozenset(bodies), f'<exclude body1="{first}" body2="{second}"/>')
    return tuple(apart.values())


# Depths.


def _depths(run: Recording, rest: list[Contact]) -> Iterator[Finding]:
    """Yield a finding on contacts that rest deep, with the solref that reduces the depth."""
    model, asked = run.model, run.wanted

    def most(at: Contact) -> float:
        return DEEP * run.thick(at.pair) if asked is None else asked

    deep = worst(rest, lambda at: at.depth / most(at))
    if not deep:
        return
    of, contacts = deep[0], named(model, "contact", (at.pair for at in deep))
    pair, thick = model.contact_pair(of.pair), run.thick(of.pair)
    verb = "rests" if of.settled else "has not come to rest and stays up to"
    problem = (
        f"{listed(contacts, 'contact')} {verb} {metres(of.depth)} deep, "
        f"{percent(of.depth / thick)} of the thinner geom's half thickness, under "
        f'solref="{pair.solref[0]:g} {pair.solref[1]:g}"'
    )
    pairs = {at.pair for at in deep}
    solimp = next(of.value for of in contacts[0].fields(model) if of.name == "solimp")
    wanted = LEFT * most(of) if asked is None else asked
    harder = stiffened(model, contacts, pair.solref, solimp, of.depth, wanted)
    # Steep friction pyramids are soft along the normal, too, and a stiff row that is not solved may
    # not reduce the depth.
    steep = model.settings.cone == "pyramidal" and friction_of(model, of.pair) > 1
    ways = (harder, other_cone(model))[:: -1 if steep or run.unsolved else 1]
    # A requested depth is met within 1 %.
    proposals = Proposals(ways, lambda other: depth_of(other, pairs), (1 + SEEN) * most(of), metres)
    severity = "warning" if of.depth > DEEP * thick else "remark"
    what = "depth at rest", severity, problem, "", contacts, of.depth, "m", TEST_CONTACTS
    yield Finding(*what, proposals=proposals)


def depth_of(run: Recording, pairs: Collection[int]) -> float | None:
    """Return the mean depth of the deepest of some pairs over the end of the run [m].

    The depth of geoms held apart by a margin is 0. None if no pair has a contact there.
    """
    late = run.part(run.late).contacts
    depths = [late.depth[places].mean() for (of, _), places in late.groups.items() if of in pairs]
    return max(0.0, float(max(depths))) if depths else None


def _impacts(run: Recording, known: Collection[int]) -> Iterator[Finding]:
    """Yield pairs that an impact or a load pressed deep into each other for a while."""
    model, deepest = run.model, _deepest(run)

    def over(pair: int) -> float:
        # A passage is reported as tunnelling.
        through = run.passed.intersection(model.contact_pair(pair).geoms)
        return 0.0 if through else deepest[pair] / (HALF * run.thick(pair))

    pairs = worst(deepest.keys() - known, over)
    if not pairs:
        return
    contacts, depth, thick = named(model, "contact", pairs), deepest[pairs[0]], run.thick(pairs[0])
    solref = model.contact_pair(pairs[0]).solref
    problem = (
        f"{listed(contacts, 'contact')} is pressed {metres(depth)} deep, "
        f"{percent(depth / thick)} of the thinner geom's half "
        f'thickness, under solref="{solref[0]:g} {solref[1]:g}"'
    )
    hard = tuple(hardest(model, pairs, model.settings.dt / part) for part in PARTS)
    ways = (other_cone(model), hard) if run.unsolved else (hard,)

    def pressed(other: Recording) -> float | None:
        """Return the largest depth of the pairs [m]; None if one has no contact."""
        deep = _deepest(other)
        return max(deep[pair] for pair in pairs) if set(pairs) <= set(deep) else None

    proposals = Proposals(ways, pressed, HALF * thick, metres, needed=True)
    what = "depth under load", "remark", problem, "", contacts, depth, "m", TEST_CONTACTS
    yield Finding(*what, proposals=proposals)


def other_cone(model: Model) -> tuple[Proposal, ...]:
    """Return the fix that changes a model's cone to the other type."""
    cone = "elliptic" if model.settings.cone == "pyramidal" else "pyramidal"
    return (Proposal(f'cone="{cone}"', Change(cone=cone)),)


def _deepest(run: Recording) -> dict[int, float]:
    """Return the largest depth of each pair [m]."""
    pairs, each = np.unique(run.contacts.pair, return_inverse=True)
    deepest = np.zeros(len(pairs))
    np.maximum.at(deepest, each, run.contacts.depth)
    return dict(zip(pairs.tolist(), deepest.tolist(), strict=True))


# Contacts without friction.


def _slides(run: Recording, rest: list[Contact]) -> Iterator[Finding]:
    """Yield contacts that slide because they have no friction, or else rest without it."""
    model, seen, moving = run.model, run.contacts, []
    for (pair, _), places in seen.groups.items():
        if friction_of(model, pair) == 0 and len(places) >= max(FEWEST, STEADY * len(run)):
            mean = float(np.linalg.norm(seen.past[places], axis=1).mean())
            moving.append(Contact(pair, speed=mean))
    fast = worst(moving, lambda at: at.speed / (DEEP * run.thick(at.pair)))
    without = [at for at in rest if friction_of(model, at.pair) == 0 and _carries(run, at)]
    told = fast or sorted(without, key=lambda at: -at.force)
    if not told:
        return
    of, contacts = told[0], named(model, "contact", (at.pair for at in told))
    frictionless = model.contact_pair(of.pair).condim == 1
    does = f"slides at {speed(of.speed)}" if fast else f"carries {newtons(of.force)}"
    why = "condim is 1" if frictionless else "its friction is 0"
    falls = "" if fast else ", so a slight push lets the body slide or topple"
    problem = f"{listed(contacts, 'contact')} {does} without friction, because {why}{falls}"
    given = 'condim="3"' if frictionless else 'friction="0.8"'
    fix = f"{given} on one of the two geoms gives it friction"
    value, unit = (of.speed, "m/s") if fast else (of.force, "N")
    yield Finding("no friction", "remark", problem, fix, contacts, value, unit)


def _carries(run: Recording, at: Contact) -> bool:
    """Return whether a contact carries a tenth of the weight of a free tree."""
    model = run.model
    roots = run.roots[_bodies(model, at.pair)].tolist()
    free = [root for root in roots if root in free_bodies(model)]
    weights = map(run.weight, free)
    return roots[0] != roots[1] and any(at.force > DEEP * weight > 0 for weight in weights)
