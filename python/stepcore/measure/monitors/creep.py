"""Creep in a run: contacts that should rest and slip, because soft friction is a damper.

Under a load below the limit of friction, a soft contact slips at a steady speed. The motion of the
body itself is not creep: surfaces that roll, sway or spin on each other turn faster than they slip.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from stepcore.measure.monitors.contacts import LEFT, ContactMonitor
from stepcore.measure.monitors.cures import setting_words
from stepcore.measure.monitors.finding import Cure, Finding, Remedy, listed, named
from stepcore.measure.monitors.readings import FEWEST, Look
from stepcore.report.units import percent, round_number, speed

# Largest relative deviation from the mean velocity; length of the window in time constants; and
# least load, as a share of the largest friction.
UNSTEADY, WINDOW, RUBS = 0.5, 10.0, 0.05
# Least slip, relative to the speed at which the surfaces turn on each other.
RESTS = 1.0
# Threshold of the slip in one second, relative to the thickness of the thinner geom.
CREEP = 0.01
# Largest impratio that is advised: beyond it, the rows differ too much in scale to be solved.
IMPRATIO = 1e4
# Slips below this are rounding [m/s].
NONE = 1e-9


@dataclass(frozen=True)
class Creep:
    """A contact that slips steadily although friction holds it.

    speed: the mean slip [m/s]. share: friction over μ × normal force.
    begin, end: the times between which it was seen [s].
    """

    pair: int
    part: int
    speed: float
    share: float
    begin: float
    end: float


def creeps(contacts: ContactMonitor, times: list[float]) -> Iterator[Creep]:
    """Yield contacts that should rest and slip steadily for a while although friction holds.

    The initial speed of a contact decays within the time constant, and under a load a speed
    remains. Of all windows of `WINDOW` time constants (and at least a tenth of the run), the
    fastest steady slip counts.

    times: the times of the readings [s].
    """
    spacing = (times[-1] - times[0]) / max(1, len(times) - 1) if len(times) > 1 else 0.0
    for (pair, part), seen in contacts.seen.items():
        if contacts.friction.of(pair) <= 0 or not spacing:
            continue
        constant = contacts.model.contact_pair(pair).solref[0]
        least = WINDOW * constant / spacing if constant > 0 else 0.0
        count = math.ceil(max(FEWEST, least, 0.1 * contacts.looks))
        steady = [
            creep
            for held in _spells(seen)
            for first in range(0, len(held) - count + 1, max(1, count // 2))
            if (creep := _steady(pair, part, held[first : first + count], times))
        ]
        if steady:
            yield max(steady, key=lambda creep: creep.speed)


def slip(
    contacts: ContactMonitor,
    times: list[float],
    pairs: Collection[int],
    begin: float,
    end: float,
) -> float | None:
    """Return the largest mean slip of some pairs within a time [m/s]; None if one does not touch.

    times: the times of the readings [s]. begin, end: [s].
    """
    every: dict[int, list[float]] = {}
    for (pair, _), seen in contacts.seen.items():
        past = [at.past for at in seen if begin <= times[at.look] <= end]
        if pair in pairs and len(past) >= FEWEST:
            slips = every.setdefault(pair, [])
            slips.append(float(np.linalg.norm(np.mean(past, axis=0))))
    return max(map(max, every.values())) if len(every) == len(pairs) else None


def creep_findings(contacts: ContactMonitor, times: list[float]) -> Iterator[Finding]:
    """Yield a finding on contacts that creep.

    times: the times of the readings [s].
    """
    model, settings = contacts.model, contacts.model.settings
    if settings.law != "solref" or settings.stiction:
        return
    notable = [
        (ratio, creep)
        for creep in creeps(contacts, times)
        if (ratio := creep.speed / (CREEP * contacts.thick(creep.pair))) > 1
    ]
    if not notable:
        return
    notable.sort(key=lambda entry: -entry[0])
    ratio, worst = notable[0]
    pairs = {creep.pair for _, creep in notable}
    elements = named(model, "contact", [creep.pair for _, creep in notable])
    cures = []
    for factor in (1, 10):
        impratio = round_number(settings.impratio * ratio / LEFT, up=True) * factor
        if impratio <= IMPRATIO:
            sets = {"cone": "elliptic", "impratio": f"{impratio:g}"}
            words = setting_words(sets)
            cures.append(Cure(words, settings={"cone": "elliptic", "impratio": impratio}))
    remedy = Remedy(
        (tuple(cures), (Cure("stiction=True", settings={"stiction": True}),)),
        lambda m: slip(m.contacts, m.times[1:], pairs, worst.begin, worst.end),
        CREEP * contacts.thick(worst.pair),
        lambda left: speed(left) if left > NONE else "none",
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


def _spells(seen: list[Look]) -> Iterator[list[Look]]:
    """Yield successive readings in which friction held."""
    spell: list[Look] = []
    for at in seen:
        if spell and (not at.held or at.look != spell[-1].look + 1):
            yield spell
            spell = []
        if at.held:
            spell.append(at)
    if spell:
        yield spell


def _steady(pair: int, part: int, held: list[Look], times: list[float]) -> Creep | None:
    """Return the creep in a window.

    None if the slip changes, without enough friction, or if the surfaces turn on each other.
    """
    past = np.array([at.past for at in held])
    drift, share = past.mean(axis=0), float(np.mean([at.share for at in held]))
    mean, rolls = float(np.linalg.norm(drift)), float(np.mean([at.rolls for at in held]))
    unsteady = np.linalg.norm(past - drift, axis=1).max() > UNSTEADY * mean
    if share < RUBS or unsteady or mean < RESTS * rolls:
        return None
    return Creep(pair, part, mean, share, times[held[0].look], times[held[-1].look])
