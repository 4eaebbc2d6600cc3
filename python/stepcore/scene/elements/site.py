"""`Site`."""

from __future__ import annotations

from dataclasses import dataclass

from stepcore.scene.element import Element
from stepcore.scene.elements.body import ABody
from stepcore.scene.elements.field_types import Quat, Text, Vec3
from stepcore.scene.frames import IDENTITY, ORIGIN


@dataclass(eq=False, repr=False, kw_only=True)
class Site(Element):
    """A named place on a body.

    pos, quat: position [m], shape (3,), and orientation, shape (4,), in the body's frame.
    """

    name: Text = ""
    body: ABody
    pos: Vec3 = ORIGIN
    quat: Quat = IDENTITY
