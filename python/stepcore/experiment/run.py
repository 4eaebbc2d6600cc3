"""`Run`: the recorded quantities of one run. `Probe`: an observer of a run in progress."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stepcore.experiment.coordinates import product, turned
from stepcore.experiment.friction import Slips


@dataclass
class Run:
    """The recorded quantities of one run, at n samples.

    com: centres of mass of the moving bodies [m], (n, bodies, 3).
    quat: orientations of the moving bodies, (n, bodies, 4).
    balance: energy, minus the energy at the start, minus the work of the actuators, plus the energy
        dissipated by the joint dampers [J], (n,).
    kinetic: kinetic energy [J], (n,).
    height: height of the common centre of mass against gravity [m], (n,).
    touching: number of touching contacts, (n,).
    slips: contacts with friction at each sample.
    overlap: the deepest overlap [m].
    residual: the largest residual [m/s].
    momentum [kg·m/s], spin [kg·m²/s]: the unexplained changes of linear and angular momentum; see
        `stepcore.experiment.bodies.Balance`.
    joint [m], limit [rad or m]: the widest gap and the largest limit violation; see
        `stepcore.experiment.bodies.Joints`.
    row_updates: the number of row updates of the solver.
    rows: the largest number of rows in any step.
    failure: why the run ended early, or None; the arrays of a failed run are short.
    gyration: the bodies' radii of gyration [m], (bodies,).

    A run with the probe `Positions` alone has com, quat, gyration and failure.
    """

    com: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    quat: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 4)))
    balance: np.ndarray = field(default_factory=lambda: np.zeros(0))
    kinetic: np.ndarray = field(default_factory=lambda: np.zeros(0))
    height: np.ndarray = field(default_factory=lambda: np.zeros(0))
    touching: np.ndarray = field(default_factory=lambda: np.zeros(0))
    slips: list[Slips] = field(default_factory=list)
    overlap: float = 0.0
    residual: float = 0.0
    momentum: float | None = None
    spin: float | None = None
    joint: float | None = None
    limit: float | None = None
    row_updates: int = 0
    rows: int = 0
    failure: str | None = None
    gyration: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def refuse_overflow(self) -> None:
        """Mark the run as failed if its positions are not finite."""
        if self.failure is None and not np.all(np.isfinite(self.com)):
            self.failure = "positions overflow"


def distance(a: Run, b: Run) -> np.ndarray:
    """Return the distance between the bodies of two runs at each sample [m], (n, bodies)."""
    with np.errstate(over="ignore"):
        apart: np.ndarray = np.linalg.norm(a.com - b.com, axis=-1)
    return apart


def angle(a: Run, b: Run) -> np.ndarray:
    """Return the angle between the bodies of two runs at each sample [rad], (n, bodies)."""
    back = b.quat * np.array([1.0, -1.0, -1.0, -1.0])
    apart: np.ndarray = np.linalg.norm(turned(product(back, a.quat)), axis=-1)
    return apart


def lever(a: Run, b: Run) -> np.ndarray | float:
    """Return the bodies' radii of gyration [m], which convert angles to lengths.

    The radii are those of `b`, or else of `a`, or else 0.
    """
    return next((run.gyration for run in (b, a) if len(run.gyration)), 0.0)


def separation(a: Run, b: Run) -> np.ndarray:
    """Return distance and angle between the bodies of two runs as one length [m], (n, bodies).

    The length is the RMS displacement over a body's mass: the angle is multiplied by the radius of
    gyration, √(tr I / 2m).
    """
    apart: np.ndarray = np.hypot(distance(a, b), lever(a, b) * angle(a, b))
    return apart


class Probe:
    """An observer of a run, which `Runner.follow` calls. A subclass overrides some methods.

    The argument `sim` is the running `Sim`, or another engine's world with step, qpos and qvel.
    """

    def stride(self, steps: int) -> int | None:
        """Return the number of time steps between two calls of `step`, or None for no calls.

        If several probes observe a run, all are called at the shortest of their strides.

        steps: the number of time steps in a control period.
        """
        return None

    def stop(self, done: int, steps: int) -> int | None:
        """Return the time step of the period after which `step` is called next, or None.

        By default `stride` determines this step. A probe that reads at uneven times overrides this
        method.

        done: the number of time steps made in this period. steps: the number in a period.
        """
        stride = self.stride(steps)
        return None if stride is None else min(done + stride, steps)

    def begin(self, sim: Any) -> None:
        """Observe the start of the run."""

    def period(self, sim: Any, period: int) -> None:
        """Observe the beginning of a control period, after its controls have been set."""

    def step(self, sim: Any) -> None:
        """Observe the state after some time steps."""

    def sample(self, sim: Any) -> None:
        """Observe a sample of the schedule."""

    def end(self, sim: Any, run: Run) -> None:
        """Write the records into `run`, after a run that did not fail."""
