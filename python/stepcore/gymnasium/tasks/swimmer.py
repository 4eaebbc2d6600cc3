"""Swimmer: swim forward in a plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from stepcore.gymnasium.tasks.mujoco_task import ForwardTask


@dataclass(frozen=True, kw_only=True)
class Swimmer(ForwardTask):
    """The options are those of gymnasium's Swimmer-v5."""

    axes: ClassVar[str] = "xy"

    xml_file: str = "swimmer.xml"
    frame_skip: int = 4
    ctrl_cost_weight: float = 1e-4
