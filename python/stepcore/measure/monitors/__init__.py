"""Findings of a run: creep, gaps, contact depths, limits, servos that sag or are saturated, falls.

The findings are measured on the run itself and need no reference. `run`, `trade`, `converge` and
`check` examine a run of the scene as shipped.
"""

from __future__ import annotations

import dataclasses
import math

from stepcore.engine.follow import Followed
from stepcore.engine.model import Model
from stepcore.experiment.schedule import Schedule
from stepcore.measure.monitors.contacts import contact_findings
from stepcore.measure.monitors.creep import creep_findings
from stepcore.measure.monitors.finding import Finding, Next, ordered, verified
from stepcore.measure.monitors.grips import grip_findings
from stepcore.measure.monitors.joints import joint_findings
from stepcore.measure.monitors.motions import motion_findings
from stepcore.measure.monitors.recording import Recording, cut, recorded
from stepcore.measure.monitors.scene import energy_findings, resting_findings
from stepcore.measure.monitors.servos import actuator_findings, fall_findings
from stepcore.measure.monitors.tunnelling import tunnelling_findings

__all__ = ["Finding", "Next", "Recording", "monitored", "ordered", "shown", "verified"]

# The monitors of a run; equally severe findings are reported in this order.
FINDINGS = (
    *(fall_findings, tunnelling_findings, grip_findings, creep_findings, contact_findings),
    *(joint_findings, actuator_findings, resting_findings),
    motion_findings,
)


def shown(run: Recording, depth: float | None = None) -> list[Finding]:
    """Return the findings of a run, most severe first; their fixes have not been tried.

    depth: the wanted depth of resting contacts [m]. By default a depth is a finding only if large
    relative to the geoms. A run that failed reports only its initial overlaps; other findings
    would describe the explosion.
    """
    run.wanted = depth
    asked = FINDINGS if run.failure is None else (contact_findings,)
    return ordered(finding for find in asked if len(run) for finding in find(run))


def monitored(
    model: Model, schedule: Schedule, depth: float | None = None, ran: Followed | None = None
) -> tuple[list[Finding], str | None]:
    """Run a schedule from its first start, and return the findings and any failure.

    Their fixes are tested in this motion. depth: see `shown`. ran: an existing run of the motion,
    which may be longer.
    """

    def again(other: Model, share: float) -> Recording | None:
        periods = math.ceil(share * schedule.periods)
        run = recorded(other, dataclasses.replace(schedule, periods=periods))
        return run if run.failure is None else None

    run = cut(model, schedule, ran) or recorded(model, schedule)
    plain = model.with_settings(model.settings.replace(ledger=False))
    steps = schedule.periods * schedule.steps(model.settings.dt)
    found = shown(run, depth)
    # `shown` leaves out energies, because the work of pushes on a run is unknown to it.
    found += energy_findings(run) if run.failure is None else ()
    return verified(ordered(found), plain, again, steps), run.failure
