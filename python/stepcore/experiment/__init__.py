"""Experiments on a scene, all by one loop: vary, run, score, choose, confirm, report.

`Study` runs `Change`s of a scene in one motion and scores them as `Trial`s; `choose` chooses, and
`Study.answer` returns the numbers and sentences as an `Answer`. `units` reads and prints lengths
and times.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stepcore.experiment import choose as choose
    from stepcore.experiment.answer import Answer as Answer
    from stepcore.experiment.arguments import Workers as Workers
    from stepcore.experiment.change import Change as Change
    from stepcore.experiment.change import Servo as Servo
    from stepcore.experiment.motion import Motion as Motion
    from stepcore.experiment.quantity import Quantity as Quantity
    from stepcore.experiment.study import Study as Study
    from stepcore.experiment.trial import Trial as Trial
    from stepcore.report import units as units

# The module of each name. A module is imported when one of its names is first used.
_HOME = {
    **{"Answer": "answer", "Change": "change", "Motion": "motion", "Servo": "change"},
    **{"Quantity": "quantity", "Study": "study", "Trial": "trial", "Workers": "arguments"},
}
_MODULES = {"choose": "stepcore.experiment.choose", "units": "stepcore.report.units"}
__all__ = [
    *("Answer", "Change", "Motion", "Quantity", "Servo", "Study", "Trial", "Workers"),
    *("choose", "units"),
]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(_MODULES[name])
    if name in _HOME:
        return getattr(importlib.import_module(f"stepcore.experiment.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
