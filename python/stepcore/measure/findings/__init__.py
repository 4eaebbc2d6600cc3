"""What is worth saying of a run, whatever it was made for: each finding a sentence with its cure.

`run`, `trade`, `converge` and `check` watch a run of the scene as shipped, and say the same of it.
"""

from __future__ import annotations

from collections.abc import Iterator

from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.experiment.runner import Runner
from stepcore.experiment.sizes import Sizes
from stepcore.experiment.watch import Watch
from stepcore.measure.findings.actuators import about_actuators
from stepcore.measure.findings.contacts import about_contacts
from stepcore.measure.findings.finding import Finding, ordered
from stepcore.measure.findings.joints import about_joints
from stepcore.measure.findings.rows import about_rows

__all__ = ["Finding", "findings_of", "ordered", "watched"]


# What a run that failed still shows; the rest is what it exploded into.
BEFORE = ("overlap at the start", "clamped control")


def findings_of(
    model: Model, watch: Watch, depth: float | None = None, failed: bool = False
) -> list[Finding]:
    """What a watched run shows, the most severe first.

    depth: at which contacts are wanted to rest [m]; by default a depth is only told where it is
    large beside the geoms. failed: whether the run did.
    """
    found = _all(model, watch, Sizes(model), depth)
    return ordered(one for one in found if not failed or one.kind in BEFORE)


def _all(model: Model, watch: Watch, sizes: Sizes, depth: float | None) -> Iterator[Finding]:
    yield from about_contacts(model, watch, sizes, depth)
    yield from about_joints(model, watch, sizes)
    yield from about_actuators(model, watch)
    yield from about_rows(model, watch)


def watched(runner: Runner, settings: Settings) -> list[Finding]:
    """The findings of a measurement's motion from its first start, under some settings."""
    model = runner.model.with_settings(settings)
    watch = Watch(model, runner.bodies, runner.schedule.periods)
    path = runner.run(settings, 0, [watch])
    return findings_of(model, watch, failed=path.failure is not None)
