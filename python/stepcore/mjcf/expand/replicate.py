"""`<replicate>`: copies of bodies, each one step further, and of all that refers to them.

MuJoCo documentation, XML reference, replicate. As there, what refers to a replicated element is
replicated too, and its copies stand after all other elements of their section.
"""

from __future__ import annotations

from collections.abc import Iterator

from stepcore.mjcf.compiler import Compiler
from stepcore.mjcf.expand.copies import Copies
from stepcore.mjcf.expand.naming import copied, names_in, rename
from stepcore.mjcf.expand.referring import Referring
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.refusals import below
from stepcore.mjcf.validation import bad
from stepcore.scene import frames
from stepcore.scene.frames import Vec


def expand_replicates(root: Node, compiler: Compiler, copies: Copies) -> None:
    """Replaces every replicate of a model, the innermost first; copies: those made so far."""
    parents = _parents(root)
    if not parents:
        return
    referring = Referring(root)
    for parent in parents:
        inside: list[Node] = []
        for node in parent.children:
            if node.tag == "replicate":
                _check(node)
                inside += _replicas(node, node.compiler or compiler, referring, copies)
            else:
                inside.append(node)
        parent.children = inside
    referring.put_back()


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


def _check(node: Node) -> None:
    if node.values["count"] < 0:
        raise bad(node, "count", node.values["count"], ">= 0")
    for child in node.children:
        if child.tag in ("joint", "freejoint", "inertial"):
            raise child.error(f"<{child.tag}> cannot be a direct child of <replicate>")


def _replicas(node: Node, compiler: Compiler, referring: Referring, copies: Copies) -> list[Node]:
    """A frame for each copy; what refers to the copies is copied at the end of the file."""
    count, sep = node.values["count"], node.values.get("sep", "")
    names = names_in(node.children)
    named = referring.take(names)
    copies.take(node, [node, *(one for _, one in named)], count)
    poses = list(_poses(node, compiler))
    # The first are the originals, to which keyframes of an attached model belong.
    trees = [[copied(child) for child in node.children] for _ in range(count - 1)]
    others = [[(tag, copied(one)) for tag, one in named] for _ in range(count - 1)]
    replicas: list[Node] = []
    for index, (inside, after) in enumerate(
        zip([node.children, *trees][:count], [named, *others][:count], strict=True)
    ):
        suffix = f"{sep}{index:0{len(str(count))}d}"
        for one in [*inside, *(one for _, one in after)]:
            rename(one, names, lambda name, suffix=suffix: name + suffix)  # type: ignore[misc]
        frame = Node("frame", {}, node.file, node.line)
        frame.path, frame.compiler, frame.children = "worldbody/frame", node.compiler, inside
        frame.values = {"pos": poses[index][0], "quat": poses[index][1]} if index else {}
        frame.attrs = {name: node.attrs[name] for name in ("childclass",) if name in node.attrs}
        frame.values |= frame.attrs
        referring.append(after)
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
