"""Errors of runs against the reference, in numbers that mean the same in every scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stepcore.experiment.friction import anisotropy, creep
from stepcore.experiment.run import Run, angle, distance, lever, separation

# A contact sticks whose friction is below this share of μ × normal force. The pyramid reaches the
# whole of it along its tangents, and 1/√2 between them.
STICKS = {"pyramidal": 0.7, "elliptic": 0.99}


@dataclass(frozen=True)
class Errors:
    """Errors of one setting over all starts.

    position [m], angle [rad]: RMS error over samples and moving bodies, of centres of mass and of
        orientations in the world, in the median start.
    position_max, angle_max: the largest error of any body, sample and start.
    worst: the index of the start with the largest position error.
    each [m]: the RMS position error of every start, of centres of mass and of orientations times
        the body's radius of gyration.
    relative, relative_max: `position` and `position_max` over the scene's size.
    gained, lost [J]: the largest rise of the energy balance of `Run` above its start, and the
        largest fall below it, in any start.
    numerical, modelling [m]: the two parts of `high` if a setting changes the model (another cone,
        another law, f32): the distance to that model's own limit, and the distance between the two
        limits; see `stepcore.experiment.other_models`. Otherwise numerical is `high`, modelling 0.

    The next ones are the largest of all starts, or None if the scene has no such quantity or it
    cannot be known.

    momentum [kg·m/s], angular_momentum [kg·m²/s]: the part that internal forces and gravity do not
        explain.
    joint [m]: the widest gap of a connection.
    limit [rad or m]: how far a joint was beyond its range.
    overlap [m]: the deepest overlap.
    creep [m/s]: the fastest slip in a contact that does not slip in the reference.
    anisotropy [rad]: the angle between friction and the direction against the slip, at contacts
        that slide.
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
        """The RMS position error of the worst start [m]; see `each`."""
        return max(self.each, default=self.position)

    @property
    def median(self) -> float:
        """The RMS position error of the median start [m]."""
        return float(np.median(self.each)) if self.each else self.position


@dataclass(frozen=True)
class Score:
    """How runs are compared with the motion that they should make: one number of their `Errors`.

    measure: an attribute of `Errors`. name: in words. unit: "m", or "1" for a share.
    """

    measure: str
    name: str
    unit: str

    def __call__(self, errors: Errors) -> float:
        return float(getattr(errors, self.measure))


# The score of a setting is its error against the converged motion.
WORST_START = Score("high", "RMS position error of the worst start", "m")


def errors(
    runs: Sequence[Run],
    truth: Sequence[Run],
    scored: np.ndarray,
    size: float = np.nan,
    sticks: float = STICKS["pyramidal"],
) -> Errors:
    """Errors of runs against the reference's, over the samples that are scored (starts, n).

    size: of the scene [m]; sticks: see `stepcore.experiment.friction.creep`.
    """
    metres, radians, both, creeps = [], [], [], []
    for run, true, mask in zip(runs, truth, scored, strict=True):
        metres.append(distance(run, true)[mask])
        radians.append(angle(run, true)[mask])
        both.append(np.hypot(metres[-1], lever(run, true) * radians[-1]))
        creeps.append(creep(run.slips, true.slips, mask, sticks))
    largest = [float(part.max(initial=0.0)) for part in metres]
    position, each = float(np.median(_roots(metres))), tuple(_roots(both))
    return Errors(
        position=position,
        position_max=max(largest),
        angle=float(np.median(_roots(radians))),
        angle_max=max(float(part.max(initial=0.0)) for part in radians),
        gained=max(0.0, *(float(run.balance.max(initial=0.0)) for run in runs)),
        lost=max(0.0, *(-float(run.balance.min(initial=0.0)) for run in runs)),
        overlap=max(run.overlap for run in runs),
        residual=max(run.residual for run in runs),
        worst=largest.index(max(largest)),
        each=each,
        relative=position / size,
        relative_max=max(largest) / size,
        numerical=max(each),
        momentum=_worst([run.momentum for run in runs]),
        angular_momentum=_worst([run.spin for run in runs]),
        joint=_worst([run.joint for run in runs]),
        limit=_worst([run.limit for run in runs]),
        creep=_known(creeps),
        anisotropy=_known([anisotropy(run.slips) for run in runs]),
    )


def _worst(values: Sequence[float | None]) -> float | None:
    """The largest; None if one of them is not known."""
    return None if None in values else _known(values)


def _known(values: Sequence[float | None]) -> float | None:
    """The largest of those that are known; None if none is."""
    return max((value for value in values if value is not None), default=None)


def moved(runs: Sequence[Run]) -> float:
    """The RMS error [m] of a run in which bodies stand still from the first sample on.

    Of the start in which they move least.
    """
    still = [Run(com=run.com[:1], quat=run.quat[:1]) for run in runs]
    return min(_roots([separation(run, stay) for run, stay in zip(runs, still, strict=True)]))


def _roots(parts: Sequence[np.ndarray]) -> list[float]:
    """The root mean square of each part."""
    with np.errstate(over="ignore"):
        return [float(np.sqrt(np.mean(part**2))) if part.size else 0.0 for part in parts]


def pareto(cost: Sequence[float], error: Sequence[float]) -> list[bool]:
    """Which points no other beats: none is as good in both and better in one.

    Of equal points the first counts; one that is not finite never does.

    >>> pareto([1.0, 2.0, 3.0, 2.5], [3.0, 2.0, 1.0, 2.0])
    [True, True, True, False]
    """
    # NaN has no place in an order: sorted with one, the rest would not be either.
    finite = [i for i in range(len(cost)) if np.isfinite(cost[i])]
    best, marks = np.inf, [False] * len(cost)
    for i in sorted(finite, key=lambda i: (cost[i], error[i], i)):
        if error[i] < best:
            best, marks[i] = error[i], True
    return marks
