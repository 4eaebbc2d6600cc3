"""Limits that an actuator can overpower, by the closed form of a soft row."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from stepcore.engine.model import Model
from stepcore.measure.findings.actuators import TORQUES
from stepcore.measure.findings.finding import Finding, others
from stepcore.measure.findings.joints import BEYOND, LEFT, WIDEST
from stepcore.measure.findings.softness import advised, yielding
from stepcore.report.units import FORCES, metres, quantity, radians
from stepcore.scene.layout import Layout


def about_limits(model: Model) -> Iterator[Finding]:
    """Actuators that can push their joint far beyond its limit, by the closed form of a soft row.

    Their largest force outwards against the limit alone: gravity and other actuators left out.
    """
    features = model.scene.features
    if model.settings.law != "solref" or not features.limit or not features.actuation:
        return
    joints, settings = Layout(model.scene).joints, model.settings
    dt = settings.dt if settings.refsafe else 0.0
    found = []
    for k in range(model.nu):
        index = int(model.actuator_joint[k])
        if index < 0 or model.actuator_actadr[k] >= 0:
            continue
        kind, joint = model.jnt_type[index], joints[index]
        low, high = (float(bound) for bound in model.jnt_range[index])
        if kind not in ("hinge", "slide") or not np.isfinite([low, high]).all():
            continue
        force = _largest(model, k, low, high)
        load = force * float(model.dof_invweight0[model.jnt_dofadr[index]])
        if not math.isfinite(load):
            continue
        width = min(high - low, WIDEST) if kind == "hinge" else high - low
        beyond = yielding(joint.solreflimit, joint.solimplimit, load, dt)
        if beyond > BEYOND * width:
            found.append((beyond / width, k, index, force, beyond, width))
    if not found:
        return
    found.sort(reverse=True)
    _, k, index, force, beyond, width = found[0]
    names = [model.element_name("actuator", one[1]) for one in found]
    hinge = model.jnt_type[index] == "hinge"
    length, wanted = radians if hinge else metres, LEFT * BEYOND * width
    joint = joints[index]
    solref, solimp = joint.solreflimit, joint.solimplimit
    cure = advised("limit", solref, solimp, beyond, wanted, settings, length(wanted))
    strength = quantity(force, TORQUES if hinge else FORCES)
    range_ = "forcerange" if model.actuator_bias[k, 1] < 0 else "ctrlrange"
    yield Finding(
        "limit",
        "warning",
        model.element_name("limit", index),
        f"{names[0][:1].upper()}{names[0][1:]}{others(names, 'actuators')} can push "
        f"{model.element_name('joint', index)} {length(beyond)} beyond its range with {strength}: "
        f"a smaller {range_} of {names[0]}, or {cure}.",
        beyond,
        "rad" if hinge else "m",
    )


def _largest(model: Model, k: int, low: float, high: float) -> float:
    """The largest force that an actuator pushes outwards with at an end of a joint's range."""
    gear, gain, bias = (
        float(model.actuator_gear[k, 0]),
        model.actuator_gain[k],
        model.actuator_bias[k],
    )
    controls = model.actuator_ctrlrange[k]
    if not model.scene.features.clampctrl or not np.isfinite(controls).all():
        if bias[1] < 0 or not np.isfinite(model.actuator_forcerange[k]).all():
            # A servo pushes as far as it is asked to, which nothing tells.
            return 0.0
        controls = np.array([-np.inf, np.inf])
    most = 0.0
    for end, outwards in ((low, -1.0), (high, 1.0)):
        for control in controls:
            with np.errstate(invalid="ignore"):
                force = gain * control + bias[0] + bias[1] * gear * end
            force = float(np.clip(force, *model.actuator_forcerange[k])) * gear * outwards
            most = max(most, force)
    return most
