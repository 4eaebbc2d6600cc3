"""Whether a converged motion runs away: a controller feeds it more and more, at every time step.

Controls are held over their period, which is part of the physics. A controller that is unstable
when it is held so explodes however short the step is, and stays finite for long: nothing that is
measured against such a motion has a meaning.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stepcore.experiment.control import control_name
from stepcore.experiment.explosion import build
from stepcore.experiment.path import Path
from stepcore.experiment.runner import Runner
from stepcore.report.units import joules, seconds

# Kinetic energy over what gravity gives the scene over its own size (or a metre a second, if that
# is more), and over the most in the first half of the motion: a constant torque gives four times.
ENERGY, GROWTH = 1e8, 1e4


def runaway(runner: Runner, paths: Sequence[Path]) -> str | None:
    """Why a converged motion is none; None where it is one."""
    if not runner.model.nu:
        return None
    scene = runner.model.scene
    size = build(scene)
    mass = float(np.sum(runner.model.body_mass))
    scale = mass * (float(np.linalg.norm(runner.bodies.gravity)) * size + 0.5)
    for path in paths:
        half = len(path.kinetic) // 2
        if not half or path.failure:
            continue
        most, before = float(path.kinetic[half:].max()), float(path.kinetic[:half].max())
        if not most <= ENERGY * scale and not most <= GROWTH * before:
            reached = f"reaches {joules(most)}" if math.isfinite(most) else "overflows"
            return (
                f"the motion itself explodes{driven(runner)}: at the finest time step its kinetic "
                f"energy {reached} within {seconds(runner.schedule.horizon)}; stepcore diagnose "
                "names the cause"
            )
    return None


def driven(runner: Runner) -> str:
    """By which control function, and how often it is sampled; "" without one."""
    schedule = runner.schedule
    if schedule.control is None:
        return ""
    return f" under {control_name(schedule.control)}, sampled every {seconds(schedule.period)}"
