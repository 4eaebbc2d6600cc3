"""Errors of runs relative to the reference, in measures that are comparable between scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stepcore.experiment.friction import anisotropy, creep
from stepcore.experiment.run import Run, angle, distance, lever, separation

# A contact counts as sticking if friction is below this share of μ × normal force. A pyramidal cone
# allows all of μ × normal force along its tangents, and 1/√2 of it between them.
STICKS = {"pyramidal": 0.7, "elliptic": 0.99}


@dataclass(frozen=True)
class Errors:
    """Errors of one setting over all starts.

    position [m], angle [rad]: RMS errors of centres of mass and of orientations over samples and
        moving bodies, in the median start.
    each [m]: the RMS position error of every start, of centres of mass and of orientations times
        the body's radius of gyration.
    position_max [m]: the largest such error of any body, sample and start.
    angle_max [rad]: the largest error of an orientation.
    worst: the index of the start with the largest RMS position error.
    relative, relative_max: `position` and `position_max` divided by the scene's size.
    gained, lost [J]: the largest rise of the energy balance of `Run` above its initial value, and
        the largest fall below it, in any start.
    numerical, modelling [m]: the two parts of `high` if a setting changes the model (another cone,
        another law, f32): the distance to the limit of the changed model, and the distance between
        the limits of both models; see `stepcore.experiment.other_models`. Otherwise numerical is
        `high`, and modelling 0.

    The following errors are the largest of all starts. They are None if the scene has no such
    quantity, or if the quantity cannot be determined.

    momentum [kg·m/s], angular_momentum [kg·m²/s]: the change that internal forces and gravity do
        not explain.
    joint [m]: the widest gap of a connection.
    limit [rad or m]: the largest violation of a joint's range.
    overlap [m]: the deepest overlap.
    creep [m/s]: the fastest slip in a contact that sticks in the reference.
    anisotropy [rad]: the largest angle between friction and the direction opposite to the slip, at
        sliding contacts.
    residual [m/s]: the largest residual.
    """

    position: float
    position_max: float
    angle: float
    angle_max: float
    gained: float
    lost: float
    overlap: float
    residual: float
    worst: int = 0
    each: tuple[float, ...] = ()
    relative: float = np.nan
    relative_max: float = np.nan
    numerical: float = np.nan
    modelling: float = 0.0
    momentum: float | None = None
    angular_momentum: float | None = None
    joint: float | None = None
    limit: float | None = None
    creep: float | None = None
    anisotropy: float | None = None

    @property
    def high(self) -> float:
        """RMS position error of the worst start [m]; see `each`."""
        return max(self.each, default=self.position)

    @property
    def median(self) -> float:
        """RMS position error of the median start [m]; see `each`."""
        return float(np.median(self.each)) if self.each else self.position


def errors(
    runs: Sequence[Run],
    truth: Sequence[Run],
    scored: np.ndarray,
    size: float = np.nan,
    sticks: float = STICKS["pyramidal"],
) -> Errors:
    """Compute the errors of runs relative to those of the reference.

    truth: the runs of the reference. scored: mask of the samples that count, (starts, n).
    size: the size of the scene [m]. sticks: see `stepcore.experiment.friction.creep`.
    """
    metres, radians, both, creeps = [], [], [], []
    for run, true, mask in zip(runs, truth, scored, strict=True):
        metres.append(distance(run, true)[mask])
        radians.append(angle(run, true)[mask])
        both.append(np.hypot(metres[-1], lever(run, true) * radians[-1]))
        creeps.append(creep(run.slips, true.slips, mask, sticks))
    position, each = float(np.median(_roots(metres))), tuple(_roots(both))
    largest = max(float(part.max(initial=0.0)) for part in both)
    return Errors(
        position=position,
        position_max=largest,
        angle=float(np.median(_roots(radians))),
        angle_max=max(float(part.max(initial=0.0)) for part in radians),
        gained=max(0.0, *(float(run.balance.max(initial=0.0)) for run in runs)),
        lost=max(0.0, *(-float(run.balance.min(initial=0.0)) for run in runs)),
        overlap=max(run.overlap for run in runs),
        residual=max(run.residual for run in runs),
        worst=each.index(max(each)),
        each=each,
        relative=position / size,
        relative_max=largest / size,
        numerical=max(each),
        momentum=_worst([run.momentum for run in runs]),
        angular_momentum=_worst([run.spin for run in runs]),
        joint=_worst([run.joint for run in runs]),
        limit=_worst([run.limit for run in runs]),
        creep=_known(creeps),
        anisotropy=_known([anisotropy(run.slips) for run in runs]),
    )


def _worst(values: Sequence[float | None]) -> float | None:
    """Return the largest value, or None if any value is None."""
    return None if None in values else _known(values)


def _known(values: Sequence[float | None]) -> float | None:
    """Return the largest value that is not None, or None without one."""
    return max((value for value in values if value is not None), default=None)


def moved(runs: Sequence[Run]) -> float:
    """Return the RMS error of a run whose bodies rest from the first sample on [m].

    The value is that of the start with the least motion.
    """
    still = [Run(com=run.com[:1], quat=run.quat[:1]) for run in runs]
    return min(_roots([separation(run, stay) for run, stay in zip(runs, still, strict=True)]))


def _roots(parts: Sequence[np.ndarray]) -> list[float]:
    """Return the root mean square of each array."""
    with np.errstate(over="ignore"):
        return [float(np.sqrt(np.mean(part**2))) if part.size else 0.0 for part in parts]


def pareto(cost: Sequence[float], error: Sequence[float]) -> list[bool]:
    """Mark the Pareto-optimal points, and return one flag per point.

    A point is Pareto-optimal if no other point is as good in both values and better in one.
    Of equal points only the first is marked. Points that are not finite are never marked.

    >>> pareto([1.0, 2.0, 3.0, 2.5], [3.0, 2.0, 1.0, 2.0])
    [True, True, True, False]
    """
    # Sorting with a NaN would leave the other points unsorted.
    finite = [i for i in range(len(cost)) if np.isfinite(cost[i])]
    best, marks = np.inf, [False] * len(cost)
    for i in sorted(finite, key=lambda i: (cost[i], error[i], i)):
        if error[i] < best:
            best, marks[i] = error[i], True
    return marks
