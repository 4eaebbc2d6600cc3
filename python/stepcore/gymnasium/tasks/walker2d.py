"""Walker2d: walk forward on two legs in a plane."""

from __future__ import annotations

from dataclasses import dataclass

from stepcore.gymnasium.tasks.upright import Upright


@dataclass(frozen=True, kw_only=True)
class Walker2d(Upright):
    """The options are those of gymnasium's Walker2d-v5."""

    xml_file: str = "walker2d_v5.xml"
    healthy_z_range: tuple[float, float] = (0.8, 2.0)
    healthy_angle_range: tuple[float, float] = (-1.0, 1.0)
