"""`Run`: what one run did at the samples. `Probe`: observes a run while it goes on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stepcore.experiment.coordinates import product, turned
from stepcore.experiment.friction import Slips


@dataclass
class Run:
    """What one run did, at the samples.

    com: centres of mass of the moving bodies [m], (n, bodies, 3). quat: (n, bodies, 4).
    gyration: the bodies' radii of gyration [m], (bodies,).
    balance: energy, less that at the start, less the work of the actuators, plus what the joint
        dampers took [J], (n,).
    kinetic: energy [J]; height: of the centre of mass against gravity [m]; touching: the number of
        contacts that touch; (n,) each.
    slips: contacts with friction, by sample.
    overlap: the deepest [m]. residual: the worst [m/s]. rows: the most in any step.
    momentum [kg·m/s], spin [kg·m²/s]: see `stepcore.experiment.bodies.Balance`. joint [m], limit
        [rad or m]: see `stepcore.experiment.bodies.Joints`.
    failure: why the run ended early; the arrays are then short.

    A run that only `Positions` observed has com, quat, gyration and failure.
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
        """Marks a run as failed whose positions are not finite."""
        if self.failure is None and not np.all(np.isfinite(self.com)):
            self.failure = "positions overflow"


def distance(a: Run, b: Run) -> np.ndarray:
    """The distance between the bodies of two runs at each sample [m], (n, bodies)."""
    with np.errstate(over="ignore"):
        apart: np.ndarray = np.linalg.norm(a.com - b.com, axis=-1)
    return apart


def angle(a: Run, b: Run) -> np.ndarray:
    """The angle between the bodies of two runs at each sample [rad], (n, bodies)."""
    back = b.quat * np.array([1.0, -1.0, -1.0, -1.0])
    apart: np.ndarray = np.linalg.norm(turned(product(back, a.quat)), axis=-1)
    return apart


def lever(a: Run, b: Run) -> np.ndarray | float:
    """The radii of gyration of the bodies of two runs [m], by which angles become lengths."""
    return next((run.gyration for run in (b, a) if len(run.gyration)), 0.0)


def separation(a: Run, b: Run) -> np.ndarray:
    """The distance and the angle between the bodies of two runs as one length [m], (n, bodies).

    It is the root mean square over a body's matter: the angle counts times the radius of gyration,
    √(tr I / 2m).
    """
    apart: np.ndarray = np.hypot(distance(a, b), lever(a, b) * angle(a, b))
    return apart


class Probe:
    """Observes a run at the times at which `Runner.follow` calls it; a subclass overrides some
    methods.

    sim: the `Sim` that runs, or another engine's world that has its step, qpos and qvel.
    """

    def stride(self, steps: int) -> int | None:
        """Steps between two calls of `step`, out of `steps` in a period; None if it need not be
        called.

        If several probes run together, all are called at the shortest of their strides.
        """
        return None

    def stop(self, done: int, steps: int) -> int | None:
        """The step of a period after which `step` is called next, if `done` are made; by `stride`.

        A probe that reads at uneven times overrides this.
        """
        stride = self.stride(steps)
        return None if stride is None else min(done + stride, steps)

    def begin(self, sim: Any) -> None:
        """The run is at its start."""

    def period(self, sim: Any, period: int) -> None:
        """A control period begins: its controls are set."""

    def step(self, sim: Any) -> None:
        """Some steps were made."""

    def sample(self, sim: Any) -> None:
        """A sample of the schedule is reached."""

    def end(self, sim: Any, run: Run) -> None:
        """The run has ended without a failure: the probe writes what it recorded into it."""
