"""Findings on connections that gape and on limits that a force pushes beyond."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from stepcore.engine.model import Model
from stepcore.experiment.sizes import Sizes
from stepcore.experiment.watch import Watch
from stepcore.experiment.watch.joints import Beyond, Gape
from stepcore.measure.findings.finding import NAMES, Finding, others
from stepcore.measure.findings.softness import advised
from stepcore.report.units import FORCES, metres, percent, quantity, radians
from stepcore.scene.layout import Layout

# A gap, of the size of the smaller body; how far beyond a limit, of the range.
GAPES, BEYOND = 0.01, 0.05
# What a cure leaves of these.
LEFT = 0.1
# A force that is this part of the limit's own is what the limit cannot bear.
OVERPOWERS = 0.5
# Where the range is wider, it says nothing of how exact a limit should be [rad].
WIDEST = 3.0

# What only resists motion.
RESISTS = ("damper", "friction loss")

TORQUES = tuple((f"{unit}·m", size) for unit, size in FORCES)


def about_joints(model: Model, watch: Watch, sizes: Sizes) -> Iterator[Finding]:
    """All findings on the connections and limits of a run."""
    if model.settings.law == "solref":
        yield from _gapes(model, watch, sizes)
    yield from _limits(model, watch)


def _gapes(model: Model, watch: Watch, sizes: Sizes) -> Iterator[Finding]:
    layout = Layout(model.scene)
    notable: list[tuple[float, Gape, float]] = []
    for one in watch.joints.gapes():
        equality = model.scene.equalities[one.equality]
        bodies = [layout.index[id(body)] for body in equality.bodies]
        # The world has no size of its own to compare with.
        size = min((sizes.bodies[body] for body in bodies if body), default=sizes.bodies[0])
        if one.most > GAPES * size:
            notable.append((one.most / size, one, size))
    if not notable:
        return
    notable.sort(key=lambda some: -some[0])
    _, worst, size = notable[0]
    names = [_name(model, one.equality) for _, one, _ in notable]
    equality = model.scene.equalities[worst.equality]
    now = worst.most if worst.rest is None else worst.rest
    where = f"up to {metres(now)}" if worst.rest is None else metres(now)
    wanted = min(LEFT * GAPES * size, now * LEFT)
    cure = advised("", equality.solref, equality.solimp, now, wanted, model.settings)
    yield Finding(
        "gap",
        "warning",
        names[0],
        f"{_capital(names[0])}{others(names, 'connections')} gapes by {where}, "
        f"{percent(now / size)} of the smaller body's size, under its "
        f'solref="{equality.solref[0]:g} {equality.solref[1]:g}": {cure}.',
        now,
        "m",
    )


def _name(model: Model, equality: int) -> str:
    return model.element_name(model.scene.equalities[equality].row_kind, equality)


def _limits(model: Model, watch: Watch) -> Iterator[Finding]:
    """Limits that a force pushes beyond: the worst with its cure, the others by name."""
    beyond: list[tuple[float, Beyond, float, bool]] = []
    for one in watch.joints.overshoots():
        low, high = (float(bound) for bound in model.jnt_range[one.joint])
        angular = model.jnt_type[one.joint] != "slide"
        width = min(high - low, WIDEST) if angular else high - low
        # What is outwards of friction and damping holds back a joint that returns.
        pushing = tuple(
            some for some in one.forces if some[0][0] not in ("damper", "friction loss")
        )
        one = replace(one, forces=pushing)
        overpowers = pushing and pushing[0][1] > OVERPOWERS * one.limit
        if one.kept <= BEYOND * width or not overpowers:
            continue
        beyond.append((one.kept / width, one, width, angular))
    if not beyond:
        return
    (_, one, width, angular), *rest = sorted(beyond, key=lambda some: -some[0])
    finding = _overpowered(model, one, width, angular)
    if rest:
        names = [
            f"{model.element_name('joint', one.joint)} by "
            f"{(radians if angular else metres)(one.kept)}"
            for _, one, _, angular in rest
        ]
        more = f" and {len(names) - NAMES} more" if len(names) > NAMES else ""
        also = f" Also beyond: {', '.join(names[:NAMES])}{more}."
        finding = replace(finding, text=finding.text + also)
    yield finding


def _overpowered(model: Model, one: Beyond, width: float, angular: bool) -> Finding:
    """A limit that a force pushes beyond, and the knobs: the force's or the limit's."""
    (kind, index), force = one.forces[0]
    joint = Layout(model.scene).joints[one.joint]
    limit = model.element_name("limit", one.joint)
    length = radians if angular else metres
    strength = quantity(force, TORQUES if angular else FORCES)
    wanted = LEFT * BEYOND * width
    solref, solimp = joint.solreflimit, joint.solimplimit
    cure = ""
    if model.settings.law == "solref":
        text = length(wanted)
        cure = advised("limit", solref, solimp, one.kept, wanted, model.settings, text)
    name = _pusher(model, kind, index)
    if kind == "actuator":
        own = "ctrlrange" if model.actuator_bias[index, 1] >= 0 else "forcerange or ctrlrange"
        cure = f"a smaller {own} of {name}" + (f", or {cure}" if cure else "")
    yet = "" if one.rest is None else ", and stays there"
    return Finding(
        "limit",
        "warning",
        limit,
        f"{_capital(name)} pushes {limit.removeprefix('limit of ')} {length(one.kept)} beyond its "
        f"range with {strength}{yet}: {cure or 'less of that force'}.",
        one.kept,
        "rad" if angular else "m",
    )


def _pusher(model: Model, kind: str, index: int) -> str:
    return "gravity" if kind == "gravity" else model.element_name(kind, index)


def _capital(name: str) -> str:
    return name[:1].upper() + name[1:]
