"""The section `<actuator>`: motors, servos and muscles."""

from __future__ import annotations

from typing import Any

from stepcore.mjcf.attributes import given
from stepcore.mjcf.controllers import INPUTS, first_of
from stepcore.mjcf.gains import ActuatorGains, saturated
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.validation import bad
from stepcore.mjcf.worldbody import WorldReader
from stepcore.scene.actuation import law, states
from stepcore.scene.elements.actuator import BIASES, DYNAMICS, GAINS, MUSCLE, Actuator
from stepcore.scene.orienting import parts

TRANSMISSIONS = ("joint", "jointinparent", "tendon", "slidersite", "site", "body")
# The second site of a transmission between two sites.
WITH = {"site": "refsite", "slidersite": "cranksite"}
# Fields of an actuator that are copies of attributes.
COPIED = ("gear", "damping", "armature", "interp", "delay", "nsample", "lengthrange")
STATEFUL = ("actlimited", "actrange")


def read(world: WorldReader, node: Node) -> None:
    """Reads one motor, servo or muscle."""
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
        **_words(gains),
    }
    added = world.scene.add_actuator(
        type=gains.tag,
        name=values.get("name", ""),
        ctrlrange=ctrlrange,
        forcerange=world.limits(node, values, "forcelimited", "forcerange"),
        actrange=actrange,
        actearly=values.get("actearly", False) and gains.tag not in INPUTS,
        enabled=values.get("group", 0) not in world.disabled_groups,
        **fields,
    )
    dim, count = values.get("actdim", -1), states(law(added))
    if dim not in (-1, count):
        raise bad(node, "actdim", dim, f"-1 or {count}, how many activations it has")
    world.keep(node, added)
    for word in parts(added)[1:]:
        _add_input(world, node, added, word)


def sizes(gains: ActuatorGains) -> tuple[int, int]:
    """How many controls and how many activations an actuator with these gains has."""
    alone = Actuator(type=gains.tag, **_words(gains))
    return len(parts(alone)) or 1, states(law(alone))


def _add_input(world: WorldReader, node: Node, owner: Actuator, word: str) -> None:
    """Another input of a controller: it has a control of its own, next to the owner's."""
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
    """What it pulls at, as fields of `Actuator`."""
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
    several = gains.tag in (*INPUTS, "orientation")
    if not several and node.values.get("input", "") not in ("", "pos", "vel", "pressure"):
        raise bad(node, "input", node.values["input"], "pos, vel or pressure")


def _refuse_gains(node: Node, gains: ActuatorGains) -> None:
    for name, built in (("dyntype", DYNAMICS), ("gaintype", GAINS), ("biastype", BIASES)):
        if getattr(gains, name) not in built:
            raise node.unbuilt(f'<general> {name}="{getattr(gains, name)}"')
    if gains.tag in INPUTS and gains.input in ("none", ""):
        raise node.unbuilt(f'a <{gains.tag}> of no input (input="{gains.input}")', "input")
    asks = any(gains.biasprm) or any(gains.more.get(word, 0) for word in ("ki", "slewmax"))
    if gains.tag == "dcmotor" and gains.input == "voltage" and asks:
        given = node.values.get("controller", gains.biasprm)
        raise bad(node, "controller", given, "0 without one of the inputs pos, vel and ff")


