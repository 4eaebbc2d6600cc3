"""Tendons that a state puts outside of their range, whose springs and limits are at odds, or that
nothing uses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.coordinates import Start
from stepcore.measure.check.ranges import OUTSIDE
from stepcore.measure.findings.finding import Finding, others
from stepcore.report.units import metres


def about_tendons(model: Model, start: Start, key: int | None) -> Iterator[Finding]:
    """The start, every keyframe, spring and tendon; key: the keyframe that is the start."""
    if not model.ntendon:
        return
    sim = Sim(model)
    if key is None:
        yield from _outside(model, sim, start.qpos, "The start")
    for index, frame in enumerate(model.keys):
        yield from _outside(model, sim, frame.qpos, f"Keyframe `{frame.name or index}`")
    yield from _pressed(model)
    yield from _unused(model)


def _outside(model: Model, sim: Sim, qpos: np.ndarray, where: str) -> Iterator[Finding]:
    """Tendons whose length a state puts outside of their range."""
    if not model.scene.features.limit:
        return
    sim.qpos = qpos
    sim.forward()
    found = []
    for i, (length, (low, high)) in enumerate(zip(sim.ten_length, _ranges(model), strict=True)):
        over = max(low - length, length - high)
        # Without a limit the range is infinite, and nothing is outside of it.
        if over > OUTSIDE * (high - low):
            found.append((float(over / (high - low)), i, float(length), low, high))
    if not found:
        return
    found.sort(key=lambda one: -one[0])
    _, i, length, low, high = found[0]
    names = [model.element_name("tendon", one[1]) for one in found]
    keyed = where.startswith("Key")
    yield Finding(
        "outside a limit",
        "error" if keyed else "warning",
        names[0],
        f"{where} has {names[0]}{others(names, 'tendons')} at a length of "
        f"{_length(model, i, length)}, outside of its range of {_length(model, i, low)} to "
        f"{_length(model, i, high)}, whose limit throws it back: correct the pose, or widen the "
        "range.",
        length,
        _unit(model, i),
    )


def _pressed(model: Model) -> Iterator[Finding]:
    """Springs that are at rest beyond the tendon's range: they press on its limit for ever."""
    features = model.scene.features
    if not (features.limit and features.spring):
        return
    found = []
    rests = model.tendon_lengthspring.tolist()
    for i, (tendon, (rest, slack)) in enumerate(zip(model.scene.tendons, rests, strict=True)):
        low, high = _ranges(model)[i]
        if tendon.sprung and (slack < low or rest > high):
            found.append((i, slack if slack < low else rest, low, high))
    if not found:
        return
    i, rest, low, high = found[0]
    names = [model.element_name("tendon", one[0]) for one in found]
    yield Finding(
        "spring beyond a limit",
        "warning",
        names[0],
        f"The spring of {names[0]}{others(names, 'tendons')} is at rest at a length of "
        f"{_length(model, i, rest)}, outside of the tendon's range of {_length(model, i, low)} to "
        f"{_length(model, i, high)}, so it always presses on the limit: correct its springlength, "
        "or widen the range.",
        rest,
        _unit(model, i),
    )


def _unused(model: Model) -> Iterator[Finding]:
    """Tendons without a force, a limit or an armature that nothing refers to."""
    scene = model.scene
    used = {id(actuator.tendon) for actuator in scene.actuators}
    used |= {id(end) for tie in scene.equalities for end in (tie.tendon1, tie.tendon2)}
    used |= {id(sensor.object) for sensor in scene.sensors}
    idle = [
        i
        for i, tendon in enumerate(scene.tendons)
        if id(tendon) not in used
        and tendon.range is None
        and not (tendon.sprung or tendon.damped or tendon.frictionloss or tendon.armature)
    ]
    if idle:
        names = [model.element_name("tendon", i) for i in idle]
        verb, its = ("does", "it has") if len(idle) == 1 else ("do", "they have")
        yield Finding(
            "unused tendon",
            "remark",
            names[0],
            f"{names[0][0].upper()}{names[0][1:]}{others(names, 'tendons')} {verb} nothing: {its} "
            "no spring, damping, friction loss, armature or limit, and no actuator, equality or "
            "sensor uses it. A tendon with a range needs limited or autolimits.",
        )


def _ranges(model: Model) -> list[list[float]]:
    ranges: list[list[float]] = model.tendon_range.tolist()
    return ranges


def _fixed(model: Model, tendon: int) -> bool:
    return model.scene.tendons[tendon].path.fixed


def _length(model: Model, tendon: int, length: float) -> str:
    """In metres; a fixed tendon's length is a sum of joints, and has no unit of its own."""
    return f"{length:.4g}" if _fixed(model, tendon) else metres(length)


def _unit(model: Model, tendon: int) -> str:
    return "" if _fixed(model, tendon) else "m"
