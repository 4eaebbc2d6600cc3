"""`Site`: a named frame on a body of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from stepcore.scene.element import Element
from stepcore.scene.elements import field_types as of
from stepcore.scene.elements.body import ABody
from stepcore.scene.frames import IDENTITY, ORIGIN

# MuJoCo's default size of a site.
SITE_SIZE = (0.005, 0.005, 0.005)


@dataclass(eq=False, repr=False, kw_only=True)
class Site(Element):
    """A named frame on a body, with a volume that some sensors use.

    name: unique among sites, or "".
    body: the `Body` that the site is fixed to.
    pos, quat: position [m], shape (3,), and orientation, shape (4,), in the body's frame.
    type: shape of the volume: "sphere", "capsule", "ellipsoid", "cylinder" or "box".
    size: size of the volume [m], as for a geom, shape (3,). Fewer numbers may be given.
    """

    name: of.Text = ""
    body: ABody
    pos: Annotated[of.Vec3, "m"] = ORIGIN
    quat: of.Quat = IDENTITY
    type: Annotated[str, of.words("sphere", "capsule", "ellipsoid", "cylinder", "box")] = "sphere"
    size: Annotated[of.Size, "m"] = SITE_SIZE


SomeSite = Annotated[Site | None, of.optional(of.element("Site"))]
