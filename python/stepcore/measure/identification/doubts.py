"""Findings on logs (units, signs, delays, gaps, horizons), and the standard errors and correlations
of estimates."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stepcore.engine.actuator import SERVO, actuators
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.predictable import GROWTH
from stepcore.measure.identification.log import DELAY, MeasuredLog
from stepcore.measure.identification.predictions import Predictions
from stepcore.measure.monitors.finding import Finding, listed, named
from stepcore.report.units import seconds
from stepcore.report.units import times as times_said

DEGREES = 180 / np.pi
# Scaling by a ratio of units must reduce a prediction's error to at most this share.
ERROR_SHARE = 0.5
RATIOS = {
    DEGREES: "degrees",
    1 / DEGREES: "degrees in the model",
    1e3: "mm",
    1e-3: "mm in the model",
}
# The ratio of the change of position to the velocity, with its cause, by the kind of joint.
SECONDS = "times must be in seconds"
SCALES = {
    "hinge": {1 / DEGREES: "it looks like degrees", 1e-3: SECONDS, 1e3: SECONDS},
    "slide": {1e-3: SECONDS, 1e3: "it looks like mm"},
}
# Correlation above which two columns belong together, as a right or wrong pair.
SIGN = 0.9
# Estimates whose correlation is above this cannot be distinguished.
CORRELATED = 0.99
# Directions whose singular value is below this share of the largest are not observable.
WEAK = 1e-6


def log_findings(
    model: Model, logs: Sequence[MeasuredLog], searched: Sequence[str]
) -> list[Finding]:
    """Return findings on units, signs, order and delays of columns, from the logs alone.

    searched: the parameters, which may include a delay.
    """
    findings = []
    for log in logs:
        joints = [k for k, kind in enumerate(model.jnt_type) if kind in ("hinge", "slide")]
        # The same problem of several joints is one finding.
        alike = dict[tuple[str, str, str], tuple[list[int], str]]()
        for kind, affected, problem, fix in [
            *_velocity_doubts(model, log, joints, searched),
            *_servo_doubts(model, log),
            *_control_doubts(model, log, searched),
        ]:
            pair = " and ".join(each.name for each in named(model, "joint", affected)[1:])
            alike.setdefault((kind, fix, pair), ([], problem))[0].extend(affected)
        for (kind, fix, pair), (affected, problem) in alike.items():
            elements = named(model, "joint", affected)
            subject = f"{elements[0].name} and {pair}" if pair else listed(elements, "joint")
            text = f"{subject}: in {log.name} {problem}"
            findings.append(Finding(kind, "error", text, fix, elements))
    return findings


# The kind of a finding, the joints, the problem and the fix.
Doubt = tuple[str, list[int], str, str]


def _velocity_doubts(
    model: Model, log: MeasuredLog, joints: Sequence[int], searched: Sequence[str]
) -> Iterator[Doubt]:
    """Yield joints whose velocity is not the change of their position."""
    if "qvel" not in log.measured or len(log.measured["qpos"].times) < 4:
        return
    (times, qpos), (clock, qvel) = log.measured["qpos"], log.measured["qvel"]
    middle = (times[1:] + times[:-1]) / 2
    rates = (np.diff(qpos, axis=0) / np.diff(times)[:, None])[:, model.jnt_qposadr[joints]]
    speeds, changes = np.zeros((2, *rates.shape))
    every = qvel[:, model.jnt_dofadr[joints]].T
    series = [(clock[there := np.isfinite(speed)], speed[there]) for speed in every]
    for k, (at, speed) in enumerate(series):
        if len(at) > 2:
            speeds[:, k] = np.interp(middle, at, speed)
            changes[:, k] = np.interp(middle, at, np.gradient(speed, at))
    rates = np.nan_to_num(rates)
    lengths = np.linalg.norm(rates, axis=0)[:, None] * np.linalg.norm(speeds, axis=0)
    alike = np.divide(rates.T @ speeds, lengths, out=np.zeros_like(lengths), where=lengths > 0)
    for kind, pair, problem in _disordered(alike, "velocity", "the change of its position"):
        yield kind, [joints[k] for k in pair], problem, "check the names and signs of the columns"
    for k, joint in enumerate(joints):
        moved, most = np.abs(rates[:, k] * np.diff(times)), np.abs(speeds[:, k]).max()
        usual = np.median(moved[moved > 0]) if moved.any() else np.inf
        # A position jumps if it changes ten times more than by its velocity, and than usual.
        if most > 0 and moved.max() > 10 * max(usual, most * np.diff(times).max()):
            at = f"{moved.max():.3g} within a row at {seconds(middle[int(moved.argmax())])}"
            yield "jump", [joint], f"its position jumps by {at}", "leave cells empty that are wrong"
            continue
        # Rows whose spacing is too large for the motion show nothing.
        if alike[k, k] <= math.sqrt(ERROR_SHARE):
            continue
        ratio = float(alike[k, k] * lengths[k, k] / (speeds[:, k] @ speeds[:, k]))
        for unit, fix in SCALES[model.jnt_type[joint]].items():
            if _near(ratio, unit):
                problem = f"its position changes {times_said(ratio)} its velocity"
                if ratio < 1:
                    problem = f"its velocity is {times_said(1 / ratio)} the change of its position"
                yield "units", [joint], problem, fix
        off, slope = rates[:, k] - speeds[:, k], changes[:, k]
        late = float(off @ slope / (slope @ slope)) if slope.any() else 0.0
        # The delay must exceed a row, and five times its error from noise.
        enough = 5 * math.sqrt(float(off @ off) / len(off) / max(float(slope @ slope), 1e-300))
        delays = any(label.startswith(f"{DELAY}/") for label in searched)
        if not delays and abs(late) > max(enough, float(np.median(np.diff(times)))):
            # The shift must give at least half of the expected reduction; it gives none if the
            # rows are too sparse for the motion.
            shifted = rates[:, k] - np.interp(middle + late, *series[k])
            less = float(off @ off - shifted @ shifted)
            if less < late * float(off @ slope) / 2:
                continue
            word, array = ("velocity", "qvel") if late > 0 else ("position", "qpos")
            problem = f"its {word} is {seconds(abs(late))} late"
            yield "delay", [joint], problem, f'search "delay/{array}" too'


def _servo_doubts(model: Model, log: MeasuredLog) -> Iterator[Doubt]:
    """Yield hinges whose positions follow their servos' targets in another unit."""
    times, qpos = log.measured["qpos"]
    for drive in actuators(model):
        if drive.kind != SERVO or drive.joint is None or model.jnt_type[drive.joint] != "hinge":
            continue
        finite = np.isfinite(positions := qpos[:, drive.qposadr])
        controls = np.interp(times[finite], log.controls.times, log.controls.rows[:, drive.index])
        targets = np.array([drive.target(each) for each in controls.tolist()]) / drive.gear
        if finite.sum() < 8 or not targets.std() or not positions[finite].std():
            continue
        alike = float(np.corrcoef(targets, positions[finite])[0, 1])
        ratio = alike * float(positions[finite].std() / targets.std())
        unit = next((unit for unit in (DEGREES, 1 / DEGREES) if _near(ratio, unit)), None)
        if alike > SIGN and unit is not None:
            problem = f"its position is {times_said(ratio)} the target of its servo"
            yield "units", [drive.joint], problem, f"it looks like {RATIOS[unit]}"


