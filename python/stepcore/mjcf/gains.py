"""The force law of an actuator from its element and its default classes.

MuJoCo's rule: `<general>` inherits from its class. A shortcut (`<position>`, `<velocity>`, …)
inherits from the innermost class whose actuator was last written as the same shortcut or as
`<general>`; without one it has defaults of its own. A class stores its law as `<general>` would.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

from stepcore.mjcf import canonical, controllers
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.validation import bad
from stepcore.scene.elements.actuator import CHARTS, MUSCLE
from stepcore.scene.frames import ORIGIN, Vec

BUILT = (
    *(
        "motor",
        "position",
        "velocity",
        "intvelocity",
        "damper",
        "cylinder",
        "muscle",
        "adhesion",
        "pid",
        "dcmotor",
        "orientation",
        "general",
    ),
)


@dataclass(frozen=True)
class ActuatorGains:
    """The force law of an actuator or a default class.

    tag: the element that gave it. inheritrange: the scale of an inherited range, or 0.
    input, motor, torque: of a controller, what its control is; of a motor its constant and
        resistance, and the bound of its torque, 0 without one, None where nothing is said.
    more: of a controller, its other numbers by name.
    damping: the first coefficient of the damping that the actuator itself has.
    """

    tag: str = "general"
    gainprm: Vec = (1.0,)
    biasprm: Vec = ORIGIN
    dyntype: str = "none"
    gaintype: str = "fixed"
    biastype: str = "none"
    inheritrange: float = 0.0
    dynprm: Vec = (1.0, 0.0, 0.0)
    input: str = ""
    motor: Vec = (0.0, 0.0)
    torque: float | None = None
    more: dict[str, Any] = field(default_factory=dict)
    damping: float = 0.0

    @property
    def is_position(self) -> bool:
        """Whether it controls a length; only then can it inherit its joint's range."""
        if self.input.split()[:1] not in ([], ["pos"]):
            return False
        fixed = self.gaintype == "fixed" and self.biastype == "affine"
        return fixed and self.gainprm[0] == -self.biasprm[1]


Chain = tuple[ActuatorGains, ...]


def inherited(chain: Chain, node: Node) -> ActuatorGains:
    """The law of an actuator or a default; chain: those of its classes, outermost first."""
    damping = (*node.values.get("damping", ()), chain[-1].damping)[0]
    return replace(_law(chain, node, damping), damping=damping)


def _law(chain: Chain, node: Node, damping: float) -> ActuatorGains:
    if node.tag not in BUILT:
        return ActuatorGains(node.tag)
    # Only a <general> of the same class uses it.
    kept = chain[-1].inheritrange
    if node.tag == "motor":
        return ActuatorGains("motor", inheritrange=kept)
    if node.tag == "general":
        return _general(chain[-1], node)
    if start := controllers.START.get(node.tag):
        own = next((g for g in reversed(chain) if g.tag == node.tag), None)
        own = replace(own or ActuatorGains(node.tag, **start), damping=damping)
        scale = _inheritrange(own, node) if node.tag == "pid" else 0.0
        return replace(own, inheritrange=scale, **controllers.law(node.tag, own, node))
    base = next((g for g in reversed(chain) if g.tag in (node.tag, "general")), ActuatorGains())
    if node.tag in ("position", "intvelocity"):
        return _position(base, node)
    if node.tag == "orientation":
        return _orientation(next((g for g in reversed(chain) if g.tag == node.tag), None), node)
    return replace(_SHORTCUTS[node.tag](base, node), inheritrange=kept)


def _velocity(base: ActuatorGains, node: Node) -> ActuatorGains:
    kv = node.values.get("kv", base.gainprm[0])
    return ActuatorGains("velocity", (kv,), (0.0, 0.0, -kv), biastype="affine")


def _damper(base: ActuatorGains, node: Node) -> ActuatorGains:
    known = base.tag == "damper"
    kv = node.values.get("kv", 0.0 - base.gainprm[2] if known else 0.0)
    if kv < 0:
        raise bad(node, "kv", kv, ">= 0")
    return ActuatorGains("damper", (0.0, 0.0, 0.0 - kv), gaintype="affine")


def _cylinder(base: ActuatorGains, node: Node) -> ActuatorGains:
    values = node.values
    area = values.get("area", base.gainprm[0])
    if values.get("diameter", -1.0) >= 0:
        # A product, which is infinite where a power raises: the element then names the value.
        area = math.pi / 4 * values["diameter"] * values["diameter"]
    bias = values.get("bias", base.biasprm[:3])
    times = (values.get("timeconst", base.dynprm[0]), 0.0, 0.0)
    return ActuatorGains("cylinder", (area,), bias, "filter", "fixed", "affine", 0.0, times)


def _adhesion(base: ActuatorGains, node: Node) -> ActuatorGains:
    gain = node.values.get("gain", base.gainprm[0])
    if gain < 0:
        raise bad(node, "gain", gain, ">= 0")
    return ActuatorGains("adhesion", (gain,))


