"""A quick run of the motion: where the bodies are at the samples, and what it costs; no more.

What the search looks at hundreds of times. The errors in the table are of `Course.run`.
"""

from __future__ import annotations

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.checks import one_line
from stepcore.experiment.coordinates import rotated
from stepcore.experiment.cost import UNKNOWN, Counter, Work
from stepcore.experiment.runner import Course, Path


def glance(
    course: Course, settings: Settings, start: int, priced: bool = False
) -> tuple[Path, Work]:
    """The motion from one start; if priced, what work that is, else unknown.

    Of the path only com, quat, row_updates and failure are known.
    """
    path = Path()
    motion, moving = course.motion, course.dofs.moving
    counter = Counter(course, settings) if priced else None
    try:
        sim = course.sim(settings)
        course.place(sim, start)
        drive, count = course.drive(start), motion.steps(settings.dt)
        xpos, quat = [], []
        for period in range(motion.periods):
            drive(sim, period)
            if counter is not None and period % motion.every == 0:
                counter.look(sim)
            sim.step(count)
            if (period + 1) % motion.every == 0:
                xpos.append(sim.xpos[moving])
                quat.append(sim.xquat[moving])
        path.row_updates = sim.row_updates
    except (ValueError, SimulationError) as error:
        path.failure = one_line(error)
        return path, UNKNOWN
    path.quat, path.gyration = np.array(quat), course.gyration
    with np.errstate(over="ignore", invalid="ignore"):
        path.com = np.array(xpos) + rotated(path.quat, course.ipos)
    if not np.all(np.isfinite(path.com)):
        path.failure = "positions overflow"
    return path, UNKNOWN if counter is None else counter.total(sim)
