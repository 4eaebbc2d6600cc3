"""Creep in a run: contacts that slip and joints that drift, because soft friction is a damper.

Under a load below the limit of friction, a soft contact slips at a steady speed. The motion of the
body itself is not creep: surfaces that roll, sway or spin on each other turn faster than they slip.

A row of friction loss has R f = b v at rest, with b = 2/(dmax tc) and R = (1 − d)/d · Â of its
solreffriction and solimpfriction (MuJoCo's documentation, "Constraint model"): below its limit it
is a damper, and moves at v = f R/b under a load f.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from stepcore.engine.actuator import actuators
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.measure.monitors.contacts import LEFT
from stepcore.measure.monitors.cures import assigned
from stepcore.measure.monitors.finding import Cure, Finding, Remedy, listed, named
from stepcore.measure.monitors.recording import FEWEST, Contacts, Recording
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

# Largest relative deviation from the mean velocity; length of the window in time constants; and
# least load, as a share of the largest friction.
UNSTEADY, WINDOW, RUBS = 0.5, 10.0, 0.05
# Least slip, relative to the speed at which the surfaces turn on each other.
RESTS = 1.0
# Threshold of the slip in one second, relative to the thickness of the thinner geom.
CREEP = 0.01
# Largest impratio that is advised: beyond it, the rows differ too much in scale to be solved.
IMPRATIO = 1e4
# A contact sticks if its friction is below this share of μ × normal force. A pyramidal cone allows
# all of it along its tangents, and 1/√2 of it between them.
STICKS = {"pyramidal": 0.7, "elliptic": 0.99}
# A row of friction loss that gives at least this share of its friction slides.
SLIDES = 0.98
# Slowest creep of a joint that is told [rad/s]; for slides, relative to the body's size [1/s].
# People ask about arms that drift at 1.5 mrad/s (MuJoCo's issue 2082), and a tenth of a degree in
# a second is seen within a minute.
CREEPS = 1e-3
# Impedances that are advised, softest first: the creep falls as (1 − d)/d.
IMPEDANCES = ((0.99, 0.999), (0.999, 0.9999), (0.9999, 0.9999))


@dataclass(frozen=True)
class Creep:
    """A contact that slips, or a joint that drifts, although its friction holds it.

    of: the contact's pair, or the joint. speed: the mean [m/s or rad/s]. share: of its friction.
    begin, end: the times between which it was seen [s].
    """

    of: int
    speed: float
    share: float
    begin: float
    end: float


def creep_findings(run: Recording) -> Iterator[Finding]:
    """Yield a finding on contacts that creep, and one on joints that do."""
    settings = run.model.settings
    if settings.law == "solref" and not settings.stiction and run.spacing:
        yield from _contacts(run)
    if settings.law == "solref" and run.spacing:
        yield from _joints(run)


def _window(run: Recording, constant: float) -> int:
    """Return the readings in which a speed must be steady: `WINDOW` time constants, or a tenth.

    The initial speed decays within the time constant [s], and under a load a speed remains.
    """
    return math.ceil(max(FEWEST, WINDOW * max(constant, 0.0) / run.spacing, 0.1 * len(run)))


# Contacts.


def creeps(run: Recording) -> Iterator[Creep]:
    """Yield contacts that should rest and slip steadily for a while although friction holds.

    Of all windows in which the friction holds, the fastest steady slip counts.
    """
    seen = run.contacts
    held = _held(run)
    for (pair, _), places in seen.groups.items():
        if seen.friction(pair) <= 0:
            continue
        count = _window(run, run.model.contact_pair(pair).solref[0])
        best: Creep | None = None
        for spell in _spells(seen, places[held[places]]):
            for first in range(0, len(spell) - count + 1, max(1, count // 2)):
                creep = _steady(run, pair, spell[first : first + count])
                if creep is not None and (best is None or creep.speed > best.speed):
                    best = creep
        if best is not None:
            yield best


def _held(run: Recording) -> np.ndarray:
    """Return which contacts stick.

    Between its edges, a pyramid yields at less friction than along an edge: there a contact sticks
    as long as every edge pushes.
    """
    seen, settings = run.contacts, run.model.settings
    held: np.ndarray = seen.share < STICKS[settings.cone]
    if settings.cone == "pyramidal":
        frictions = np.array([seen.friction(int(pair)) for pair in seen.pair])
        unsure = np.flatnonzero(~held & (frictions > 0) & (seen.share < 1))
        for reading in np.unique(seen.reading[unsure]):
            rows = run.at(int(reading)).rows
            for k in unsure[seen.reading[unsure] == reading]:
                mine = (rows["index"] == seen.pair[k]) & (rows["part"] == seen.part[k])
                edges = rows["force"][mine & (rows["kind"] == "contact")]
                # A force of rounding is none.
                held[k] = edges.min(initial=np.inf) > 1e-6 * edges.max(initial=0.0)
    return held


def _spells(seen: Contacts, places: np.ndarray) -> list[np.ndarray]:
    """Return the places of one contact in stretches of successive readings."""
    return np.split(places, np.flatnonzero(np.diff(seen.reading[places]) > 1) + 1)


def _steady(run: Recording, pair: int, window: np.ndarray) -> Creep | None:
    """Return the creep in a window.

    None if the slip changes, without enough friction, or if the surfaces turn on each other.
    """
    seen = run.contacts
    past = seen.past[window]
    drift, share = past.mean(axis=0), float(seen.share[window].mean())
    mean = float(np.linalg.norm(drift))
    unsteady = np.linalg.norm(past - drift, axis=1).max() > UNSTEADY * mean
    if share < RUBS or unsteady or mean < RESTS * seen.rolls[window].mean():
        return None
    begin, end = run.times[seen.reading[window[[0, -1]]]].tolist()
    return Creep(pair, mean, share, begin, end)


def _slip(run: Recording, found: Collection[Creep]) -> float | None:
    """Return the largest mean slip of some pairs, each in its time [m/s].

    None if one does not touch.
    """
    seen, slips = run.contacts, dict[int, float]()
    times = run.times[seen.reading]
    for creep in found:
        for (pair, _), places in seen.groups.items():
            within = places[(times[places] >= creep.begin) & (times[places] <= creep.end)]
            if pair == creep.of and len(within) >= FEWEST:
                mean = float(np.linalg.norm(seen.past[within].mean(axis=0)))
                slips[pair] = max(mean, slips.get(pair, 0.0))
    return max(slips.values()) if slips.keys() == {creep.of for creep in found} else None


def _contacts(run: Recording) -> Iterator[Finding]:
    model, seen = run.model, run.contacts
    notable = [
        (ratio, creep)
        for creep in creeps(run)
        if (ratio := creep.speed / (CREEP * seen.thick(creep.of))) > 1
    ]
    if not notable:
        return
    notable.sort(key=lambda entry: -entry[0])
    ratio, worst = notable[0]
    found = [creep for _, creep in notable]
    elements = named(model, "contact", [creep.of for creep in found])
    cures = []
    for factor in (1, 10):
        impratio = round_number(model.settings.impratio * ratio / LEFT, up=True) * factor
        if impratio <= IMPRATIO:
            words = f'cone="elliptic" with impratio="{impratio:g}"'
            cures.append(Cure(words, Change(cone="elliptic", impratio=impratio)))
    remedy = Remedy(
        (tuple(cures), (Cure("stiction=True", Change(stiction=True)),)),
        lambda other: _slip(other, found),
        CREEP * seen.thick(worst.of),
        # Below a nanometre in a second it is rounding.
        lambda left: speed(left) if left > 1e-9 else "none",
        most=2,
        # A slip that harder friction does not end belongs to the motion.
        needed=True,
    )
    problem = (
        f"{listed(elements, 'contacts')} creeps at {speed(worst.speed)} although its friction "
        f"holds ({percent(worst.share)} of what it could be)"
    )
    value = worst.speed
    yield Finding("creep", "warning", problem, "", elements, value, "m/s", remedy=remedy)


# Joints with friction loss.


def drifts(run: Recording) -> Iterator[Creep]:
    """Yield joints that move steadily under less than their friction loss, at their fastest.

    A joint whose own controls change is meant to move, and one with a servo ends at its target. So
    is what a tendon's actuator moves not told.
    """
    model, features = run.model, run.model.scene.features
    joints = _losses(model)
    if not (features.constraint and features.frictionloss and joints):
        return
    changing = np.ptp(run["ctrl"], axis=0) > 0
    moving = [a.index for a in actuators(model) if a.kp > 0 or changing[a.index]]
    moved = set(model.actuator_joint[moving].tolist())
    for joint, of in joints.items() if -1 not in moved else ():
        count = _window(run, of.solreffriction[0])
        dof = int(model.jnt_dofadr[joint])
        velocity = run["qvel"][:, dof]
        share = np.abs(velocity) * _damping(model, joint, of) / of.frictionloss
        best: Creep | None = None
        for first in range(0, len(run) - count + 1, max(1, count // 2)):
            window = slice(first, first + count)
            mean, used = float(velocity[window].mean()), float(share[window].mean())
            held = share[window].max() < SLIDES and used > RUBS
            steady = np.abs(velocity[window] - mean).max() <= UNSTEADY * abs(mean)
            if held and steady and (best is None or abs(mean) > best.speed):
                begin, end = run.times[[first, first + count - 1]].tolist()
                best = Creep(joint, abs(mean), used, begin, end)
        if joint not in moved and best is not None:
            yield best


def _losses(model: Model) -> dict[int, Joint]:
    """Return the joints of one dof with friction loss, by index."""
    joints = enumerate(Layout(model.scene).joints)
    return {k: of for k, of in joints if of.frictionloss and of.type in ("hinge", "slide")}


def _damping(model: Model, joint: int, of: Joint) -> float:
    """Return b/R of a joint's row of friction loss [N·m·s/rad or N·s/m]."""
    settings, (constant, ratio) = model.settings, of.solreffriction
    d = impedance(of.solimpfriction, 0.0)
    most = impedance(of.solimpfriction, math.inf)
    if constant > 0:
        constant = max(constant, 2 * settings.dt) if settings.refsafe else constant
        b = 2 / (most * constant)
    else:
        b = -ratio / most
    inverse = float(model.dof_invweight0[model.jnt_dofadr[joint]])
    return b * d / ((1 - d) * inverse)


