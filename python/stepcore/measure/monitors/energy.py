"""Energy that the steps of a scene without a drive gain: the sign of a dt that is too long."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stepcore.experiment.change import Change
from stepcore.measure.monitors.finding import (
    DEEP,
    PARTS,
    PLOT,
    SEEN,
    Cure,
    Finding,
    Remedy,
    shorter,
)
from stepcore.measure.monitors.recording import FEWEST, Recording
from stepcore.report.units import percent


def gained(run: Recording) -> float | None:
    """Return the energy gained over the largest energy of motion; None if something may give it.

    That is an actuator, the wind, a moving surface, or a row that is pressed at the start.
    """
    scene = run.model.scene
    drags = (any(geom.surfacevel) or geom.adhesion for geom in scene.geoms)
    if run["actuator_force"].any() or any(scene.wind) or any(drags) or len(run.at(0).rows):
        return None
    some = np.unique(np.linspace(0, len(run) - 1, FEWEST**2).astype(int)).tolist()
    kinetic, potential = np.array([run.at(k).energy for k in some]).T
    total = kinetic + potential
    return float((total.max() - total[0]) / max(kinetic.max(), 1e-300))


def energy_findings(run: Recording) -> Iterator[Finding]:
    """Yield that the motion gains energy, with an integrator or a dt that was seen to keep it."""
    gain = gained(run)
    if gain is None or gain < DEEP:
        return
    dt = run.model.settings.dt
    problem = (
        f"the steps give the motion energy, {percent(gain)} of its largest energy of motion, and "
        "may make it explode in a longer run"
    )
    exact = (
        (Cure(f'integrator="{name}"', Change(integrator=name)),) for name in ("midpoint", "rk4")
    )
    ways = (*exact, shorter(dt / (2 * part) for part in PARTS))
    remedy = Remedy(ways, gained, SEEN, lambda left: percent(max(left, 0.0)), 2, needed=True)
    yield Finding("energy", "warning", problem, "", (), gain, "1", PLOT, remedy=remedy)
