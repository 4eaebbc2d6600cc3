"""Numbers that look like millimetres where metres are meant, or like the other unit of an angle."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from stepcore.engine.model import Model
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.sizes import Sizes
from stepcore.measure.findings.finding import Finding, others
from stepcore.report.units import metres

# Gravity in m/s² is near this; in mm/s² it is above that.
EARTH, MILLI = (1.0, 50.0), 500.0
# Sizes of things that move which millimetres look like, and which metres look like [m].
LARGE, SMALL = 10.0, 5.0
# Radians written where degrees are read, in degrees: never more than a turn, seldom less than this.
TURN, LEAST = 2 * math.pi * 1.001, 0.5
# Degrees written where radians are read, in radians: more turns than a joint with limits makes.
TURNS = 20.0
# A control range in degrees over a joint range in radians.
DEGREES, NEAR = 180 / math.pi, 0.1


def about_units(model: Model, sizes: Sizes) -> Iterator[Finding]:
    """Lengths and angles."""
    yield from _lengths(model, sizes)
    yield from _radians(model)
    yield from _degrees(model)
    yield from _controls(model)


def _lengths(model: Model, sizes: Sizes) -> Iterator[Finding]:
    moving = set(Coordinates(model).moving)
    reaches = [
        reach
        for reach, body in zip(sizes.reach, model.geom_body.tolist(), strict=True)
        if body in moving and math.isfinite(reach)
    ]
    gravity = float(np.linalg.norm(model.scene.gravity)) if model.scene.features.gravity else 0.0
    if not reaches or not gravity:
        return
    typical = float(np.median(reaches))
    if EARTH[0] < gravity < EARTH[1] and typical >= LARGE:
        yield Finding(
            "units",
            "error",
            "",
            f"Half of the geoms that move are larger than {metres(typical)}, under a gravity of "
            f"{gravity:.3g} m/s²: sizes and positions look like mm; divide lengths by 1000 "
            "(masses that come from density fall by 1e9), or check that it is so large.",
            typical,
            "m",
        )
    if gravity > MILLI and typical < SMALL:
        yield Finding(
            "units",
            "error",
            "",
            f"Gravity is {gravity:.4g} m/s² while half of the geoms that move are smaller than "
            f'{metres(typical)}: gravity looks like mm/s²; write gravity="0 0 -9.81" where lengths '
            "are in m.",
            gravity,
            "m/s²",
        )


def _hinges(model: Model) -> list[int]:
    """Hinges with limits."""
    if not model.scene.features.limit:
        return []
    finite = np.isfinite(model.jnt_range).all(axis=1)
    return [k for k, kind in enumerate(model.jnt_type) if kind == "hinge" and finite[k]]


def _radians(model: Model) -> Iterator[Finding]:
    """All ranges of hinges are below a turn if they were written as radians."""
    ranges = {k: np.degrees(model.jnt_range[k]) for k in _hinges(model)}
    if not ranges:
        return
    most = [float(np.abs(bounds).max()) for bounds in ranges.values()]
    if max(most) > TURN or max(most) < LEAST:
        return
    names = [model.element_name("joint", k) for k in ranges]
    low, high = next(iter(ranges.values()))
    yield Finding(
        "units",
        "warning",
        names[0],
        f"The range of {names[0]}{others(names, 'joints')} is {low:.4g} to {high:.4g} degrees: if "
        'radians were meant, write <compiler angle="radian"/>.',
        max(most),
        "deg",
    )


def _degrees(model: Model) -> Iterator[Finding]:
    """Ranges or keyframes of many turns."""
    wide = [k for k in _hinges(model) if np.abs(model.jnt_range[k]).max() > TURNS]
    if wide:
        names = [model.element_name("joint", k) for k in wide]
        low, high = model.jnt_range[wide[0]]
        yield Finding(
            "units",
            "warning",
            names[0],
            f"The range of {names[0]}{others(names, 'joints')} is {low:.4g} to {high:.4g} rad, "
            f"{max(abs(low), abs(high)) / 2 / math.pi:.2g} turns: if degrees were meant, write "
            '<compiler angle="degree"/> or multiply by π/180.',
            float(max(abs(low), abs(high))),
            "rad",
        )
    for index, key in enumerate(model.keys):
        turned = [
            k
            for k, kind in enumerate(model.jnt_type)
            if kind == "hinge" and abs(key.qpos[model.jnt_qposadr[k]]) > TURNS
        ]
        if turned:
            names = [model.element_name("joint", k) for k in turned]
            value = float(key.qpos[model.jnt_qposadr[turned[0]]])
            yield Finding(
                "units",
                "warning",
                names[0],
                f"Keyframe `{key.name or index}` puts {names[0]}{others(names, 'joints')} at "
                f"{value:.4g} rad: keyframes are in radians whatever the compiler's angle; "
                "multiply degrees by π/180.",
                value,
                "rad",
            )


def _controls(model: Model) -> Iterator[Finding]:
    """Servos whose control range is the joint's range in degrees: it is not converted."""
    found = []
    for k in range(model.nu):
        joint = int(model.actuator_joint[k])
        if joint < 0:
            continue
        bounds, limits = model.actuator_ctrlrange[k], model.jnt_range[joint]
        servo = model.actuator_bias[k, 1] < 0 and model.jnt_type[joint] == "hinge"
        if not servo or not np.isfinite([*bounds, *limits]).all():
            continue
        ratio = float(np.abs(bounds).max() / np.abs(limits).max())
        if abs(ratio / DEGREES - 1) < NEAR:
            found.append((k, bounds))
    if found:
        names = [model.element_name("actuator", k) for k, _ in found]
        low, high = found[0][1]
        yield Finding(
            "units",
            "error",
            names[0],
            f"The ctrlrange of {names[0]}{others(names, 'servos')} is {low:.4g} to {high:.4g} rad, "
            "its joint's range in degrees: control ranges are in radians whatever the compiler's "
            "angle; multiply by π/180.",
            float(max(abs(low), abs(high))),
            "rad",
        )
