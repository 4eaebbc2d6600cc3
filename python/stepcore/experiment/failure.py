"""Criteria for failed runs, with one threshold each, which all measurements share.

- The run *ended early*: the engine raised an exception, positions overflowed, or a body moved by
  more than `STEP` times the scene's size in one step (`Explosion`).
- The run is *far* from the reference: the distance exceeds `FAR` times the scene's size.
- The energy of the run is *large*: the gain exceeds `LARGE` times the energy in motion of the
  reference, plus the energy that lifts the scene by its own size.
- A body *passes through* another one and leaves on the other side, and does not in the reference
  (`stepcore.experiment.passage`); `diagnose` judges this.
- Without a reference, a motion *runs away* (`runaway`): the kinetic energy exceeds `RUNAWAY` times
  the energy that gravity can give the scene, and still grows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.run import Run, distance
from stepcore.experiment.schedule import Schedule
from stepcore.experiment.sizes import scene_size
from stepcore.report.units import joules, seconds

# Multiple of the scene's size. A distance of a few sizes is an error that a measurement reports,
# for example of a ball that rolls away. At a hundred sizes, bodies have left the modelled scene.
FAR = 100.0
# Multiple of the reference's energy. The energy error of an integrator is a fraction of the energy
# in motion, so a tenfold gain comes from rows or feedback with too large forces.
LARGE = 10.0
# Kinetic energy, relative to a fall over the scene's size plus the energy at 1 m/s; and relative to
# the maximum in the first half of the motion, where a constant torque gives a factor of 4. No
# useful motion has ten thousand times the speed of such a fall.
RUNAWAY, GROWTH = 1e8, 1e4
# Motion in a single step, in sizes of the scene or in radians: a hundred times `FAR`.
STEP = 1e4
# With fewer pairs of geoms than this every step is cheap, and a test after each would be expensive.
PAIRS = 200


def failure(
    runs: Sequence[Run], truth: Sequence[Run], size: float, weight: float | None = None
) -> str | None:
    """Explain why one of several runs failed, or return None.

    runs: the runs, one per start.
    truth: the reference's runs, from the same starts.
    size: the size of the scene [m].
    weight: the weight of all bodies [N]. None skips the comparison of energies, for runs that
        recorded positions alone.
    """
    for start, run in enumerate(runs):
        if run.failure:
            return f"start {start}: {run.failure}"
    far = far_off(runs, truth, size)
    return far if far or weight is None else _gains_energy(runs, truth, weight * size)


def far_off(runs: Sequence[Run], truth: Sequence[Run], size: float) -> str | None:
    """Explain which run is far from the reference, or return None.

    All samples count, because even a chaotic motion does not leave the scene.
    """
    for start, (run, true) in enumerate(zip(runs, truth, strict=True)):
        apart = float(distance(run, true).max(initial=0.0))
        if not apart <= FAR * size:
            return f"start {start}: far off ({apart:.2g} m from the reference)"
    return None


def _gains_energy(runs: Sequence[Run], truth: Sequence[Run], lift: float) -> str | None:
    """Explain which run has gained energy without a source, or return None.

    lift: the energy that lifts the scene by its own size [J].
    """
    for start, (run, true) in enumerate(zip(runs, truth, strict=True)):
        given = max(float(true.balance.max(initial=0.0)), 0.0)
        moving = float(true.kinetic.max(initial=0.0)) + float(
            np.ptp(true.balance) if len(true.balance) else 0.0
        )
        gained = float(run.balance.max(initial=0.0)) - given
        if not gained <= LARGE * moving + lift:
            return f"start {start}: gains {joules(gained)} of energy that nothing gives it"
    return None


def runaway(model: Model, schedule: Schedule, runs: Sequence[Run]) -> str | None:
    """Explain why the converged motion diverges under an unstable controller, or return None.

    Controls are constant over the control period, which is part of the physics. A controller that
    is unstable at this period diverges at every time step, while the motion stays finite for long.
    """
    if not model.nu:
        return None
    scene = model.scene
    gravity = float(np.linalg.norm(scene.gravity)) if scene.features.gravity else 0.0
    scale = float(np.sum(model.body_mass)) * (gravity * scene_size(scene) + 0.5)
    for run in runs:
        half = len(run.kinetic) // 2
        if not half or run.failure:
            continue
        most, before = float(run.kinetic[half:].max()), float(run.kinetic[:half].max())
        if not most <= RUNAWAY * scale and not most <= GROWTH * before:
            reached = f"reaches {joules(most)}" if math.isfinite(most) else "overflows"
            return (
                f"the motion itself explodes{schedule.driven}: at the finest time step its kinetic "
                f"energy {reached} within {seconds(schedule.horizon)}; stepcore diagnose names the "
                "cause"
            )
    return None


class Exploded(SimulationError):
    """Raised to end a run that explodes."""


class Explosion:
    """A test that ends an exploding run before its last steps cost more than all earlier steps.

    The positions of bodies far outside of the scene round to the same values, so that all bodies
    overlap. Each of the few steps before the numbers overflow then solves thousands of contacts.

    watches: whether the model has enough pairs of geoms to make a test after every step worthwhile.
    reach: the largest plausible motion in one step, by dof [m or rad], (nv,).
    """

    def __init__(self, model: Model, coordinates: Coordinates) -> None:
        self.watches = model.npair >= PAIRS
        self.model, self.coordinates = model, coordinates
        self.reach = coordinates.scaled(np.full(model.nv, STEP), scene_size(model.scene), 1.0)

    def beyond(self, qvel: np.ndarray, dt: float) -> np.ndarray:
        """Return which dofs move implausibly far in a step; dt: time step [s]. Shape as qvel."""
        # NaN compares as False; the engine reports it.
        over: np.ndarray = np.abs(qvel) * dt > self.reach
        return over

    def reason(self, qvel: np.ndarray, dt: float, time: float) -> str | None:
        """Explain why a world explodes, or return None.

        qvel: the velocities of the world, (nv,). dt: time step [s]. time: [s].
        """
        over = np.flatnonzero(self.beyond(qvel, dt))
        if not len(over):
            return None
        dof, step = int(over[0]), float(np.abs(qvel[over[0]])) * dt
        unit = "m" if self.coordinates.slides[dof] else "rad"
        k = int(np.searchsorted(self.model.jnt_dofadr, dof, "right")) - 1
        joint = self.model.element_name("joint", k)
        return f"exploded at time {time:.6f} s: {joint} moves {step:.0e} {unit} in a step"

    def guarded(self, sim: Sim) -> Callable[[int], None]:
        """Return `sim.step` with a test after every step, which raises Exploded."""

        def step(count: int) -> None:
            dt = sim.settings.dt
            for _ in range(count):
                sim.step(1)
                text = self.reason(sim.qvel, dt, sim.time)
                if text is not None:
                    raise Exploded(text)

        return step
