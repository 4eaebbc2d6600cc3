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
from stepcore.measure.monitors.finding import (
    DEEP,
    FEW,
    HALF,
    OTHERS,
    PLOT,
    SEEN,
    Cure,
    Finding,
    Remedy,
    listed,
    named,
    worst,
)
from stepcore.measure.monitors.joints import length_of, unit_of, width_of
from stepcore.measure.monitors.recording import FEWEST, REST, Recording
from stepcore.report.units import FORCES, TORQUES, percent, plural, quantity, rounded, seconds

# The share of a run above which saturation is told: a servo that lost a quarter of a sine's
# amplitude (fastsine.xml) was at its end for 38 % of the run. And the share of the least sag that a
# cure leaves; a smaller one needs kps that isaacfranka.xml's step does not hold.
THIRD = 1 / 3


def actuator_findings(run: Recording) -> Iterator[Finding]:
    """Yield all findings on actuators."""
    model = run.model
    if not (model.nu and model.scene.features.actuation):
        return
    still, full = list(at_rest(run)), list(saturated(run))
    weak = {at.actuator for at in full}
    loaded = (at for at in still if at.loaded and at.actuator.index not in weak)
    sagging = worst(loaded, lambda at: abs(at.error) / _notable(model, at.actuator))
    if sagging:
        yield _sags(model, sagging)
    # A servo that presses against an object or a limit does so on purpose, and may be saturated.
    presses = {at.actuator.index for at in still if not at.loaded}
    servos = {of.index for of in _servos(model)} - presses
    full = worst((at for at in full if at.actuator in servos), lambda at: at.share / THIRD)
    if full:
        yield _saturated(model, full)


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
    # A force of 0 is not saturated, even if the range begins at 0.
    low, high = (np.isclose(force, end, 1e-9, 0) & (force != 0) for end in bounds.T)
    for k in np.flatnonzero((low | high).any(axis=0)):
        end = bounds[k, int(low[:, k].sum() <= high[:, k].sum())]
        yield AtEnd(int(k), float(np.mean(low[:, k] | high[:, k])), float(end))


def _saturated(model: Model, full: list[AtEnd]) -> Finding:
    """Return one finding on all saturated servos, the longest saturated first."""
    elements = named(model, "actuator", [at.actuator for at in full])
    ends = dict.fromkeys(strength(model, at.actuator, abs(at.value)) for at in full)
    largest = max(full, key=lambda at: abs(at.value))
    force = strength(model, largest.actuator, abs(largest.value))
    shares = list(dict.fromkeys(percent(at.share) for at in reversed(full)))
    share = f"{shares[0].removesuffix(' %')} to {shares[-1]}" if shares[1:] else shares[0]
    ranges = "are at the ends of their forceranges"
    if len(full) == 1:
        ranges = "is at the end of its forcerange"
    problem = (
        f"{_all(elements)} {ranges} ({'up to ' * (len(ends) > 1)}{force}) for {share} of the run, "
        "where kv has no effect"
    )
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
        if held and float(np.ptp(error)) < FEW * abs(mean):
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
    assert of.joint is not None
    low, high = model.jnt_range[of.joint]
    if not low <= asked / of.gear <= high:
        return False
    if float(loads(sim)[of.dof]) / of.gear * force >= HALF * force**2:
        return True
    tree = run.roots[model.jnt_body[of.joint]]
    free = [
        body for body, kind in zip(model.jnt_body, model.jnt_type, strict=True) if kind == "free"
    ]
    if tree not in run.roots[free]:
        return False
    trees = run.roots[model.geom_body[np.stack([sim.contacts[f"geom{k}"] for k in (1, 2)])]]
    touched = trees[:, (trees == tree).any(axis=0)]
    return bool(touched.size) and bool(np.isin(touched, (tree, 0)).all())


def sag_of(run: Recording, indices: Collection[int]) -> float | None:
    """Return the largest error of some servos over the end of the run, before the gear.

    None if a control changes there.
    """
    count, most = max(FEWEST, int(REST * len(run))), 0.0
    for of in _servos(run.model):
        if of.index in indices:
            if np.ptp(run["ctrl"][-count:, of.index]):
                return None
            most = max(most, float(np.abs(_errors(run, of)[1]).max()))
    return most


