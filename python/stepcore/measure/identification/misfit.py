"""`Misfit`: the part of the residuals beyond the noise, and the value that would explain it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.model import Model
from stepcore.engine.parameters import named_columns
from stepcore.engine.sim import Sim
from stepcore.experiment.change import Change
from stepcore.measure.identification.doubts import WEAK
from stepcore.measure.identification.log import DELAY, is_delay
from stepcore.measure.identification.predictions import Predictions

# Noise is mistaken for a signal in one of ten thousand logs, with a hundred values and lags tried.
SURE = NormalDist().inv_cdf(1 - 1e-6)
# The lags over which autocorrelations are summed, for misfits that change quickly and slowly.
LAGS = 4.0 ** np.arange(3)


@dataclass(frozen=True)
class Misfit:
    """The residual of one quantity, in its unit.

    residual: RMS. noise: RMS of the part that differs at random from row to row, by differences of
    neighbouring measured rows of up to the fourth order (Gasser, Sroka & Jennen-Steinmetz 1986), at
    most the residual. step: RMS change of the prediction with shorter steps; NaN if not computed.
    white: whether the residual's autocorrelation is consistent with white noise. spread: the
    variance of a mean relative to white noise.
    """

    residual: float
    noise: float
    step: float
    white: bool
    spread: float

    @property
    def unexplained(self) -> float:
        """RMS of the residual beyond the noise."""
        return 0.0 if self.white else math.sqrt(max(0.0, self.residual**2 - self.noise**2))

    @property
    def severity(self) -> float:
        """The unexplained residual over the noise."""
        return self.unexplained / (self.noise or math.ulp(0.0))

    @property
    def ratio(self) -> float:
        """The residual over the noise."""
        return self.residual / self.noise if self.noise else math.inf


def misfits(fit: Predictions, after: np.ndarray, steps: Mapping[str, float]) -> dict[str, Misfit]:
    """Return the misfit of each quantity.

    after: the predictions. steps: their RMS changes with shorter steps.
    """
    off = np.split(after - fit.measured, np.cumsum([len(part.times) for part in fit.parts])[:-1])
    by_label = {}
    for label in fit.quantities:
        indices = [k for k, part in enumerate(fit.parts) if part.label == label]
        rows = [off[k][np.isfinite(off[k])] for k in indices]
        square = _mean([row**2 for row in rows])
        noise = min(
            square,
            *(
                _mean([np.diff(row, order) ** 2 for row in rows]) / math.comb(2 * order, order)
                for order in range(1, 5)
            ),
        )
        # Rounded numbers differ by at least their last digit, or not at all.
        values = [fit.parts[k].values for k in indices]
        apart = np.concatenate([np.abs(np.diff(each[np.isfinite(each)])) for each in values])
        digit = np.min(apart[apart > 0], initial=np.inf)
        if math.isfinite(digit):
            noise = min(square, max(noise, digit**2 / 12))
        white, spread = True, 1.0
        if square > (WEAK * fit.scales[label]) ** 2:
            white, spread = _autocorrelation(rows, square)
        by_label[label] = Misfit(math.sqrt(square), math.sqrt(noise), steps[label], white, spread)
    return by_label


def _mean(rows: Sequence[np.ndarray]) -> float:
    every = np.concatenate(rows)
    return float(every.mean()) if len(every) else math.inf


def _autocorrelation(rows: Sequence[np.ndarray], square: float) -> tuple[bool, float]:
    """Return whether residuals are white, and the variance of their means relative to white noise.

    For white noise the sum of the autocorrelations at m lags has a variance of m/n.
    """
    count = sum(map(len, rows))
    most = min(max(map(len, rows)) // 4, int(LAGS[-1] ** 2))
    if most < 1:
        return True, 1.0
    each = [
        sum(float(row[lag:] @ row[:-lag]) for row in rows) / (count * square)
        for lag in range(1, most + 1)
    ]
    sums = np.cumsum(each)
    lags = LAGS[most >= LAGS].astype(int)
    if (sums[lags - 1] * np.sqrt(count / lags)).max() <= SURE:
        return True, 1.0
    return False, 1.0 + 2.0 * float(sums.max())


def beyond(by_label: Mapping[str, Misfit], usual: Mapping[str, Misfit]) -> float:
    """Return the squared residuals beyond the noise, relative to the noise of `usual`."""
    noise = {key: max(each.noise, WEAK * each.residual) for key, each in usual.items()}
    ratios = [each.residual / (noise[key] or 1.0) for key, each in by_label.items()]
    return sum(max(0.0, ratio**2 - 1) for ratio in ratios)


def refines(
    fit: Predictions, by_label: Mapping[str, Misfit], finer: np.ndarray, moved: np.ndarray
) -> bool:
    """Return whether shorter steps leave less than half of the squared residual beyond the noise.

    finer: the predictions with shorter steps. moved: the values estimated for these steps, which
    are run too.
    """
    runs = [finer]
    with suppress(SimulationError):
        runs.append(fit.predicted(moved, FINER))
    for run in runs:
        off = fit.rms(fit.measured, run)
        after = {key: replace(each, residual=off[key]) for key, each in by_label.items()}
        if beyond(after, by_label) <= beyond(by_label, by_label) / 2:
            return True
    return False


# Values outside the search that a residual may point to, in words.
LOOKS = {
    "joint": {"armature": "an inertia", "damping": "a damping", "frictionloss": "a friction"},
    "body": {"mass": "a mass"},
    "actuator": dict.fromkeys(("kp", "kv", "gainprm[0]", "gear[0]"), "a gain"),
}


# The integration error is measured with steps this many times shorter.
FINER = 4
# The label of the explanation by shorter steps.
STEP = "the time step"


@dataclass(frozen=True)
class Missing:
    """The value whose addition to the search would explain most, to first order.

    label: its path; STEP if it is the length of the steps. change: its change, to first order.
    delay: the change of the delay of the controls; 0 if noise could cause it.
    share: the explained share of the squared residual beyond the noise.
    absent: whether the value is zero in the model. sure: whether noise can hardly cause it.
    shift: the change of the estimates, shape (n,).
    """

    label: str
    change: float
    delay: float
    share: float
    absent: bool
    sure: bool
    shift: np.ndarray

    @property
    def looks(self) -> str:
        """The possible cause of the residual in words."""
        kind, field = self.label.split("/")[0], self.label.rpartition("/")[2]
        cause = LOOKS.get(kind, {}).get(field, "a delay")
        return f"{cause} that is {'missing' if self.absent else 'wrong'}"


@dataclass(frozen=True)
class Quality:
    """The quality of a fit.

    misfits: residual and noise by quantity. missing: the value whose addition would explain most of
    the rest; None if there was no time to search for it. spare: the number of measurements minus
    the number of estimates, first states included. refined: whether a run with four times shorter
    steps leaves less than half of the squared residual beyond the noise.
    """

    misfits: Mapping[str, Misfit]
    missing: Missing | None
    spare: int
    refined: bool

    @property
    def worst(self) -> str:
        """The quantity with the largest unexplained residual relative to its noise."""
        return max(self.misfits, key=lambda label: self.misfits[label].severity)

    @property
    def verdict(self) -> str:
        """The kind of residual: "noise", "step", "unexplained", or "bad" if above the noise; "few"
        if there are at least as many values to estimate as measured numbers.
        """
        if self.spare <= 0:
            return "few"
        worst, lacks = self.misfits[self.worst], self.missing
        if not worst.unexplained and not (lacks is not None and lacks.sure):
            return "noise"
        if lacks is not None and lacks.sure and lacks.share > 0.5:
            short = lacks.label == STEP
        else:
            short = all(each.unexplained <= each.step for each in self.misfits.values())
        if short and self.refined:
            return "step"
        return "bad" if worst.unexplained > worst.noise else "unexplained"


def lacking(
    fit: Predictions,
    x: np.ndarray,
    slopes: np.ndarray,
    finer: np.ndarray | None,
    by_label: Mapping[str, Misfit],
) -> Missing | None:
    """Return the additional value that would explain most, from derivatives at the estimates.

    slopes: the Jacobian at x. finer: the change of the residuals with shorter steps, None if it
    does not explain them. by_label: the misfit of each quantity, whose noise is its weight.

    Each value's column c, minus its projection on the estimates' columns, explains (cᵀr)²/cᵀc of
    the squared residual, in units of the noise: for white noise a number of a χ² distribution.
    """
    count = len(fit.labels)
    least = [max(by_label[label].noise, WEAK * fit.scales[label]) for label in fit.quantities]
    noise = fit.in_units(least)[:, None]
    model, values = _candidates(fit)
    if not values:
        return None
    wide = Predictions(model, fit.logs, [*fit.labels, *values], fit.scales, fit.threads)
    first = np.concatenate([x[:count], list(values.values()), x[count:]])
    columns = wide.jacobian(first)[:, count : count + len(values)]
    steps = [] if finer is None else [STEP]
    columns = np.column_stack([columns, *([] if finer is None else [finer])]) / noise
    basis, _ = np.linalg.qr(slopes / noise)
    residual = fit.residual(x) / noise[:, 0]
    left = residual - basis @ (basis.T @ residual)
    added = columns - basis @ (basis.T @ columns)
    sizes = np.linalg.norm(added, axis=0)
    seen = sizes > WEAK * np.linalg.norm(columns, axis=0)
    change = np.where(seen, -(left @ added) / np.where(seen, sizes, 1.0) ** 2, 0.0)
    # A value that is zero in the model can only increase; a measurement may be early or late.
    labels = [*values, *steps]
    absent = np.array([*(value in (0.0, WEAK) for value in values.values()), *map(bool, steps)])
    can = (change > 0) | ~absent | [is_delay(label) for label in labels]
    explained = np.where(can, (change * sizes) ** 2, 0.0)
    best = int(np.argmax(explained))
    explaining = columns[:, best] * change[best]
    most, enough = float(explained[best]), SURE**2 * max(each.spread for each in by_label.values())
    late = labels.index(DELAY) if DELAY in labels else best
    return Missing(
        label=labels[best],
        change=float(change[best]),
        delay=float(change[late]) if labels[late] == DELAY and explained[late] > enough else 0.0,
        share=most / max(float(left @ left) - len(left), most, math.ulp(0.0)),
        absent=bool(absent[best]),
        sure=most > enough,
        shift=np.linalg.lstsq(slopes / noise, explaining, rcond=None)[0][:count],
    )


def _candidates(fit: Predictions) -> tuple[Model, dict[str, float]]:
    """Return a model with values outside the search that a log may need, and these values."""
    model, additions, almost = fit.base, dict[str, float](), dict[str, float]()
    for kind, fields in LOOKS.items():
        for (k, name), field in itertools.product(enumerate(model.names[kind]), fields):
            label = f"{kind}/{name or f'#{k}'}/{field}"
            try:
                (column,) = named_columns(model, [label])
            except ValueError:
                continue
            if column.value:
                additions[label] = column.value
            elif kind == "joint" and model.jnt_type[k] in ("hinge", "slide"):
                additions[label] = almost[label] = WEAK
    late = [f"{DELAY}/{array}" for array in dict.fromkeys(part.array for part in fit.parts)]
    additions |= dict.fromkeys([DELAY] * bool(model.nu) + late, 0.0)
    values = {label: value for label, value in additions.items() if label not in fit.labels}
    model = Change({k: v for k, v in almost.items() if k in values}).of(model)
    sim, labels = Sim(model), [label for label in values if not label.startswith(DELAY)]
    # Some values change more than numbers, such as the gear of a force at a site.
    while labels:
        try:
            sim.linearize(labels)
            break
        except (ValueError, SimulationError) as error:
            bad = [label for label in labels if f" {label}: " in str(error)]
            if not bad:
                # The model's first pose has no derivative, but poses of the log may have one.
                break
            labels = [label for label in labels if label not in bad]
            values = {label: value for label, value in values.items() if label not in bad}
    return model, values
