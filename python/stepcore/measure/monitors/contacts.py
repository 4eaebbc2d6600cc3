"""Findings on contacts in a run: initial overlap, resting depth, frictionless sliding."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.coordinates import rotated
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.measure.monitors.finding import (
    DEEP,
    HALF,
    LEFT,
    PARTS,
    SEEN,
    TEST_CONTACTS,
    Cure,
    Finding,
    Remedy,
    listed,
    named,
    others,
    worst,
)
from stepcore.measure.monitors.recording import FEWEST, STEADY, Recording, friction_of
from stepcore.measure.monitors.soft_rows import hardest, pair_solimp, stiffened
from stepcore.report.units import metres, newtons, percent, speed

# An initial overlap up to this many times the resting depth is the scene's resting state: the feet
# of playground's go1 begin 4 times as deep as they rest, those of half_cheetah 1.9 times.
RESTS = 3.0


class Contact(NamedTuple):
    """The behaviour of one contact of a pair of geoms.

    depth: the overlap at the start, or at rest [m]. force: the normal force at rest [N].
    speed: at which it slides, or at which the geoms left their overlap [m/s].
    movable: whether some joint can separate the geoms. settled: whether it came to rest.
    """

    pair: int
    depth: float = 0.0
    force: float = 0.0
    speed: float = 0.0
    movable: bool = True
    settled: bool = True


def contact_findings(run: Recording, passed: Collection[int] = ()) -> Iterator[Finding]:
    """Yield all findings on contacts; of a run that failed, the overlaps that it began with.

    passed: pairs that passed through each other.
    """
    if not run.model.npair:
        return
    starts = overlaps(run)
    if run.failure is not None:
        yield from _overlaps(run, starts, {})
        return
    rest = list(resting(run))
    jammed = _jammed(run, starts, {at.pair: at for at in rest})
    if jammed:
        yield _jam(run.model, list(jammed.values()))
    sunk = list(_sunk(run, rest))
    rest = [at for at in rest if at.pair not in jammed]
    deepest = {at.pair: at.depth for at in sorted(rest, key=lambda at: at.depth)}
    yield from _overlaps(run, [at for at in starts if at.pair not in jammed], deepest)
    if run.model.settings.law == "solref":
        deep = [*rest, *sunk]
        yield from _depths(run, deep)
        known = {at.pair for at in (*starts, *deep) if at.depth > DEEP * run.thick(at.pair)}
        yield from _impacts(run, known | _with_geoms_of(run, passed))
    yield from _slides(run, rest)


def resting(run: Recording) -> Iterator[Contact]:
    """Yield contacts whose depth is constant to the end of the run."""
    seen = run.contacts
    for (pair, _), late in seen.late():
        depth = seen.depth[late]
        if depth.min() > 0 and np.ptp(depth) < STEADY * depth.mean():
            yield Contact(pair, float(depth.mean()), float(seen.force[late].mean()))


def _sunk(run: Recording, rest: list[Contact]) -> Iterator[Contact]:
    """Yield contacts that stay deep over the end of the run and have not come to rest."""
    known = {at.pair for at in rest}
    for (pair, _), late in run.contacts.late():
        depth = run.contacts.depth[late]
        if pair not in known and depth.min() > DEEP * run.thick(pair):
            yield Contact(pair, float(depth.max()), settled=False)


def _gravity(model: Model) -> float:
    return float(np.linalg.norm(model.scene.gravity)) if model.scene.features.gravity else 0.0


# Overlaps.


def overlaps(run: Recording) -> list[Contact]:
    """Return the overlaps at the start, with the speeds at which they end, deepest first."""
    sim = run.at(0)
    contacts = sim.contacts[sim.contacts["dist"] < 0]
    if not len(contacts):
        return []
    movable = []
    for contact in contacts:
        point = np.zeros((3, run.model.nv))
        for geom, sign in (("geom1", -1.0), ("geom2", 1.0)):
            body = int(run.model.geom_body[contact[geom]])
            jacobian, arm = sim.jacobian(body), contact["pos"] - sim.xpos[body]
            point += sign * (jacobian[:3] + np.cross(jacobian[3:].T, arm).T)
        along = np.abs(contact["normal"] @ point).max(initial=0.0)
        # Not rounding, of what moves across the normal.
        movable.append(bool(along > 1e-9 * np.abs(point).max(initial=0.0)))
    speeds = _separation(run, contacts).tolist()
    found = [
        Contact(int(contact["index"]), -float(contact["dist"]), 0.0, left, free)
        for contact, left, free in zip(contacts, speeds, movable, strict=True)
    ]
    return sorted(found, key=lambda overlap: -overlap.depth)


def _separation(run: Recording, contacts: np.ndarray) -> Floats:
    """Return the speed along the normal at which geoms leave their overlap [m/s], (contacts,).

    The speed is that of the centres of mass of free trees: a leg that straightens moves its foot,
    and does not throw the robot. Only the first time counts: a later one follows another impact.
    """
    model, sim, roots = run.model, run.at(0), run.roots
    free = {int(body) for k, body in enumerate(model.jnt_body) if model.jnt_type[k] == "free"}
    moved, rose = np.zeros((2, len(run), len(contacts)))
    xmat = np.array(sim.xmat).reshape(-1, 3, 3)
    for geom, sign in (("geom1", -1.0), ("geom2", 1.0)):
        body = model.geom_body[contacts[geom]]
        point = np.einsum("cji,cj->ci", xmat[body], contacts["pos"] - sim.xpos[body])
        place = run["xpos"][:, body] + rotated(run["xquat"][:, body], point)
        carried = place.copy()
        for root in free.intersection(roots[body].tolist()):
            carried[:, roots[body] == root] = run.centre_of_mass(root)[:, None]
        moved += sign * np.einsum("nci,ci->nc", place, contacts["normal"])
        rose += sign * np.einsum("nci,ci->nc", carried, contacts["normal"])
    left = moved - moved[0] >= -contacts["dist"]
    first, each = left.argmax(axis=0), np.arange(len(contacts))
    way = rose[first, each] - rose[np.maximum(first - 1, 0), each]
    return np.where(left.any(axis=0) & (first > 0), way / (run.spacing or 1.0), 0.0)


def _jammed(
    run: Recording, starts: list[Contact], at_rest: Mapping[int, Contact]
) -> dict[int, Contact]:
    """Return pairs of one tree that overlap throughout because joints keep the geoms there."""
    jammed: dict[int, Contact] = {}
    for start in starts:
        at, geoms = at_rest.get(start.pair), run.model.contact_pair(start.pair).geoms
        one = len(set(run.roots[run.model.geom_body[list(geoms)]].tolist())) == 1
        if at is not None and one and min(start.depth, at.depth) > DEEP * run.thick(start.pair):
            jammed.setdefault(at.pair, at)
    return jammed


def _jam(model: Model, jammed: list[Contact]) -> Finding:
    of, contacts = jammed[0], named(model, "contact", (at.pair for at in jammed))
    problem = (
        f"{_geoms(model, of.pair)} overlap by {metres(of.depth)}{others(contacts[1:], 'pair')}, as "
        f"their joints hold them, and push each other with {newtons(of.force)} all the time"
    )
    cure = _apart(model, of.pair)
    return Finding("overlap", "warning", problem, cure, contacts, of.depth, "m", TEST_CONTACTS)


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
    of, model, contacts = deep[0], run.model, named(run.model, "contact", (s.pair for s in deep))
    share, also = of.depth / run.thick(of.pair), others(contacts[1:], "pair")
    # Thrown further apart than they overlapped: v²/2g > depth.
    thrown = of.speed > (2 * _gravity(model) * of.depth) ** 0.5
    becomes = f" and are thrown apart at {speed(of.speed)}" if thrown else ""
    if not of.movable:
        becomes = " and no joint can move them apart"
    problem = (
        f"{_geoms(model, of.pair)} overlap by {metres(of.depth)} at the start, "
        f"{percent(share)} of the thinner one's half thickness{also},{becomes}".rstrip(",")
    )
    kind, cure = "overlap at the start", _apart(model, of.pair)
    severity = "error" if share > DEEP and (thrown or not of.movable) else "warning"
    yield Finding(kind, severity, problem, cure, contacts, of.depth, "m", TEST_CONTACTS)


def _geoms(model: Model, pair: int) -> str:
    """Return the two geoms of a pair as the subject of a sentence."""
    geoms = model.contact_pair(pair).geoms
    names = [model.geom_names[geom] for geom in geoms]
    if all(names):
        return "geoms " + " and ".join(f"`{name}`" for name in names)
    return " and ".join(model.element_name("geom", geom) for geom in geoms)


def _apart(model: Model, pair: int) -> str:
    """Return the cure for an overlap: other positions, or no contact between the two bodies."""
    bodies = [int(model.geom_body[geom]) for geom in model.contact_pair(pair).geoms]
    tree = [model.root(body) for body in bodies]
    if tree[0] == tree[1] and tree[0]:
        a, b = (model.body_names[body] or "…" for body in bodies)
        exclude = f'<exclude body1="{a}" body2="{b}"/>'
        return f"leave them out with {exclude}, or make the geoms smaller"
    mover = model.element_name("body", bodies[1] if tree[1] else bodies[0])
    return f"move {mover} away by that much in the model or in the keyframe"


# Depths.


def _depths(run: Recording, rest: list[Contact]) -> Iterator[Finding]:
    """Yield how deep contacts rest, with the solref that reduces the depth."""
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
    pairs, solimp = {at.pair for at in deep}, pair_solimp(model, *pair.geoms)
    wanted = LEFT * most(of) if asked is None else asked
    harder = stiffened(model, contacts, pair.solref, solimp, of.depth, wanted)
    # Steep friction pyramids are soft along the normal, too.
    steep = model.settings.cone == "pyramidal" and friction_of(model, of.pair) > 1
    ways = (*(((Cure('cone="elliptic"', Change(cone="elliptic")),),) * steep), harder)
    # A depth that was asked for is reached within a hundredth.
    remedy = Remedy(ways, lambda other: depth_of(other, pairs), (1 + SEEN) * most(of), metres)
    severity = "warning" if of.depth > DEEP * thick else "remark"
    what = "depth at rest", severity, problem, "", contacts, of.depth, "m", TEST_CONTACTS
    yield Finding(*what, remedy=remedy)


def depth_of(run: Recording, pairs: Collection[int]) -> float | None:
    """Return the mean depth of the deepest of some pairs over the end of the run [m].

    None if none is pressed there.
    """
    late = run.part(run.late).contacts
    depths = [late.depth[places].mean() for (of, _), places in late.groups.items() if of in pairs]
    deepest = float(max(depths, default=0.0))
    return deepest if deepest > 0 else None


def _impacts(run: Recording, known: Collection[int]) -> Iterator[Finding]:
    """Yield pairs that an impact or a load pressed deep into each other for a while."""
    model, deepest = run.model, _deepest(run)

    def over(pair: int) -> float:
        return deepest[pair] / (HALF * run.thick(pair))

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
    ways = (tuple(hardest(model, pairs, model.settings.dt / part) for part in PARTS),)

    def pressed(other: Recording) -> float | None:
        """Return how deep the pairs were pressed at most [m]; None if one does not touch."""
        deep = _deepest(other)
        return max(deep[pair] for pair in pairs) if set(pairs) <= set(deep) else None

    remedy = Remedy(ways, pressed, HALF * thick, metres, needed=True)
    what = "depth under load", "remark", problem, "", contacts, depth, "m", TEST_CONTACTS
    yield Finding(*what, remedy=remedy)


def _deepest(run: Recording) -> dict[int, float]:
    """Return how deep each pair was pressed at most [m]."""
    deepest: dict[int, float] = {}
    for (pair, _), places in run.contacts.groups.items():
        most = float(run.contacts.depth[places].max())
        deepest[pair] = max(most, deepest.get(pair, 0.0))
    return deepest


def _with_geoms_of(run: Recording, passed: Collection[int]) -> set[int]:
    """Return the pairs seen that share a geom with a pair."""
    model, seen = run.model, {pair for pair, _ in run.contacts.groups}
    geoms = {geom for pair in passed for geom in model.contact_pair(pair).geoms}
    return {pair for pair in seen if geoms.intersection(model.contact_pair(pair).geoms)}


# Contacts without friction.


def _slides(run: Recording, rest: list[Contact]) -> Iterator[Finding]:
    """Yield contacts that slide because they have no friction, or else stand without it."""
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
    cure = f"{given} on one of the two geoms gives it friction"
    value, unit = (of.speed, "m/s") if fast else (of.force, "N")
    yield Finding("no friction", "remark", problem, cure, contacts, value, unit)


def _carries(run: Recording, at: Contact) -> bool:
    """Return whether a contact carries a tenth of the weight of a free tree."""
    model = run.model
    roots = run.roots[model.geom_body[list(model.contact_pair(at.pair).geoms)]].tolist()
    free = {int(body) for k, body in enumerate(model.jnt_body) if model.jnt_type[k] == "free"}
    masses = [model.body_mass[run.roots == root].sum() for root in roots if root in free]
    weights = [_gravity(model) * float(mass) for mass in masses]
    return roots[0] != roots[1] and any(at.force > DEEP * weight > 0 for weight in weights)
