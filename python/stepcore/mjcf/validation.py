"""Check a tree of nodes against the schema and convert the texts of attributes."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from stepcore.checks import nearest, shown
from stepcore.mjcf.custom import ours
from stepcore.mjcf.exclusions import Exclusions
from stepcore.mjcf.nodes import MJCFError, Node
from stepcore.mjcf.notation import Spec
from stepcore.mjcf.refusals import Refusals
from stepcore.mjcf.schema import ROOT, SEEN, UNCHECKED

# Stricter than float(): no nan, inf, underscores or other spellings.
_REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_INT = re.compile(r"[+-]?\d+", re.ASCII)

# Names whose empty text is kept; other empty attributes count as not given.
KEPT_EMPTY = ("class", "childclass", "file")
WHY = {
    "draws": "only draws",
    "senses": "only senses",
    "data": "data that the simulation does not use",
}


def validate(root: Node, refusals: Refusals, exclusions: Exclusions) -> list[str]:
    """Set `values` and `path` of every node, and return the lines for `Scene.ignored`.

    Errors are collected in `refusals`, and elements with errors are removed from the tree. Errors
    are elements, attributes, keywords or numbers outside the schema, and elements that would change
    the motion and are not built yet. Elements of the kinds in `exclusions` are removed too.
    """
    if root.tag != "mujoco":
        raise root.error(f"the root element is <{root.tag}>, not <mujoco>: not an MJCF model")
    # A schema location only serves text editors.
    root.attrs = {k: v for k, v in root.attrs.items() if not k.startswith(("xmlns", "xsi:"))}
    ignored: list[str] = []
    root.values = values_of(root, ROOT)
    exclusions.begin(root)
    pending: list[tuple[Node, Spec, str]] = [(root, ROOT, "")]
    while pending:
        node, spec, role = pending.pop()
        inside: list[Node] = []
        deeper: list[tuple[Node, Spec, str]] = []
        for child in node.children:
            inner = spec.children.get(child.tag)
            try:
                if inner is None:
                    near = nearest(child.tag, spec.children)
                    raise child.error(f"unknown element <{child.tag}> in <{node.tag}>{near}")
                # A path does not include the tag of the root.
                section = node.path.partition("/")[0] if node is not root else ""
                child.path = f"{section}/{child.tag}" if section else child.tag
                kind = exclusions.kind(child.path) if section != "default" else ""
                if kind:
                    exclusions.add(kind, child)
                    continue
                exclusions.strip(child)
                ignored += _strip(child, inner)
                _read(child, inner, node, role, ignored)
            except MJCFError as error:
                refusals.add(error, child)
                continue
            inside.append(child)
            deeper.append((child, inner, inner.role))
        node.children = inside
        pending += reversed(deeper)
    exclusions.follow(root)
    return ignored


def _strip(node: Node, spec: Spec) -> list[str]:
    """Remove attributes that MuJoCo ignores, and return a line about each.

    The class of a frame acts as its childclass, unless the frame has a childclass.
    """
    if node.tag not in UNCHECKED:
        return []
    if "class" in node.attrs:
        node.attrs.setdefault("childclass", node.attrs["class"])
        del node.attrs["class"]
    unknown = [name for name in node.attrs if name not in spec.attrs]
    for name in unknown:
        del node.attrs[name]
    return [node.listed(f"{name} does nothing in {node.tag}") for name in unknown]


def _read(node: Node, spec: Spec, parent: Node, above: str, ignored: list[str]) -> None:
    node.values = values_of(node, spec)
    _check_once(node, spec)
    if spec.role == "unbuilt":
        raise node.unbuilt(f"<{node.tag}> in <{parent.tag}>")
    if spec.role and spec.role != above and not ours(node):
        ignored.append(node.listed(WHY[spec.role]))


def _check_once(node: Node, spec: Spec) -> None:
    for tag in spec.once:
        same = [child for child in node.children if child.tag == tag]
        if len(same) > 1:
            raise same[1].error(f"a second <{tag}> in the same <{node.tag}>")


def values_of(node: Node, spec: Spec) -> dict[str, object]:
    """Return the attributes of an element as numbers and words.

    As in MuJoCo, empty numbers and names count as not given. Raises MJCFError for an unknown
    attribute or a bad value.
    """
    result: dict[str, object] = {}
    for name, text in node.attrs.items():
        kind = spec.attrs.get(name)
        if kind is None:
            near = nearest(name, spec.attrs)
            raise node.error(f'unknown attribute "{name}" of <{node.tag}>{near}')
        if text.strip() or "|" in kind or name in spec.required or name in KEPT_EMPTY:
            result[name] = _value(node, name, text, kind)
    for name in spec.required:
        if name not in result:
            raise node.error(f'<{node.tag}> lacks the required attribute "{name}"')
    return result


def seen_values(node: Node, known: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the attributes that views show of an element that only draws.

    known: the attribute texts, completed from the default class. Raises MJCFError for a bad value.
    """
    spec, texts = SEEN[node.tag], node.values if known is None else known
    seen = {name: texts[name] for name in spec.attrs if name in texts}
    return values_of(Node(node.tag, seen, node.file, node.line), spec)


def _value(node: Node, name: str, text: str, kind: str) -> object:
    """Return the attribute's value: text, bool, keyword, int, or a tuple of numbers."""
    if not kind:
        return text
    if "|" in kind:
        words = kind.split("|")
        if text not in words:
            raise bad(node, name, text, f"one of {', '.join(words)}{nearest(text, words, 0)}")
        return {"true": True, "false": False}.get(text, text) if words[0] == "false" else text
    entries = text.split()
    if kind == "int":
        if len(entries) != 1 or not _INT.fullmatch(entries[0]):
            raise bad(node, name, text, "an integer")
        return _int(node, name, entries[0])
    if kind.startswith("int"):
        count = None if kind == "int*" else int(kind[3:])
        if count not in (None, len(entries)) or not all(map(_INT.fullmatch, entries)):
            raise bad(node, name, text, f"{count or 'any number of'} integers")
        return tuple(_int(node, name, entry) for entry in entries)
    low, _, high = kind.partition("-")
    if kind == "*":
        fits, limit = True, "finite numbers"
    elif high:
        fits = int(low) <= len(entries) <= int(high)
        limit = f"{low} to {high} finite numbers"
    else:
        fits = len(entries) == int(low)
        limit = f"{low} finite number{'s' if low != '1' else ''}"
    if not fits or not all(map(_REAL.fullmatch, entries)):
        raise bad(node, name, text, limit)
    numbers = tuple(map(float, entries))
    if not all(map(math.isfinite, numbers)):
        raise bad(node, name, text, limit)
    return numbers[0] if kind == "1" else numbers


def _int(node: Node, name: str, text: str) -> int:
    if len(text) > 11 or not -(2**31) <= int(text) < 2**31:
        raise bad(node, name, text, "a 32-bit integer")
    return int(text)


def bad(node: Node, name: str, value: object, limit: str) -> MJCFError:
    """Return the error about the value of an attribute. limit: the allowed values."""
    return node.error(f"<{node.tag}> {name} = {shown(value)}: must be {limit}")
