"""The distance between two motions: the norm of all measurements and error bars.

The distance of two poses of a body is √(d² + (r θ)²): d is the distance of the centres of mass, θ
the angle between the orientations, and r = √(tr I / 2m) the radius of gyration, so that this is the
RMS displacement of the body's mass. The distance of two motions from one start is the RMS of this
over samples and moving bodies [m]; the largest distance at any time is also reported. For several
starts, results report the worst and the median start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from stepcore.engine.coordinates import Coordinates, rotated

if TYPE_CHECKING:
    from stepcore.engine.model import Model


class Matter:
    """The properties of a model's moving bodies that the norm needs.

    moving: their indices. ipos: centres of mass in the bodies' frames [m], (bodies, 3).
    gyration: radii of gyration [m], (bodies,). mass: [kg], (bodies,).
    """

    def __init__(
        self, moving: Sequence[int], ipos: np.ndarray, gyration: np.ndarray, mass: np.ndarray
    ) -> None:
        self.moving, self.ipos = list(moving), ipos
        self.gyration, self.mass = gyration, mass

    @classmethod
    def of(cls, model: Model) -> Matter:
        """Return the moving bodies of a model."""
        moving = Coordinates(model).moving
        mass = np.asarray(model.body_mass, float)[moving]
        inertia = np.trace(np.asarray(model.body_inertia, float)[moving], axis1=1, axis2=2)
        gyration = np.sqrt(inertia / 2 / np.maximum(mass, 1e-300))
        return cls(moving, np.asarray(model.body_ipos, float)[moving], gyration, mass)

    def tracks(
        self, xpos: np.ndarray, xquat: np.ndarray, failures: dict[int, str] | None = None
    ) -> Tracks:
        """Return tracks from the frames of all bodies, (starts, n, nbody, 3) and (…, 4)."""
        quat = xquat[:, :, self.moving]
        return Tracks(xpos[:, :, self.moving] + rotated(quat, self.ipos), quat, failures or {})


@dataclass(frozen=True, eq=False)
class Tracks:
    """The poses of the moving bodies at n samples, from several starts.

    com: centres of mass [m], (starts, n, bodies, 3). quat: orientations, (starts, n, bodies, 4).
        Both are NaN after a run has ended.
    failures: why a run ended early, by the index of its start.
    evaluations: the number of force evaluations of adaptive steps, (starts,), if counted.
    readings: further quantities at the samples, (starts, n, k), if the engine reads any.
    """

    com: np.ndarray
    quat: np.ndarray
    failures: dict[int, str] = field(default_factory=dict)
    evaluations: np.ndarray | None = None
    readings: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.com)

    @property
    def failure(self) -> str:
        """Why the first run that failed did; "" if none did."""
        return self.failure_from(range(len(self)))

    def failure_from(self, starts: Sequence[int]) -> str:
        """Return why the first run that failed did, with the index of its start; "" for none."""
        failed = sorted(self.failures.items())
        return next((f"start {starts[k]}: {why}" for k, why in failed), "")

    def some(self, indices: Sequence[int]) -> Tracks:
        """Return the tracks of some of the starts, by their indices."""
        places = {k: n for n, k in enumerate(indices)}
        failures = {places[k]: why for k, why in self.failures.items() if k in places}
        chosen = list(indices)
        evaluations, readings = (
            None if array is None else array[chosen] for array in (self.evaluations, self.readings)
        )
        return Tracks(self.com[chosen], self.quat[chosen], failures, evaluations, readings)

    def at(self, sample: int) -> Tracks:
        """Return the tracks at one sample."""
        return Tracks(self.com[:, [sample]], self.quat[:, [sample]])

    def nothing(self, why: str) -> Tracks:
        """Return tracks like the first of these, of a run that was not made."""
        arrays = (self.com, self.quat, self.readings)
        com, quat, readings = (None if array is None else array[:1] * np.nan for array in arrays)
        assert com is not None and quat is not None
        return Tracks(com, quat, {0: why}, readings=readings)

    def first(self, samples: int) -> Tracks:
        """Return the tracks until a sample, with the failures before it."""
        com, quat = self.com[:, :samples], self.quat[:, :samples]
        readings = None if self.readings is None else self.readings[:, :samples]
        failures = {k: why for k, why in self.failures.items() if not np.isfinite(com[k]).all()}
        return Tracks(com, quat, failures, readings=readings)

    @classmethod
    def joined(cls, parts: Sequence[Tracks]) -> Tracks:
        """Return the tracks of all starts of several parts, in their order."""
        failures, first = dict[int, str](), 0
        for part in parts:
            failures |= {first + k: why for k, why in part.failures.items()}
            first += len(part)
        com, quat = (np.concatenate([getattr(p, name) for p in parts]) for name in ("com", "quat"))
        evaluations = _joined([part.evaluations for part in parts])
        return cls(com, quat, failures, evaluations, _joined([part.readings for part in parts]))


def _joined(arrays: Sequence[np.ndarray | None]) -> np.ndarray | None:
    """Return the arrays of all parts as one; None if some part has none."""
    some = [array for array in arrays if array is not None]
    return np.concatenate(some) if len(some) == len(arrays) else None


def distances(a: Tracks, b: Tracks, matter: Matter) -> np.ndarray:
    """Return the distance of each body at every sample [m], (starts, n, bodies).

    The distance is infinite at samples that a run has not reached.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        far = np.hypot(vector_norm(a.com - b.com), matter.gyration * arc(a.quat, b.quat))
    far[np.isnan(far)] = np.inf
    return far


def arc(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angle between orientations [rad]; quaternions: (…, 4)."""
    half = np.minimum(vector_norm(a - b), vector_norm(a + b))
    return np.asarray(4 * np.arcsin(np.minimum(half / 2, 1.0)))


def vector_norm(vectors: np.ndarray) -> np.ndarray:
    """Return the norm over the last axis, in half the time of numpy.linalg for a few bodies."""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=-1)))


def rms(far: np.ndarray, scored: np.ndarray | None = None) -> np.ndarray:
    """Return the RMS distance over samples and bodies, of every start [m], (starts,).

    far: from `distances`. scored: the samples that count, (starts, n); by default all.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.mean(far**2, axis=2)
        if scored is None:
            return np.asarray(np.sqrt(squares.mean(axis=1)))
        counted = np.where(scored, squares, 0.0).sum(axis=1)
        return np.asarray(np.sqrt(counted / np.maximum(scored.sum(axis=1), 1)))


def largest(far: np.ndarray, scored: np.ndarray | None = None) -> np.ndarray:
    """Return the largest distance of any body at any sample, of every start [m], (starts,)."""
    counted = far if scored is None else np.where(scored[..., None], far, 0.0)
    return np.asarray(counted.max(axis=(1, 2), initial=0.0))
