"""The section `<actuator>`: motors, servos and muscles."""

from __future__ import annotations

from typing import Any

from stepcore.mjcf.attributes import given
from stepcore.mjcf.gains import CONTROLLERS, ActuatorGains, saturated
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.validation import bad
from stepcore.mjcf.worldbody import WorldReader
from stepcore.scene.elements.actuator import BIASES, DYNAMICS, GAINS, Actuator

TRANSMISSIONS = ("joint", "jointinparent", "tendon", "slidersite", "site", "body")
# The attribute of the second site, for transmissions between two sites.
WITH = {"site": "refsite", "slidersite": "cranksite"}
# Fields of an actuator that are copied from attributes.
COPIED = ("gear", "damping", "armature", "interp", "delay", "nsample", "lengthrange")
STATEFUL = ("actlimited", "actrange")


def read(world: WorldReader, node: Node) -> None:
    """Read an actuator."""
    values = world.defaults.of(node, kind="actuator")
    target = _target(world, node, values)
    gains = world.defaults.gains(node)
    _refuse(node, values, gains)
    values = saturated(values, gains, node)
    _refuse_gains(node, gains)
    ctrlrange, actrange = _ranges(world, node, values, gains, target)
    fields: dict[str, Any] = {
        **target,
        **given(Actuator, {name: values[name] for name in COPIED if name in values}),
        **gains.fields,
    }
    added = world.scene.add_actuator(
        type=gains.tag,
        name=values.get("name", ""),
        ctrlrange=ctrlrange,
        forcerange=world.limits(node, values, "forcelimited", "forcerange"),
        actrange=actrange,
        actearly=values.get("actearly", False) and gains.tag not in CONTROLLERS,
        enabled=values.get("group", 0) not in world.disabled_groups,
        **fields,
    )
    dim, count = values.get("actdim", -1), added.law.states
    if dim not in (-1, count):
        raise bad(node, "actdim", dim, f"-1 or {count}, how many activations it has")
    world.keep(node, added)
    for word in added.inputs[1:]:
        _add_input(world, node, added, word)


def sizes(gains: ActuatorGains) -> tuple[int, int]:
    """Return the numbers of controls and activations of an actuator with these gains."""
    return len(gains.inputs) or 1, gains.law.states


def _add_input(world: WorldReader, node: Node, owner: Actuator, word: str) -> None:
    """Add a further input of a controller as an actuator; its control follows the owner's."""
    values = world.defaults.of(node, kind="actuator")
    bounds: Bounds = owner.ctrlrange
    if owner.type == "pid":
        bounds = values.get(f"{word}range")
        bounds = bounds if bounds and bounds[0] < bounds[1] else None
    world.scene.add_actuator(
        type="input",
        feeds=owner,
        input=word,
        name=f"{owner.name}/{word}" if owner.name else "",
        ctrlrange=bounds,
        enabled=owner.enabled,
        **{name: getattr(owner, name) for name in ("delay", "nsample", "interp")},
    )
    what = f"the input {word} of {owner} is an actuator of its own, with a control of its own"
    world.scene.notes.append(f"{node.file}:{node.line}: {what}")


def _target(world: WorldReader, node: Node, values: dict[str, Any]) -> dict[str, Any]:
    """Return the transmission, as fields of `Actuator`."""
    used = [name for name in TRANSMISSIONS if name in values]
    if not used:
        raise node.error(f'<{node.tag}> needs joint="…"')
    if len(used) > 1:
        raise node.error(f"<{node.tag}> has two transmissions: {used[0]} and {used[1]}")
    kind = used[0]
    scene = world.scene
    if kind == "body":
        return {"body": scene.body(values["body"])}
    if kind in ("joint", "jointinparent"):
        return {kind: scene.joint(values[kind])}
    if kind == "tendon":
        return {"tendon": scene.tendon(values["tendon"])}
    second = WITH[kind]
    sites = {name: scene.site(values[name]) for name in (kind, second) if name in values}
    if kind == "slidersite":
        if second not in values:
            raise node.error(f'<{node.tag}> needs cranksite="…" beside slidersite')
        if values.get("cranklength", 0.0) <= 0:
            raise bad(node, "cranklength", values.get("cranklength", 0.0), "> 0")
        sites["cranklength"] = values["cranklength"]
    return sites


def _refuse(node: Node, values: dict[str, Any], gains: ActuatorGains) -> None:
    if values.get("delay", 0.0) > 0 and values.get("nsample", 0) <= 0:
        raise bad(node, "nsample", values.get("nsample", 0), "> 0 with a delay")
    if gains.tag == "orientation" and "joint" not in values:
        raise node.unbuilt("an <orientation> that turns a site", "site")
    several = gains.tag in (*CONTROLLERS, "orientation")
    if not several and node.values.get("input", "") not in ("", "pos", "vel", "pressure"):
        raise bad(node, "input", node.values["input"], "pos, vel or pressure")


