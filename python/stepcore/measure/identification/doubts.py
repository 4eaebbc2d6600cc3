"""What is doubtful: units and gaps of logs, motions that cannot be predicted to their end, and
estimates: their errors, correlations, and what cannot be told apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stepcore.engine.model import Model
from stepcore.experiment.predictable import GROWTH
from stepcore.measure.identification.log import MeasuredLog, Series
from stepcore.measure.identification.predictions import Predictions
from stepcore.measure.monitors.finding import Finding, named
from stepcore.report.units import seconds, times

DEGREES = 180 / np.pi
# A ratio is that of two units if it is this close to it.
NEAR = 0.2
# A measured number this many times outside a joint's range is in another unit.
OUTSIDE = 3.0
# Scaled by a ratio of units, what is predicted is off by at most this share of what it was.
BETTER = 0.5
RATIOS = {
    DEGREES: "degrees",
    1 / DEGREES: "degrees in the model",
    1e3: "mm",
    1e-3: "mm in the model",
}
# Estimates whose correlation is above this cannot be told apart.
ALIKE = 0.99
# Directions of which a log says less than this share of what it says of the best known.
WEAK = 1e-6
# A gap of the controls is this many times as long as most of their rows are apart.
GAP = 10


def log_findings(model: Model, logs: Sequence[MeasuredLog]) -> list[Finding]:
    """Return findings on units that the logs alone show."""
    found = []
    for log in logs:
        for joint in [k for k, kind in enumerate(model.jnt_type) if kind == "hinge"]:
            what, value, cure = _unit_of(model, log, joint)
            if what:
                element = named(model, "joint", [joint])
                problem = f"{element[0].name}: in {log.name} {what}"
                found.append(Finding("units", "error", problem, cure, element, value))
    return found


def _unit_of(model: Model, log: MeasuredLog, joint: int) -> tuple[str, float, str]:
    """Return what of a hinge's numbers is in another unit, by which number, and which."""
    qpos, qvel = log.measured["qpos"], log.measured.get("qvel")
    q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    largest = float(np.nanmax(np.abs(qpos.values[:, q])))
    limit, degrees = float(np.abs(model.jnt_range[joint]).max()), "it looks like degrees"
    if limit > 0 and OUTSIDE * limit < largest < OUTSIDE * DEGREES * limit:
        what = f"its position reaches {largest:.3g} rad, its range {limit:.3g} rad"
        return what, largest, degrees
    ratio = None if qvel is None else _ratio(qpos, q, qvel, v)
    if ratio is None:
        return "", 0.0, ""
    if _near(ratio, DEGREES):
        return f"its position changes {times(ratio)} its velocity", ratio, degrees
    if _near(ratio, 1 / DEGREES):
        what = f"its velocity is {times(1 / ratio)} the change of its position"
        return what, ratio, degrees
    if _near(ratio, 1e-3) or _near(ratio, 1e3):
        what = f"the position changes {times(ratio)} the measured velocity"
        return what, ratio, "times must be in seconds"
    return "", 0.0, ""


def _ratio(qpos: Series, q: int, qvel: Series, v: int) -> float | None:
    """Return how many times the change of a position is the velocity, in the least squares."""
    known = np.isfinite(qpos.values[:, q])
    moved, at = qpos.values[known, q], qpos.times[known]
    have = np.isfinite(qvel.values[:, v])
    if known.sum() < 3 or have.sum() < 3:
        return None
    rate, middle = np.diff(moved) / np.diff(at), (at[1:] + at[:-1]) / 2
    speed = np.interp(middle, qvel.times[have], qvel.values[have, v])
    if not speed @ speed > 0 or not rate @ rate > 0:
        return None
    ratio = float(rate @ speed / (speed @ speed))
    # Rows so far apart that they miss the motion show nothing.
    alike = (rate @ speed) ** 2 / ((rate @ rate) * (speed @ speed))
    return ratio if alike > BETTER and ratio > 0 else None


def _near(ratio: float, unit: float) -> bool:
    return abs(ratio / unit - 1) < NEAR


def fit_findings(fit: Predictions, predicted: np.ndarray) -> list[Finding]:
    """Return findings on quantities whose prediction fits when it is in another unit.

    predicted: with the first guess, which the fit has not bent to these units.
    """
    found = []
    for kind, label in enumerate(fit.quantities):
        own = fit.known & (fit.kinds == kind)
        made, known = predicted[own], fit.measured[own]
        if not made @ made > 0:
            continue
        ratio = float(known @ made / (made @ made))
        left, before = np.sum((known - ratio * made) ** 2), np.sum((known - made) ** 2)
        word = next((word for unit, word in RATIOS.items() if _near(ratio, unit)), None)
        if word is not None and left < BETTER**2 * before:
            problem = f"{label}: measured {times(ratio)} the prediction"
            cure = f"it looks like another unit, {word}"
            found.append(Finding("units", "error", problem, cure, (), ratio))
    return found


