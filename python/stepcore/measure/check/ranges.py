"""Starts and keyframes outside of limits, controls outside of their range, one-sided forces."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stepcore.engine.model import Model
from stepcore.experiment.coordinates import Start
from stepcore.measure.findings.finding import Finding, others
from stepcore.mjcf.worldbody import EMPTY
from stepcore.report.units import metres, radians

# A coordinate this part of its range beyond a limit is outside: a pose of rest is not.
OUTSIDE = 0.02


def about_ranges(model: Model, start: Start, key: int | None) -> Iterator[Finding]:
    """The start, every keyframe, every range; key: the keyframe that is the start."""
    yield from _inverted(model)
    if key is None:
        yield from _outside(model, start.qpos, "The start")
    for index, frame in enumerate(model.keys):
        name = f"Keyframe `{frame.name or index}`"
        yield from _outside(model, frame.qpos, name)
        yield from _clamped(model, frame.ctrl, name)
    yield from _one_sided(model)


def _inverted(model: Model) -> Iterator[Finding]:
    """Ranges of the file whose first number is not the smaller one: they limit nothing."""
    for note in model.scene.notes:
        if not note.endswith(EMPTY):
            continue
        field, _, rest = note.rpartition(": ")[0].rpartition(": ")[2].partition(" = ")
        low, high = rest.removesuffix(EMPTY.partition(":")[0]).split()
        order = f'write {field}="{high} {low}"' if low != high else "give it two different numbers"
        yield Finding(
            "inverted range",
            "error",
            "",
            f"{note.removesuffix(EMPTY)}limits nothing, because its first number must be the "
            f"smaller one: {order}.",
            float(low),
        )


def _outside(model: Model, qpos: np.ndarray, where: str) -> Iterator[Finding]:
    """Joints that a state puts outside of their limits."""
    if not model.scene.features.limit:
        return
    found = []
    for k, kind in enumerate(model.jnt_type):
        low, high = (float(bound) for bound in model.jnt_range[k])
        if kind not in ("hinge", "slide") or not np.isfinite([low, high]).all():
            continue
        value = float(qpos[model.jnt_qposadr[k]])
        over = max(low - value, value - high)
        if over > OUTSIDE * (high - low):
            found.append((over / (high - low), k, value, low, high))
    if not found:
        return
    found.sort(reverse=True)
    _, k, value, low, high = found[0]
    names = [model.element_name("joint", one[1]) for one in found]
    length = radians if model.jnt_type[k] == "hinge" else metres
    nearest = low if value < low else high
    keyed = where.startswith("Key")
    cure = "correct its qpos" if keyed else "give a keyframe, or correct its ref"
    yield Finding(
        "outside a limit",
        "error" if keyed else "warning",
        names[0],
        f"{where} has {names[0]}{others(names, 'joints')} at {length(value)}, outside of its range "
        f"of {length(low)} to {length(high)}, whose limit throws it back: {cure} (the nearest is "
        f"{nearest:.4g}), or widen the range.",
        value,
        "rad" if model.jnt_type[k] == "hinge" else "m",
    )


def _clamped(model: Model, ctrl: np.ndarray, where: str) -> Iterator[Finding]:
    """Controls of a keyframe that will be clamped."""
    if not model.nu or not model.scene.features.clampctrl:
        return
    bounds = model.actuator_ctrlrange
    over = np.maximum(bounds[:, 0] - ctrl, ctrl - bounds[:, 1])
    found = np.flatnonzero(over > 1e-9 * np.maximum(1.0, np.abs(ctrl)))
    if len(found):
        k = int(found[np.argmax(over[found])])
        names = [model.element_name("actuator", int(i)) for i in (k, *found) if i == k or i != k]
        low, high = bounds[k]
        yield Finding(
            "clamped control",
            "warning",
            names[0],
            f"{where} has a control of {ctrl[k]:.4g} for {names[0]}{_rest(names)}, clamped to its "
            f"ctrlrange of {low:.4g} to {high:.4g}: correct its ctrl, or widen the ctrlrange.",
            float(ctrl[k]),
        )


def _rest(names: list[str]) -> str:
    return others(list(dict.fromkeys(names)), "actuators")


def _one_sided(model: Model) -> Iterator[Finding]:
    """Servos whose force range does not hold 0, or only one direction."""
    found = []
    for k in range(model.nu):
        low, high = model.actuator_forcerange[k]
        if model.actuator_bias[k, 1] < 0 and (low >= 0 or high <= 0):
            found.append((k, float(low), float(high)))
    if found:
        k, low, high = found[0]
        names = [model.element_name("actuator", one[0]) for one in found]
        most = max(abs(low), abs(high))
        yield Finding(
            "force range",
            "warning",
            names[0],
            f"The forcerange of {names[0]}{others(names, 'servos')}, {low:.4g} to {high:.4g}, lets "
            f"it push in one direction only: {-most:.4g} to {most:.4g} lets it hold a position.",
            most,
        )
