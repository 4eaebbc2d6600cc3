"""`<replicate>`: copies of bodies, each one step further, and of all that refers to them.

MuJoCo documentation, XML reference, replicate. As there, what refers to a replicated element is
replicated too, and its copies stand after all other elements of their section.
"""

from __future__ import annotations

from collections.abc import Iterator

from stepcore.mjcf.compiler import Compiler
from stepcore.mjcf.expand.naming import Names, copied, kind_of, names_in, refers, rename
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.refusals import below
from stepcore.mjcf.validation import bad
from stepcore.scene import frames
from stepcore.scene.frames import Vec

# Sections whose elements refer to the tree, and to each other.
SECTIONS = ("contact", "tendon", "equality", "actuator", "sensor")
# The most elements that copies may have together.
MOST = 1_000_000


def expand_replicates(root: Node, compiler: Compiler) -> None:
    """Replaces every replicate of a model, the innermost first."""
    made = 0
    for parent in _parents(root):
        inside: list[Node] = []
        for node in parent.children:
            if node.tag != "replicate":
                inside.append(node)
                continue
            made += _size(node, made)
            inside += _replicas(root, node, node.compiler or compiler)
        parent.children = inside


def _parents(root: Node) -> list[Node]:
    """The elements that hold a replicate, the innermost first."""
    trees = [node for node in root.children if node.tag == "worldbody"]
    every = [node for tree in trees for node in below(tree)]
    # Below a node come those that it holds, so the reverse begins with the innermost.
    found = [n for n in every if any(child.tag == "replicate" for child in n.children)]
    depth: dict[int, int] = {}
    for node in every:
        for child in node.children:
            depth[id(child)] = depth.get(id(node), 0) + 1
    return sorted(found, key=lambda node: -depth.get(id(node), 0))


def _size(node: Node, made: int) -> int:
    count = node.values["count"]
    if count < 0:
        raise bad(node, "count", count, ">= 0")
    size: int = count * sum(1 for _ in below(node))
    if made + size > MOST:
        raise node.error(f"<replicate> makes more than {MOST} elements")
    for child in node.children:
        if child.tag in ("joint", "freejoint", "inertial"):
            raise child.error(f"<{child.tag}> cannot be a direct child of <replicate>")
    return size


def _replicas(root: Node, node: Node, compiler: Compiler) -> list[Node]:
    """A frame for each copy; what refers to the copies is copied at the end of the file."""
    count, sep = node.values["count"], node.values.get("sep", "")
    names = names_in(node.children)
    referring = _take_referring(root, names)
    poses = list(_poses(node, compiler))
    # The first are the originals, to which keyframes of an attached model belong.
    copies = [[copied(child) for child in node.children] for _ in range(count - 1)]
    others = [[(tag, copied(one)) for tag, one in referring] for _ in range(count - 1)]
    replicas: list[Node] = []
    for index, (inside, after) in enumerate(
        zip([node.children, *copies][:count], [referring, *others][:count], strict=True)
    ):
        suffix = f"{sep}{index:0{len(str(count))}d}"
        for one in [*inside, *(one for _, one in after)]:
            rename(one, names, lambda name, suffix=suffix: name + suffix)  # type: ignore[misc]
        frame = Node("frame", {}, node.file, node.line)
        frame.path, frame.compiler, frame.children = "worldbody/frame", node.compiler, inside
        frame.values = {"pos": poses[index][0], "quat": poses[index][1]} if index else {}
        frame.attrs = {name: node.attrs[name] for name in ("childclass",) if name in node.attrs}
        frame.values |= frame.attrs
        _append(root, after)
        replicas.append(frame)
    return replicas


def _poses(node: Node, compiler: Compiler) -> Iterator[tuple[Vec, Vec]]:
    """The pose of each copy.

    As in MuJoCo, the k-th is turned by k times the Euler angles, which differs from k turns where
    there is more than one angle; its offset from the one before is in the frame of that one.
    """
    angles = [compiler.radians(angle) for angle in node.values.get("euler", frames.ORIGIN)]
    pos = frames.ORIGIN
    for index in range(node.values["count"]):
        quat = frames.from_euler([index * angle for angle in angles], compiler.eulerseq)
        yield pos, quat
        pos = frames.composed((pos, quat), node.values.get("offset", frames.ORIGIN), quat)[0]


def _take_referring(root: Node, names: Names) -> list[tuple[str, Node]]:
    """Removes what refers to `names`, or to what does; adds the names of these to `names`."""
    taken: dict[int, tuple[str, Node]] = {}
    while True:
        before = len(taken)
        for section in root.children:
            if section.tag not in SECTIONS:
                continue
            for node in section.children:
                if id(node) not in taken and refers(node, names):
                    taken[id(node)] = (section.tag, node)
                    if node.attrs.get("name"):
                        names.setdefault(kind_of(node), set()).add(node.attrs["name"])
        if len(taken) == before:
            break
    ordered = []
    for section in root.children:
        ordered += [taken[id(node)] for node in section.children if id(node) in taken]
        section.children = [node for node in section.children if id(node) not in taken]
    return ordered


def _append(root: Node, nodes: list[tuple[str, Node]]) -> None:
    """Adds elements to sections at the end of the file."""
    for tag in dict.fromkeys(tag for tag, _ in nodes):
        inside = [node for section, node in nodes if section == tag]
        part = Node(tag, {}, inside[0].file, inside[0].line)
        part.path, part.children = tag, inside
        root.children.append(part)
