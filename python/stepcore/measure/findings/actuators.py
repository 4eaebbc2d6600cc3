"""Findings on actuators: clamped controls, saturated forces, servos that do not hold their load."""

from __future__ import annotations

from collections.abc import Iterator

from stepcore.engine.model import Model
from stepcore.experiment.watch import Watch
from stepcore.experiment.watch.actuators import Servo
from stepcore.measure.findings.finding import Finding
from stepcore.report.units import FORCES, metres, percent, quantity, radians

TORQUES = tuple((f"{unit}·m", size) for unit, size in FORCES)
# Shares of a run from which clamping and saturation are worth saying.
CLAMPED, SATURATED = 0.05, 0.5
# How far a servo may sag: of a radian, or of the range of a slide.
SAGS = 0.1
# What a cure leaves of that.
LEFT = 0.1


def about_actuators(model: Model, watch: Watch) -> Iterator[Finding]:
    """All findings on the actuators of a run."""
    told = set()
    for servo in watch.actuators.at_rest():
        # One that presses against a thing or a limit is meant to, and may be saturated.
        finding = _sags(model, servo) if servo.loaded else None
        if finding is not None or not servo.loaded:
            told.add(servo.actuator)
        if finding is not None:
            yield finding
    for clamped in watch.actuators.clamped():
        if clamped.share < CLAMPED:
            continue
        name = model.element_name("actuator", clamped.actuator)
        low, high = model.actuator_ctrlrange[clamped.actuator]
        yield Finding(
            "clamped control",
            "warning",
            name,
            f"The control of {name} is clamped for {percent(clamped.share)} of the run, "
            f"{clamped.value:.4g} to its ctrlrange of {low:.4g} to {high:.4g}: widen the "
            "ctrlrange, or scale the control.",
            clamped.share,
            "1",
        )
    servos = set(watch.actuators.servos.tolist())
    for one in watch.actuators.saturated():
        if one.share < SATURATED or one.actuator in told or one.actuator not in servos:
            continue
        name = model.element_name("actuator", one.actuator)
        yield Finding(
            "saturation",
            "warning",
            name,
            f"{_capital(name)} is at the end of its forcerange ({force_text(model, one)}) for "
            f"{percent(one.share)} of the run, where it has no damping: a wider forcerange or a "
            "lower kp keeps it within.",
            one.share,
            "1",
        )


def _sags(model: Model, servo: Servo) -> Finding | None:
    """A servo that rests away from what its control asks for, if that is its load's doing."""
    k = servo.actuator
    joint = int(model.actuator_joint[k])
    angular = model.jnt_type[joint] == "hinge"
    low, high = (float(bound) for bound in model.jnt_range[joint])
    gear = abs(float(model.actuator_gear[k, 0])) or 1.0
    error = abs(servo.error) / gear
    notable = SAGS if angular else SAGS * min(high - low, 1.0)
    if error <= notable:
        return None
    name, length = model.element_name("actuator", k), radians if angular else metres
    value = {"value": error, "unit": "rad" if angular else "m"}
    strength = quantity(abs(servo.force), TORQUES if angular else FORCES)
    if servo.saturated:
        return Finding(
            "servo too weak",
            "error",
            name,
            f"{_capital(name)} cannot hold its load: it rests {length(error)} from where its "
            f"control asks it to be, at the end of its forcerange ({strength}): widen the "
            "forcerange, raise the gear, or lighten the load.",
            **value,  # type: ignore[arg-type]
        )
    kp = -float(model.actuator_bias[k, 1])
    enough = kp * error / (LEFT * notable)
    return Finding(
        "servo sags",
        "warning",
        name,
        f"{_capital(name)} sags by {length(error)} under its load of {strength}, which is load / "
        f"kp with kp {kp:.4g}: kp {enough:.3g} leaves {length(LEFT * notable)}, or let the control "
        "carry the load.",
        **value,  # type: ignore[arg-type]
    )


def force_text(model: Model, one: object) -> str:
    """The end of a force range that an actuator is at, with its unit."""
    joint = int(model.actuator_joint[one.actuator])  # type: ignore[attr-defined]
    units = FORCES if joint < 0 or model.jnt_type[joint] == "slide" else TORQUES
    return quantity(one.end, units)  # type: ignore[attr-defined]


def _capital(name: str) -> str:
    return name[:1].upper() + name[1:]
