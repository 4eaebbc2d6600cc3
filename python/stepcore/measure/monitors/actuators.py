"""Findings on actuators in a run: saturated forces, servos that sag, and robots that fall over."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from stepcore.engine.actuator import SERVO, Actuator, actuators, loads
from stepcore.engine.arrays import Floats
from stepcore.engine.coordinates import rotated
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.experiment.moves import SINKS, TILT, moves_about, roots
from stepcore.measure.monitors.contacts import centre_of_mass
from stepcore.measure.monitors.finding import OTHERS, PLOT, Cure, Finding, Remedy, listed, named
from stepcore.measure.monitors.joints import width_of
from stepcore.measure.monitors.recording import FEWEST, REST, Recording
from stepcore.report.units import (
    FORCES,
    TORQUES,
    metres,
    percent,
    plural,
    quantity,
    radians,
    rounded,
    seconds,
)

# Relative distance from the end of the force range within which a force is at the end.
AT_END = 1e-9
# A servo pushes against a weight if the weight's load has at least this share of the servo's force.
HALF = 0.5
# At rest, a servo's error changes by less than this share over the end of a run.
STEADY = 0.05
# The share of a run above which saturation is reported: a servo that lost a quarter of a sine's
# amplitude (bullet3's issue 2152) was at its end for 41 % of the run.
SATURATED = 1 / 3
# Gains within this factor are given as one.
ALIKE = 1.1
# Least sag that is told and that will be noticed, relative to the joint's range (a hinge's, at most
# 3 rad): 30 mrad move the hand of an arm of 0.8 m by 24 mm. And the share that a cure should leave.
SAGS, OBVIOUS, LEFT = 0.01, 0.033, 1 / 3


def actuator_findings(run: Recording) -> Iterator[Finding]:
    """Yield all findings on actuators."""
    model, explained = run.model, set[int]()
    if not (model.nu and model.scene.features.actuation):
        return
    full = list(saturated(run))
    sagging = list[tuple[float, Servo]]()
    for servo in at_rest(run):
        # A servo that presses against an object or a limit does so on purpose, and may be
        # saturated.
        k = servo.actuator.index
        ratio = abs(servo.error) / _notable(model, servo.actuator) if servo.loaded else 0.0
        if ratio > 1 and k not in {at.actuator for at in full}:
            sagging.append((ratio, servo))
        if not servo.loaded:
            explained.add(k)
    if sagging:
        sagging.sort(key=lambda entry: -entry[0])
        yield _sags(model, [servo for _, servo in sagging])
    servos = {of.index for of in _servos(model)} - explained
    full = [at for at in full if at.share >= SATURATED and at.actuator in servos]
    if full:
        yield _saturated(model, sorted(full, key=lambda at: -at.share))


def _servos(model: Model) -> list[Actuator]:
    return [of for of in actuators(model) if of.direct and of.holds]


# Saturation.


class AtEnd(NamedTuple):
    """An actuator whose force was at an end [N or N·m] of its range for a share of the run."""

    actuator: int
    share: float
    value: float


def saturated(run: Recording) -> Iterator[AtEnd]:
    """Yield actuators whose forces are at the end of their range."""
    # The first reading is the start, which no step has led to.
    force, bounds = run["actuator_force"][1:], run.model.actuator_forcerange
    room = AT_END * np.abs(bounds)
    with np.errstate(invalid="ignore"):
        low, high = force <= bounds[:, 0] + room[:, 0], force >= bounds[:, 1] - room[:, 1]
    # A force of 0 is not saturated, even if the range begins at 0.
    low, high = low & (force != 0), high & (force != 0)
    for k in np.flatnonzero((low | high).any(axis=0)):
        end = bounds[k, 0] if low[:, k].sum() > high[:, k].sum() else bounds[k, 1]
        yield AtEnd(int(k), float(np.mean(low[:, k] | high[:, k])), float(end))


def _saturated(model: Model, full: list[AtEnd]) -> Finding:
    """Return one finding on all saturated servos, the longest saturated first."""
    elements = named(model, "actuator", [at.actuator for at in full])
    ends = dict.fromkeys(strength(model, at.actuator, abs(at.value)) for at in full)
    largest = max(full, key=lambda at: abs(at.value))
    force = f"up to {strength(model, largest.actuator, abs(largest.value))}"
    force = next(iter(ends)) if len(ends) == 1 else force
    shares = list(dict.fromkeys(percent(at.share) for at in reversed(full)))
    share = f"{shares[0].removesuffix(' %')} to {shares[-1]}" if shares[1:] else shares[0]
    ranges = "are at the ends of their forceranges"
    if len(full) == 1:
        ranges = "is at the end of its forcerange"
    problem = f"{_all(elements)} {ranges} ({force}) for {share} of the run, where kv has no effect"
    cure = "slow the motion or lower kp; a wider forcerange must be one that the hardware has"
    return Finding("saturation", "warning", problem, cure, elements, full[0].share, "1", PLOT)


# Sag.


class Servo(NamedTuple):
    """A position servo at rest under a constant control.

    error: commanded length minus length [rad or m], before the gear. force: [N·m or N].
    loaded: whether it pushes against a weight, and not a limit or an object that it presses.
    """

    actuator: Actuator
    error: float
    force: float
    loaded: bool


def at_rest(run: Recording) -> Iterator[Servo]:
    """Yield position servos whose control and error are constant over the end of the run."""
    if run.late < 0:
        return
    for of in _servos(run.model):
        asked, error = _errors(run, of)
        mean, held = float(error.mean()), np.ptp(run["ctrl"][run.late :, of.index]) == 0
        if held and float(np.ptp(error)) < STEADY * abs(mean):
            force = float(run["actuator_force"][-1, of.index])
            yield Servo(of, mean, force, _loaded(run, of, float(asked[-1]), force))


def _errors(run: Recording, of: Actuator) -> tuple[Floats, Floats]:
    """Return the lengths that a servo is asked for at the end of the run, and its errors."""
    late = max(run.late, 0)
    asked = of.target(np.clip(run["ctrl"][late:, of.index], *of.ctrlrange))
    return asked, asked - of.gear * run["qpos"][late:, of.qposadr]


def _loaded(run: Recording, of: Actuator, asked: float, force: float) -> bool:
    """Return whether a servo pushes against a weight at the end of the run.

    The weight is that of the bodies that hang on the servo's joint, or, in a tree that rests on a
    floor, that of the tree.
    """
    model, sim = run.model, run.at(len(run) - 1)
    low, high = model.jnt_range[of.joint]
    if not low <= asked / of.gear <= high:
        return False
    if float(loads(sim)[of.dof]) / of.gear * force >= HALF * force**2:
        return True
    assert of.joint is not None
    tree = model.root(int(model.jnt_body[of.joint]))
    free = (j for j, kind in enumerate(model.jnt_type) if kind == "free")
    if tree not in [model.root(int(model.jnt_body[j])) for j in free]:
        return False
    pairs = zip(sim.contacts["geom1"], sim.contacts["geom2"], strict=True)
    touched = {frozenset(model.root(int(model.geom_body[g])) for g in pair) for pair in pairs}
    touches = [trees for trees in touched if tree in trees]
    return bool(touches) and all(trees <= {tree, 0} for trees in touches)


def sag_of(run: Recording, indices: Collection[int]) -> float | None:
    """Return the largest error of some servos over the end of the run, before the gear.

    None if a control changes there.
    """
    count, worst = max(FEWEST, int(REST * len(run))), 0.0
    for of in _servos(run.model):
        if of.index in indices:
            if np.ptp(run["ctrl"][-count:, of.index]):
                return None
            worst = max(worst, float(np.abs(_errors(run, of)[1]).max()))
    return worst


def _notable(model: Model, of: Actuator) -> float:
    """Return the least sag that is told, before the gear [rad or m]."""
    assert of.joint is not None
    widest = math.inf if _turns(model, of) else 1.0
    return SAGS * min(width_of(model, of.joint), widest) * abs(of.gear)


def _turns(model: Model, of: Actuator) -> bool:
    assert of.joint is not None
    return model.jnt_type[of.joint] == "hinge"


def _sags(model: Model, servos: list[Servo]) -> Finding:
    """Return a finding on servos that sag under their loads, the worst first."""
    worst, (of, *_) = servos[0], [servo.actuator for servo in servos]
    indices, notable = [servo.actuator.index for servo in servos], _notable(model, of)
    elements, error = named(model, "actuator", indices), abs(worst.error / of.gear)
    in_words = radians if _turns(model, of) else metres
    ratios = {s.actuator: abs(s.error) / (_notable(model, s.actuator) * LEFT) for s in servos}
    if max(ratios.values()) < ALIKE * min(ratios.values()):
        ratios = dict.fromkeys(ratios, max(ratios.values()))
    gains = [rounded(other.kp * ratio) for other, ratio in ratios.items()]
    # "kp 1810 (servo `j2` 995)"
    also = [f"{e.name} {gain:g}" for e, gain in zip(elements, gains, strict=True)][1:]
    more = f" and {len(also) - OTHERS} more in proportion" if len(also) > OTHERS else ""
    words = f"kp {gains[0]:g}" + (f" ({', '.join(also[:OTHERS])}{more})" if also else "")
    if also and len(set(gains)) == 1:
        words = f"kp {gains[0]:g} of each"
    by_index = {other.index: ratio for other, ratio in ratios.items()}
    way = (
        Cure(words, Change(stronger(model, by_index, damped=False))),
        Cure(f"{words}, with kv in proportion", Change(stronger(model, by_index, damped=True))),
    )
    remedy = Remedy(
        (way,),
        lambda other: sag_of(other, indices),
        notable,
        lambda left: in_words(abs(left / of.gear)),
    )
    problem = (
        f"{listed(elements, 'servos')} sags by {in_words(error)} under its load of "
        f"{strength(model, of.index, abs(worst.force))}, which is load / kp with kp {of.kp:.4g}"
    )
    severity = "warning" if abs(worst.error) > OBVIOUS / SAGS * notable else "remark"
    cure, unit = "let the control carry the load", "rad" if _turns(model, of) else "m"
    return Finding(
        "servo sags", severity, problem, cure, elements, error, unit, PLOT, remedy=remedy
    )


def stronger(model: Model, ratios: Mapping[int, float], damped: bool) -> dict[str, Any]:
    """Return the gains of servos, by path, with kp multiplied by a ratio each.

    damped: whether kv grows, too, so that the damping ratio is kept.
    """
    changes: dict[str, Any] = {}
    for k, ratio in ratios.items():
        fields = {field.name: field for field in Element.of(model, "actuator", k).fields(model)}
        faster = math.sqrt(ratio) if damped else 1.0
        if "kp" in fields:
            changes[f"actuator/#{k}/kp"] = rounded(fields["kp"].value * ratio)
            if fields["kv"].value > 0:
                changes[f"actuator/#{k}/kv"] = rounded(fields["kv"].value * faster)
        elif "biasprm" in fields:
            for name, factors in (("gainprm", [ratio]), ("biasprm", [1.0, ratio, faster])):
                terms = np.atleast_1d(np.asarray(fields[name].value, float))
                terms[: len(factors)] *= factors[: len(terms)]
                scaled = tuple(map(rounded, terms.tolist()))
                changes[f"actuator/#{k}/{name}"] = scaled if len(scaled) > 1 else scaled[0]
    return changes


def strength(model: Model, actuator: int, force: float) -> str:
    """Return an actuator's force in words, as a torque if the joint turns."""
    joint = int(model.actuator_joint[actuator])
    linear = joint < 0 or model.jnt_type[joint] == "slide"
    return quantity(force, FORCES if linear else TORQUES)


