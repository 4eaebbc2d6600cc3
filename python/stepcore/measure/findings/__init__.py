"""What is worth saying of a run, whatever it was made for: each finding a sentence with its cure.

`run`, `trade`, `converge` and `check` watch a run of the scene as shipped, and say the same of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.experiment.runner import Runner
from stepcore.experiment.sizes import Sizes
from stepcore.experiment.watch import Watch
from stepcore.measure.findings.actuators import about_actuators
from stepcore.measure.findings.contacts import about_contacts
from stepcore.measure.findings.finding import Finding, ordered
from stepcore.measure.findings.joints import about_joints

__all__ = ["Finding", "findings_of", "ordered", "watched"]


def findings_of(model: Model, watch: Watch, depth: float | None = None) -> list[Finding]:
    """What a watched run shows, the most severe first.

    depth: at which contacts are wanted to rest [m]; by default a depth is only told where it is
    large beside the geoms.
    """
    sizes = Sizes(model)
    return ordered(_all(model, watch, sizes, depth))


def _all(model: Model, watch: Watch, sizes: Sizes, depth: float | None) -> Iterator[Finding]:
    yield from about_contacts(model, watch, sizes, depth)
    yield from about_joints(model, watch, sizes)
    yield from about_actuators(model, watch)


def watched(runner: Runner, settings: Settings, starts: Iterable[int] = (0,)) -> list[Finding]:
    """The findings of a measurement's motion under some settings, those of each start once."""
    found: dict[tuple[str, str], Finding] = {}
    for start in starts:
        watch = Watch(runner.model, runner.bodies)
        runner.run(settings, start, [watch])
        for one in findings_of(runner.model.with_settings(settings), watch):
            found.setdefault((one.kind, one.element), one)
    return ordered(found.values())
