"""The order of a scene's elements in the compiled model.

As in MuJoCo, bodies are ordered depth first, and joints, geoms and sites body by body.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from stepcore import checks
from stepcore.scene.elements import Body, Element, Geom, Joint

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

QPOS = {"free": 7, "ball": 4, "slide": 1, "hinge": 1}
DOFS = {"free": 6, "ball": 3, "slide": 1, "hinge": 1}
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3, "plane": 0}
# These take their sizes from their assets.
SIZES |= {"mesh": 0, "hfield": 0}
# The scene's list of each kind of element.
LISTS = {
    **{"body": "bodies", "joint": "joints", "geom": "geoms", "mesh": "meshes"},
    **{"hfield": "hfields", "site": "sites", "tendon": "tendons", "actuator": "actuators"},
    **{"equality": "equalities", "sensor": "sensors", "pair": "pairs", "key": "keys"},
}


class Layout:
    """The elements of a scene in the order of the compiled model."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.bodies = _depth_first(scene.bodies)
        self.index = {id(body): i for i, body in enumerate(self.bodies)}
        # For each kind and ``id`` of an element: its index.
        self._places: dict[str, dict[int, int]] = {"body": self.index}
        self.joints: list[Joint] = self._by_body(scene.joints)
        self.geoms: list[Geom] = self._by_body(scene.geoms)
        self.sites = self._by_body(scene.sites)
        self.joints_of: dict[int, list[Joint]] = {}
        for joint in self.joints:
            self.joints_of.setdefault(id(joint.body), []).append(joint)

    def _by_body(self, elements: Iterable[Any]) -> list[Any]:
        return sorted(elements, key=lambda e: self.needed(e, e.body))

    def needed(self, owner: Element | str, element: Element) -> int:
        """Return the index of an element that `owner` refers to; raise if the scene has it not."""
        index = self.place(element)
        if index is None:
            raise checks.ElementError(owner, f"refers to {element}, which is not in this scene")
        return index

    def elements(self, kind: str) -> Sequence[Any]:
        """Return the elements of a kind, in the order of the compiled model."""
        ordered = self if kind in ("body", "joint", "geom", "site") else self.scene
        elements: Sequence[Any] = getattr(ordered, LISTS[kind])
        return elements

    def body_called(self, body: Body) -> str:
        """Return the label of a body in errors: "body 'leg'", or "body 3" without a name."""
        if body is self.bodies[0]:
            return "the world"
        return f"body '{body.name}'" if body.name else f"body {self.needed(body, body)}"

    @property
    def nq(self) -> int:
        return sum(QPOS[joint.type] for joint in self.joints)

    @property
    def nv(self) -> int:
        return sum(DOFS[joint.type] for joint in self.joints)

    @property
    def na(self) -> int:
        """The number of activations."""
        return sum(actuator.law.states for actuator in self.scene.actuators)

    def place(self, element: Element) -> int | None:
        """Return the index of an element in the list of its kind; None if not in the scene."""
        kind = type(element).__name__.lower()
        if kind not in self._places:
            self._places[kind] = {id(each): at for at, each in enumerate(self.elements(kind))}
        return self._places[kind].get(id(element))

    @cached_property
    def _moving(self) -> set[int]:
        moving: set[int] = set()
        # Parents precede their children.
        for body in self.bodies:
            if id(body) in self.joints_of or id(body.parent) in moving:
                moving.add(id(body))
        return moving

    def moving(self, body: Body | None) -> bool:
        """Return whether there is a joint between this body and the world."""
        return id(body) in self._moving

    def qpos0(self) -> list[float]:
        """Return qpos in the scene's initial pose, length nq."""
        qpos: list[float] = []
        for joint in self.joints:
            if joint.type == "free":
                qpos += [*joint.body.pos, *joint.body.quat]
            elif joint.type == "ball":
                qpos += [1.0, 0.0, 0.0, 0.0]
            else:
                qpos.append(joint.ref)
        return qpos

    def unit_quaternions(self, qpos: Iterable[float]) -> list[float]:
        """Return `qpos` with normalised quaternions; a zero quaternion becomes the identity."""
        result = list(qpos)
        at = 0
        for joint in self.joints:
            if joint.type in ("free", "ball"):
                start = at + (3 if joint.type == "free" else 0)
                quat = result[start : start + 4]
                norm = math.hypot(*quat)
                if norm < checks.TINY_LENGTH:
                    quat = [1.0, 0.0, 0.0, 0.0]
                elif abs(norm - 1) > 1e-15:
                    quat = [x / norm for x in quat]
                result[start : start + 4] = quat
            at += QPOS[joint.type]
        return result


def _depth_first(bodies: list[Body]) -> list[Body]:
    children: dict[int, list[Body]] = {}
    for body in bodies[1:]:
        if body.parent is None:
            raise checks.ElementError(body, "parent = None: only the world has no parent")
        children.setdefault(id(body.parent), []).append(body)
    order: list[Body] = []
    stack = [bodies[0]]
    while stack:
        body = stack.pop()
        order.append(body)
        stack.extend(reversed(children.get(id(body), [])))
    if len(order) != len(bodies):
        seen = {id(body) for body in order}
        lost = next(body for body in bodies if id(body) not in seen)
        raise checks.ElementError(lost, "is not connected to the world through its parents")
    return order


def label_of(scene: Scene, element: object) -> str:
    """Return the engine's label of an element: "joint 3 of body 'leg'" without a name.

    The label of an element that is not yet in the scene has the index that it would get.
    """
    kind = type(element).__name__.lower()
    try:
        layout = Layout(scene)
        if getattr(element, "name", "") or kind not in LISTS or kind in ("mesh", "hfield"):
            return str(element)
        elements = layout.elements(kind)
        index = next((k for k, other in enumerate(elements) if other is element), len(elements))
        body = getattr(element, "body", None)
        whose = f" of {layout.body_called(body)}" if isinstance(body, Body) else ""
        return f"{kind} {index}{whose}"
    except checks.ElementError:
        # The scene refers to an element that is not in the scene.
        return str(element)


def relabelled(scene: Scene, error: checks.ElementError) -> checks.ElementError:
    """Return the error with the element named as the engine names it."""
    renamed = checks.ElementError(label_of(scene, error.owner), error.text)
    renamed.owner = error.owner
    return renamed
