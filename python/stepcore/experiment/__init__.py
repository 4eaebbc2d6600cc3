"""Experiments: a user's questions to a scene, on one loop: vary, run, score, choose, confirm, say.

`Study` runs `Change`s of a scene in one motion and scores them as `Trial`s; `choose` chooses.
"""

from __future__ import annotations

import importlib
from typing import Any

# Each name with its module: imported when it is first used, as all of stepcore is.
_HOME = {"Change": "change", "Study": "study", "Trial": "trial", "Motion": "motion"}
__all__ = ["Change", "Motion", "Study", "Trial", "choose"]


def __getattr__(name: str) -> Any:
    if name == "choose":
        return importlib.import_module("stepcore.experiment.choose")
    if name in _HOME:
        return getattr(importlib.import_module(f"stepcore.experiment.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
