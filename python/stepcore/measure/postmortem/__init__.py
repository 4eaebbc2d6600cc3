"""What a run that failed tells: why, and how it comes again."""

from __future__ import annotations

from stepcore.measure.postmortem.file import Replay
from stepcore.measure.postmortem.result import PostMortem, replay

__all__ = ["PostMortem", "Replay", "replay"]