def _notable(model: Model, of: Actuator) -> float:
    """Return the least sag that is told, before the gear [rad or m]."""
    assert of.joint is not None
    widest = math.inf if unit_of(model, of.joint) == "rad" else 1.0
    return SEEN * min(width_of(model, of.joint), widest) * abs(of.gear)


def _sags(model: Model, servos: list[Servo]) -> Finding:
    """Return a finding on servos that sag under their loads, the worst first."""
    first, indices = servos[0], [servo.actuator.index for servo in servos]
    of, notable = first.actuator, _notable(model, first.actuator)
    assert of.joint is not None
    joint, elements = of.joint, named(model, "actuator", indices)
    error = abs(first.error / of.gear)
    ratios = [abs(s.error) / (_notable(model, s.actuator) * THIRD) for s in servos]
    if max(ratios) < (1 + DEEP) * min(ratios):
        ratios = [max(ratios)] * len(ratios)
    gains = [rounded(s.actuator.kp * r) for s, r in zip(servos, ratios, strict=True)]
    words = _gains(elements, gains)
    by_index = dict(zip(indices, ratios, strict=True))
    way = (
        Cure(words, Change(stronger(model, by_index, damped=False))),
        Cure(f"{words}, with kv in proportion", Change(stronger(model, by_index, damped=True))),
    )
    remedy = Remedy(
        (way,),
        lambda other: sag_of(other, indices),
        notable,
        lambda left: length_of(model, joint, abs(left / of.gear)),
    )
    problem = (
        f"{listed(elements, 'servo')} sags by {length_of(model, joint, error)} under its load of "
        f"{strength(model, of.index, abs(first.force))}, which is load / kp with kp {of.kp:.4g}"
    )
    severity = "warning" if abs(first.error) > FEW / SEEN * notable else "remark"
    cure, unit = "let the control carry the load", unit_of(model, joint)
    return Finding(
        "servo sags", severity, problem, cure, elements, error, unit, PLOT, remedy=remedy
    )


def _gains(elements: Sequence[Element], gains: list[float]) -> str:
    """Return "kp 1810 (servo `j2` 995)", or "kp 91.2 of each"."""
    if len(gains) > 1 and len(set(gains)) == 1:
        return f"kp {gains[0]:g} of each"
    also = [f"{e.name} {gain:g}" for e, gain in zip(elements, gains, strict=True)][1:]
    more = f" and {len(also) - OTHERS} more in proportion" if len(also) > OTHERS else ""
    return f"kp {gains[0]:g}" + (f" ({', '.join(also[:OTHERS])}{more})" if also else "")


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
    down = {body: _down(run, body) for body in sorted(roots(model, drives))}
    falls = {body: float(run.times[at.argmax()]) for body, at in down.items() if at.any()}
    if not falls:
        return
    body = min(falls, key=falls.__getitem__)
    after, of = falls[body] - float(run.times[0]), named(model, "body", [body])
    problem = (
        f"{of[0].name} falls over within {seconds(after)}, because its servos do not balance it"
    )
    cure = "give the controls or the controller that balance it (--ctrl, --control)"
    yield Finding("fall", "warning", problem, cure, of, after, "s")


def _down(run: Recording, body: int) -> np.ndarray:
    """Return at which readings a robot is no longer upright."""
    axis = rotated(run["xquat"][:, body] * (1.0, -1.0, -1.0, -1.0), np.array([0.0, 0.0, 1.0]))
    down: np.ndarray = axis @ axis[0] < np.cos(TILT)
    geoms = np.flatnonzero(run.roots[run.model.geom_body] == body)
    if len(geoms):
        lowest = run.geoms[0][:, geoms, 2] - run.model.geom_size[geoms].max(axis=1)
        height = run.centre_of_mass(body)[:, 2] - lowest.min(axis=1)
        down |= height < (1 - SINKS) * height[0]
    return down