def _refuse_gains(node: Node, gains: ActuatorGains) -> None:
    own = gains.values
    for name, built in (("dyntype", DYNAMICS), ("gaintype", GAINS), ("biastype", BIASES)):
        if gains.tag == "general" and own[name] not in built:
            raise node.unbuilt(f'<general> {name}="{own[name]}"')
    if gains.tag in CONTROLLERS and own["input"] in ("none", ""):
        raise node.unbuilt(f'a <{gains.tag}> of no input (input="{own["input"]}")', "input")
    voltage = gains.tag == "dcmotor" and own["input"] == "voltage"
    if voltage and (own["kp"] or own["kv"] or own["ki"] or own["slewmax"]):
        given = node.values.get("controller", (0.0, 0.0 - own["kp"], 0.0 - own["kv"]))
        raise bad(node, "controller", given, "0 without one of the inputs pos, vel and ff")


Bounds = tuple[float, ...] | None


def _ctrlrange(
    world: WorldReader, node: Node, values: dict[str, Any], gains: ActuatorGains
) -> Bounds:
    """Return the range of the actuator's own control; for a <pid> MuJoCo names it by input."""
    if gains.tag in ("damper", "adhesion"):
        # MuJoCo limits these regardless of ctrllimited and autolimits.
        values = values | {"ctrllimited": True}
    if gains.tag != "pid":
        return world.limits(node, values, "ctrllimited", "ctrlrange")
    first = gains.inputs[0]
    if first == "pos":
        name = next(
            (
                name
                for where in (node.values, values)
                for name in ("posrange", "ctrlrange")
                if name in where
            ),
            "posrange",
        )
        return world.limits(node, values, "ctrllimited", name)
    bounds: Bounds = values.get(f"{first}range")
    return bounds if bounds and bounds[0] < bounds[1] else None


def _ranges(
    world: WorldReader,
    node: Node,
    values: dict[str, Any],
    gains: ActuatorGains,
    target: dict[str, Any],
) -> tuple[Bounds, Bounds]:
    """Return the ranges of control and activation; one may be inherited from joint or tendon."""
    if gains.tag == "intvelocity":
        # MuJoCo limits this actuator regardless of actlimited.
        values = {name: value for name, value in values.items() if name != "actlimited"}
    actrange = _actrange(world, node, values, gains)
    integrates = gains.activates == "integrator"
    if gains.inheritrange <= 0 or not gains.is_position:
        return _ctrlrange(world, node, values, gains), actrange
    handed_down = _inherited(world, node, values, gains, target)
    switch = "actlimited" if integrates else "ctrllimited"
    if values.get(switch, "auto") == "auto" and not world.compiler.autolimits:
        what = f'inheritrange without {switch}="true", and autolimits is "false"'
        raise node.error(f"<{node.tag}> {what}")
    if integrates:
        limited = values.get("actlimited", "auto") is not False
        return world.limits(
            node, values, "ctrllimited", "ctrlrange"
        ), handed_down if limited else None
    return None if values.get("ctrllimited", "auto") is False else handed_down, actrange


def _actrange(
    world: WorldReader, node: Node, values: dict[str, Any], gains: ActuatorGains
) -> Bounds:
    stateless = gains.activates == "none"
    if stateless:
        for name in STATEFUL:
            if values.get(name, False) not in (False, "auto"):
                text = f"<{node.tag}> inherits {name}, but a {node.tag} has no activation"
                raise node.error(text)
    return None if stateless else world.limits(node, values, "actlimited", "actrange")


def _inherited(
    world: WorldReader,
    node: Node,
    values: dict[str, Any],
    gains: ActuatorGains,
    target: dict[str, Any],
) -> tuple[float, float]:
    takes_over = node.values.get("inheritrange", 0.0) > 0
    if gains.tag == "position" and "ctrlrange" in values and not takes_over:
        raise node.error("<position> inherits both ctrlrange and inheritrange")
    element = next(iter(target.values()))
    bounds = world.ranges.get(id(element))
    if bounds is None or bounds[0] == bounds[1]:
        raise node.error(f"<{node.tag}> inheritrange: {element} has no range")
    radians = "tendon" in target or element.range is not None or element.type != "hinge"
    if not radians and world.compiler.degrees:
        what = f"the range of {element} is inherited unconverted, as radians, as MuJoCo does"
        world.scene.notes.append(f"{node.file}:{node.line}: {what}: the joint is not limited")
    middle, half = (bounds[0] + bounds[1]) / 2, gains.inheritrange * (bounds[1] - bounds[0]) / 2
    return middle - half, middle + half
