"""Findings on actuators: clamped controls, saturated forces, servos that do not hold their load."""

from __future__ import annotations

from collections.abc import Iterator

from stepcore.engine.model import Model
from stepcore.experiment.watch import Watch
from stepcore.experiment.watch.actuators import Saturated, Servo
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
    servos = set(watch.actuators.servos.tolist()) - told
    saturated = [one for one in watch.actuators.saturated() if one.share >= SATURATED]
    yield from _saturated(model, [one for one in saturated if one.actuator in servos])


def _saturated(model: Model, found: list[Saturated]) -> Iterator[Finding]:
    """Servos at the ends of their force ranges, in one sentence."""
    if not found:
        return
    found = sorted(found, key=lambda one: -one.share)
    names = [model.element_name("actuator", one.actuator) for one in found]
    ends = list(dict.fromkeys(force_text(model, one).removeprefix("-") for one in found))
    shares = list(dict.fromkeys(percent(one.share) for one in reversed(found)))
    share = " to ".join(dict.fromkeys((shares[0].removesuffix(" %"), shares[-1])))
    if len(shares) == 1:
        share = shares[0]
    force = ends[0] if len(ends) == 1 else f"up to {_largest(model, found)}"
    if len(found) == 1:
        said = f"is at the end of its forcerange ({force}) for {share} of the run, where it has"
        cure = "a wider forcerange or a lower kp keeps it within"
    else:
        said = f"are at the ends of their forceranges ({force}) for {share} of the run, where they "
        said += "have"
        cure = "wider forceranges or a lower kp keep them within"
    yield Finding(
        "saturation",
        "warning",
        names[0],
        f"{_all(names)} {said} no damping: {cure}.",
        found[0].share,
        "1",
    )


def _all(names: list[str]) -> str:
    """All of some actuators by name: "Servos `a`, `b` and `c`"."""
    kinds = {name.partition(" ")[0] for name in names}
    if len(names) == 1:
        return _capital(names[0])
    if len(kinds) > 1:
        return _capital(", ".join(names[:-1])) + f" and {names[-1]}"
    own = [name.partition(" ")[2] for name in names]
    return f"{_capital(kinds.pop())}s {', '.join(own[:-1])} and {own[-1]}"


def _largest(model: Model, found: list[Saturated]) -> str:
    return force_text(model, max(found, key=lambda one: abs(one.end))).removeprefix("-")


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
