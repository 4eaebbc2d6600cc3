"""Findings on contacts in a run: initial overlap, resting depth, frictionless sliding."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.coordinates import rotated
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.measure.monitors.finding import Cure, Finding, Next, Remedy, listed, named, others
from stepcore.measure.monitors.recording import FEWEST, STEADY, Recording
from stepcore.measure.monitors.soft_rows import hardest, pair_solimp, stiffened
from stepcore.report.units import metres, newtons, percent, speed

# Thresholds of findings, relative to the thickness of the thinner geom: a depth at rest, an overlap
# at the start, an overlap that joints maintain, frictionless sliding in one second.
DEEP, OVERLAP, JAMMED, SLIDES = 0.1, 0.01, 0.2, 0.1
# An initial overlap up to this many times the resting depth is the scene's resting state.
RESTS = 3.0
# A contact without friction carries a body from this share of its weight.
CARRIES = 0.1
# Two geoms visibly pass into each other from this share of the thinner one's half thickness.
PRESSED = 0.5
# The share of a threshold that a cure leaves; and within which factor a depth asked for is reached.
LEFT, REACHED = 0.1, 1.05

TEST_CONTACTS = (
    Next("converge", "whether the contacts are solved"),
    Next("run", "energy and overlap over time", ("--plot", "run.png")),
)


class Contact(NamedTuple):
    """The behaviour of one contact of a pair of geoms.

    depth: the overlap at the start, or at rest [m]. force: the normal force at rest [N].
    speed: at which it slides, or at which the geoms left their overlap [m/s].
    movable: whether some joint can separate the geoms. settled: whether it came to rest.
    """

    pair: int
    part: int = 0
    depth: float = 0.0
    force: float = 0.0
    speed: float = 0.0
    movable: bool = True
    settled: bool = True


def contact_findings(
    run: Recording, depth: float | None, passed: Collection[int] = ()
) -> Iterator[Finding]:
    """Yield all findings on contacts.

    depth: the wanted depth of resting contacts [m]. passed: pairs that passed through each other.
    """
    if not run.model.npair:
        return
    starts = overlaps(run)
    if run.failure is not None:
        yield from _overlaps(run, starts, [])
        return
    rest = list(resting(run))
    jammed = _jammed(run, starts, rest)
    if jammed:
        yield _jam(run, list(jammed.values()))
    rest = [at for at in rest if at.pair not in jammed]
    yield from _overlaps(run, [at for at in starts if at.pair not in jammed], rest)
    if run.model.settings.law == "solref":
        deep = [*rest, *_sunk(run)]
        yield from _depths(run, deep, depth)
        known = {at.pair for at in (*starts, *deep) if at.depth > DEEP * run.thick(at.pair)}
        yield from _impacts(run, known | _with_geoms_of(run, passed))
    yield from _slides(run, rest)


def resting(run: Recording) -> Iterator[Contact]:
    """Yield contacts whose depth is constant to the end of the run."""
    seen = run.contacts
    for (pair, part), late in seen.late():
        depth = seen.depth[late]
        if depth.min() > 0 and np.ptp(depth) < STEADY * depth.mean():
            yield Contact(pair, part, float(depth.mean()), float(seen.force[late].mean()))


def depth_of(run: Recording, pairs: Collection[int]) -> float | None:
    """Return the mean depth of the deepest of some pairs over the end of the run [m].

    None if none is pressed there.
    """
    seen, depths = run.contacts, [0.0]
    for (pair, _), places in seen.groups.items():
        late = places[seen.reading[places] >= run.late]
        if pair in pairs and len(late):
            depths.append(float(seen.depth[late].mean()))
    return max(depths) if max(depths) > 0 else None


def _sunk(run: Recording) -> Iterator[Contact]:
    """Yield contacts that stay deep over the end of the run and have not come to rest."""
    rest = {(at.pair, at.part) for at in resting(run)}
    for key, late in run.contacts.late():
        depth = run.contacts.depth[late]
        if key not in rest and depth.min() > DEEP * run.thick(key[0]):
            yield Contact(*key, float(depth.max()), settled=False)


def _gravity(model: Model) -> float:
    return float(np.linalg.norm(model.scene.gravity)) if model.scene.features.gravity else 0.0


# Overlaps.


def overlaps(run: Recording) -> list[Contact]:
    """Return the overlaps at the start, with the speeds at which they end, deepest first."""
    sim = run.at(0)
    contacts = sim.contacts[sim.contacts["dist"] < 0]
    if not len(contacts):
        return []
    bodies = [run.model.geom_body[contacts[name]] for name in ("geom1", "geom2")]
    movable = []
    for k, contact in enumerate(contacts):
        point = np.zeros((3, run.model.nv))
        for body, sign in zip((bodies[0][k], bodies[1][k]), (-1.0, 1.0), strict=True):
            jacobian, arm = sim.jacobian(int(body)), contact["pos"] - sim.xpos[body]
            point += sign * (jacobian[:3] + np.cross(jacobian[3:].T, arm).T)
        along = np.abs(contact["normal"] @ point).max(initial=0.0)
        # Not rounding, of what moves across the normal.
        movable.append(bool(along > 1e-9 * np.abs(point).max(initial=0.0)))
    speeds = _separation(run, contacts, bodies)
    columns = (contacts["index"].tolist(), (-contacts["dist"]).tolist(), speeds.tolist(), movable)
    found = [
        Contact(pair, depth=depth, speed=left, movable=free)
        for pair, depth, left, free in zip(*columns, strict=True)
    ]
    return sorted(found, key=lambda overlap: -overlap.depth)


def _separation(run: Recording, contacts: np.ndarray, bodies: list[np.ndarray]) -> Floats:
    """Return the speed along the normal at which geoms leave their overlap [m/s], (contacts,).

    The speed is that of the centres of mass of free trees: a leg that straightens moves its foot,
    and does not throw the robot. Only the first time counts: a later one follows another impact.
    """
    model, sim = run.model, run.at(0)
    roots = np.array([model.root(body) for body in range(model.nbody)])
    free = [int(body) for k, body in enumerate(model.jnt_body) if model.jnt_type[k] == "free"]
    moved, rose = np.zeros((2, len(run), len(contacts)))
    xmat = np.array(sim.xmat).reshape(-1, 3, 3)
    for body, sign in zip(bodies, (-1.0, 1.0), strict=True):
        point = np.einsum("cji,cj->ci", xmat[body], contacts["pos"] - sim.xpos[body])
        place = run["xpos"][:, body] + rotated(run["xquat"][:, body], point)
        carried = place.copy()
        for root in set(roots[body]) & set(free):
            carried[:, roots[body] == root] = centre_of_mass(run, int(root))[:, None]
        moved += sign * np.einsum("nci,ci->nc", place, contacts["normal"])
        rose += sign * np.einsum("nci,ci->nc", carried, contacts["normal"])
    left = moved - moved[0] >= -contacts["dist"]
    first, each = left.argmax(axis=0), np.arange(len(contacts))
    way = rose[first, each] - rose[np.maximum(first - 1, 0), each]
    return np.where(left.any(axis=0) & (first > 0), way / (run.spacing or 1.0), 0.0)


def centre_of_mass(run: Recording, root: int) -> Floats:
    """Return the centre of mass of a tree at all readings [m], (n, 3)."""
    model = run.model
    bodies = [body for body in range(1, model.nbody) if model.root(body) == root]
    mass = model.body_mass[bodies]
    each = run["xpos"][:, bodies] + rotated(run["xquat"][:, bodies], model.body_ipos[bodies])
    centre: Floats = np.einsum("nbi,b->ni", each, mass) / max(float(mass.sum()), 1e-300)
    return centre


def _jammed(run: Recording, starts: list[Contact], rest: list[Contact]) -> dict[int, Contact]:
    """Return pairs of one tree that overlap throughout because joints keep the geoms there."""
    at_rest = {at.pair: at for at in rest}
    jammed: dict[int, Contact] = {}
    for start in starts:
        at, geoms = at_rest.get(start.pair), run.model.contact_pair(start.pair).geoms
        roots = {run.model.root(int(run.model.geom_body[g])) for g in geoms}
        deep = JAMMED * run.thick(start.pair)
        if at is not None and len(roots) == 1 and min(start.depth, at.depth) > deep:
            jammed.setdefault(at.pair, at)
    return jammed


def _jam(run: Recording, jammed: list[Contact]) -> Finding:
    worst, contacts = jammed[0], named(run.model, "contact", (at.pair for at in jammed))
    also = others([contact.name for contact in contacts[1:]], "pairs")
    problem = (
        f"{_geoms(run.model, worst.pair)} overlap by {metres(worst.depth)}{also}, as their joints "
        f"hold them, and push each other with {newtons(worst.force)} all the time"
    )
    cure, depth = _apart(run.model, worst.pair), worst.depth
    return Finding("overlap", "warning", problem, cure, contacts, depth, "m", TEST_CONTACTS)


def _overlaps(run: Recording, starts: list[Contact], rest: list[Contact]) -> Iterator[Finding]:
    """Yield pairs that overlap at the start and do not rest at that depth."""
    at_rest: dict[int, float] = {}
    for at in rest:
        at_rest[at.pair] = max(at_rest.get(at.pair, 0.0), at.depth)
    deep: dict[int, Contact] = {}
    for start in starts:
        notable = OVERLAP * run.thick(start.pair)
        known = RESTS * at_rest.get(start.pair, 0.0)
        if start.depth > (max(notable, known) if start.movable else LEFT * notable):
            deep.setdefault(start.pair, start)
    if not deep:
        return
    worst, contacts = next(iter(deep.values())), named(run.model, "contact", deep)
    share = worst.depth / run.thick(worst.pair)
    # Thrown further apart than they overlapped: v²/2g > depth.
    thrown = worst.speed > (2 * _gravity(run.model) * worst.depth) ** 0.5
    becomes = f" and are thrown apart at {speed(worst.speed)}" if thrown else ""
    if not worst.movable:
        becomes = " and no joint can move them apart"
    also = others([contact.name for contact in contacts[1:]], "pairs")
    problem = (
        f"{_geoms(run.model, worst.pair)} overlap by {metres(worst.depth)} at the start, "
        f"{percent(share)} of the thinner one's half thickness{also},{becomes}".rstrip(",")
    )
    kind, depth = "overlap at the start", worst.depth
    severity = "error" if share > OVERLAP * 10 and (thrown or not worst.movable) else "warning"
    cure = _apart(run.model, worst.pair)
    yield Finding(kind, severity, problem, cure, contacts, depth, "m", TEST_CONTACTS)


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


def _depths(run: Recording, rest: list[Contact], asked: float | None) -> Iterator[Finding]:
    """Yield how deep contacts rest, with the solref that reduces the depth."""
    notable = []
    for at in rest:
        thick = run.thick(at.pair)
        ratio = at.depth / (DEEP * thick)
        if ratio > 1 or (asked is not None and at.depth > asked):
            notable.append((ratio, thick, at))
    if not notable:
        return
    notable.sort(key=lambda entry: -entry[2].depth if asked is not None else -entry[0])
    (ratio, thick, worst), model = notable[0], run.model
    contacts = named(run.model, "contact", (at.pair for _, _, at in notable))
    pair = model.contact_pair(worst.pair)
    wanted = asked if asked is not None else LEFT * DEEP * thick
    verb = "rests" if worst.settled else "has not come to rest and stays up to"
    problem = (
        f"{listed(contacts, 'contacts')} {verb} {metres(worst.depth)} deep, "
        f"{percent(worst.depth / thick)} of the thinner geom's half thickness, under "
        f'solref="{pair.solref[0]:g} {pair.solref[1]:g}"'
    )
    pairs, solimp = {at.pair for _, _, at in notable}, pair_solimp(model, *pair.geoms)
    harder = stiffened(model, contacts, pair.solref, solimp, worst.depth, wanted)
    # Steep friction pyramids are soft along the normal, too.
    round_ = (Cure('cone="elliptic"', Change(cone="elliptic")),)
    steep = model.settings.cone == "pyramidal" and run.contacts.friction(worst.pair) > 1
    remedy = Remedy(
        (*((round_,) * steep), harder),
        lambda other: depth_of(other, pairs),
        REACHED * wanted if asked is not None else DEEP * thick,
        metres,
    )
    severity = "warning" if ratio > 1 else "remark"
    finding = Finding("depth at rest", severity, problem, "", contacts, worst.depth, "m")
    yield replace(finding, commands=TEST_CONTACTS, remedy=remedy)


def _impacts(run: Recording, known: Collection[int]) -> Iterator[Finding]:
    """Yield pairs that an impact or a load pressed deep into each other for a while."""
    notable = sorted(
        (
            (depth / (PRESSED * run.thick(pair)), depth, pair)
            for pair, depth in _deepest(run).items()
            if pair not in known and depth > PRESSED * run.thick(pair)
        ),
        reverse=True,
    )
    if not notable:
        return
    model, pairs = run.model, [pair for *_, pair in notable]
    (_, depth, worst), contacts = notable[0], named(run.model, "contact", pairs)
    solref = model.contact_pair(worst).solref
    problem = (
        f"{listed(contacts, 'contacts')} is pressed {metres(depth)} deep, "
        f"{percent(depth / run.thick(worst))} of the thinner geom's half "
        f'thickness, under solref="{solref[0]:g} {solref[1]:g}"'
    )
    ways = (tuple(hardest(model, pairs, model.settings.dt / part) for part in (1, 2, 4)),)
    enough = PRESSED * run.thick(worst)
    remedy = Remedy(ways, lambda other: _pressed(other, pairs), enough, metres, needed=True)
    finding = Finding("depth under load", "remark", problem, "", contacts, depth, "m")
    yield replace(finding, commands=TEST_CONTACTS, remedy=remedy)


def _deepest(run: Recording) -> dict[int, float]:
    """Return how deep each pair was pressed at most [m]."""
    deepest: dict[int, float] = {}
    for (pair, _), places in run.contacts.groups.items():
        most = float(run.contacts.depth[places].max())
        deepest[pair] = max(most, deepest.get(pair, 0.0))
    return deepest


def _pressed(run: Recording, pairs: Collection[int]) -> float | None:
    """Return how deep some pairs were pressed at most [m]; None if one does not touch."""
    deepest = _deepest(run)
    return max(deepest[pair] for pair in pairs) if set(pairs) <= set(deepest) else None


def _with_geoms_of(run: Recording, passed: Collection[int]) -> set[int]:
    """Return the pairs seen that share a geom with a pair."""
    model, seen = run.model, {pair for pair, _ in run.contacts.groups}
    geoms = {geom for pair in passed for geom in model.contact_pair(pair).geoms}
    return {pair for pair in seen if geoms.intersection(model.contact_pair(pair).geoms)}


# Contacts without friction.


def _slides(run: Recording, rest: list[Contact]) -> Iterator[Finding]:
    """Yield contacts that slide because they have no friction, or else stand without it."""
    seen, fast = run.contacts, []
    for (pair, part), places in seen.groups.items():
        if seen.friction(pair) > 0 or len(places) < max(FEWEST, 0.2 * len(run)):
            continue
        mean = float(np.linalg.norm(seen.past[places], axis=1).mean())
        if mean > SLIDES * run.thick(pair):
            fast.append(Contact(pair, part, speed=mean))
    model, remark = run.model, "remark"
    if fast:
        fast.sort(key=lambda slide: -slide.speed)
        contacts = named(run.model, "contact", (slide.pair for slide in fast))
        frictionless = model.contact_pair(fast[0].pair).condim == 1
        cure = 'condim="3"' if frictionless else 'friction="0.8"'
        problem = (
            f"{listed(contacts, 'contacts')} slides at {speed(fast[0].speed)} without friction, "
            f"because {'condim is 1' if frictionless else 'its friction is 0'}"
        )
        cure = f"{cure} on one of the two geoms gives it friction"
        yield Finding("no friction", remark, problem, cure, contacts, fast[0].speed, "m/s")
        return
    free = {int(body) for k, body in enumerate(model.jnt_body) if model.jnt_type[k] == "free"}
    without = [at for at in rest if seen.friction(at.pair) == 0 and _carries(model, at, free)]
    carrying = sorted(without, key=lambda at: -at.force)
    if carrying:
        frictionless = model.contact_pair(carrying[0].pair).condim == 1
        force, contacts = (
            carrying[0].force,
            named(model, "contact", (at.pair for at in carrying)),
        )
        problem = (
            f"{listed(contacts, 'contacts')} carries {newtons(force)} without friction, because "
            f"{'condim is 1' if frictionless else 'its friction is 0'}, so a slight push lets the "
            "body slide or topple"
        )
        cure = 'condim="3" on one of the two geoms gives it friction'
        yield Finding("no friction", remark, problem, cure, contacts, force, "N")


def _carries(model: Model, at: Contact, free: set[int]) -> bool:
    """Return whether a contact carries a tenth of the weight of a free tree."""
    roots = [model.root(int(model.geom_body[geom])) for geom in model.contact_pair(at.pair).geoms]
    weights = [
        _gravity(model) * sum(m for k, m in enumerate(model.body_mass) if model.root(k) == root)
        for root in roots
        if root in free
    ]
    return roots[0] != roots[1] and any(at.force > CARRIES * weight > 0 for weight in weights)