def _muscle(base: ActuatorGains, node: Node) -> ActuatorGains:
    """MuJoCo takes what is as in `<general>` for what was not given."""
    values = node.values
    base = base if base.tag == "muscle" else ActuatorGains()
    old = (*base.gainprm, *(0.0,) * 9)[:9]
    fresh = (1.0,) + (0.0,) * 8
    defaults = (*MUSCLE["range"], *list(MUSCLE.values())[1:])
    numbers = [
        default if kept == unset else kept
        for kept, unset, default in zip(old, fresh, defaults, strict=True)
    ]
    given = [*values.get("range", (-1.0, -1.0)), *(values.get(word, -1.0) for word in MUSCLE)]
    del given[2]
    numbers = [_unless_negative(new, old) for new, old in zip(given, numbers, strict=True)]
    rise, fall, smooth = base.dynprm[:3]
    times = (0.01 if rise == 1 else rise, 0.04 if fall == 0 else fall)
    new = values.get("timeconst", times)
    times = (_unless_negative(new[0], times[0]), _unless_negative(new[1], times[1]))
    dynamics = (*times, values.get("tausmooth", smooth))
    if dynamics[2] < 0:
        raise bad(node, "tausmooth", dynamics[2], ">= 0")
    own = tuple(numbers)
    return ActuatorGains("muscle", own, own, "muscle", "muscle", "muscle", 0.0, dynamics)


def _unless_negative(new: float, old: float) -> float:
    """A muscle keeps a number in place of a negative one."""
    return old if new < 0 else new


_SHORTCUTS = {"velocity": _velocity, "damper": _damper, "cylinder": _cylinder, "muscle": _muscle}
_SHORTCUTS["adhesion"] = _adhesion


def _general(base: ActuatorGains, node: Node) -> ActuatorGains:
    if base.tag not in BUILT or base.tag in controllers.START:
        raise node.unbuilt(f"<general> in a class whose default is <{base.tag}>")
    values = node.values
    given: dict[str, Any] = {
        name: (*values[name], *getattr(base, name)[len(values[name]) :])
        for name in ("gainprm", "biasprm", "dynprm")
        if values.get(name)
    }
    given |= {n: values[n] for n in ("dyntype", "gaintype", "biastype") if n in values}
    made = replace(base, tag="general", inheritrange=_inheritrange(base, node), **given)
    return replace(made, **canonical.fields(made, node))


def _position(base: ActuatorGains, node: Node) -> ActuatorGains:
    values = node.values
    for name in ("kv", "dampratio", "timeconst"):
        if values.get(name, 0.0) < 0:
            raise bad(node, name, values[name], ">= 0")
    if "kv" in values and "dampratio" in values:
        raise node.error(f"<{node.tag}> has both kv and dampratio")
    kp = values.get("kp", base.gainprm[0])
    # Above 0 the last one is a damping ratio.
    damping = base.biasprm[2]
    if "kv" in values or "dampratio" in values:
        damping = values.get("dampratio", -values.get("kv", 0.0))
    kind, times = (
        (base.dyntype, base.dynprm) if base.tag == "position" else ("none", (1.0, 0.0, 0.0))
    )
    if "timeconst" in values:
        kind = "filterexact" if values["timeconst"] > 0 else "none"
        times = (values["timeconst"], 0.0, 0.0)
    if node.tag == "intvelocity":
        kind, times = "integrator", (1.0, 0.0, 0.0)
    bias, scale = (0.0, -kp, damping), _inheritrange(base, node)
    return ActuatorGains(node.tag, (kp,), bias, kind, "fixed", "affine", scale, times)


def _orientation(own: ActuatorGains | None, node: Node) -> ActuatorGains:
    base = own or ActuatorGains(biasprm=(0.0, -1.0, 0.0), input="expmap")
    chart = node.values.get("input", "") or base.input
    if chart not in CHARTS:
        raise bad(node, "input", chart, " or ".join(CHARTS))
    made = _position(replace(base, tag="orientation", inheritrange=0.0), node)
    return replace(made, inheritrange=0.0, input=chart)


def _inheritrange(base: ActuatorGains, node: Node) -> float:
    """The scale from the joint's range to the control's; 0 if a control range is given."""
    given: float = node.values.get("inheritrange", base.inheritrange)
    own = {"intvelocity": "actrange", "pid": "posrange"}.get(node.tag, "ctrlrange")
    if own not in node.values:
        return given
    if node.values.get("inheritrange", 0.0) > 0:
        raise node.error(f"<{node.tag}> has both {own} and inheritrange")
    return 0.0


def saturated(values: dict[str, Any], made: ActuatorGains, node: Node) -> dict[str, Any]:
    """The values of a motor or its class, the bounds being those of its saturation."""
    if made.torque is None or "saturation" not in node.values:
        return values
    rest = {name: v for name, v in values.items() if name not in ("forcerange", "forcelimited")}
    return rest | ({"forcerange": (-made.torque, made.torque)} if made.torque > 0 else {})


def without_range(values: dict[str, Any], node: Node) -> dict[str, Any]:
    """The values of a class, without ctrlrange if `node` inherits the joint's range."""
    takes_over = node.values.get("inheritrange", 0.0) > 0
    return {name: v for name, v in values.items() if name != "ctrlrange" or not takes_over}