def _control_doubts(model: Model, log: MeasuredLog, searched: Sequence[str]) -> Iterator[Doubt]:
    """Yield joints whose controls differ in sign, order, unit or time from the required ones."""
    times, qpos = log.measured["qpos"]
    drives = [each for each in actuators(model) if each.direct and each.gain and each.gear]
    usable = np.isfinite(qpos).all() and len(times) > 8
    if not drives or not usable or model.settings.law != "solref":
        return
    moved = Coordinates(model).change(qpos[:-2], qpos[2:])
    qvel, at = moved / (times[2:] - times[:-2])[:, None], times[1:-1]
    if "qvel" in log.measured and np.isfinite(log.measured["qvel"].values).all():
        clock, seen = log.measured["qvel"]
        qvel = np.column_stack([np.interp(at, clock, column) for column in seen.T])
    qacc, sim = np.gradient(qvel, at, axis=0), unwatched(Sim(model))
    rows = np.unique(np.linspace(1, len(at) - 2, 200).astype(int))
    force = np.empty((len(rows), model.nv))
    for row, k in enumerate(rows):
        sim.qpos[:], sim.qvel[:] = qpos[k + 1], qvel[k]
        sim.forward()
        force[row] = sim.inverse(qacc[k])
    gain, gear, offset, kp, kv = np.array(
        [(each.gain, each.gear, each.offset, each.kp, each.kv) for each in drives]
    ).T
    dofs, places = [each.dof for each in drives], [each.qposadr for each in drives]
    feedback = kp * gear * qpos[rows + 1][:, places] + kv * gear * qvel[rows][:, dofs]
    needed = (force[:, dofs] / gear - offset + feedback) / gain
    inputs, step = [each.index for each in drives], model.settings.dt
    period = float(np.median(np.diff(at)))

    def controls_at(late: float) -> np.ndarray:
        """Return the controls when they act late after their rows [s]."""
        return np.array([log.controls.steps(float(at[k]) - late, step, 1)[0, inputs] for k in rows])

    alike = _correlations(needed, now := controls_at(0.0))
    joints = [each.joint or 0 for each in drives]
    for kind, pair, problem in _disordered(alike, "control", "the one that its motion needs"):
        fix = "check the names and signs of the control columns"
        yield kind, [joints[k] for k in pair], problem, fix
    ratios = now.std(axis=0) / np.maximum(needed.std(axis=0), 1e-300)
    for k, ratio in enumerate(ratios.tolist()):
        if alike[k, k] > SIGN and (_near(ratio, 1e3) or _near(ratio, 1e-3)):
            problem = f"its control is {times_said(ratio)} what its motion needs"
            yield "units", [joints[k]], problem, "it looks like another unit"
    if DELAY in searched:
        return
    # A wrong model moves a peak too, but not by several rows in all joints.
    lags = period * np.arange(-10, 11)
    better = np.array([np.diag(_correlations(needed, controls_at(late))) for late in lags.tolist()])
    peaks, missed = lags[better.argmax(axis=0)], 1 - better.mean(axis=1)
    together = (
        bool((np.sign(peaks) == np.sign(peaks[0])).all()) and np.abs(peaks).min() > 2.5 * period
    )
    if together and missed[len(lags) // 2] > 4 * missed.min():
        late = float(np.median(peaks))
        problem = f"its motion is about {seconds(abs(late))} {'late' if late > 0 else 'early'}"
        for joint in joints:
            yield "delay", [joint], f"{problem}, beside its controls", f'search "{DELAY}" too'


def _correlations(table: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the correlation of each column of one table with each column of the other."""
    table, other = (
        (each - each.mean(axis=0)) / np.maximum(each.std(axis=0), 1e-300) for each in (table, other)
    )
    alike: np.ndarray = table.T @ other / len(table)
    return alike


def _disordered(alike: np.ndarray, name: str, other: str) -> Iterator[tuple[str, list[int], str]]:
    """Yield joints with another joint's column, or with the other sign: kind, numbers, problem.

    alike: correlations of each joint's first number with each joint's second, near 1 on a diagonal.
    """
    diagonal = np.diag(alike)
    for k in np.flatnonzero(diagonal < -SIGN).tolist():
        yield "sign", [k], f"its {name} has the opposite sign of {other}"
    for j, k in itertools.combinations(range(len(diagonal)), 2):
        crossed = min(alike[j, k], alike[k, j])
        # Columns of fingers that move together correlate as strongly as right pairs.
        if crossed > SIGN and 1 - max(diagonal[j], diagonal[k]) > 4 * (1 - crossed):
            yield "swapped", [j, k], f"the {name} of each is {other} of the other"


def _near(ratio: float, unit: float) -> bool:
    return abs(ratio / unit - 1) < 0.2


def fit_findings(fit: Predictions, predicted: np.ndarray) -> list[Finding]:
    """Return findings on quantities whose prediction fits in another unit.

    predicted: with the first guess, which the fit has not adapted to these units.
    """
    findings = []
    for kind, label in enumerate(fit.quantities):
        rows = fit.known & (fit.kinds == kind)
        model, values = predicted[rows], fit.measured[rows]
        if not model @ model > 0:
            continue
        ratio = float(values @ model / (model @ model))
        left, before = (np.sum((values - factor * model) ** 2) for factor in (ratio, 1.0))
        word = next((word for unit, word in RATIOS.items() if _near(ratio, unit)), None)
        if word is not None and left < ERROR_SHARE**2 * before:
            problem = f"{label}: measured {times_said(ratio)} the prediction"
            fix = f"it looks like another unit, {word}"
            findings.append(Finding("units", "error", problem, fix, (), ratio))
    return findings


def gap_findings(logs: Sequence[MeasuredLog]) -> list[Finding]:
    """Return findings on gaps in the controls that last ten times the usual row."""
    fix, findings = "the last ones before it were held; split the log there if they were not", []
    for log in logs:
        times = log.controls.times
        apart = np.diff(times)
        for k in np.flatnonzero(apart > 10 * np.median(apart)) if len(apart) else ():
            gap = f"{log.name} has no controls for {seconds(apart[k])} from {seconds(times[k])} on"
            findings.append(Finding("gap", "warning", gap, fix))
    return findings


def predictable_times(fit: Predictions, x: np.ndarray) -> list[float]:
    """Return the time until which each log can be predicted [s]; inf if to its end.

    It is the time at which an error of the first positions has grown a thousand times, as in
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
    findings = []
    for log, end in zip(logs, ends, strict=True):
        if end < log.duration:
            problem = (
                f"{log.name} can be predicted for {seconds(end)} of {seconds(log.duration)}: from "
                f"then on what is off at its beginning has grown {times_said(GROWTH)}"
            )
            fix = f"cut it into pieces of {seconds(end)} or less: --pieces (pieces=)"
            findings.append(Finding("horizon", "warning", problem, fix, (), end, "s"))
    return findings


@dataclass(frozen=True)
class Certainty:
    """The certainty of the estimates.

    errors: the standard error of each estimate; inf if the logs do not determine it.
    correlations: between the estimates, shape (n, n).
    alike: sets of parameters that cannot be distinguished.
    inverse: J⁺; its product with a residual is the error of all values; 0 if unobservable.
    """

    errors: np.ndarray
    correlations: np.ndarray
    alike: list[tuple[str, ...]]
    inverse: np.ndarray


def spare(jacobian: np.ndarray) -> int:
    """Return the number of measurements minus the number of estimates that affect them."""
    return len(jacobian) - int(jacobian.any(axis=0).sum())


def certainty(
    jacobian: np.ndarray,
    residual: np.ndarray,
    kinds: np.ndarray,
    labels: Sequence[str],
    spreads: Sequence[float],
) -> Certainty:
    """Return the certainty of estimates from the Jacobian of the residuals.

    jacobian: shape (n, all); its first columns belong to the parameters `labels`.
    residual: shape (n,). kinds: the quantity of each residual; each quantity has its variance.
    spreads: for each quantity, the variance of a mean relative to that of white noise.

    The error of the estimates is J⁺ e, whose covariance is J⁺ V J⁺ᵀ with the variances V of e.
    """
    share = max(1, spare(jacobian)) / len(residual)
    variances = np.array(
        [
            spread * np.mean(residual[kinds == kind] ** 2) / share
            for kind, spread in enumerate(spreads)
        ]
    )
    inverse, turns, weak = _inverse(jacobian)
    count = len(labels)
    estimates = inverse[:count]
    covariance = (estimates * variances[kinds]) @ estimates.T
    unknown = (np.abs(turns[weak][:, :count]) > WEAK).any(axis=0)
    spread = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        related = np.nan_to_num(covariance / np.outer(spread, spread))
    np.fill_diagonal(related, 1.0)
    # A component of this size in a weak direction corresponds to a correlation of ALIKE.
    ways = np.abs(turns[weak][:, :count]) > math.sqrt(1 - CORRELATED)
    sets = (tuple(labels[int(k)] for k in np.flatnonzero(way)) for way in ways if way.any())
    alike = list(dict.fromkeys(sets))
    for i in range(count):
        for k in range(i):
            pair = (labels[k], labels[i])
            covered = any(set(pair) <= set(names) for names in alike)
            if abs(related[i, k]) > CORRELATED and not covered:
                alike.append(pair)
    return Certainty(np.where(unknown, np.inf, spread), related, alike, inverse)


def _inverse(jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pseudo-inverse, directions in units of the columns' norms, and the weak ones."""
    sizes = np.linalg.norm(jacobian, axis=0)
    sizes = np.where(sizes > 0, sizes, 1.0)
    left, singular, turns = np.linalg.svd(jacobian / sizes, full_matrices=False)
    weak = singular <= WEAK * max(singular.max(initial=0.0), 1e-300)
    inverse = (turns[~weak].T / singular[~weak]) @ left[:, ~weak].T
    return inverse / sizes[:, None], turns, weak
