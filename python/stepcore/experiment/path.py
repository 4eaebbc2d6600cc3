"""`Path`: one run as recorded at the samples; the distance between two runs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from stepcore.experiment.coordinates import product, turned
from stepcore.experiment.slip import Slips


@dataclass
class Path:
    """What one run did, at the samples.

    com: centres of mass of the moving bodies [m], (n, bodies, 3). quat: (n, bodies, 4).
    gyration: the bodies' radii of gyration [m], (bodies,).
    balance: energy, less that at the start, less the work of the actuators, plus what the joint
    dampers took [J], (n,). kinetic: energy [J], height: of the centre of mass against gravity
    [m], touching: contacts that touch; (n,) each. slips: contacts with friction, by sample.
    overlap: deepest [m]. residual: worst [m/s]. rows: the most of any step.
    momentum [kg·m/s], spin [kg·m²/s]: see `stepcore.experiment.momentum`. joint [m], limit [rad or
    m]: see `stepcore.experiment.joints`. failure: why the run ended early; the arrays are then
    short.

    A run that only `Positions` looked at has com, quat, gyration and failure.
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


def distance(a: Path, b: Path) -> np.ndarray:
    """How far the bodies of two runs are apart at each sample [m], shape (n, bodies)."""
    with np.errstate(over="ignore"):
        apart: np.ndarray = np.linalg.norm(a.com - b.com, axis=-1)
    return apart


def angle(a: Path, b: Path) -> np.ndarray:
    """How far the bodies of two runs are turned apart at each sample [rad], (n, bodies)."""
    back = b.quat * np.array([1.0, -1.0, -1.0, -1.0])
    apart: np.ndarray = np.linalg.norm(turned(product(back, a.quat)), axis=-1)
    return apart
