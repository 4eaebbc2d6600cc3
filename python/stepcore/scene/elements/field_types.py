"""The types of fields: the check of assigned values, and MJCF's notation of the attribute."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated

from stepcore import checks
from stepcore.scene.element import FieldType
from stepcore.scene.frames import ORIGIN, Vec

GRAVITY: Vec = (0.0, 0.0, -9.81)
MAGNETIC: Vec = (0.0, -0.5, 0.0)
# The values of the whole scene that belong to no element, with their defaults.
WHOLE: dict[str, float | Vec] = {
    **{"gravity": GRAVITY, "density": 0.0, "viscosity": 0.0},
    **{"wind": ORIGIN, "magnetic": MAGNETIC},
}
SOLREF: Vec = (0.02, 1.0)
SOLIMP: Vec = (0.9, 0.95, 0.001, 0.5, 2.0)
FRICTION: Vec = (1.0, 0.005, 0.0001)
PAIR_FRICTION: Vec = (1.0, 1.0, 0.005, 0.0001, 0.0001)
ZERO_VELOCITY: Vec = (0.0,) * 6
FLUIDCOEF: Vec = (0.5, 0.25, 1.5, 1.0, 1.0)
POLYCOEF: Vec = (0.0, 1.0, 0.0, 0.0, 0.0)
GEAR: Vec = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
# MJCF's notation of a flag, and of a flag whose default depends on other attributes.
BOOL, AUTO = "false|true", "false|true|auto"


def real(low: float = -math.inf, above: float = -math.inf) -> FieldType:
    """Return the type of a number within limits."""
    return FieldType(checks.real(low, above), "float", "1")


def vector(count: int, *, low: float = -math.inf, fill: Vec = ()) -> FieldType:
    """Return the type of `count` numbers; with `fill`, fewer numbers may be given."""
    check = checks.vector(count, low=low, fill=fill)
    return (
        FieldType(check, "Numbers", f"1-{count}")
        if fill
        else FieldType(check, "Vector", str(count))
    )


def unit(count: int) -> FieldType:
    """Return the type of a direction or a quaternion."""
    return FieldType(checks.unit(count), "Vector", str(count))


def words(*allowed: str) -> FieldType:
    """Return the type of a word from a list."""
    return FieldType(checks.one_of(*allowed), "str", "|".join(allowed))


def whole(low: int, high: int) -> FieldType:
    """Return the type of a whole number within limits."""
    return FieldType(checks.whole(low, high), "int", "int")


def element(*kinds: str) -> FieldType:
    """Return the type of a reference to an element of these classes; MJCF gives its name."""
    return FieldType(checks.element(*kinds), "", "", refers=kinds)


def optional(inner: FieldType) -> FieldType:
    """Return the type that also allows None."""
    annotation = inner.annotation and f"{inner.annotation} | None"
    return replace(inner, check=checks.optional(inner.check), annotation=annotation)


Text = Annotated[str, FieldType(checks.text, "str", "")]
Flag = Annotated[bool, FieldType(checks.flag, "bool", BOOL)]
# A flag without an MJCF attribute.
OwnFlag = Annotated[bool, FieldType(checks.flag, "bool")]
Real = Annotated[float, real()]
Gain = Annotated[float | None, optional(real())]
Limit = Annotated[float | None, optional(real(low=0))]
NonNegative = Annotated[float, real(low=0)]
Positive = Annotated[float, real(above=0)]
Mass = Annotated[float | None, optional(real(low=0))]
Delay = Annotated[float, replace(real(low=0), read=lambda value: max(value, 0.0))]
Int = Annotated[int, whole(-(2**31), 2**31 - 1)]
Condim = Annotated[int, FieldType(checks.one_of(1, 3, 4, 6), "int", "int")]
# MJCF's masks are signed.
Mask = Annotated[
    int,
    replace(
        whole(0, 2**32 - 1),
        read=lambda value: value % 2**32,
        write=lambda value: (value + 2**31) % 2**32 - 2**31,
    ),
]
Vec3 = Annotated[Vec, vector(3)]
Axis = Annotated[Vec, unit(3)]
Quat = Annotated[Vec, unit(4)]
Size = Annotated[Vec, vector(3, low=0, fill=(0.0, 0.0, 0.0))]
Friction = Annotated[Vec, vector(3, low=0, fill=FRICTION)]
PairFriction = Annotated[Vec, vector(5, low=0, fill=PAIR_FRICTION)]
Gear = Annotated[Vec, vector(6, fill=GEAR)]
SurfaceVel = Annotated[Vec, vector(6, fill=ZERO_VELOCITY)]
FluidCoef = Annotated[Vec, vector(5, fill=FLUIDCOEF)]
# In MJCF the two numbers count only if both are positive.
SpringDamper = Annotated[
    Vec | None,
    replace(optional(vector(2, low=0)), read=lambda value: value if min(value) > 0 else None),
]
PolyCoef = Annotated[Vec, vector(5, fill=POLYCOEF)]
# A zero quaternion in MJCF means: as in the initial pose.
RelPose = Annotated[
    Vec | None,
    FieldType(
        checks.optional(checks.pose),
        "Vector | None",
        "7",
        read=lambda value: value if any(value[3:]) else None,
    ),
]
# The higher coefficients of a polynomial; MJCF writes them in the attribute of the first.
Poly = Annotated[Vec, replace(vector(2, fill=(0.0, 0.0)), attribute=None)]
DynPrm = Annotated[Vec | None, replace(optional(vector(3, fill=(1.0, 0.0, 0.0))), attribute="*")]
Bias = Annotated[Vec | None, replace(optional(vector(3, fill=ORIGIN)), attribute="3")]
SolRef = Annotated[
    Vec, FieldType(checks.solref, "Vector", "1-2", read=lambda value: value + SOLREF[len(value) :])
]
# MuJoCo's "0 0" means: the solref of the normal.
SolRefFriction = Annotated[
    Vec | None,
    FieldType(
        checks.optional(checks.solreffriction),
        "Vector | None",
        "1-2",
        read=lambda value: (*value, 0.0)[:2] if any(value) else None,
    ),
]
SolImp = Annotated[Vec, vector(5, fill=SOLIMP)]
Range = Annotated[
    tuple[float, float] | None, FieldType(checks.optional(checks.interval), "Vector | None", "2")
]
# The range of a joint: a ball may have the range (0, 0).
Reach = Annotated[
    tuple[float, float] | None,
    FieldType(checks.optional(checks.interval_or_zero), "Vector | None", "2"),
]
# An empty range in MJCF means no range.
Lengths = Annotated[
    tuple[float, float] | None,
    FieldType(
        checks.optional(checks.interval),
        "Vector | None",
        "2",
        read=lambda value: value if value[0] < value[1] else None,
    ),
]
Numbers = Annotated[Vec | None, FieldType(checks.optional(checks.numbers), "Vector | None", "*")]
Groups = Annotated[tuple[int, ...], FieldType(checks.whole_pair, "Sequence[int]", "int2")]
Inertia = Annotated[Vec, FieldType(checks.inertia, "Vector", None)]
