"""Findings on contacts: overlaps at the start, creep, depth at rest, sliding without friction."""

from __future__ import annotations

import math
from collections.abc import Iterator

from stepcore.engine.model import Model
from stepcore.experiment.sizes import Sizes
from stepcore.experiment.watch import Watch
from stepcore.experiment.watch.contacts import Creep, Overlap, Resting
from stepcore.measure.findings.finding import Finding, others
from stepcore.measure.findings.softness import advised
from stepcore.report.units import metres, newtons, percent, speed
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout

# Of the thickness of the thinner geom: creep in a second, a depth at rest, an overlap at the start.
CREEP, DEEP, OVERLAP = 0.01, 0.1, 0.01
# Geoms that joints hold in each other overlap by this at the start and at the end.
JAMMED = 0.2
# Sliding without friction, in a second.
SLIDES = 0.1
# An overlap at the start that is at most this many times as deep at rest is how the scene rests.
RESTS = 3.0
# What a cure leaves, as a part of what is worth saying.
LEFT = 0.1
# A larger impratio is not advised: the rows are then too unequal to be solved.
IMPRATIO = 1e4


def about_contacts(
    model: Model, watch: Watch, sizes: Sizes, depth: float | None
) -> Iterator[Finding]:
    """All findings on the contacts of a run; depth: see `findings_of`."""
    resting = list(watch.contacts.resting())
    jammed = _jammed(model, watch.contacts.starts, resting, sizes)
    if jammed:
        yield _jam(model, jammed, sizes)
    resting = [one for one in resting if one.pair not in _of(jammed)]
    starts = [one for one in watch.contacts.starts if one.pair not in _of(jammed)]
    yield from _overlaps(model, starts, resting, sizes)
    yield from _creeps(model, watch, sizes)
    yield from _depths(model, resting, sizes, depth)
    yield from _slides(model, watch, sizes)


def _of(jammed: list[Resting]) -> set[int]:
    return {one.pair for one in jammed}


def _jammed(
    model: Model, starts: list[Overlap], resting: list[Resting], sizes: Sizes
) -> list[Resting]:
    """Pairs of one tree that overlap from the start to the end: their joints hold them there."""
    rest = {one.pair: one for one in resting}
    found: dict[int, Resting] = {}
    for start in starts:
        one, geoms = rest.get(start.pair), model.contact_pair(start.pair).geoms
        roots = {model.root(int(model.geom_body[g])) for g in geoms}
        deep = JAMMED * sizes.contact(*geoms)
        if one is not None and len(roots) == 1 and min(start.depth, one.depth) > deep:
            found.setdefault(one.pair, one)
    return list(found.values())


def _jam(model: Model, jammed: list[Resting], sizes: Sizes) -> Finding:
    worst = jammed[0]
    names = [model.element_name("contact", one.pair) for one in jammed]
    overlap = Overlap(worst.pair, worst.depth)
    return Finding(
        "overlap",
        "warning",
        names[0],
        f"{_pair(names[0])} overlap by {metres(worst.depth)}{others(names, 'pairs')}, as their "
        f"joints hold them, and push each other with {newtons(worst.force)} all the time: "
        f"{_apart(model, overlap)}.",
        worst.depth,
        "m",
    )


def _overlaps(
    model: Model, starts: list[Overlap], resting: list[Resting], sizes: Sizes
) -> Iterator[Finding]:
    """Pairs that overlap at the start, and not because they rest like that."""
    rest: dict[int, float] = {}
    for one in resting:
        rest[one.pair] = max(rest.get(one.pair, 0.0), one.depth)
    deep: dict[int, Overlap] = {}
    for start in starts:
        notable = OVERLAP * sizes.contact(*model.contact_pair(start.pair).geoms)
        known = RESTS * rest.get(start.pair, 0.0)
        if start.depth > (max(notable, known) if start.movable else LEFT * notable):
            deep.setdefault(start.pair, start)
    if not deep:
        return
    names = [model.element_name("contact", pair) for pair in deep]
    worst = next(iter(deep.values()))
    share = worst.depth / sizes.contact(*model.contact_pair(worst.pair).geoms)
    becomes = "and are thrown apart" if worst.movable else "and no joint can move them apart"
    yield Finding(
        "overlap at the start",
        "error" if share > OVERLAP * 10 else "warning",
        names[0],
        f"{_pair(names[0])} overlap by {metres(worst.depth)} at the start, {percent(share)} of the "
        f"thinner one's half thickness{others(names, 'pairs')}, {becomes}: "
        f"{_apart(model, worst)}.",
        worst.depth,
        "m",
    )


def _pair(contact: str) -> str:
    """ "contact `a`/`b`" as the beginning of a sentence on the two geoms."""
    return "Geoms " + contact.removeprefix("contact ").replace("/", " and ", 1)


