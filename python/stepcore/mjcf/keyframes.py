"""The section `<keyframe>`: named states."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from stepcore.mjcf.nodes import Node
from stepcore.mjcf.validation import bad
from stepcore.mjcf.worldbody import WorldReader
from stepcore.scene.elements import Actuator
from stepcore.scene.layout import DOFS, QPOS, Layout

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

# The number of values per mocap body.
MOCAP = {"mpos": 3, "mquat": 4}
MAX_KEYS = 100_000


def default_state(layout: Layout) -> dict[str, list[float]]:
    """Return the default state, which completes a keyframe."""
    mocaps = [body for body in layout.bodies if body.mocap]
    return {
        "qpos": layout.qpos0(),
        "qvel": [0.0] * layout.nv,
        "act": [0.0] * layout.na,
        "ctrl": [0.0] * len(layout.scene.actuators),
        "mpos": [x for body in mocaps for x in body.pos],
        "mquat": [x for body in mocaps for x in body.quat],
    }


def read(world: WorldReader, layout: Layout, rest: dict[str, list[float]], node: Node) -> None:
    """Read a keyframe. rest: the default state, which completes the keyframe."""
    values = node.values
    if values.get("plastic"):
        raise bad(node, "plastic", values["plastic"], "empty: the model has no plastic")
    fields: dict[str, Any] = {}
    said: set[int] = set()
    for name, default in rest.items():
        given = list(values.get(name, ()))
        if node.parts is not None:
            given = _assembled(world, layout, node, name, default)
            said |= _joints_of(world, node) if name == "qpos" else set()
        if len(given) > len(default):
            raise bad(node, name, tuple(given), f"at most {len(default)} numbers, not {len(given)}")
        if given:
            fields[name] = given + default[len(given) :]
    if "qpos" in fields:
        fields["qpos"] = layout.unit_quaternions(fields["qpos"])
    added = world.scene.add_key(values.get("name", ""), time=values.get("time", 0.0), **fields)
    world.keep(node, added)
    if "qpos" in fields and node.parts is not None:
        world.open_keys.append((added, said))


def _joints_of(world: WorldReader, node: Node) -> set[int]:
    """Return the ids of joints whose positions a keyframe of an attached model gives."""
    parts = (node.parts or {}).get("qpos", ())
    return {id(world.elements.get(id(part))) for part, _ in parts}


def follow_bodies(world: WorldReader) -> None:
    """Set free joints that keyframes of attached models omit to the final poses of their bodies."""
    layout = Layout(world.scene)
    for key, said in world.open_keys:
        qpos, at = list(key.qpos or ()), 0
        for joint in layout.joints:
            if joint.type == "free" and id(joint) not in said:
                qpos[at : at + 7] = [*joint.body.pos, *joint.body.quat]
            at += QPOS[joint.type]
        key.qpos = tuple(qpos)


def _assembled(
    world: WorldReader, layout: Layout, node: Node, name: str, default: list[float]
) -> list[float]:
    """Return a vector of an attached model's keyframe, assembled from the numbers per element."""
    starts: dict[int, int] = {}
    at = 0
    sizes = {"qpos": QPOS, "qvel": DOFS}.get(name)
    if name in MOCAP:
        for body in (body for body in layout.bodies if body.mocap):
            starts[id(body)], at = at, at + MOCAP[name]
    for element in world.scene.actuators if sizes is None else layout.joints:
        starts.setdefault(id(element), at)
        if isinstance(element, Actuator):
            at += element.law.states if name == "act" else 1
        elif sizes is not None:
            at += sizes[element.type]
    numbers = list(default)
    for part, given in (node.parts or {}).get(name, ()):
        start = starts.get(id(world.elements.get(id(part))))
        if start is not None:
            numbers[start : start + len(given)] = given
    return numbers


def add_empty_keys(scene: Scene, sizes: Iterable[Node]) -> None:
    """Add default states until there are ``<size nkey>`` keyframes."""
    count = 0
    for node in sizes:
        count = node.values.get("nkey", count)
        if count > MAX_KEYS:
            raise bad(node, "nkey", count, f"at most {MAX_KEYS}")
    while len(scene.keys) < count:
        scene.add_key()