def _words(gains: ActuatorGains) -> dict[str, Any]:
    """The law as fields of `Actuator`."""
    gain, damping = gains.gainprm[0], gains.biasprm[2]
    filtered = gains.dyntype != "none"
    if gains.tag in ("position", "intvelocity"):
        words: dict[str, Any] = {"dampratio": damping} if damping > 0 else {"kv": 0.0 - damping}
        if gains.tag == "position" and filtered:
            words["timeconst"] = gains.dynprm[0]
        return {"kp": gain, **words}
    if gains.tag == "orientation":
        words = {"dampratio": damping} if damping > 0 else {"kv": 0.0 - damping}
        return {"kp": gain, "input": gains.input, **words}
    if gains.tag == "pid":
        words = {"dampratio": damping} if damping > 0 else {"kv": 0.0 - damping}
        return {"kp": gain, "input": gains.input, **words, **gains.more}
    if gains.tag == "dcmotor":
        return _motor_words(gains)
    if gains.tag == "velocity":
        return {"kv": gain}
    if gains.tag == "adhesion":
        return {"gain": gain}
    if gains.tag == "damper":
        return {"kv": 0.0 - gains.gainprm[2]}
    if gains.tag == "cylinder":
        return {"area": gain, "bias": gains.biasprm[:3], "timeconst": gains.dynprm[0]}
    if gains.tag == "muscle":
        numbers = (gains.gainprm[:2], *gains.gainprm[2:9])
        rise, fall, smooth = gains.dynprm[:3]
        muscle = dict(zip(MUSCLE, numbers, strict=True))
        return {**muscle, "timeconst": (rise, fall), "tausmooth": smooth}
    return _general(gains) if gains.tag == "general" else {}


def _motor_words(gains: ActuatorGains) -> dict[str, Any]:
    constant, resistance = gains.motor
    more = dict(gains.more)
    more["inductance"] = more.pop("timeconst", 0.0) * resistance
    words = {"motorconst": constant, "resistance": resistance, "input": gains.input}
    if gains.input != "voltage":
        words |= {"kp": 0.0 - gains.biasprm[1], "kv": 0.0 - gains.biasprm[2]}
    return words | more


def _general(gains: ActuatorGains) -> dict[str, Any]:
    affine = gains.biastype == "affine"
    words: dict[str, Any] = {"gainprm": gains.gainprm[0]}
    words["biasprm"] = gains.biasprm[:3] if affine else None
    if gains.gaintype != "fixed":
        words |= {"gaintype": gains.gaintype, "gainprm": gains.gainprm[:10]}
    if gains.biastype == "muscle":
        words |= {"biastype": "muscle", "biasprm": gains.biasprm[:10]}
    if gains.dyntype != "none":
        words |= {"dyntype": gains.dyntype, "dynprm": gains.dynprm[:3]}
    return words


Bounds = tuple[float, ...] | None


def _ctrlrange(
    world: WorldReader, node: Node, values: dict[str, Any], gains: ActuatorGains
) -> Bounds:
    """That of the one input; MuJoCo names it by the input of a <pid>."""
    if gains.tag in ("damper", "adhesion"):
        # MuJoCo limits these whatever ctrllimited and autolimits say.
        values = values | {"ctrllimited": True}
    if gains.tag != "pid":
        return world.limits(node, values, "ctrllimited", "ctrlrange")
    if first_of(gains) == "pos":
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
    bounds: Bounds = values.get(f"{first_of(gains)}range")
    return bounds if bounds and bounds[0] < bounds[1] else None


def _ranges(
    world: WorldReader,
    node: Node,
    values: dict[str, Any],
    gains: ActuatorGains,
    target: dict[str, Any],
) -> tuple[Bounds, Bounds]:
    """The bounds of control and activation, one of which may be that of the joint or tendon."""
    if gains.tag == "intvelocity":
        # MuJoCo limits it whatever actlimited says.
        values = {name: value for name, value in values.items() if name != "actlimited"}
    actrange = _actrange(world, node, values, gains)
    integrates = gains.dyntype == "integrator"
    if gains.inheritrange <= 0 or not gains.is_position:
        return _ctrlrange(world, node, values, gains), actrange
    found = _inherited(world, node, values, gains, target)
    switch = "actlimited" if integrates else "ctrllimited"
    if values.get(switch, "auto") == "auto" and not world.compiler.autolimits:
        what = f'inheritrange without {switch}="true", and autolimits is "false"'
        raise node.error(f"<{node.tag}> {what}")
    if integrates:
        limited = values.get("actlimited", "auto") is not False
        return world.limits(node, values, "ctrllimited", "ctrlrange"), found if limited else None
    return None if values.get("ctrllimited", "auto") is False else found, actrange


def _actrange(
    world: WorldReader, node: Node, values: dict[str, Any], gains: ActuatorGains
) -> Bounds:
    stateless = gains.dyntype == "none"
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
