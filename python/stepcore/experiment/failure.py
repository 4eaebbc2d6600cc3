"""When a run has failed. Each meaning has one threshold, which every measurement uses.

- It *ended early*: the engine raised, positions overflow, or a step moved the scene by `STEP`
  times its size (`Explosion`).
- It is *far* from the reference: by more than `FAR` sizes of the scene.
- Its energy is *large*: more than `LARGE` times what the reference has and gravity could give.
- Where there is no reference yet, a motion *runs away* if its energy exceeds `RUNAWAY` times what
  gravity gives the scene, and still grows (`runaway`).
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

# Sizes of the scene. A run that is wrong by a few sizes has an error, which a measurement reports:
# a ball that rolls away does that. At a hundred sizes it has left the scene that was modelled.
FAR = 100.0
# Times the reference's energy. An integrator's own energy error is a part of the energy in motion,
# so that ten times as much was made by rows or feedback that push too hard.
LARGE = 10.0
# Kinetic energy over what gravity gives the scene over its own size (or a metre a second, if that
# is more), and over the most in the first half of the motion: a constant torque gives four times.
# A speed of ten thousand times that of a fall is no motion of use.
RUNAWAY, GROWTH = 1e8, 1e4
# Sizes of the scene, or radians, in a single step: a hundred times as far as `FAR`, at once.
STEP = 1e4
# With fewer pairs of geoms than this no step is dear, and a look after each step would be.
PAIRS = 200


def failure(
    runs: Sequence[Run], truth: Sequence[Run], size: float, weight: float | None = None
) -> str | None:
    """Why runs from several starts failed, or None.

    truth: the reference's runs, from the same starts. size: of the scene [m]. weight: of all bodies
    [N]; without it, as where positions alone were recorded, energies are not compared.
    """
    for start, run in enumerate(runs):
        if run.failure:
            return f"start {start}: {run.failure}"
    far = far_off(runs, truth, size)
    return far if far or weight is None else _gains_energy(runs, truth, weight * size)


def far_off(runs: Sequence[Run], truth: Sequence[Run], size: float) -> str | None:
    """Why runs that are nowhere near the reference failed, or None.

    All samples count: chaos is no reason to be far outside of the scene.
    """
    for start, (run, true) in enumerate(zip(runs, truth, strict=True)):
        apart = float(distance(run, true).max(initial=0.0))
        if not apart <= FAR * size:
            return f"start {start}: far off ({apart:.2g} m from the reference)"
    return None


def _gains_energy(runs: Sequence[Run], truth: Sequence[Run], lift: float) -> str | None:
    """Why runs failed that have energy which nothing gave them, or None.

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
    """Why a converged motion is useless because a controller feeds it more and more, or None.

    Controls are held over their period, which is part of the physics. A controller that is unstable
    when it is held so explodes however short the step is, and stays finite for long.
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
    """A run that was ended because it explodes."""


class Explosion:
    """Ends a run that explodes, before its last steps cost more than all those before them.

    Bodies that are thrown far beyond the scene all overlap in the rounding of their positions: each
    of the few steps until the numbers overflow then solves thousands of contacts.

    watches: whether the model has so many pairs of geoms that this is worth a look at every step.
    """

    def __init__(self, model: Model, coordinates: Coordinates) -> None:
        self.watches = model.npair >= PAIRS
        self.model, self.coordinates = model, coordinates
        self.reach = coordinates.scaled(np.full(model.nv, STEP), scene_size(model.scene), 1.0)

    def beyond(self, qvel: np.ndarray, dt: float) -> np.ndarray:
        """Whether worlds move further in a step of dt [s] than any motion does, by dof."""
        # NaN compares as False: the engine reports it.
        over: np.ndarray = np.abs(qvel) * dt > self.reach
        return over

    def reason(self, qvel: np.ndarray, dt: float, time: float) -> str | None:
        """Why a world explodes at a time [s], or None; qvel: its velocities."""
        over = np.flatnonzero(self.beyond(qvel, dt))
        if not len(over):
            return None
        dof, step = int(over[0]), float(np.abs(qvel[over[0]])) * dt
        unit = "m" if self.coordinates.slides[dof] else "rad"
        k = int(np.searchsorted(self.model.jnt_dofadr, dof, "right")) - 1
        joint = self.model.element_name("joint", k)
        return f"exploded at time {time:.6f} s: {joint} moves {step:.0e} {unit} in a step"

    def guarded(self, sim: Sim) -> Callable[[int], None]:
        """`sim.step`, which raises Exploded after the step in which the motion explodes."""

        def step(count: int) -> None:
            dt = sim.settings.dt
            for _ in range(count):
                sim.step(1)
                text = self.reason(sim.qvel, dt, sim.time)
                if text is not None:
                    raise Exploded(text)

        return step
