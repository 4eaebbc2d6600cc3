"""The norm of all measurements; it stands in `stepcore.engine.norm`."""

from stepcore.engine.norm import Matter as Matter
from stepcore.engine.norm import Tracks as Tracks
from stepcore.engine.norm import apart as apart
from stepcore.engine.norm import largest as largest
from stepcore.engine.norm import rms as rms
