"""Creep in a run: contacts that slip and joints that drift, because soft friction is a damper.

Under a load below the limit of friction, a soft contact slips at a steady speed. The motion of the
body itself is not creep: surfaces that roll, sway or spin on each other turn faster than they slip.

A row of friction loss has R f = b v at rest, with b = 2/(dmax tc) and R = (1 − d)/d · Â of its
solreffriction and solimpfriction (MuJoCo's documentation, "Constraint model"): below its limit it
is a damper, and moves at v = f R/b under a load f.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from stepcore.engine.actuator import actuators
from stepcore.engine.arrays import Floats
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.measure.monitors.cures import assigned
from stepcore.measure.monitors.finding import (
    FEW,
    HALF,
    LEFT,
    SEEN,
    Cure,
    Finding,
    Remedy,
    listed,
    named,
    worst,
)
from stepcore.measure.monitors.recording import FEWEST, Recording, friction_of
from stepcore.measure.monitors.soft_rows import impedance
from stepcore.report.units import (
    FORCES,
    TORQUES,
    percent,
    quantity,
    radians,
    round_number,
    speed,
)
from stepcore.scene.elements import Joint
from stepcore.scene.layout import Layout

# Length of the window in which a slip is steady, in time constants: what it began with has decayed.
WINDOW = 10.0
# Largest impratio that is advised: beyond it, the rows differ too much in scale to be solved. Go2
# needs all of it.
IMPRATIO = 1e4
# A contact sticks, and a friction loss holds, below this share of its friction. A pyramidal cone
# allows all of that along its tangents, and 1/√2 of it between them.
STICKS = 0.99
# Slowest creep of a joint that is told [rad/s]; for slides, relative to the body's size [1/s].
# People ask about arms that drift at 1.5 mrad/s (MuJoCo's issue 2082, frictionloss.xml), and a
# tenth of a degree in a second is seen within a minute.
CREEPS = 1e-3
# Impedances that are advised, softest first: the creep falls as (1 − d)/d. frictionloss.xml is
# cured by the first, friceq.xml by the last.
IMPEDANCES = ((0.99, 0.999), (0.999, 0.9999), (0.9999, 0.9999))


class Creep(NamedTuple):
    """A contact that slips, or a joint that drifts, although its friction holds it.

    of: the contact's pair, or the joint. speed: the mean [m/s or rad/s]. share: of its friction.
    begin, end: the times between which it was seen [s].
    """

    of: int
    speed: float
    share: float
    begin: float
    end: float


# Returns the velocities of a pair or a joint in a run: readings, and (m, 3) or (m, 1).
Series = Callable[[Recording, int], Iterator[tuple[np.ndarray, Floats]]]


def creep_findings(run: Recording) -> Iterator[Finding]:
    """Yield a finding on contacts that creep, and one on joints that do."""
    settings = run.model.settings
    if settings.law == "solref" and run.spacing:
        if not settings.stiction:
            yield from _contacts(run)
        yield from _joints(run)


def _fastest(
    run: Recording,
    of: int,
    constant: float,
    readings: np.ndarray,
    velocity: Floats,
    share: Floats,
    rolls: Floats,
) -> Creep | None:
    """Return the fastest steady slip of one contact or joint in readings in which friction holds.

    It must be steady over a window of `WINDOW` time constants, or a tenth of the run: the initial
    speed decays within the time constant [s], and under a load a speed remains.

    velocity: (m, k). share: of the friction, (m,). rolls: at which the surfaces turn, (m,) [m/s].
    """
    best: Creep | None = None
    count = math.ceil(max(FEWEST, WINDOW * max(constant, 0.0) / run.spacing, 0.1 * len(run)))
    spells = np.split(np.arange(len(readings)), np.flatnonzero(np.diff(readings) > 1) + 1)
    for spell in spells:
        for first in range(0, len(spell) - count + 1, max(1, count // 2)):
            window = spell[first : first + count]
            drift, used = velocity[window].mean(axis=0), float(share[window].mean())
            mean = float(np.linalg.norm(drift))
            unsteady = np.linalg.norm(velocity[window] - drift, axis=1).max() > HALF * mean
            turns = mean < rolls[window].mean()
            if used >= FEW and not unsteady and not turns and (not best or mean > best.speed):
                begin, end = run.times[readings[window[[0, -1]]]].tolist()
                best = Creep(of, mean, used, begin, end)
    return best


def _left(found: Sequence[Creep], series: Series, run: Recording) -> float | None:
    """Return the largest mean velocity of what crept, each in its time; None if one is not seen."""
    # Contacts are read in these times alone.
    begin, end = min(creep.begin for creep in found), max(creep.end for creep in found)
    first, last = np.searchsorted(run.times, (begin, end * (1 + 1e-9))).tolist()
    run, speeds = run.part(first, last + 1), list[float]()
    for creep in found:
        means = []
        for readings, velocity in series(run, creep.of):
            times = run.times[readings]
            within = (times >= creep.begin) & (times <= creep.end)
            if within.sum() >= FEWEST:
                means.append(float(np.linalg.norm(velocity[within].mean(axis=0))))
        if not means:
            return None
        speeds += means
    return max(speeds)


# Contacts.


def creeps(run: Recording) -> Iterator[Creep]:
    """Yield contacts that should rest and slip steadily for a while although friction holds."""
    seen, held = run.contacts, _held(run)
    for (pair, _), places in seen.groups.items():
        if friction_of(run.model, pair) > 0:
            some, constant = places[held[places]], run.model.contact_pair(pair).solref[0]
            series = seen.reading[some], seen.past[some], seen.share[some], seen.rolls[some]
            if creep := _fastest(run, pair, constant, *series):
                yield creep


def _slips(run: Recording, pair: int) -> Iterator[tuple[np.ndarray, Floats]]:
    for (of, _), places in run.contacts.groups.items():
        if of == pair:
            yield run.contacts.reading[places], run.contacts.past[places]


def _held(run: Recording) -> np.ndarray:
    """Return which contacts stick.

    Between its edges, a pyramid yields at less friction than along an edge: there a contact sticks
    as long as every edge pushes.
    """
    seen = run.contacts
    if run.model.settings.cone != "pyramidal":
        held: np.ndarray = seen.share < STICKS
        return held
    held = seen.share < STICKS / math.sqrt(2)
    unsure = np.flatnonzero(~held & (seen.share < 1))
    for reading in np.unique(seen.reading[unsure]):
        rows = run.at(int(reading)).rows
        rows = rows[rows["kind"] == "contact"]
        for k in unsure[seen.reading[unsure] == reading]:
            mine = (rows["index"] == seen.pair[k]) & (rows["part"] == seen.part[k])
            edges = rows["force"][mine]
            # A force of rounding is none.
            held[k] = edges.min(initial=np.inf) > 1e-6 * edges.max(initial=0.0)
    return held


def _contacts(run: Recording) -> Iterator[Finding]:
    model = run.model

    def over(creep: Creep) -> float:
        return creep.speed / (SEEN * run.thick(creep.of))

    found = worst(creeps(run), over)
    if not found:
        return
    of, elements = found[0], named(model, "contact", [creep.of for creep in found])
    least = round_number(model.settings.impratio * over(of) / LEFT, up=True)
    cures = tuple(
        Cure(
            f'cone="elliptic" with impratio="{impratio:g}"',
            Change(cone="elliptic", impratio=impratio),
        )
        for impratio in (least, 10 * least)
        if impratio <= IMPRATIO
    )
    remedy = Remedy(
        (cures, (Cure("stiction=True", Change(stiction=True)),)),
        functools.partial(_left, found, _slips),
        SEEN * run.thick(of.of),
        # Below a nanometre in a second it is rounding.
        lambda left: speed(left) if left > 1e-9 else "none",
        most=2,
        # A slip that harder friction does not end belongs to the motion.
        needed=True,
    )
    problem = (
        f"{listed(elements, 'contact')} creeps at {speed(of.speed)} although its friction "
        f"holds ({percent(of.share)} of what it could be)"
    )
    yield Finding("creep", "warning", problem, "", elements, of.speed, "m/s", remedy=remedy)


# Joints with friction loss.


def drifts(run: Recording) -> Iterator[Creep]:
    """Yield joints that move steadily under less than their friction loss, at their fastest.

    A joint whose own controls change is meant to move, and one with a servo ends at its target.
    Nothing is told where an actuator drives no single joint.
    """
    model, features = run.model, run.model.scene.features
    changing = np.ptp(run["ctrl"], axis=0) > 0
    moving = [a.index for a in actuators(model) if a.holds or changing[a.index]]
    moved = set(model.actuator_joint[moving].tolist())
    losses = _losses(model) if features.constraint and features.frictionloss else {}
    for joint, of in losses.items():
        if joint in moved or -1 in moved:
            continue
        velocity = run["qvel"][:, [int(model.jnt_dofadr[joint])]]
        share = np.abs(velocity[:, 0]) * _damping(model, joint, of) / of.frictionloss
        held = np.flatnonzero(share < STICKS)
        series = held, velocity[held], share[held], np.zeros(len(held))
        if creep := _fastest(run, joint, of.solreffriction[0], *series):
            yield creep


def _velocities(run: Recording, joint: int) -> Iterator[tuple[np.ndarray, Floats]]:
    yield np.arange(len(run)), run["qvel"][:, [int(run.model.jnt_dofadr[joint])]]


def _losses(model: Model) -> dict[int, Joint]:
    """Return the joints of one dof with friction loss, by index."""
    joints = enumerate(Layout(model.scene).joints)
    return {k: of for k, of in joints if of.frictionloss and of.type in ("hinge", "slide")}


def _damping(model: Model, joint: int, of: Joint) -> float:
    """Return b/R of a joint's row of friction loss [N·m·s/rad or N·s/m]."""
    settings, (constant, ratio) = model.settings, of.solreffriction
    d, most = (impedance(of.solimpfriction, violation) for violation in (0.0, math.inf))
    least = 2 * settings.dt if settings.refsafe else 0.0
    b = 2 / (most * max(constant, least)) if constant > 0 else -ratio / most
    inverse = float(model.dof_invweight0[model.jnt_dofadr[joint]])
    return b * d / ((1 - d) * inverse)


