"""Things that slip out of a grip in a run, because friction at its bound does not carry them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from stepcore.engine.actuator import actuators
from stepcore.engine.arrays import Floats
from stepcore.experiment.change import Change
from stepcore.experiment.moves import roots
from stepcore.measure.monitors.creep import STICKS
from stepcore.measure.monitors.finding import (
    HALF,
    PARTS,
    Cure,
    Finding,
    Remedy,
    assigned,
    named,
    others,
)
from stepcore.measure.monitors.recording import Recording, free_bodies, friction_of
from stepcore.report.units import rounded, seconds


class Slip(NamedTuple):
    """A body that slipped out of a grip, and fell by more than its size.

    pairs: its contacts with what gripped it. pressed, held, weight: the forces on it while it
    slipped, on average: along the normals, the friction that these allow, and its weight [N].
    time: at which nothing gripped it any more [s].
    """

    body: int
    pairs: tuple[int, ...]
    pressed: float
    held: float
    weight: float
    time: float


def slips(run: Recording) -> Iterator[Slip]:
    """Yield free bodies that only driven bodies touched, with friction at its bound, and that fell.

    What is gripped slides for most of the time until it falls.
    """
    model, driven = run.model, roots(run.model, actuators(run.model))
    gravity = float(np.linalg.norm(model.scene.gravity)) * model.scene.features.gravity
    things = sorted(free_bodies(model) - driven) if driven and gravity and model.npair else []
    if not things or model.is_heap:
        return
    seen, trees = run.contacts, run.roots[model.geom_body[model.pair_geoms]][run.contacts.pair]
    sticks = STICKS / math.sqrt(2 if model.settings.cone == "pyramidal" else 1)
    for body in things:
        mine = (trees == body).any(axis=1)
        grips = mine & np.isin(trees, [body, *driven]).all(axis=1)
        touched, gripped, slid = (
            np.bincount(seen.reading[some], minlength=len(run))
            for some in (mine, grips, grips & (seen.share >= sticks))
        )
        slipping = np.flatnonzero((slid > 0) & (slid == touched))
        height = _height(run, body)
        # A grip that held for long is another matter: see `creep`.
        if len(slipping) <= HALF * np.count_nonzero(gripped) or gripped[slipping[-1] + 1 :].any():
            continue
        # Nor has a grip what falls past a robot.
        fell, before = height[slipping[0]] - height[-1], height[0] - height[slipping[0]]
        if not before < run.sizes.bodies[body] < fell:
            continue
        at = grips & np.isin(seen.reading, slipping)
        force = seen.force[at] / (slipping[-1] - slipping[0] + 1)
        friction = np.array([friction_of(model, pair) for pair in seen.pair[at].tolist()])
        weight = gravity * float(model.body_mass[run.roots == body].sum())
        pairs = tuple(dict.fromkeys(seen.pair[at].tolist()))
        time = float(run.times[slipping[-1]])
        yield Slip(body, pairs, float(force.sum()), float(force @ friction), weight, time)


def _height(run: Recording, body: int) -> Floats:
    """Return the height of a tree's centre of mass against gravity [m], (n,)."""
    gravity = np.asarray(run.model.scene.gravity, float)
    height: Floats = -run.centre_of_mass(body) @ gravity / np.linalg.norm(gravity)
    return height


def grip_findings(run: Recording) -> Iterator[Finding]:
    """Yield a finding on what slips out of a grip."""
    found = sorted(slips(run), key=lambda slip: slip.time)
    if not found:
        return
    model, first = run.model, found[0]
    bodies = named(model, "body", [slip.body for slip in found])
    contacts = named(model, "contact", [pair for slip in found for pair in slip.pairs])
    friction = max(friction_of(model, pair) for pair in first.pairs)
    problem = (
        f"{bodies[0].name}{others(bodies[1:], 'body')} slips out of its grip by "
        f"{seconds(first.time)}: {first.pressed:.3g} N press on it in all, with which friction "
        f"{friction:.3g} carries {first.held:.3g} N at most, and it weighs {first.weight:.3g} N"
    ) + ", while the motion asks for more" * (first.held >= first.weight)
    ways, more = list[Cure](), max(1.0, first.weight / first.held)
    for part in PARTS:
        values, new = dict[str, Any](), rounded(2 * part * friction * more, up=True)
        for contact in contacts:
            fields = {of.name: of.value for of in contact.fields(model)}
            row = (new, *fields["friction"][1:])
            values |= assigned(model, [contact], {"friction": row})
        ways.append(Cure(f"a friction of {new:g} on both geoms", Change(values)))

    def left(other: Recording) -> float:
        """Return how many still fall, however."""
        heights = {slip.body: _height(other, slip.body) for slip in found}
        sizes = other.sizes.bodies
        return float(sum(h.max() - h[-1] > sizes[body] for body, h in heights.items()))

    remedy = Remedy(
        (tuple(ways),),
        left,
        0.0,
        lambda count: "it in the grip",
        now=float(len(found)),
    )
    elements = (*bodies, *contacts)
    yield Finding(
        "slip", "warning", problem, "a stronger grip", elements, first.held, "N", remedy=remedy
    )