def _drift(run: Recording, found: Collection[Creep]) -> float | None:
    """Return the fastest mean velocity of some joints, each in its time; None without readings."""
    means = []
    for drift in found:
        within = (run.times >= drift.begin) & (run.times <= drift.end)
        dof = int(run.model.jnt_dofadr[drift.of])
        means.append(abs(float(run["qvel"][within, dof].mean())) if within.any() else None)
    return None if None in means else max(mean for mean in means if mean is not None)


def _joints(run: Recording) -> Iterator[Finding]:
    model = run.model

    def scale(joint: int) -> float:
        """Return the unit of a velocity: 1 rad, or the size of the body that slides [m]."""
        slides = model.jnt_type[joint] == "slide"
        return run.sizes.bodies[int(model.jnt_body[joint])] if slides else 1.0

    found = ((drift.speed / (CREEPS * scale(drift.of)), drift) for drift in drifts(run))
    notable = sorted((entry for entry in found if entry[0] > 1), key=lambda entry: -entry[0])
    if not notable:
        return
    worst, some = notable[0][1], [drift for _, drift in notable]
    elements = tuple(Element.of(model, "friction loss", drift.of) for drift in some)
    angular = model.jnt_type[worst.of] != "slide"
    loss = quantity(_losses(model)[worst.of].frictionloss, TORQUES if angular else FORCES)
    constant = float(f"{2 * model.settings.dt:.3g}")
    cures = tuple(_harder(model, elements, constant, *ends) for ends in IMPEDANCES)

    def rate(value: float) -> str:
        return f"{radians(value)}/s" if angular else speed(value)

    remedy = Remedy(
        (cures,),
        lambda other: _drift(other, some),
        CREEPS * scale(worst.of),
        rate,
        # A motion that harder friction does not end is no creep.
        needed=True,
    )
    problem = (
        f"{listed(elements, 'friction losses')} lets the joint creep at {rate(worst.speed)} "
        f"under {percent(worst.share)} of its {loss}"
    )
    unit = "rad/s" if angular else "m/s"
    yield Finding("creep", "warning", problem, "", elements, worst.speed, unit, remedy=remedy)


def _harder(
    model: Model, elements: tuple[Element, ...], constant: float, low: float, high: float
) -> Cure:
    """Return the cure by a time constant [s] and two impedances."""
    values = {"solreffriction": (constant, 1.0), "solimpfriction": (low, high, 0.001, 0.5, 2.0)}
    words = f'solreffriction="{constant:g} 1" with solimpfriction="{low:g} {high:g}"'
    return Cure(words, Change(assigned(model, elements, values)))
