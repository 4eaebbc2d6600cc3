"""`Settings`: how the reference computes."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """How to compute: the fields and defaults of the engine that the reference knows."""

    dt: float = 0.002
    integrator: str = "semi-implicit"
    solver: str = "pgs"
    acceleration: str = "none"
    sweeps: int | str = 100  # or "auto"
    tolerance: float = 1e-10
    warm_start: bool = True
    law: str = "lesson"
    beta: float = 0.2
    softness: float = 0.0
    restitution: float = 0.0
    slop: float = 0.0
    max_recovery_speed: float | str = "auto"  # or "none"
    penalty_stiffness: float = 1e5
    penalty_damping_ratio: float = 0.1
    cone: str = "pyramidal"
    precision: str = "f64"

    def __post_init__(self) -> None:
        known = {
            "integrator": ("explicit", "semi-implicit", "midpoint", "rk4"),
            "solver": ("pgs",),
            "acceleration": ("none",),
            "law": ("lesson", "relaxed", "rigid", "penalty"),
            "cone": ("pyramidal", "elliptic"),
            "precision": ("f64",),
        }
        for name, values in known.items():
            if getattr(self, name) not in values:
                raise ValueError(
                    f"{name} '{getattr(self, name)}': the reference has {', '.join(values)}"
                )
        speed = self.max_recovery_speed
        if speed not in ("auto", "none") and not (isinstance(speed, float | int) and speed > 0):
            raise ValueError(f"max_recovery_speed {speed}: must be > 0 m/s, 'auto' or 'none'")
        if not self.dt > 0:
            raise ValueError(f"dt {self.dt}: must be > 0 s")
        if self.sweeps == "auto" and not self.tolerance > 0:
            raise ValueError(f"tolerance {self.tolerance}: must be > 0 with sweeps 'auto'")

    @property
    def recovery_limit(self) -> float:
        """The fastest that a contact is pushed apart [m/s]."""
        if isinstance(self.max_recovery_speed, str):
            return 3.0 if self.max_recovery_speed == "auto" else math.inf
        return self.max_recovery_speed

    @property
    def stages(self) -> bool:
        """The smooth motion comes first, and rows after it."""
        return self.integrator in ("midpoint", "rk4") and self.law != "penalty"

    @property
    def connects_inside(self) -> bool:
        """Connections are held at the stages of the step; a softness is that of its end."""
        return self.stages and not (self.law == "lesson" and self.softness > 0)
