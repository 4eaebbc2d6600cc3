"""`Pair` and `ContactOverride`: contact parameters that do not come from geoms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from stepcore.scene.element import Element
from stepcore.scene.elements import field_types as of
from stepcore.scene.elements.geom import AGeom


@dataclass(eq=False, repr=False, kw_only=True)
class Pair(Element):
    """Two geoms that can collide, with contact parameters of the pair's own.

    The parameters and masks of the geoms have no effect on the pair, nor do excluded bodies. The
    geoms collide even if the body of one geom is the parent of the body of the other geom.

    name: unique among pairs, or "".
    geom1, geom2: the two `Geom` objects.
    condim: dimension of the contact: 1 (frictionless), 3 (sliding), 4 (and torsion about the
        normal) or 6 (and rolling).
    friction: sliding along both tangents [1], torsional [m], and rolling about both [m], shape
        (5,), >= 0. A pyramid or cone can be narrower along one tangent than along the other.
    solref, solimp: softness of the pair's contacts.
    solreffriction: solref of the friction rows of an elliptic cone, where only the damping counts;
        None means the solref of the normal row.
    margin: distance below which contacts act [m].
    gap: contacts are listed at distances below margin + gap [m].
    adhesion: largest pulling force of each contact [N].
    """

    name: of.Text = ""
    geom1: AGeom
    geom2: AGeom
    condim: of.Condim = 3
    friction: of.PairFriction = of.PAIR_FRICTION
    solref: of.SolRef = of.SOLREF
    solimp: of.SolImp = of.SOLIMP
    solreffriction: of.SolRefFriction = None
    margin: Annotated[of.Real, "m"] = 0.0
    gap: Annotated[of.NonNegative, "m"] = 0.0
    adhesion: Annotated[of.NonNegative, "N"] = 0.0


@dataclass(eq=False, repr=False, kw_only=True)
class ContactOverride(Element):
    """Contact parameters that replace the parameters of every contact while `enable` is True.

    MJCF's ``o_margin``, ``o_solref``, ``o_solimp``, ``o_friction`` and the flag ``override``.

    margin: distance below which contacts act [m].
    solref, solimp: softness.
    friction: as in `Pair`, shape (5,).
    """

    enable: of.Flag = False
    margin: Annotated[of.Real, "m"] = 0.0
    solref: of.SolRef = of.SOLREF
    solimp: of.SolImp = of.SOLIMP
    friction: of.PairFriction = of.PAIR_FRICTION

    def __str__(self) -> str:
        return "contact_override"
