"""`<replicate>`: copies of bodies at successive offsets, and of all elements that refer to them.

MuJoCo documentation, XML reference, replicate. As in MuJoCo, copies of elements that refer to a
replicated element come after all other elements of their section.
"""

from __future__ import annotations

from collections.abc import Iterator

from stepcore.mjcf.compiler import Compiler
from stepcore.mjcf.copies import Copies, Referring, copied, names_in, rename
from stepcore.mjcf.nodes import Node, below, sections
from stepcore.mjcf.validation import bad
from stepcore.scene import frames
from stepcore.scene.frames import Vec


def expand_replicates(root: Node, compiler: Compiler, copies: Copies) -> None:
    """Replace every <replicate> of a model by frames, the innermost first."""
    parents = _parents(root)
    if not parents:
        return
    referring = Referring(root)
    for parent in parents:
        children: list[Node] = []
        for node in parent.children:
            if node.tag == "replicate":
                children += _replicas(node, node.compiler or compiler, referring, copies)
            else:
                children.append(node)
        parent.children = children
    referring.put_back()


def _parents(root: Node) -> list[Node]:
    """Return the parents of <replicate> elements, the innermost first."""
    every = [node for tree in sections(root, "worldbody") for node in below(tree)]
    depth: dict[int, int] = {}
    for node in every:
        for child in node.children:
            depth[id(child)] = depth.get(id(node), 0) + 1
    holding = [n for n in every if any(child.tag == "replicate" for child in n.children)]
    return sorted(holding, key=lambda node: -depth.get(id(node), 0))


def _replicas(node: Node, compiler: Compiler, referring: Referring, copies: Copies) -> list[Node]:
    """Return a frame for each copy, and add copies of referring elements to `referring`."""
    count, sep = node.values["count"], node.values.get("sep", "")
    if count < 0:
        raise bad(node, "count", count, ">= 0")
    for child in node.children:
        if child.tag in ("joint", "freejoint", "inertial"):
            raise child.error(f"<{child.tag}> cannot be a direct child of <replicate>")
    names = names_in(node.children)
    named = referring.take(names)
    copies.take(node, [node, *(part for _, part in named)], count)
    # The originals become the first replica, because keyframes of attached models refer to them.
    trees = [node.children, *([copied(n) for n in node.children] for _ in range(count - 1))]
    parts = [named, *([(tag, copied(n)) for tag, n in named] for _ in range(count - 1))]
    replicas: list[Node] = []
    for index, (pos, quat) in enumerate(_poses(node, compiler)):
        suffix = f"{sep}{index:0{len(str(count))}d}"
        for element in [*trees[index], *(part for _, part in parts[index])]:
            rename(element, names, suffix=suffix)
        frame = Node("frame", {}, node.file, node.line)
        frame.path, frame.compiler, frame.children = "worldbody/frame", node.compiler, trees[index]
        frame.attrs = {name: node.attrs[name] for name in ("childclass",) if name in node.attrs}
        frame.values = {**({"pos": pos, "quat": quat} if index else {}), **frame.attrs}
        referring.append(parts[index])
        replicas.append(frame)
    return replicas


def _poses(node: Node, compiler: Compiler) -> Iterator[tuple[Vec, Vec]]:
    """Yield the pose of each copy.

    As in MuJoCo, copy k is rotated by k times the Euler angles. With more than one angle this
    differs from k successive rotations. The offset of each copy is in the frame of the previous
    copy.
    """
    angles = [compiler.radians(angle) for angle in node.values.get("euler", frames.ORIGIN)]
    pos = frames.ORIGIN
    for index in range(node.values["count"]):
        quat = frames.from_euler([index * angle for angle in angles], compiler.eulerseq)
        yield pos, quat
        pos = frames.composed((pos, quat), node.values.get("offset", frames.ORIGIN), quat)[0]
