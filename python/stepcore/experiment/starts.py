"""The starts of runs, and the default controls: both are drawn from a seed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.coordinates import Coordinates, Start

# How far the seeded starts are from the keyframe: small beside a robot, long beside a step.
SHIFT, TURN = 1e-3, 1e-2  # [m], [rad]
SPEED, SPIN = 0.05, 0.1  # [m/s], [rad/s]
SINES = 3


def home(model: Model, key: str | int | None) -> tuple[Start, np.ndarray]:
    """A key's state and controls; by default the first key's, or the scene's pose at rest."""
    if key is None and not model.keys:
        return Start(model.qpos0, np.zeros(model.nv)), np.zeros(model.nu)
    frame = model.keys[0 if key is None else model.index("key", key)]
    return Start(frame.qpos, frame.qvel, frame.act), frame.ctrl


def near(model: Model, coordinates: Coordinates, home: Start, rng: np.random.Generator) -> Start:
    """A start near `home`, within the joints' ranges and no deeper in contact than it.

    By 0.1 mm at most where contacts are springs. A law that undoes a share of an overlap in a step
    throws a body out of it at a speed that grows as 1/dt: there, no deeper at all.
    """
    sim = Sim(model)

    def depth(start: Start) -> float:
        sim.qpos[:] = start.qpos
        sim.forward()
        dist = sim.contacts["dist"]
        return -float(dist.min()) if len(dist) else 0.0

    slack = 1e-4 if model.settings.law in ("solref", "penalty") else 1e-12
    allowed = max(0.0, depth(home)) + slack
    tried = []
    for _ in range(64):
        step, rate = coordinates.drawn(rng, SHIFT, TURN), coordinates.drawn(rng, SPEED, SPIN)
        moved = coordinates.inside(coordinates.moved(home.qpos, step))
        start = Start(moved, home.qvel + rate, home.act)
        tried.append((depth(start), start))
        if tried[-1][0] <= allowed:
            return start
    return min(tried, key=lambda pair: pair[0])[1]


def given(ctrl: ArrayLike, periods: int, nu: int) -> np.ndarray:
    """The user's controls, one row a period; the last is held if there are too few."""
    try:
        values = np.asarray(ctrl, float)
    except (TypeError, ValueError):
        raise checks.refuse("motion", "ctrl", ctrl, f"numbers of shape (n, {nu})") from None
    if values.ndim == 1 and nu == 1:
        values = values[:, None]
    if values.ndim != 2 or values.shape[1] != nu or len(values) == 0:
        raise ValueError(f"ctrl has shape {values.shape}: must be (n, {nu}), one row a period")
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, column = bad[0]
        raise ValueError(f"ctrl[{row}, {column}] = {values[row, column]}: must be finite")
    return values[np.minimum(np.arange(periods), len(values) - 1)]


def smooth(
    model: Model, held: np.ndarray, periods: int, period: float, rng: np.random.Generator
) -> np.ndarray:
    """A few sines in every actuator's range, around the keyframe's control; shape (periods, nu).

    An actuator without a range swings by a quarter of the keyframe's control.
    """
    times = period * np.arange(periods)
    values = np.empty((periods, model.nu))
    for k in range(model.nu):
        hertz = rng.uniform(0.3, 3.0, SINES)
        phase = rng.uniform(0.0, 2 * math.pi, SINES)
        share = rng.dirichlet(np.ones(SINES))
        wave = np.sin(2 * math.pi * np.outer(times, hertz) + phase) @ share
        if _clamped(model, k):
            low, high = model.actuator_ctrlrange[k]
            centre = held[k] if held[k] else (low + high) / 2
            values[:, k] = np.clip(centre + 0.4 * (high - low) * wave, low, high)
        else:
            values[:, k] = held[k] + 0.25 * abs(held[k]) * wave
    return values


def undriven(model: Model, held: np.ndarray) -> list[str]:
    """Actuators that `smooth` holds still: nothing says how far they may go."""
    return [
        name
        for k, name in enumerate(model.called("actuator"))
        if not _clamped(model, k) and held[k] == 0
    ]


def _clamped(model: Model, actuator: int) -> bool:
    """Whether an actuator's control is held to a range."""
    given = bool(np.isfinite(model.actuator_ctrlrange[actuator]).all())
    return given and model.scene.features.clampctrl
