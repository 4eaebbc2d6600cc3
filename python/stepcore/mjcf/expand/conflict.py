"""Options of an attached model that differ from those of the model that it is attached to.

MuJoCo documentation, Model editing, Attribute merging.
"""

from __future__ import annotations

from typing import Any

from stepcore.mjcf.nodes import Node
from stepcore.mjcf.schema import FLAGS

MINIMUM = (
    *("timestep", "tolerance", "ls_tolerance", "noslip_tolerance", "ccd_tolerance"),
    "sleep_tolerance",
)
MAXIMUM = (
    *("iterations", "ls_iterations", "noslip_iterations", "ccd_iterations"),
    *("sdf_iterations", "sdf_initpoints"),
)
UNION = "actuatorgroupdisable"


def authored(root: Node) -> tuple[dict[str, Any], dict[str, str]]:
    """The options and the flags that a model's file gives."""
    options: dict[str, Any] = {}
    flags: dict[str, str] = {}
    for section in root.children:
        if section.tag == "option":
            options |= section.values
            for child in section.children:
                flags |= child.values
    return options, flags


def merge(root: Node, child: Node, node: Node, policy: str) -> list[str]:
    """Merges the options of `child` into those of `root` by `policy`; returns notes.

    node: the <attach>. Raises MJCFError for a conflict that the policy does not allow.
    """
    ours, our_flags = authored(root)
    theirs, their_flags = authored(child)
    named = f'"{child.attrs.get("model", "") or node.attrs.get("model", "")}"'
    where = f"{node.file}:{node.line}: <attach> of the model {named}"
    both = [(ours, theirs), (our_flags, their_flags)]
    if policy == "error":
        for mine, other in both:
            for name in other:
                if name in mine and mine[name] != other[name]:
                    raise node.error(_clash(named, name, mine[name], other[name]))
        return []
    if policy == "warning":
        unused = [name for mine, other in both for name in other if mine.get(name) != other[name]]
        what = ", ".join(unused)
        return [f"{where}: its {what} {_is(unused)} not used (conflict)"] if unused else []
    options = {name: _merged(node, named, name, ours, theirs) for name in theirs}
    # A flag that one of them turns from its default is turned.
    turned = {name: word for name, word in their_flags.items() if _turns(name, word)}
    _add_option(root, node, options, turned)
    taken = [*(name for name in options if options[name] != ours.get(name)), *turned]
    return [f"{where}: its {', '.join(taken)} {_is(taken)} used (conflict)"] if taken else []


def _is(names: list[str]) -> str:
    return "is" if len(names) == 1 else "are"


def _merged(node: Node, named: str, name: str, ours: dict[str, Any], theirs: dict[str, Any]) -> Any:
    other = theirs[name]
    mine = ours.get(name, other)
    if name in MINIMUM:
        return min(mine, other)
    if name in MAXIMUM:
        return max(mine, other)
    if name == UNION:
        return tuple(dict.fromkeys((*mine, *other)))
    if mine != other:
        raise node.error(_clash(named, name, mine, other))
    return mine


def _clash(named: str, name: str, mine: Any, other: Any) -> str:
    return f"<attach>: the model {named} has {name} = {other}, this one {mine}, a conflict"


def _turns(name: str, word: str) -> bool:
    """Whether a flag is turned from its default; those after "override" are off by default."""
    flags = FLAGS.split()
    off = flags[flags.index("override") :]
    return word == ("enable" if name in off else "disable")


def _add_option(root: Node, node: Node, options: dict[str, Any], flags: dict[str, str]) -> None:
    """Adds an option section at the end, which replaces the values of earlier ones."""
    section = Node("option", {}, node.file, node.line)
    section.values = options
    if flags:
        inner = Node("flag", {}, node.file, node.line)
        inner.values = dict(flags)
        section.children = [inner]
    root.children.append(section)
