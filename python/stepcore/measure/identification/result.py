"""`Identification`: the values found in logs, as a result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from stepcore._core import Settings
from stepcore.engine.axes import units_of
from stepcore.engine.model import Model
from stepcore.experiment.log import SAID, entries_of
from stepcore.measure.identification.log import DELAY, is_delay
from stepcore.measure.identification.misfit import FINER, Quality
from stepcore.measure.monitors.finding import Finding
from stepcore.report.result import Result
from stepcore.report.settings import differing
from stepcore.report.table import Table
from stepcore.report.units import counted, seconds, times
from stepcore.scene.value_paths import WHOLE

# The cause of the residual in words, by the verdict on the fit.
LIMITS = {"noise": "its noise", "step": "the error of its time step"}
# The columns of estimates that are numbers.
NUMBERS = ("value", "low", "high", "before", "finer")


@dataclass(frozen=True)
class Estimate:
    """An estimated value.

    parameter: its path. value: the estimate. low, high: the 95 % interval. before: the first guess.
    finer: the estimate with steps four times shorter, to first order.
    """

    parameter: str
    value: float
    low: float
    high: float
    before: float
    finer: float


@dataclass(frozen=True, eq=False)
class Curve:
    """A measured number over time.

    log: its index. quantity: such as "qpos[knee]". time: [s], shape (T,). measured: NaN in gaps;
    before, after: predicted with the values before and after the fit; shape (T,).
    """

    log: int
    quantity: str
    time: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray


@dataclass(eq=False, repr=False, kw_only=True)
class Identification(Result):
    """The values that `identify` found.

    settings: the settings of the runs. logs: the number of logs. samples: the number of measured
        numbers.
    values: the estimates by path. start: the values before. bounds: the requested ranges.
    intervals: 95 % intervals by path, (low, high), widened by residuals that are not noise;
        infinite for values that the logs do not determine or whose search had no time to converge,
        if the unexplained residual exceeds the noise, and without more measurements than estimates.
    kept: parameters that the search had no time to change; they have their first values.
    quality: the noise in each quantity's residual, and the value that would explain most of the
        rest.
    alike: sets of parameters that the logs cannot distinguish.
    correlations: of the estimates, shape (n, n), in the order of `values`.
    residuals, before: RMS residual of each quantity after and before, such as "qpos[knee]" [m or
        rad], "qvel[knee]" [m/s or rad/s] and "sensordata[imu.0]".
    integration: RMS change of each prediction with steps four times shorter; NaN if there was no
        time to compute it.
    finer: the estimates by path with these steps, to first order; NaN likewise.
    predictable: the time until which each log can be predicted [s]; inf if to its end.
    findings: doubts about the logs: units, gaps, horizons; see `Finding`.
    curves: measurements and predictions over time.
    model: the model with the estimates.
    steps: the number of time steps. linearised: the number of these with derivatives. Each of these
        also steps four nearby models per parameter, in vector lanes.

    >>> import stepcore as sc
    >>> true = sc.lesson.spring().compile().with_values({"joint/spring/stiffness": 90.0})
    >>> sim = sc.Sim(true, dt=0.005, integrator="semi-implicit")
    >>> sim.reset("start")
    >>> log = sim.run(0.5)
    >>> model = sc.lesson.spring().compile().with_settings(dt=0.005, integrator="semi-implicit")
    >>> found = sc.identify(model, log, {"joint/spring/stiffness": (50, 200)})
    >>> round(found.values["joint/spring/stiffness"], 6)
    90.0
    >>> max(found.residuals.values()) < 1e-9 < max(found.integration.values())
    True
    """

    settings: Settings
    logs: int
    samples: int
    values: dict[str, float]
    start: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    intervals: dict[str, tuple[float, float]]
    alike: list[tuple[str, ...]]
    correlations: np.ndarray
    quality: Quality
    before: dict[str, float]
    finer: dict[str, float]
    predictable: list[float]
    findings: list[Finding]
    curves: list[Curve]
    kept: list[str]
    model: Model
    steps: int
    linearised: int

    kind: ClassVar[str] = "identification"
    units: ClassVar[Mapping[str, str]] = dict.fromkeys(NUMBERS, "of the model's field")

    @property
    def title(self) -> str:
        """The scene, and the numbers of estimated values and of logs."""
        return f"{self.name}: {counted(len(self.values), 'value')} from {counted(self.logs, 'log')}"

    @property
    def setup(self) -> str:
        """The method in one line."""
        steps = f"{self.steps} steps, of which {self.linearised} were linearised"
        return f"{counted(self.samples, 'measured number')}, {steps}. {differing(self.settings)}"

    @property
    def residuals(self) -> dict[str, float]:
        return {label: misfit.residual for label, misfit in self.quality.misfits.items()}

    @property
    def integration(self) -> dict[str, float]:
        return {label: misfit.step for label, misfit in self.quality.misfits.items()}

    @property
    def sentences(self) -> list[str]:
        """The quality of the fit, findings on the logs, the estimates and the residuals."""
        problems = [finding.text for finding in self.findings]
        return [self.fit, *problems, *self._estimates(), *self._doubts(), *self._remains()]

    @property
    def fit(self) -> str:
        """The quality of the fit in a sentence."""
        logs = "log" if self.logs == 1 else "logs"
        label, lacks, verdict = self.quality.worst, self.quality.missing, self.quality.verdict
        if verdict in LIMITS:
            return f"The model explains the {logs} to within {LIMITS[verdict]}."
        if verdict == "few":
            unknown = counted(self.samples - self.quality.spare, "number")
            return (
                f"The fit cannot be judged: {unknown}, first states included, were estimated from "
                f"{counted(self.samples, 'measured number')}."
            )
        worst = self.quality.misfits[label]
        text = f"{self._amount(label, worst.residual)}, {times(worst.ratio)} the noise"
        text = f"The fit is bad: {text}"
        if verdict == "unexplained":
            text = "The residual is about as small as the noise, but not random"
        if lacks is None:
            return f"{text}."
        if lacks.share < 0.5:
            return f"{text}; no single value besides these explains most of it."
        if is_delay(lacks.label):
            return f"{text}; it looks as if {shifted(lacks.label, lacks.change)}."
        return f"{text}; it looks like {lacks.looks} ({in_words(lacks.label)}?)."

    def _amount(self, label: str, value: float) -> str:
        """Return a residual with its unit: "0.1 rad at knee"."""
        name, _, unit = self.named(label)
        return f"{value:.2g} {unit} RMS at {name}" if unit else f"{value:.2g} RMS of {label}"

    def named(self, label: str) -> tuple[str, str, str]:
        """Return a quantity's entry and kind, such as "knee" and "position", and its unit or ""."""
        array, _, name = label.removesuffix("]").partition("[")
        units = units_of(self.model, array)
        unit = units[entries_of(self.model, array, len(units)).index(name)] if units else ""
        return name, SAID[array], unit

    def _estimates(self) -> Iterator[str]:
        for path, value in self.values.items():
            low, high = self.intervals[path]
            finite = np.isfinite(high - low)
            interval = f"95 %: {low:.6g} to {high:.6g}" if finite else "no interval"
            if path in self.kept:
                yield f"{path} was not estimated: {value:.6g} is its first value."
                continue
            yield f"{path} = {value:.6g} ({interval}; begun at {self.start[path]:.6g})."
            if path == DELAY and value < 0:
                yield f"P{shifted(path, value)[1:]}."

    def _doubts(self) -> Iterator[str]:
        for paths in self.alike:
            *others, last = map(in_words, paths)
            yield (
                f"The logs cannot tell apart {', '.join(others)} and {last}."
                if others
                else f"The logs say nothing of the {last}."
            )
        covered = {path for paths in self.alike for path in paths} | {*self.kept}
        for path in self.unknown:
            if path not in covered:
                yield f"The logs say little of {path}: its interval is half of its range or more."
        for path, value in self.values.items():
            if value in self.bounds[path]:
                yield f"{path} is at the bound of its range."

    def _remains(self) -> Iterator[str]:
        """Yield the residual that the time step affects most, and its effect on estimates."""
        worst = max(
            self.residuals, key=lambda key: self.integration[key] / (self.residuals[key] or 1.0)
        )
        after, step = self.residuals[worst], self.integration[worst]
        if np.isnan(step):
            yield (
                f"The residual of {worst} is {after:.3g} RMS ({self.before[worst]:.3g} before); "
                "what shorter steps change was not computed."
            )
            return
        dt, shorter = seconds(float(self.settings.dt) / FINER), "."
        if step > after / 2 and self.quality.verdict != "bad":
            shorter = f": take shorter steps, such as {dt} (timestep in the file, dt in Python)."
        yield (
            f"The residual of {worst} is {after:.3g} RMS ({self.before[worst]:.3g} before); steps "
            f"{FINER} times shorter change the prediction by {step:.3g}, the most of all beside "
            f"their residuals{shorter}"
        )
        for path, value in self.values.items():
            (low, high), finer = self.intervals[path], self.finer[path]
            # Noiseless logs have intervals of almost zero: compare four digits.
            if abs(finer - value) > (high - low) / 2 and f"{finer:.4g}" != f"{value:.4g}":
                yield (
                    f"With steps {FINER} times shorter the estimate of {path} is {finer:.6g}: "
                    "outside of the interval."
                )

    @property
    def unknown(self) -> list[str]:
        """The parameters that the logs hardly determine: the interval is half of the range or more.

        Empty for a fit that is bad or cannot be judged, which has no intervals.
        """
        if self.quality.verdict in ("bad", "few"):
            return []
        spans = {
            path: (np.ptp(self.intervals[path]), np.ptp(ends)) for path, ends in self.bounds.items()
        }
        return [path for path, (interval, full) in spans.items() if not interval < full / 2]

    @property
    def rows(self) -> list[Estimate]:
        """The estimates."""
        return [
            Estimate(path, value, *self.intervals[path], self.start[path], self.finer[path])
            for path, value in self.values.items()
        ]

    @property
    def table(self) -> Table:
        """A row for each parameter; see `Estimate`."""
        formats = dict.fromkeys(NUMBERS, ".6g")
        heading = f"Estimates with 95 % intervals; finer: with steps {FINER} times shorter"
        return Table(map(vars, self.rows), formats=formats, heading=heading)

    @property
    def residual_table(self) -> Table:
        """A row for each measured quantity, RMS."""
        rows = [
            {
                "quantity": key,
                "residual": each.residual,
                "noise": each.noise,
                "white": "yes" if each.white else "no",
                "before": self.before[key],
                "finer": each.step,
            }
            for key, each in self.quality.misfits.items()
        ]
        heading = (
            "RMS residual of each quantity, and what of it is noise; finer: what shorter steps "
            "change of its prediction"
        )
        return Table(rows, heading=heading)

    @property
    def correlation_table(self) -> Table:
        """The correlation of each two estimates."""
        rows = [
            {"": path, **{str(k + 1): float(value) for k, value in enumerate(row[: nth + 1])}}
            for nth, (path, row) in enumerate(zip(self.values, self.correlations, strict=True))
        ]
        formats = {str(k + 1): ".2f" for k in range(len(rows))}
        return Table(rows, formats=formats, heading="Correlations of the estimates, in this order")

    def tables(self, full: bool) -> list[Table]:
        """Return the estimates, the residuals, and with several estimates the correlations."""
        several = [self.correlation_table] if len(self.values) > 1 else []
        return [self.table, self.residual_table, *several]

    def details(self) -> dict[str, Any]:
        """Return further numbers of the result."""
        lacks = self.quality.missing
        names = ("values", "intervals", "alike", "residuals", "integration", "finer")
        more = ("predictable", "steps", "linearised")
        return {
            **{name: getattr(self, name) for name in (*names, *more)},
            "correlations": self.correlations.tolist(),
            "residuals_before": self.before,
            "findings": [finding.record() for finding in self.findings],
            "misfits": {label: vars(misfit) for label, misfit in self.quality.misfits.items()},
            "fit": self.quality.verdict,
            "missing": lacks and {"path": lacks.label, "share": lacks.share},
        }


def shifted(path: str, change: float) -> str:
    """Describe a delay in a log, by its sign.

    >>> shifted("delay", -0.005), shifted("delay/qpos", 0.02)
    ('positions in the log lead the commands by 5 ms', '`qpos` in the log is 20 ms late')
    """
    name, time = path.partition("/")[2], seconds(float(f"{abs(change):.2g}"))
    if not name:
        way = "lead the commands by" if change < 0 else "follow the commands late, by"
        return f"positions in the log {way} {time}"
    return f"`{name}` in the log is {time} {'early' if change < 0 else 'late'}"


def in_words(path: str) -> str:
    """Return a parameter in words.

    >>> in_words("body/shin/mass"), in_words("delay")
    ('mass of `shin`', 'delay of the controls')
    """
    parts = path.split("/")
    if is_delay(path):
        name = path.partition("/")[2]
        return f"{DELAY} of `{name}`" if name else f"{DELAY} of the controls"
    if len(parts) < 3 or parts[0] in WHOLE:
        return path
    return f"{parts[-1]} of `{'/'.join(parts[1:-1])}`"
