"""HalfCheetah: run forward."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from stepcore.gymnasium.tasks.mujoco_task import ForwardTask


@dataclass(frozen=True, kw_only=True)
class HalfCheetah(ForwardTask):
    """The options are those of gymnasium's HalfCheetah-v5."""

    normal: ClassVar[bool] = True

    xml_file: str = "half_cheetah.xml"
