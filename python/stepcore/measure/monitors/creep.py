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
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.experiment.proposal import Proposal
from stepcore.measure.monitors.finding import (
    DEEP,
    FEW,
    HALF,
    LEFT,
    SEEN,
    Finding,
    Proposals,
    assigned,
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

# Length of the window in which a slip is steady, in time constants: initial speeds have decayed.
# With half of it, creep of op3 is reported while it settles.
WINDOW = 10.0
# Largest advised impratio: beyond it, the rows differ too much in scale to be solved. Go2
# needs all of it.
IMPRATIO = 1e4
# A contact sticks, and a friction loss holds, below this share of its friction.
STICKS = 0.99
# Slowest creep of a joint that is reported [rad/s]; for slides, relative to the body's size [1/s].
# Users report arms that drift at 1.5 mrad/s (MuJoCo's issue 2082, frictionloss.xml), and a tenth of
# a degree per second is visible within a minute.
CREEPS = 1e-3
# Advised impedances, softest first: the creep falls as (1 − d)/d. The first fixes
# frictionloss.xml, the last friceq.xml.
IMPEDANCES = ((0.99, 0.999), (0.999, 0.9999), (0.9999, 0.9999))


class Creep(NamedTuple):
    """A contact that slips, or a joint that drifts, although its friction holds it.

    of: the contact's pair, or the joint. speed: the mean [m/s or rad/s]. share: of its friction
    limit. begin, end: the times between which it creeps [s].
    """

    of: int
    speed: float
    share: float
    begin: float
    end: float


class Series(NamedTuple):
    """The motion of one contact, or of one joint with friction loss.

    of: see `Creep`. constant: the time constant of its friction [s]. readings: the m readings with
    this motion. Then at these: velocity [m/s or rad/s], (m, k); share of the friction limit; held:
    whether friction holds; rolls: the speed at which the surfaces turn on each other [m/s].
    """

    of: int
    constant: float
    readings: np.ndarray
    velocity: Floats
    share: Floats
    held: np.ndarray
    rolls: Floats


def creep_findings(run: Recording) -> Iterator[Finding]:
    """Yield a finding on contacts that creep, and one on joints that do."""
    model, settings = run.model, run.model.settings
    if settings.law != "solref" or not run.spacing:
        return

    def most(creep: Creep) -> float:
        slides = model.jnt_type[creep.of] == "slide"
        return CREEPS * (run.sizes.bodies[int(model.jnt_body[creep.of])] if slides else 1.0)

    slips = () if settings.stiction else creeps(run)
    slid = worst(slips, lambda creep: creep.speed / (SEEN * run.thick(creep.of)))
    if slid:
        yield _of_contacts(run, slid)
    drifts = worst(creeps(run, of_joints), lambda creep: creep.speed / most(creep))
    if drifts:
        yield _of_joints(model, drifts, most(drifts[0]))


def of_contacts(run: Recording) -> Iterator[Series]:
    """Yield the motions of contacts with friction."""
    seen = run.contacts
    # Between its edges, a pyramid yields at less friction than along an edge.
    sticks = STICKS / math.sqrt(2 if run.model.settings.cone == "pyramidal" else 1)
    for (pair, _), at in seen.groups.items():
        if friction_of(run.model, pair) > 0:
            constant = run.model.contact_pair(pair).solref[0]
            share, held = seen.share[at], seen.share[at] < sticks
            series = seen.reading[at], seen.past[at], share, held, seen.rolls[at]
            yield Series(pair, constant, *series)


def of_joints(run: Recording) -> Iterator[Series]:
    """Yield the motions of joints with friction loss that no actuator moves.

    A joint whose controls change is meant to move, and a joint with a servo ends at its target. If
    such an actuator drives no single joint, nothing is yielded.
    """
    model, features = run.model, run.model.scene.features
    changing = np.ptp(run["ctrl"], axis=0) > 0
    moving = [a.index for a in actuators(model) if a.holds or changing[a.index]]
    moved = set(model.actuator_joint[moving].tolist())
    if -1 in moved or not (features.constraint and features.frictionloss):
        return
    readings = np.arange(len(run))
    for joint, of in enumerate(Layout(model.scene).joints):
        if of.frictionloss and of.type in ("hinge", "slide") and joint not in moved:
            velocity = run["qvel"][:, [int(model.jnt_dofadr[joint])]]
            share = np.abs(velocity[:, 0]) * _damping(model, joint, of) / of.frictionloss
            series = velocity, share, share < STICKS, np.zeros(len(run))
            yield Series(joint, of.solreffriction[0], readings, *series)


def _damping(model: Model, joint: int, of: Joint) -> float:
    """Return b/R of a joint's row of friction loss [N·m·s/rad or N·s/m]."""
    settings, (constant, ratio) = model.settings, of.solreffriction
    d, most = (impedance(of.solimpfriction, violation) for violation in (0.0, math.inf))
    least = 2 * settings.dt if settings.refsafe else 0.0
    b = 2 / (most * max(constant, least)) if constant > 0 else -ratio / most
    inverse = float(model.dof_invweight0[model.jnt_dofadr[joint]])
    return b * d / ((1 - d) * inverse)


def creeps(
    run: Recording, motions: Callable[[Recording], Iterator[Series]] = of_contacts
) -> Iterator[Creep]:
    """Yield the fastest steady motion of each contact or joint that friction should hold.

    The motion must be steady over `WINDOW` time constants and over a tenth of the run: an initial
    speed decays within the time constant, and under a load a speed remains.
    """
    for of, constant, *columns in motions(run):
        readings, velocity, share, held, rolls = columns
        best: Creep | None = None
        lasts = WINDOW * max(constant, 0.0) / run.spacing, DEEP * len(run)
        count, some = math.ceil(max(FEWEST, *lasts)), np.flatnonzero(held)
        for spell in np.split(some, np.flatnonzero(np.diff(readings[some]) > 1) + 1):
            for first in range(0, len(spell) - count + 1, max(1, count // 2)):
                window = spell[first : first + count]
                drift, used = velocity[window].mean(axis=0), float(share[window].mean())
                mean = float(np.linalg.norm(drift))
                unsteady = np.linalg.norm(velocity[window] - drift, axis=1).max() > HALF * mean
                turns = mean < rolls[window].mean()
                if used >= FEW and not unsteady and not turns and (not best or mean > best.speed):
                    best = Creep(of, mean, used, *run.times[readings[window[[0, -1]]]].tolist())
        if best:
            yield best


def _left(
    found: Sequence[Creep], motions: Callable[[Recording], Iterator[Series]], run: Recording
) -> float | None:
    """Return the largest mean speed of what crept, each in its time; None if one has no data."""
    # Contacts are read only between these times.
    begin, end = min(creep.begin for creep in found), max(creep.end for creep in found)
    first, last = np.searchsorted(run.times, (begin, end * (1 + 1e-9))).tolist()
    run, speeds, moved = run.part(first, last + 1), list[float](), dict[int, list[Series]]()
    for series in motions(run):
        moved.setdefault(series.of, []).append(series)
    for creep in found:
        means = []
        for series in moved.get(creep.of, []):
            times = run.times[series.readings]
            within = (times >= creep.begin) & (times <= creep.end)
            if within.sum() >= FEWEST:
                means.append(float(np.linalg.norm(series.velocity[within].mean(axis=0))))
        if not means:
            return None
        speeds += means
    return max(speeds)


def _of_contacts(run: Recording, found: list[Creep]) -> Finding:
    model, of, most = run.model, found[0], SEEN * run.thick(found[0].of)
    elements = named(model, "contact", [creep.of for creep in found])
    least = round_number(model.settings.impratio * of.speed / (LEFT * most), up=True)
    fixes = tuple(
        Proposal(
            f'cone="elliptic" with impratio="{impratio:g}"',
            Change(cone="elliptic", impratio=impratio),
        )
        for impratio in (least, 10 * least)
        if impratio <= IMPRATIO
    )
    proposals = Proposals(
        (fixes, (Proposal("stiction=True", Change(stiction=True)),)),
        functools.partial(_left, found, of_contacts),
        most,
        # Below a nanometre per second it is rounding.
        lambda left: speed(left) if left > 1e-9 else "none",
        most=2,
        # A slip that harder friction does not stop belongs to the motion.
        needed=True,
    )
    problem = (
        f"{listed(elements, 'contact')} creeps at {speed(of.speed)} although its friction "
        f"holds ({percent(of.share)} of what it could be)"
    )
    return Finding("creep", "warning", problem, "", elements, of.speed, "m/s", proposals=proposals)


def _of_joints(model: Model, found: list[Creep], most: float) -> Finding:
    of, angular = found[0], model.jnt_type[found[0].of] != "slide"
    elements = named(model, "friction loss", [creep.of for creep in found])
    loss = Layout(model.scene).joints[of.of].frictionloss
    constant = float(f"{2 * model.settings.dt:.3g}")

    def rate(value: float) -> str:
        return f"{radians(value)}/s" if angular else speed(value)

    def harder(low: float, high: float) -> Proposal:
        solimp = (low, high, 0.001, 0.5, 2.0)
        values = {"solreffriction": (constant, 1.0), "solimpfriction": solimp}
        words = f'solreffriction="{constant:g} 1" with solimpfriction="{low:g} {high:g}"'
        return Proposal(words, Change(assigned(model, elements, values)))

    # A motion that harder friction does not stop is no creep.
    way = tuple(harder(*ends) for ends in IMPEDANCES)
    left = functools.partial(_left, found, of_joints)
    proposals = Proposals((way,), left, most, rate, needed=True)
    problem = (
        f"{listed(elements, 'friction loss')} lets the joint creep at {rate(of.speed)} "
        f"under {percent(of.share)} of its {quantity(loss, TORQUES if angular else FORCES)}"
    )
    unit = "rad/s" if angular else "m/s"
    return Finding("creep", "warning", problem, "", elements, of.speed, unit, proposals=proposals)