def _apart(model: Model, overlap: Overlap) -> str:
    """How two geoms come apart: other positions, or no contact between the two bodies."""
    bodies = [int(model.geom_body[g]) for g in model.contact_pair(overlap.pair).geoms]
    tree = [model.root(b) for b in bodies]
    if tree[0] == tree[1] and tree[0]:
        a, b = (model.body_names[body] or "…" for body in bodies)
        return f'leave them out with <exclude body1="{a}" body2="{b}"/>, or make the geoms smaller'
    mover = model.element_name("body", bodies[1] if tree[1] else bodies[0])
    return f"move {mover} away by that much in the model or in the keyframe"


def _creeps(model: Model, watch: Watch, sizes: Sizes) -> Iterator[Finding]:
    """Contacts that move although their friction holds."""
    if model.settings.law != "solref":
        return
    notable: list[tuple[float, Creep]] = []
    for one in watch.contacts.creeps(watch.times):
        ratio = one.speed / (CREEP * sizes.contact(*model.contact_pair(one.pair).geoms))
        if ratio > 1:
            notable.append((ratio, one))
    if not notable:
        return
    notable.sort(key=lambda pair: -pair[0])
    ratio, worst = notable[0]
    names = [model.element_name("contact", one.pair) for _, one in notable]
    settings = model.settings
    impratio = _round_up(settings.impratio * ratio / LEFT)
    if settings.stiction:
        return
    rigid = (
        'stiction=True or law="rigid" (with solver pgs and integrator semi-implicit) leaves none'
    )
    if impratio <= IMPRATIO:
        less = speed(worst.speed * settings.impratio / impratio)
        cure = f'cone="elliptic" with impratio="{impratio:g}" leaves {less} or less, and {rigid}'
    else:
        cure = rigid
    yield Finding(
        "creep",
        "warning",
        names[0],
        f"{_capital(names[0])}{others(names, 'contacts')} creeps at {speed(worst.speed)} although "
        f"its friction holds ({percent(worst.share)} of what it could be): {cure}.",
        worst.speed,
        "m/s",
    )


def _round_up(value: float) -> float:
    """1, 2 or 5 times a power of ten, not below the value."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(power * step for step in (1, 2, 5, 10) if power * step >= value * (1 - 1e-9))


def _depths(
    model: Model, resting: list[Resting], sizes: Sizes, asked: float | None
) -> Iterator[Finding]:
    """How deep contacts rest, and the solref that makes it less."""
    if model.settings.law != "solref":
        return
    notable = []
    for one in resting:
        thick = sizes.contact(*model.contact_pair(one.pair).geoms)
        ratio = one.depth / (DEEP * thick)
        if ratio > 1 or (asked is not None and one.depth > asked):
            notable.append((ratio, thick, one))
    if not notable:
        return
    notable.sort(key=lambda some: -some[2].depth if asked is not None else -some[0])
    ratio, thick, worst = notable[0]
    names = [model.element_name("contact", one.pair) for _, _, one in notable]
    wanted = asked if asked is not None else LEFT * DEEP * thick
    solref = model.contact_pair(worst.pair).solref
    solimp = pair_solimp(model, *model.contact_pair(worst.pair).geoms)
    cure = advised("", solref, solimp, worst.depth, wanted, model.settings)
    yield Finding(
        "depth at rest",
        "warning" if ratio > 1 else "remark",
        names[0],
        f"{_capital(names[0])}{others(names, 'contacts')} rests {metres(worst.depth)} deep, "
        f"{percent(worst.depth / thick)} of the thinner geom's half thickness, under "
        f'solref="{solref[0]:g} {solref[1]:g}": {cure}.',
        worst.depth,
        "m",
    )


def pair_solimp(model: Model, geom1: int, geom2: int) -> Vec:
    """The solimp that two geoms have together: of the higher priority, or mixed by solmix."""
    geoms = Layout(model.scene).geoms
    a, b = geoms[geom1], geoms[geom2]
    if a.priority != b.priority:
        return a.solimp if a.priority > b.priority else b.solimp
    total = a.solmix + b.solmix
    share = a.solmix / total if total > 0 else 0.5
    return tuple(share * x + (1 - share) * y for x, y in zip(a.solimp, b.solimp, strict=True))


def _slides(model: Model, watch: Watch, sizes: Sizes) -> Iterator[Finding]:
    """Contacts that have no friction, and slide."""
    some = [
        (one.speed, one)
        for one in watch.contacts.slides()
        if one.speed > SLIDES * sizes.contact(*model.contact_pair(one.pair).geoms)
    ]
    if not some:
        return
    some.sort(key=lambda pair: -pair[0])
    worst = some[0][1]
    names = [model.element_name("contact", one.pair) for _, one in some]
    condim = model.contact_pair(worst.pair).condim
    cure = 'condim="3"' if condim == 1 else 'friction="0.8"'
    why = "condim is 1" if condim == 1 else "its friction is 0"
    yield Finding(
        "no friction",
        "remark",
        names[0],
        f"{_capital(names[0])}{others(names, 'contacts')} slides at {speed(worst.speed)} without "
        f"friction, because {why}: {cure} on one of the two geoms gives it friction.",
        worst.speed,
        "m/s",
    )


def _capital(name: str) -> str:
    return name[:1].upper() + name[1:]
