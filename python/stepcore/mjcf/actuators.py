"""The section `<actuator>`: motors and servos on joints."""

from __future__ import annotations

from typing import Any

from stepcore.mjcf.gains import ActuatorGains
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.validation import bad
from stepcore.mjcf.worldbody import WorldReader
from stepcore.scene.elements import Joint
from stepcore.scene.elements.actuator import DYNAMICS

TRANSMISSIONS = ("joint", "jointinparent", "tendon", "slidersite", "site", "body")
# The second site of a transmission between two sites.
WITH = {"site": "refsite", "slidersite": "cranksite"}
STATEFUL = ("actlimited", "actrange")


def read(world: WorldReader, node: Node) -> None:
    """Reads one motor or servo on a joint."""
    values = world.defaults.of(node, kind="actuator")
    joint = _joint(world, node, values)
    _refuse(node, values)
    gains = world.defaults.gains(node)
    _refuse_gains(node, gains)
    added = world.scene.add_actuator(
        joint,
        gains.tag,
        name=values.get("name", ""),
        gear=values.get("gear", (1.0,)),
        ctrlrange=_ctrlrange(world, node, values, gains, joint),
        forcerange=world.limits(node, values, "forcelimited", "forcerange"),
        actrange=_actrange(world, node, values, gains),
        actearly=values.get("actearly", False),
        **_words(gains),
    )
    world.keep(node, added)


def _joint(world: WorldReader, node: Node, values: dict[str, Any]) -> Joint:
    used = [name for name in TRANSMISSIONS if name in values]
    if not used:
        raise node.error(f'<{node.tag}> needs joint="…"')
    if len(used) > 1:
        raise node.error(f"<{node.tag}> has two transmissions: {used[0]} and {used[1]}")
    if used[0] not in ("joint", "jointinparent"):
        second = WITH.get(used[0], "")
        both = f" and {second}" if second in values else ""
        raise node.unbuilt(f"a <{node.tag}> that acts through {used[0]}{both}")
    joint = world.scene.joint(values[used[0]])
    if used[0] == "jointinparent" and joint.type in ("ball", "free"):
        raise node.unbuilt(f"jointinparent on a {joint.type} joint")
    return joint


def _refuse(node: Node, values: dict[str, Any]) -> None:
    if values.get("delay", 0) != 0:
        raise node.unbuilt("a delay between control and force (delay)")
    if any(values.get("damping", ())) or values.get("armature", 0) != 0:
        raise node.unbuilt("an actuator's own damping or armature")
    if node.values.get("input", "") not in ("", "pos", "vel", "pressure"):
        raise bad(node, "input", node.values["input"], "pos, vel or pressure")


def _refuse_gains(node: Node, gains: ActuatorGains) -> None:
    for name, built in (("dyntype", DYNAMICS), ("gaintype", ("fixed",))):
        if getattr(gains, name) not in built:
            raise node.unbuilt(f'<general> {name}="{getattr(gains, name)}"')
    if gains.biastype not in ("none", "affine"):
        raise node.unbuilt(f'<general> biastype="{gains.biastype}"')


def _words(gains: ActuatorGains) -> dict[str, Any]:
    """The gains as fields of `Actuator`."""
    gain, damping = gains.gainprm[0], gains.biasprm[2]
    if gains.tag == "position":
        words = {"dampratio": damping} if damping > 0 else {"kv": 0.0 - damping}
        return {"kp": gain, **words, "timeconst": gains.dynprm[0] if gains.dyntype != "none" else None}
    if gains.tag == "velocity":
        return {"kv": gain}
    if gains.tag == "general":
        bias = gains.biasprm[:3] if gains.biastype == "affine" else None
        words = {"dyntype": gains.dyntype, "dynprm": gains.dynprm} if gains.dyntype != "none" else {}
        return {"gainprm": gain, "biasprm": bias, **words}
    return {}


def _actrange(
    world: WorldReader, node: Node, values: dict[str, Any], gains: ActuatorGains
) -> tuple[float, ...] | None:
    stateless = gains.dyntype == "none"
    if stateless:
        for name in STATEFUL:
            if values.get(name, False) not in (False, "auto"):
                text = f"<{node.tag}> inherits {name}, but a {node.tag} has no activation"
                raise node.error(text)
    dim = values.get("actdim", -1)
    if dim not in (-1, 0 if stateless else 1):
        raise bad(node, "actdim", dim, "-1, 0 without an activation or 1 with one")
    return None if stateless else world.limits(node, values, "actlimited", "actrange")


def _ctrlrange(
    world: WorldReader, node: Node, values: dict[str, Any], gains: ActuatorGains, joint: Joint
) -> tuple[float, ...] | None:
    if gains.inheritrange <= 0 or not gains.is_position:
        return world.limits(node, values, "ctrllimited", "ctrlrange")
    takes_over = node.values.get("inheritrange", 0.0) > 0
    if gains.tag == "position" and "ctrlrange" in values and not takes_over:
        raise node.error("<position> inherits both ctrlrange and inheritrange")
    bounds = world.ranges.get(id(joint))
    if bounds is None or bounds[0] == bounds[1]:
        raise node.error(f"<{node.tag}> inheritrange: {joint} has no range")
    if joint.range is None and joint.type == "hinge" and world.compiler.degrees:
        what = f"the range of {joint} is inherited unconverted, as radians, as MuJoCo does"
        world.scene.notes.append(f"{node.file}:{node.line}: {what}: the joint is not limited")
    if values.get("ctrllimited", "auto") is False:
        return None
    middle, half = (bounds[0] + bounds[1]) / 2, gains.inheritrange * (bounds[1] - bounds[0]) / 2
    return middle - half, middle + half
