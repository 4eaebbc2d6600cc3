"""The types of fields: each with the check that every assigned value passes."""

from __future__ import annotations

from typing import Annotated

from stepcore import checks
from stepcore.scene.frames import ORIGIN, Vec

GRAVITY: Vec = (0.0, 0.0, -9.81)
SOLREF: Vec = (0.02, 1.0)
SOLIMP: Vec = (0.9, 0.95, 0.001, 0.5, 2.0)
FRICTION: Vec = (1.0, 0.005, 0.0001)
PAIR_FRICTION: Vec = (1.0, 1.0, 0.005, 0.0001, 0.0001)
STILL: Vec = (0.0,) * 6
FLUIDCOEF: Vec = (0.5, 0.25, 1.5, 1.0, 1.0)
POLYCOEF: Vec = (0.0, 1.0, 0.0, 0.0, 0.0)
GEAR: Vec = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)

Text = Annotated[str, checks.text]
Flag = Annotated[bool, checks.flag]
Real = Annotated[float, checks.real()]
Gain = Annotated[float | None, checks.optional(checks.real())]
NonNegative = Annotated[float, checks.real(low=0)]
Mass = Annotated[float | None, checks.optional(checks.real(low=0))]
Int = Annotated[int, checks.whole(-(2**31), 2**31 - 1)]
Mask = Annotated[int, checks.whole(0, 2**32 - 1)]
Vec3 = Annotated[Vec, checks.vector(3)]
Axis = Annotated[Vec, checks.unit(3)]
Quat = Annotated[Vec, checks.unit(4)]
Size = Annotated[Vec, checks.vector(3, low=0, fill=(0.0, 0.0, 0.0))]
Friction = Annotated[Vec, checks.vector(3, low=0, fill=FRICTION)]
PairFriction = Annotated[Vec, checks.vector(5, low=0, fill=PAIR_FRICTION)]
Gear = Annotated[Vec, checks.vector(6, fill=GEAR)]
SurfaceVel = Annotated[Vec, checks.vector(6, fill=STILL)]
FluidCoef = Annotated[Vec, checks.vector(5, fill=FLUIDCOEF)]
SpringDamper = Annotated[Vec | None, checks.optional(checks.vector(2, low=0))]
PolyCoef = Annotated[Vec, checks.vector(5, fill=POLYCOEF)]
RelPose = Annotated[Vec | None, checks.optional(checks.pose)]
Poly = Annotated[Vec, checks.vector(2, fill=(0.0, 0.0))]
DynPrm = Annotated[Vec | None, checks.optional(checks.vector(3, fill=(1.0, 0.0, 0.0)))]
Bias = Annotated[Vec | None, checks.optional(checks.vector(3, fill=ORIGIN))]
SolRef = Annotated[Vec, checks.solref]
SolRefFriction = Annotated[Vec | None, checks.optional(checks.solreffriction)]
SolImp = Annotated[Vec, checks.vector(5, fill=SOLIMP)]
Range = Annotated[tuple[float, float] | None, checks.optional(checks.interval)]
# Of a ball joint, which may turn through no angle.
Reach = Annotated[tuple[float, float] | None, checks.optional(checks.interval_or_zero)]
Numbers = Annotated[Vec | None, checks.optional(checks.numbers)]
Groups = Annotated[tuple[int, ...], checks.whole_pair]
Inertia = Annotated[Vec, checks.inertia]
