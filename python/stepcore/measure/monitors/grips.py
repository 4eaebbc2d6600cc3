"""Bodies that slip out of a grip in a run: forces oppose each other, but friction fails."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from stepcore.engine.actuator import actuators
from stepcore.engine.arrays import Floats
from stepcore.engine.coordinates import rotated
from stepcore.experiment.change import Change
from stepcore.experiment.moves import driven_roots
from stepcore.experiment.proposal import Proposal
from stepcore.measure.monitors.creep import IMPRATIO, STICKS
from stepcore.measure.monitors.finding import (
    HALF,
    PARTS,
    Finding,
    Proposals,
    assigned,
    named,
    others,
)
from stepcore.measure.monitors.recording import Recording, free_bodies, friction_of
from stepcore.report.units import rounded, seconds
from stepcore.scene.layout import Layout

# Factors that turn a quaternion into its inverse.
BACK = np.array([1.0, -1.0, -1.0, -1.0])


class Slip(NamedTuple):
    """A body that slipped out of a grip, and fell by more than its size.

    pairs: its contacts in the grip. pressed, held, weight: mean forces on it in the grip [N]: along
    the normals, the friction that these allow, and its weight. The mean is over readings with slip,
    if there are any.
    last, fallen: the last reading in the grip, and the reading at which the body had fallen.
    """

    body: int
    pairs: tuple[int, ...]
    pressed: float
    held: float
    weight: float
    last: int
    fallen: int


def slips(run: Recording) -> Iterator[Slip]:
    """Yield free bodies that left a grip although it did not open, and that fell."""
    model, things = run.model, _things(run)
    if not things or model.is_heap:
        return
    drives = driven_roots(model, actuators(model))
    sticks = STICKS / math.sqrt(2 if model.settings.cone == "pyramidal" else 1)
    for body in things:
        grip = Grip(run, body, drives)
        at = grip.fallen()
        if at is None:
            continue
        seen, places = grip.seen, grip.places
        slid = places[seen.share[places] >= sticks]
        some = slid if len(slid) else places
        force, count = seen.force[some], 1 + int(np.ptp(seen.reading[some]))
        friction = np.array([friction_of(model, pair) for pair in seen.pair[some].tolist()])
        weight = run.weight(body)
        pairs = tuple(dict.fromkeys(seen.pair[places].tolist()))
        pressed, held = float(force.sum()) / count, float(force @ friction) / count
        yield Slip(body, pairs, pressed, held, weight, int(grip.readings[-1]), at)


def _things(run: Recording) -> list[int]:
    """Return the free bodies that nothing drives and no connection holds, if there is gravity."""
    model, scene = run.model, run.model.scene
    if not (run.gravity and model.npair):
        return []
    index, tied = Layout(scene).index, set[int]()
    for equality in scene.equalities:
        if equality.active and equality.type in ("connect", "weld"):
            tied |= {int(run.roots[index[id(body)]]) for body in equality.bodies}
    return sorted(free_bodies(model) - driven_roots(model, actuators(model)) - tied)


class Grip:
    """The readings at which machines hold a body between them, and its motion afterwards.

    A body is in a grip if only machines touch it, and if most of the forces along the normals
    cancel. On a tray or in a cup, these forces carry the body instead.

    readings: in the grip. places: indices of the contacts there, in the `Contacts` of the run.
    """

    def __init__(self, run: Recording, body: int, driven: set[int]) -> None:
        self.run, self.body, self.seen = run, body, run.contacts
        model, seen = run.model, run.contacts
        trees = run.roots[model.geom_body[seen.geoms]]
        mine = np.flatnonzero((trees == body).any(axis=1) & (trees[:, 0] != trees[:, 1]))
        second = trees[mine, 1] == body
        self.hand = model.geom_body[seen.geoms[mine, np.where(second, 0, 1)]]
        self.push = np.where(second, 1.0, -1.0)[:, None] * seen.normal[mine]
        force, reading = seen.force[mine], seen.reading[mine]
        movers = {int(run.roots[k]) for k in model.jnt_body} - free_bodies(model) | driven
        movers |= {k for k, of in enumerate(Layout(model.scene).bodies) if of.mocap}
        held = ~np.isin(run.roots[self.hand], list(movers))
        pressed, besides = (np.bincount(reading, w, len(run)) for w in (force, held))
        net = [np.bincount(reading, force * way, len(run)) for way in self.push.T]
        grips = (pressed > 0) & (besides == 0) & (np.linalg.norm(net, axis=0) < HALF * pressed)
        self.readings, some = np.flatnonzero(grips), grips[reading]
        self.places, self.hand, self.push = mine[some], self.hand[some], self.push[some]

    def fallen(self) -> int | None:
        """Return the reading at which the body has slipped and fallen by its size, or None.

        A grip that opens drops its body on purpose, and does not count.
        """
        run, readings = self.run, self.readings
        if not len(readings):
            return None
        first, last, size = int(readings[0]), int(readings[-1]), run.sizes.bodies[self.body]
        height = run.height(self.body)
        # A body that falls into a hand and past it was never held.
        if height[0] - height[first] >= size:
            return None
        place = self._in_hand(run.centre_of_mass(self.body))
        way = float(np.linalg.norm(place[last] - place[first]))
        fell = np.flatnonzero(way + height[last] - height[last + 1 :] > size)
        if not len(fell):
            return None
        return None if self._opens(last, size) else last + 1 + int(fell[0])

    @functools.cached_property
    def _palm(self) -> int:
        """The nearest body that carries all bodies that touched the body in the grip."""
        parents, common = self.run.model.body_parent, list[int]()
        for hand in np.unique(self.hand).tolist():
            line = [hand]
            while line[-1]:
                line.append(int(parents[line[-1]]))
            common = [one for one in common if one in line] if common else line
        return common[0]

    def _in_hand(self, points: Floats) -> Floats:
        """Return points in the frame of the palm, (n, 3)."""
        quat = self.run["xquat"][:, self._palm] * BACK
        return rotated(quat, points - self.run["xpos"][:, self._palm])

    def _opens(self, last: int, size: float) -> bool:
        """Return whether the hand moves away from the body while the body falls by its size.

        It does if the last forces on the body would do negative work, in the frame of the palm.
        """
        run, seen, work = self.run, self.seen, 0.0
        time = math.sqrt(2 * size / run.gravity)
        end = min(last + math.ceil(time / run.spacing), len(run) - 1)
        back = run["xquat"][last, self._palm] * BACK
        for k in np.flatnonzero(seen.reading[self.places] == last).tolist():
            place, hand = self.places[k], self.hand[k]
            arm = seen.position[place] - run["xpos"][last, hand]
            arm = rotated(run["xquat"][last, hand] * BACK, arm)
            way = self._in_hand(run["xpos"][:, hand] + rotated(run["xquat"][:, hand], arm))
            work += float(seen.force[place] * rotated(back, self.push[k]) @ (way[end] - way[last]))
        return work < 0


def grip_findings(run: Recording) -> Iterator[Finding]:
    """Yield a finding on bodies that slip out of a grip."""
    found = sorted(slips(run), key=lambda slip: slip.last)
    if not found:
        return
    model, first = run.model, found[0]
    bodies = named(model, "body", [slip.body for slip in found])
    contacts = named(model, "contact", [pair for slip in found for pair in slip.pairs])
    friction = max(friction_of(model, pair) for pair in first.pairs)
    problem = (
        f"{bodies[0].name}{others(bodies[1:], 'body')} slips out of its grip by "
        f"{seconds(float(run.times[first.last]))}: {first.pressed:.3g} N press on it in all, with "
        f"which friction {friction:.3g} carries {first.held:.3g} N at most, and it weighs "
        f"{first.weight:.3g} N"
    ) + ", which the grip would carry at rest" * (first.held >= first.weight)

    def left(other: Recording) -> float:
        """Return how many have left the grip by the time of their recorded fall, or slip."""
        lost = {slip.body for slip in slips(other)}
        driven = driven_roots(model, actuators(model))
        for slip in found:
            times, end = other.times[Grip(other, slip.body, driven).readings], run.times
            kept = (times >= end[slip.last] - other.spacing) & (times <= end[slip.fallen])
            lost |= set() if kept.any() else {slip.body}
        return float(len(lost & {slip.body for slip in found}))

    ways = [*_harder(run), *_rougher(run, found, friction)]
    now = float(len(found))

    def say(count: float) -> str:
        return f"{count:g} that slip" if count else "it in the grip"

    proposals = Proposals(tuple(ways), left, 0.0, say, most=2, now=now, compared=True)
    elements = (*bodies, *contacts)
    yield Finding(
        "slip",
        "warning",
        problem,
        "a stronger grip",
        elements,
        first.held,
        "N",
        proposals=proposals,
    )


def _harder(run: Recording) -> Iterator[tuple[Proposal, ...]]:
    """Yield elliptic cones and a larger impratio, each alone and then both."""
    settings = run.model.settings
    if settings.law != "solref":
        return
    elliptic = Change(cone="elliptic")
    if settings.cone == "pyramidal":
        yield (Proposal('cone="elliptic"', elliptic),)
    larger = [value for part in (10, 100) if (value := part * settings.impratio) <= IMPRATIO]
    alone = [Proposal(f'impratio="{value:g}"', Change(impratio=value)) for value in larger]
    yield tuple(alone)
    if settings.cone == "pyramidal":
        words = 'cone="elliptic" with '
        yield tuple(Proposal(words + one.words, elliptic.also(one.change)) for one in alone)


def _rougher(run: Recording, found: list[Slip], friction: float) -> Iterator[tuple[Proposal, ...]]:
    """Yield larger frictions of the bodies that slip, if they have any friction."""
    model, fixes = run.model, list[Proposal]()
    contacts = named(model, "contact", [pair for slip in found for pair in slip.pairs])
    more = max(1.0, found[0].weight / found[0].held) if found[0].held else 0.0
    for part in PARTS if more else ():
        values, new = dict[str, Any](), rounded(2 * part * friction * more, up=True)
        for contact in contacts:
            fields = {of.name: of.value for of in contact.fields(model)}
            row = (new, *fields["friction"][1:])
            values |= assigned(model, [contact], {"friction": row})
        fixes.append(Proposal(f"a friction of {new:g} on both geoms", Change(values)))
    yield tuple(fixes)
