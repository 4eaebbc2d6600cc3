"""Controllers, motors and orientations that are written as `<general>`.

MuJoCo's canonical notation writes them so: their numbers by place (MuJoCo documentation, XML
reference, "actuator/general").
"""

from __future__ import annotations

from typing import Any

from stepcore.mjcf.nodes import Node
from stepcore.mjcf.validation import bad
from stepcore.scene.elements.actuator import CHARTS
from stepcore.scene.frames import Vec

TAGS = {"pid": "pid", "dcmotor": "dcmotor", "so3": "orientation"}
# The other two types that go with a gain type.
TYPES: dict[str, tuple[str, tuple[str, ...]]] = {
    "pid": ("affine", ("none", "pid")),
    "dcmotor": ("dcmotor", ("none", "dcmotor")),
    "so3": ("so3", ("none",)),
}


def fields(gains: Any, node: Node) -> dict[str, Any]:
    """The fields of `ActuatorGains` that make it what its shortcut is; none of other types."""
    if gains.gaintype not in TAGS:
        return {}
    kind = gains.gaintype
    bias, dynamics = TYPES[kind]
    if gains.biastype != bias or gains.dyntype not in dynamics:
        types = f'biastype="{gains.biastype}" and dyntype="{gains.dyntype}"'
        raise node.unbuilt(f'<general> gaintype="{kind}" with {types}')
    early = node.values.get("actearly", kind == "dcmotor")
    if early != (kind == "dcmotor") or node.values.get("actrange"):
        name = "actrange" if node.values.get("actrange") else "actearly"
        raise node.unbuilt(f'<general> gaintype="{kind}" with {name}', name)
    made = {"pid": _pid, "dcmotor": _motor, "so3": _orientation}[kind](gains, node)
    return {"tag": TAGS[kind], "gaintype": "fixed", "biastype": "affine", "dyntype": "none"} | made


def _all(prm: Vec) -> Vec:
    return (*prm, *(0.0,) * 10)[:10]


def _pid(gains: Any, node: Node) -> dict[str, Any]:
    constant, stiffness, damping = _all(gains.biasprm)[:3]
    if constant != 0:
        raise bad(node, "biasprm", gains.biasprm, "0 first, for a pid")
    more = {}
    if gains.dyntype == "none" and gains.gainprm[0] != 0:
        raise bad(
            node, "gainprm", gains.gainprm, '0 (the gain of the integral) without dyntype="pid"'
        )
    if gains.dyntype == "pid":
        ki, (imax, slewmax) = gains.gainprm[0], _all(gains.dynprm)[:2]
        if min(ki, imax, slewmax) < 0:
            raise bad(node, "dynprm", gains.dynprm, "gains and limits >= 0")
        more = {"ki": ki, "imax": imax, "slewmax": slewmax}
    return {
        **{"gainprm": (0.0 - stiffness,), "biasprm": (0.0, stiffness, damping)},
        **{"more": more, "input": node.values.get("input", "") or "pos vel"},
    }


def _motor(gains: Any, node: Node) -> dict[str, Any]:
    gain, bias, dynamics = _all(gains.gainprm), _all(gains.biasprm), _all(gains.dynprm)
    resistance, constant, more_by_degree, reference, kp, ki, kd, vmax = gain[:8]
    if gains.dyntype == "none":
        dynamics = (0.0,) * 10
    timeconst, rate, path, capacity, ambient, stiffness, damping, slewmax, imax = dynamics[:9]
    if resistance <= 0 or constant <= 0:
        raise bad(node, "gainprm", gains.gainprm, "a resistance and a constant > 0 for a dcmotor")
    heats = path > 0 and capacity > 0
    more = {
        **{"ki": ki, "slewmax": max(slewmax, 0.0), "imax": max(imax, 0.0), "vmax": max(vmax, 0.0)},
        **{"current_rate": max(rate, 0.0), "timeconst": max(timeconst, 0.0)},
        "cogging": bias[:3],
        "lugre": (stiffness, damping, *bias[3:6]),
        "thermal": (path, capacity, more_by_degree, reference, ambient) if heats else None,
    }
    return {
        **{"gainprm": (0.0,), "biasprm": (0.0, 0.0 - kp, 0.0 - kd), "more": more},
        **{"motor": (constant, resistance), "input": node.values.get("input", "") or "voltage"},
    }


def _orientation(gains: Any, node: Node) -> dict[str, Any]:
    chart = node.values.get("input", "") or "expmap"
    if chart not in CHARTS:
        raise bad(node, "input", chart, " or ".join(CHARTS))
    bias = _all(gains.biasprm)[:3]
    if bias[:2] != (0.0, 0.0 - gains.gainprm[0]):
        raise bad(node, "biasprm", gains.biasprm, "0 -kp -kv for an orientation")
    return {"gainprm": gains.gainprm[:1], "biasprm": bias, "input": chart}
