"""The gains of an actuator from its element and its default classes.

MuJoCo's rule: `<general>` inherits from its class. A shortcut (`<position>`, `<velocity>`, …)
inherits from the innermost class whose actuator was last written as the same shortcut or as
`<general>`; without one it has defaults of its own. A class stores its gains as `<general>` would.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from stepcore.mjcf.nodes import Node
from stepcore.mjcf.validation import bad
from stepcore.scene.frames import Vec

BUILT = ("motor", "position", "velocity", "general")


@dataclass(frozen=True)
class ActuatorGains:
    """The gains of an actuator or a default class.

    tag: the element that gave them. inheritrange: the scale of an inherited range, or 0.
    """

    tag: str = "general"
    gainprm: Vec = (1.0,)
    biasprm: Vec = (0.0, 0.0, 0.0)
    dyntype: str = "none"
    gaintype: str = "fixed"
    biastype: str = "none"
    inheritrange: float = 0.0
    dynprm: Vec = (1.0, 0.0, 0.0)

    @property
    def is_position(self) -> bool:
        """Whether it controls a length; only then can it inherit its joint's range."""
        return self.biastype == "affine" and self.gainprm[0] == -self.biasprm[1]


Chain = tuple[ActuatorGains, ...]


def inherited(chain: Chain, node: Node) -> ActuatorGains:
    """The gains of an actuator or a default; chain: those of its classes, outermost first."""
    if node.tag not in BUILT:
        return ActuatorGains(node.tag)
    # Only a <general> of the same class uses it.
    kept = chain[-1].inheritrange
    if node.tag == "motor":
        return ActuatorGains("motor", inheritrange=kept)
    if node.tag == "general":
        return _general(chain[-1], node)
    base = next((g for g in reversed(chain) if g.tag in (node.tag, "general")), ActuatorGains())
    if node.tag == "position":
        return _position(base, node)
    kv = node.values.get("kv", base.gainprm[0])
    return ActuatorGains("velocity", (kv,), (0.0, 0.0, -kv), biastype="affine", inheritrange=kept)


def _general(base: ActuatorGains, node: Node) -> ActuatorGains:
    if base.tag not in BUILT:
        raise node.unbuilt(f"<general> in a class whose default is <{base.tag}>")
    values = node.values
    given: dict[str, Any] = {
        name: (*values[name], *getattr(base, name)[len(values[name]) :])
        for name in ("gainprm", "biasprm", "dynprm")
        if values.get(name)
    }
    given |= {n: values[n] for n in ("dyntype", "gaintype", "biastype") if n in values}
    return replace(base, tag="general", inheritrange=_inheritrange(base, node), **given)


def _position(base: ActuatorGains, node: Node) -> ActuatorGains:
    values = node.values
    for name in ("kv", "dampratio", "timeconst"):
        if values.get(name, 0.0) < 0:
            raise bad(node, name, values[name], ">= 0")
    if "kv" in values and "dampratio" in values:
        raise node.error("<position> has both kv and dampratio")
    kp = values.get("kp", base.gainprm[0])
    # Above 0 the last one is a damping ratio.
    damping = base.biasprm[2]
    if "kv" in values or "dampratio" in values:
        damping = values.get("dampratio", -values.get("kv", 0.0))
    dyntype, dynprm = (base.dyntype, base.dynprm) if base.tag == "position" else ("none", (1.0,))
    if "timeconst" in values:
        dyntype = "filterexact" if values["timeconst"] > 0 else "none"
        dynprm = (values["timeconst"],)
    bias = (0.0, -kp, damping)
    inherited = _inheritrange(base, node)
    return ActuatorGains("position", (kp,), bias, dyntype, "fixed", "affine", inherited, dynprm)


def _inheritrange(base: ActuatorGains, node: Node) -> float:
    """The scale from the joint's range to the control's; 0 if a control range is given."""
    given: float = node.values.get("inheritrange", base.inheritrange)
    if "ctrlrange" not in node.values:
        return given
    if node.values.get("inheritrange", 0.0) > 0:
        raise node.error(f"<{node.tag}> has both ctrlrange and inheritrange")
    return 0.0


def without_range(values: dict[str, Any], node: Node) -> dict[str, Any]:
    """The values of a class, without ctrlrange if `node` inherits the joint's range."""
    takes_over = node.values.get("inheritrange", 0.0) > 0
    return {name: v for name, v in values.items() if name != "ctrlrange" or not takes_over}