def gap_findings(logs: Sequence[MeasuredLog]) -> list[Finding]:
    """Return findings on controls that are missing for long."""
    cure, found = "the last ones before it were held; split the log there if they were not", []
    for log in logs:
        times = log.controls.times
        apart = np.diff(times)
        for k in np.flatnonzero(apart > GAP * np.median(apart)) if len(apart) else ():
            gap = f"{log.name} has no controls for {seconds(apart[k])} from {seconds(times[k])} on"
            found.append(Finding("gap", "warning", gap, cure))
    return found


def predictable(fit: Predictions, x: np.ndarray) -> list[float]:
    """Return until when each log can be predicted [s]; inf to its end.

    Until an error of the first positions has grown a thousand times in the positions, as in
    `stepcore.predict`.
    """
    ends, nv, first = [], fit.base.nv, len(fit.labels)
    for run in fit.runs(x):
        growth = np.linalg.norm(run.slopes[:, :nv, first : first + nv], 2, axis=(1, 2))
        late = np.flatnonzero(~(growth <= GROWTH))
        ends.append(float(late[0] * run.dt) if len(late) else np.inf)
    return ends


def horizon_findings(logs: Sequence[MeasuredLog], ends: Sequence[float]) -> list[Finding]:
    """Return findings on logs that are longer than they can be predicted."""
    found = []
    for log, end in zip(logs, ends, strict=True):
        if end < log.duration:
            problem = (
                f"{log.name} can be predicted for {seconds(end)} of {seconds(log.duration)}: from "
                f"then on what is off at its beginning has grown {times(GROWTH)}"
            )
            cure = f"cut it into pieces of {seconds(end)} or less, and give them as a list"
            found.append(Finding("horizon", "warning", problem, cure, (), end, "s"))
    return found


@dataclass(frozen=True)
class Certainty:
    """What the logs say of the estimates.

    errors: the standard error of each; inf where the logs say nothing.
    correlations: between each two, shape (n, n).
    alike: sets of parameters that cannot be told apart.
    inverse: J⁺: times a residual, by how much all values are too large for it; 0 where nothing is
        known.
    """

    errors: np.ndarray
    correlations: np.ndarray
    alike: list[tuple[str, ...]]
    inverse: np.ndarray


def certainty(
    jacobian: np.ndarray,
    residual: np.ndarray,
    kinds: np.ndarray,
    labels: Sequence[str],
    spreads: Sequence[float],
) -> Certainty:
    """Return the certainty of estimates from the Jacobian of the residuals.

    jacobian: shape (n, all), of which the first columns are of the parameters `labels`.
    residual: shape (n,). kinds: the quantity of each residual, whose variance is its own.
    spreads: of each quantity, how many times the variance of a mean is that of white noise.

    The estimates are off by J⁺ e, whose covariance is J⁺ V J⁺ᵀ with the variances V of e.
    """
    spare = max(1, len(residual) - jacobian.shape[1]) / len(residual)
    variances = np.array(
        [
            spread * np.mean(residual[kinds == kind] ** 2) / spare
            for kind, spread in enumerate(spreads)
        ]
    )
    inverse, turns, weak = _inverse(jacobian)
    count = len(labels)
    own = inverse[:count]
    covariance = (own * variances[kinds]) @ own.T
    unknown = (np.abs(turns[weak][:, :count]) > WEAK).any(axis=0)
    spread = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        related = np.nan_to_num(covariance / np.outer(spread, spread))
    np.fill_diagonal(related, 1.0)
    # A part of this size leaves a correlation as large.
    ways = np.abs(turns[weak][:, :count]) > math.sqrt(1 - ALIKE)
    alike = [tuple(labels[int(k)] for k in np.flatnonzero(way)) for way in ways if way.any()]
    for i in range(count):
        for k in range(i):
            pair = (labels[k], labels[i])
            known = any(set(pair) <= set(names) for names in alike)
            if abs(related[i, k]) > ALIKE and not known:
                alike.append(pair)
    return Certainty(np.where(unknown, np.inf, spread), related, alike, inverse)


def _inverse(jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pseudo-inverse; directions in units of the columns' sizes, and the weak ones."""
    sizes = np.linalg.norm(jacobian, axis=0)
    sizes = np.where(sizes > 0, sizes, 1.0)
    left, singular, turns = np.linalg.svd(jacobian / sizes, full_matrices=False)
    weak = singular <= WEAK * max(singular.max(initial=0.0), 1e-300)
    inverse = (turns[~weak].T / singular[~weak]) @ left[:, ~weak].T
    return inverse / sizes[:, None], turns, weak
