"""Geoms that pass through others in a run, and leave on the other side.

Contacts keep the centre of a geom outside of every geom that it collides with. A step that moves a
geom by more than its thickness may carry the centre across, and so may a contact that sinks too
deep. In the other geom's frame, the centre then goes from one side of its box to the opposite one,
between two readings or through readings inside; a ray along that path hits the geom.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.experiment.proposal import Proposal
from stepcore.measure.monitors.finding import (
    HALF,
    PARTS,
    Finding,
    Proposals,
    assigned,
    finer,
    named,
    others,
    shorter,
)
from stepcore.measure.monitors.recording import FEWEST, Recording, friction_of
from stepcore.measure.monitors.soft_rows import hardest
from stepcore.report.units import metres, seconds, speed


class Passage(NamedTuple):
    """A geom that passed through another one.

    mover, wall: the geoms. pair: their index. speed: of the mover at arrival [m/s].
    room: half of both thicknesses [m]. time: [s].
    """

    mover: int
    wall: int
    pair: int
    speed: float
    room: float
    time: float


def passages(run: Recording) -> list[Passage]:
    """Return the geoms that passed through others, in order of time; the smaller is the mover."""
    model, features = run.model, run.model.scene.features
    if not (model.npair and features.contact and features.constraint) or model.is_heap:
        return []
    passed = (_passage(run, *near) for near in _near(run))
    return sorted((at for at in passed if at is not None), key=lambda at: at.time)


def _near(run: Recording) -> list[tuple[int, int, int]]:
    """Return the geoms that come near each other: the smaller one, the other, and their pair."""
    model, reach, pair = run.model, np.array(run.sizes.reach), np.arange(run.model.npair)
    first, second = model.pair_geoms.T
    swap = reach[first] > reach[second]
    mover, wall = np.where(swap, second, first), np.where(swap, first, second)
    # No geom leaves a plane below it. Joints keep the geoms of one tree on their sides.
    flat = np.array([kind == "plane" for kind in model.geom_type], bool)
    roots = run.roots[model.geom_body]
    able = np.isfinite(reach[mover]) & ~flat[wall] & (roots[mover] != roots[wall])
    mover, wall, pair = mover[able], wall[able], pair[able]
    centres, nearest = run.geoms[0], np.full(len(pair), np.inf)
    before = centres[0, mover] - centres[0, wall]
    with np.errstate(over="ignore", invalid="ignore"):
        for places in centres[1:]:
            now = places[mover] - places[wall]
            way = np.linalg.norm(now - before, axis=1)
            nearest, before = np.minimum(nearest, np.linalg.norm(now, axis=1) - way), now
    near = nearest < reach[wall]
    return list(zip(*(values[near].tolist() for values in (mover, wall, pair)), strict=True))


def _passage(
    run: Recording, mover: int, wall: int, pair: int, whole: bool = True
) -> Passage | None:
    """Return the passage of a geom through another one; None if there is none.

    Between two readings a geom may go around a wall that is narrower than its path. This part of
    the run is then repeated with readings at every step. whole: whether `run` is no such part.
    """
    centres, turns = run.geoms
    seen = np.einsum("nji,nj->ni", turns[:, wall], centres[:, mover] - centres[:, wall])
    halves = np.array(run.sizes.halves[wall])
    outside = np.flatnonzero((np.abs(seen) > halves).any(axis=1))
    firsts, lasts = outside[:-1], outside[1:]
    # The geom enters by the face that a straight path crosses last.
    ways = seen[firsts + 1] - seen[firsts]
    with np.errstate(divide="ignore", invalid="ignore"):
        faces = np.stack([-halves - seen[firsts], halves - seen[firsts]]) / ways
    enters, leaves = faces.min(axis=0), faces.max(axis=0).min(axis=1)
    axes, each = enters.argmax(axis=1), np.arange(len(firsts))
    entry, sides = enters[each, axes], np.sign(seen[firsts, axes])
    # A path that ends on the same side of the middle has not passed.
    passed = (entry >= 0) & (entry <= np.minimum(leaves, 1.0)) & (sides * seen[lasts, axes] <= 0)
    for k in np.flatnonzero(passed).tolist():
        first, last, axis, side, way = firsts[k], lasts[k], axes[k], sides[k], ways[k]
        # Soft contact slows the geom down, so the speed before counts.
        arrival = -side * np.diff(seen[max(0, first - FEWEST) : first + 2, axis])
        fast, room = float(arrival.max() / run.spacing), run.sizes.thick[mover] + halves[axis]
        if whole and np.linalg.norm(way) > np.delete(halves, axis).min():
            within = _passage(run.between(first, last), mover, wall, pair, whole=False)
            if within is not None:
                return within._replace(speed=max(within.speed, fast))
        elif _hits(run, mover, wall, seen[[first, last]], last):
            time = float(run.times[first + 1])
            return Passage(mover, wall, pair, fast, float(room), time)
    return None


def _hits(run: Recording, mover: int, wall: int, ends: Floats, reading: int) -> bool:
    """Return whether a path, given in the frame of the wall, meets the wall first."""
    turn, origin = run.geoms[1][reading, wall], run.geoms[0][reading, wall]
    start, end = origin + ends @ turn.T
    body = int(run.model.geom_body[mover])
    hit = run.at(reading).ray(start, end - start, exclude=body)
    return int(hit.geom) == wall and bool(hit.distance <= 1)


def tunnelling_findings(run: Recording) -> Iterator[Finding]:
    """Yield a finding on the geoms that passed through others."""
    passed = passages(run)
    run.passed = frozenset(at.mover for at in passed)
    if not passed:
        return
    model, first, dt = run.model, passed[0], run.model.settings.dt
    movers = named(model, "geom", [entry.mover for entry in passed])
    wall, also = model.element_name("geom", first.wall), others(movers[1:], "geom")
    problem = (
        f"{movers[0].name}{also} {'pass' if also else 'passes'} through {wall} at "
        f"{seconds(first.time)}: it arrives at {speed(first.speed)}, "
        f"{metres(first.speed * dt)} in a step, and half of both thicknesses is "
        f"{metres(first.room)}"
    )
    contacts = named(model, "contact", [entry.pair for entry in passed])
    span = float(run.times[-1] - run.times[0])
    # Twice the time until the first passage.
    seen = min(1.0, 2 * (first.time - float(run.times[0])) / span)
    proposals = Proposals(
        tuple(_fixes(model, passed)),
        lambda other: float(len(passages(other))),
        0.0,
        lambda count: f"{count:g} that pass" if count else "none that passes",
        most=2 if _steep(model, first.pair) else 1,
        now=float(len(passed)),
        by=seen,
    )
    elements, value = (*movers, *contacts), first.speed
    yield Finding("tunnelling", "error", problem, "", elements, value, "m/s", proposals=proposals)


def _steep(model: Model, pair: int) -> bool:
    """Return whether the friction pyramid of a pair is soft along the normal."""
    return model.settings.cone == "pyramidal" and friction_of(model, pair) > 1


def _fixes(model: Model, passed: Sequence[Passage]) -> Iterator[tuple[Proposal, ...]]:
    """Yield changes that may stop the passages; those without shorter steps come first."""
    dt, fast = model.settings.dt, max(passed, key=lambda entry: entry.speed / entry.room)
    if any(_steep(model, entry.pair) for entry in passed):
        yield (Proposal('cone="elliptic"', Change(cone="elliptic")),)
        contacts = named(model, "contact", [entry.pair for entry in passed])
        fields = {of.name: of.value for of in contacts[0].fields(model)}
        flat = (1.0, *fields["friction"][1:])
        words = "a friction of 1 on both geoms"
        yield (Proposal(words, Change(assigned(model, contacts, {"friction": flat}))),)
    # A step should move the geom by half of `room` at most.
    most = min(dt / 2, HALF * fast.room / fast.speed)
    steps = list(dict.fromkeys(finer(model.settings, most / part) for part in PARTS))
    # All possible contacts of the geoms, because another wall may be next.
    ids = {entry.mover for entry in passed}
    touching = np.flatnonzero(np.isin(model.pair_geoms, list(ids)).any(axis=1)).tolist()
    yield (hardest(model, touching, dt),)
    yield shorter(steps)
    yield tuple(hardest(model, touching, step) for step in steps)