def _all(elements: Sequence[Element]) -> str:
    """Return the names of actuators in words: "servos `a`, `b` and `c`"."""
    if len(elements) == 1:
        return elements[0].name
    *labels, last = (element.label for element in elements)
    return f"{plural(elements[0].noun)} {', '.join(labels)} and {last}"


# Falls.


def fall_findings(run: Recording) -> Iterator[Finding]:
    """Yield a robot on a free base, with servos, that falls over: nothing balances it.

    Robots without servos are not watched: motors at zero hold nothing, and walkers that learn fall
    by design.
    """
    model, drives = run.model, actuators(run.model)
    if not any(drive.kind == SERVO for drive in drives) or not moves_about(model, drives):
        return
    first: tuple[float, int] | None = None
    for body in sorted(roots(model, drives)):
        down = _down(run, body)
        if down.any():
            when = float(run.times[down.argmax()] - run.times[0])
            first = min(first or (when, body), (when, body))
    if first is None:
        return
    after, of = first[0], named(model, "body", [first[1]])
    problem = (
        f"{of[0].name} falls over within {seconds(after)}, because its servos do not balance it"
    )
    cure = "give the controls or the controller that balance it (--ctrl, --control)"
    yield Finding("fall", "warning", problem, cure, of, after, "s")


def _down(run: Recording, body: int) -> np.ndarray:
    """Return at which readings a robot is no longer upright."""
    axis = rotated(run["xquat"][:, body] * (1.0, -1.0, -1.0, -1.0), np.array([0.0, 0.0, 1.0]))
    down: np.ndarray = axis @ axis[0] < np.cos(TILT)
    owners = run.model.geom_body.tolist()
    geoms = [k for k, owner in enumerate(owners) if run.model.root(owner) == body]
    if geoms:
        lowest = run.geoms[0][:, geoms, 2] - run.model.geom_size[geoms].max(axis=1)
        height = centre_of_mass(run, body)[:, 2] - lowest.min(axis=1)
        down |= height < (1 - SINKS) * height[0]
    return down