def _joints(run: Recording) -> Iterator[Finding]:
    model = run.model

    def over(drift: Creep) -> float:
        slides = model.jnt_type[drift.of] == "slide"
        size = run.sizes.bodies[int(model.jnt_body[drift.of])] if slides else 1.0
        return drift.speed / (CREEPS * size)

    found = worst(drifts(run), over)
    if not found:
        return
    of, angular = found[0], model.jnt_type[found[0].of] != "slide"
    elements = tuple(Element.of(model, "friction loss", drift.of) for drift in found)
    loss = quantity(_losses(model)[of.of].frictionloss, TORQUES if angular else FORCES)
    constant = float(f"{2 * model.settings.dt:.3g}")

    def rate(value: float) -> str:
        return f"{radians(value)}/s" if angular else speed(value)

    def harder(low: float, high: float) -> Cure:
        solimp = (low, high, 0.001, 0.5, 2.0)
        values = {"solreffriction": (constant, 1.0), "solimpfriction": solimp}
        words = f'solreffriction="{constant:g} 1" with solimpfriction="{low:g} {high:g}"'
        return Cure(words, Change(assigned(model, elements, values)))

    remedy = Remedy(
        (tuple(harder(*ends) for ends in IMPEDANCES),),
        functools.partial(_left, found, _velocities),
        of.speed / over(of),
        rate,
        # A motion that harder friction does not end is no creep.
        needed=True,
    )
    problem = (
        f"{listed(elements, 'friction loss')} lets the joint creep at {rate(of.speed)} "
        f"under {percent(of.share)} of its {loss}"
    )
    unit = "rad/s" if angular else "m/s"
    yield Finding("creep", "warning", problem, "", elements, of.speed, unit, remedy=remedy)
