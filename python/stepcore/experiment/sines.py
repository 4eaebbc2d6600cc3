"""Random controls: smooth sums of sines, or new values in every control period."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stepcore.engine.model import Model

# The number of sines in a control, and their frequencies [Hz].
SINES, HERTZ = 3, (0.3, 3.0)
# The time over which they grow from the keyframe's control [s]: a jump would shock a stiff servo.
RAMP = 0.25
# The amplitude, as a share of the control range, and without one of the keyframe's control.
RANGED, UNRANGED = 0.4, 0.25


def sines(
    ranges: np.ndarray, held: np.ndarray, periods: int, period: float, rng: np.random.Generator
) -> np.ndarray:
    """Return smooth controls: a few random sines around the keyframe's control, (periods, nu).

    The sines stay within the control range. The amplitude of an actuator without a range is a
    quarter of the keyframe's control.

    ranges: of the controls, see `control_ranges`. held: the keyframe's controls, (nu,).
    period: the control period [s].
    """
    times = period * np.arange(periods)
    ramp = np.minimum(1.0, times / RAMP)
    values = np.empty((periods, len(ranges)))
    for k, (low, high) in enumerate(ranges):
        hertz = rng.uniform(*HERTZ, SINES)
        phase = rng.uniform(0.0, 2 * math.pi, SINES)
        share = rng.dirichlet(np.ones(SINES))
        wave = np.sin(2 * math.pi * np.outer(times, hertz) + phase) @ share
        wave *= ramp
        if math.isfinite(high - low):
            centre = held[k] if held[k] else (low + high) / 2
            begun = np.clip(held[k], low, high)
            middle = begun + ramp * (centre - begun)
            values[:, k] = np.clip(middle + RANGED * (high - low) * wave, low, high)
        else:
            values[:, k] = held[k] + UNRANGED * abs(held[k]) * wave
    return values


def uniform(
    ranges: np.ndarray, held: np.ndarray, periods: int, rng: np.random.Generator
) -> np.ndarray:
    """Return a new uniform draw from the control range in every period, (periods, nu).

    Actuators without a range keep their controls `held`, (nu,).
    """
    ranged = np.flatnonzero(np.isfinite(ranges).all(axis=1))
    low, high = ranges[ranged].T
    values = np.tile(held, (periods, 1))
    values[:, ranged] = rng.uniform(low, high, (periods, len(ranged)))
    return values


def undriven(names: Sequence[str], ranges: np.ndarray, held: np.ndarray) -> list[str]:
    """Return the names of the actuators without a control range and with keyframe control 0.

    `sines` keeps the controls of these actuators at 0.
    """
    free = ~np.isfinite(ranges).all(axis=1)
    return [name for k, name in enumerate(names) if free[k] and held[k] == 0]


def sines_in_words(ranges: np.ndarray, what: str, still: list[str]) -> str:
    """Describe the controls of `sines`; what: the actuators; still: those that are constant."""
    if len(still) == len(ranges):
        return f"{what} are held at zero, because nothing gives their range"
    swings = int((~np.isfinite(ranges).all(axis=1)).sum()) - len(still)
    low, high = HERTZ
    tuned = f"test motion: random sines of {low:g} to {high:g} Hz"
    if swings + len(still) == len(ranges):
        said = f"{tuned}, ±{UNRANGED:.0%} of the keyframe's controls"
    else:
        said = f"{tuned}, ±{RANGED:.0%} of the control range, as policies look"
        if swings:
            said += f" ({swings} without a range: ±{UNRANGED:.0%} of the keyframe's control)"
    if still:
        names = still[0] if len(still) == 1 else f"{len(still)} of them"
        said += f"; {names} without a range held at zero"
    return said.replace("%", " %")


def control_ranges(model: Model) -> np.ndarray:
    """Return the ranges to which controls are clamped, (nu, 2); infinite where they are not."""
    free = np.full((model.nu, 2), (-np.inf, np.inf))
    return np.asarray(model.actuator_ctrlrange) if model.scene.features.clampctrl else free
