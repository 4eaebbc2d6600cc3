"""`Misfit`: how much of the residuals is more than noise, and which value would explain it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.model import Model
from stepcore.engine.parameters import named_columns
from stepcore.engine.sim import Sim
from stepcore.experiment.change import Change
from stepcore.measure.identification.doubts import WEAK
from stepcore.measure.identification.log import DELAY
from stepcore.measure.identification.predictions import Predictions

# Noise passes for more than noise once in ten thousand logs, of a hundred values and lags tried.
SURE = NormalDist().inv_cdf(1 - 1e-6)
# The lags over which autocorrelations are summed: of misfits that change quickly and slowly.
LAGS = 4.0 ** np.arange(3)


@dataclass(frozen=True)
class Misfit:
    """The residual of one quantity, in its unit.

    residual: RMS. noise: RMS of the part that differs at random from row to row, by differences of
    neighbouring rows of up to the fourth order (Gasser, Sroka & Jennen-Steinmetz 1986). step: RMS
    change of the prediction with shorter steps. white: whether the autocorrelation of the residual
    is that of noise. spread: how many times the variance of a mean is that of white noise.
    """

    residual: float
    noise: float
    step: float
    white: bool
    spread: float

    @property
    def unexplained(self) -> float:
        """RMS of what is no noise."""
        return 0.0 if self.white else math.sqrt(max(0.0, self.residual**2 - self.noise**2))

    @property
    def severity(self) -> float:
        """How many times the noise is unexplained."""
        return self.unexplained / (self.noise or math.ulp(0.0))

    @property
    def ratio(self) -> float:
        """How many times the noise the residual is."""
        return self.residual / self.noise if self.noise else math.inf


def misfits(fit: Predictions, after: np.ndarray, steps: Mapping[str, float]) -> dict[str, Misfit]:
    """Return the misfit of each quantity.

    after: the predictions. steps: their RMS changes with shorter steps.
    """
    off = np.split(after - fit.measured, np.cumsum([len(part.times) for part in fit.parts])[:-1])
    found = {}
    for label in fit.quantities:
        own = [k for k, part in enumerate(fit.parts) if part.label == label]
        rows = [off[k] for k in own]
        square = _mean([row**2 for row in rows])
        noise = min(
            _mean([np.diff(row, order) ** 2 for row in rows]) / math.comb(2 * order, order)
            for order in range(1, 5)
        )
        # Numbers that were rounded differ by their last digit, or not at all.
        apart = np.concatenate([np.abs(np.diff(fit.parts[k].values)) for k in own])
        digit = np.min(apart[apart > 0], initial=np.inf)
        if math.isfinite(digit):
            noise = min(square, max(noise, digit**2 / 12))
        white, spread = True, 1.0
        if square > (WEAK * fit.scales[label]) ** 2:
            white, spread = _autocorrelation(rows, square)
        found[label] = Misfit(math.sqrt(square), math.sqrt(noise), steps[label], white, spread)
    return found


def _mean(rows: Sequence[np.ndarray]) -> float:
    every = np.concatenate(rows)
    every = every[np.isfinite(every)]
    return float(every.mean()) if len(every) else math.inf


def _autocorrelation(rows: Sequence[np.ndarray], square: float) -> tuple[bool, float]:
    """Return whether residuals are white, and how many times their means vary as if they were.

    Of white noise the sum of the autocorrelations at m lags has a variance of m/n.
    """
    known = sum(int(np.isfinite(row).sum()) for row in rows)
    most = min(max(map(len, rows)) // 4, int(LAGS[-1] ** 2))
    if most < 1:
        return True, 1.0
    each = [
        sum(float(np.nansum(row[lag:] * row[:-lag])) for row in rows) / (known * square)
        for lag in range(1, most + 1)
    ]
    sums = np.cumsum(each)
    lags = LAGS[most >= LAGS].astype(int)
    if (sums[lags - 1] * np.sqrt(known / lags)).max() <= SURE:
        return True, 1.0
    return False, 1.0 + 2.0 * float(sums.max())


# What a log may show of values that are not searched.
LOOKS = {
    "joint": {"armature": "an inertia", "damping": "a damping", "frictionloss": "a friction"},
    "body": {"mass": "a mass"},
    "actuator": dict.fromkeys(("kp", "kv", "gainprm[0]", "gear[0]"), "a gain"),
}


# What explains a residual if steps four times shorter do.
STEP = "the time step"


@dataclass(frozen=True)
class Missing:
    """The value whose addition to the search would explain most, to first order.

    label: its path; STEP if it is the length of the steps. share: of what is more than noise.
    absent: whether it is zero in the model. sure: whether noise would hardly look like it.
    shift: how much the estimates would change, shape (n,).
    """

    label: str
    share: float
    absent: bool
    sure: bool
    shift: np.ndarray

    @property
    def looks(self) -> str:
        """What the residual looks like."""
        kind, field = self.label.split("/")[0], self.label.rpartition("/")[2]
        what = LOOKS.get(kind, {}).get(field, "a delay")
        return f"{what} that is {'missing' if self.absent else 'wrong'}"


@dataclass(frozen=True)
class Quality:
    """How good a fit is.

    misfits: how much of the residual of each quantity is noise. missing: the value whose addition
    would explain most of the rest; None if there was no time to look for it.
    """

    misfits: Mapping[str, Misfit]
    missing: Missing | None

    @property
    def worst(self) -> str:
        """The quantity of which most is unexplained, beside its noise."""
        return max(self.misfits, key=lambda label: self.misfits[label].severity)

    @property
    def verdict(self) -> str:
        """What the residual is: "noise", "step", "unexplained", or "bad" if more than the noise."""
        worst, lacks = self.misfits[self.worst], self.missing
        if not worst.unexplained and not (lacks is not None and lacks.sure):
            return "noise"
        if lacks is not None and lacks.sure and lacks.share > 0.5:
            short = lacks.label == STEP
        else:
            short = all(each.unexplained <= each.step for each in self.misfits.values())
        if short:
            return "step"
        return "bad" if worst.unexplained > worst.noise else "unexplained"


def missing(
    fit: Predictions,
    x: np.ndarray,
    own: np.ndarray,
    finer: np.ndarray,
    found: Mapping[str, Misfit],
) -> Missing:
    """Return which further value would explain most, from its derivatives at the estimates.

    own: the Jacobian at x. finer: what shorter steps change of the residuals. found: the misfit of
    each quantity, whose noise is its weight.

    Each value's column c, less what the estimates make of it, explains (cᵀr)²/cᵀc of the squared
    residual, in units of the noise: of white noise a number of a χ² distribution.
    """
    count = len(fit.labels)
    least = [max(found[label].noise, WEAK * fit.scales[label]) for label in fit.quantities]
    noise = fit.in_units(least)[:, None]
    model, values = _candidates(fit)
    wide = Predictions(model, fit.logs, [*fit.labels, *values], fit.scales, fit.threads)
    first = np.concatenate([x[:count], list(values.values()), x[count:]])
    columns = wide.jacobian(first)[:, count : count + len(values)]
    columns = np.column_stack([columns, finer]) / noise
    basis, _ = np.linalg.qr(own / noise)
    residual = fit.residual(x) / noise[:, 0]
    left = residual - basis @ (basis.T @ residual)
    added = columns - basis @ (basis.T @ columns)
    sizes = np.linalg.norm(added, axis=0)
    seen = sizes > WEAK * np.linalg.norm(columns, axis=0)
    change = np.where(seen, -(left @ added) / np.where(seen, sizes, 1.0) ** 2, 0.0)
    # What the model does not have can only be added; but what was measured may be early.
    labels = [*values, STEP]
    absent = np.array([*(value in (0.0, WEAK) for value in values.values()), True])
    can = (change > 0) | ~absent | [label.startswith(f"{DELAY}/") for label in labels]
    explained = np.where(can, (change * sizes) ** 2, 0.0)
    best = int(np.argmax(explained))
    most = float(explained[best])
    return Missing(
        label=labels[best],
        share=most / max(float(left @ left) - len(left), most, math.ulp(0.0)),
        absent=bool(absent[best]),
        sure=most > SURE**2 * max(each.spread for each in found.values()),
        shift=np.linalg.lstsq(own / noise, columns[:, best] * change[best], rcond=None)[0][:count],
    )


def _candidates(fit: Predictions) -> tuple[Model, dict[str, float]]:
    """Return a model with the values that a log may need besides those searched, and these."""
    model, found, almost = fit.base, dict[str, float](), dict[str, float]()
    for kind, fields in LOOKS.items():
        for (k, name), field in itertools.product(enumerate(model.names[kind]), fields):
            label = f"{kind}/{name or f'#{k}'}/{field}"
            try:
                (column,) = named_columns(model, [label])
            except ValueError:
                continue
            if column.value:
                found[label] = column.value
            elif kind == "joint" and model.jnt_type[k] in ("hinge", "slide"):
                found[label] = almost[label] = WEAK
    late = [f"{DELAY}/{array}" for array in dict.fromkeys(part.array for part in fit.parts)]
    found |= dict.fromkeys([DELAY] * bool(model.nu) + late, 0.0)
    values = {label: value for label, value in found.items() if label not in fit.labels}
    model = Change({k: v for k, v in almost.items() if k in values}).of(model)
    sim, labels = Sim(model), [label for label in values if not label.startswith(DELAY)]
    # Some change more than numbers, as the gear of a force at a site.
    while labels:
        try:
            sim.linearize(labels)
            break
        except (ValueError, SimulationError) as error:
            bad = [label for label in labels if f" {label}: " in str(error)]
            if not bad:
                # The first pose itself has no derivative; those of the log may.
                break
            labels = [label for label in labels if label not in bad]
            values = {label: value for label, value in values.items() if label not in bad}
    return model, values
