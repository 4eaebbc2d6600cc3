"""`Equality`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from stepcore import checks
from stepcore.scene.element import Element
from stepcore.scene.elements.body import ABody
from stepcore.scene.elements.field_types import SOLIMP, SOLREF, Flag, SolImp, SolRef, Text, Vec3
from stepcore.scene.frames import ORIGIN


@dataclass(eq=False, repr=False, kw_only=True)
class Equality(Element):
    """A constraint between two bodies.

    name: unique among equalities, or "".
    type: "connect": the bodies share one point.
    body1, body2: the two `Body` objects.
    anchor: the point in the frame of body1, in the pose of the scene [m], shape (3,).
    active: False leaves the constraint out.
    solref, solimp: softness of the constraint.
    """

    name: Text = ""
    type: Annotated[str, checks.one_of("connect")] = "connect"
    body1: ABody
    body2: ABody
    anchor: Vec3 = ORIGIN
    active: Flag = True
    solref: SolRef = SOLREF
    solimp: SolImp = SOLIMP
