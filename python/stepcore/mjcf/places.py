"""The place of an element in the file of a model: for messages of other programs."""

from __future__ import annotations

import re
from pathlib import Path

from stepcore.mjcf.nodes import Node, below, expand, parse, read_main, sections

# The tags, or the section, in which an element of each kind stands.
TAGS = {
    "joint": ("joint", "freejoint"),
    "contact": ("geom", "pair"),
    "body": ("body", "link"),
}
SECTIONS = ("actuator", "tendon", "equality", "sensor", "keyframe")
NAME = re.compile(r"`([^`]+)`")


class Places:
    """The elements of a file by name, includes among them.

    file: the path of an MJCF or URDF file; another source, such as a Scene, has no places.
    """

    def __init__(self, file: str) -> None:
        self.file, self._root = file, Node("mujoco", {}, file, 1)
        path = Path(file)
        if path.is_file():
            self._root = parse(read_main(file), file)
            expand(self._root, path.parent, path)

    def of(self, kind: str, name: str) -> tuple[str, int]:
        """Return file and line of an element; of the root if the file has no such name.

        kind: "joint", "contact", "actuator" and so on, as the owner of fields of an
        `Element`. name: its name in a finding, such as "contact `floor`/`foot`": the last of
        several names is looked up first.
        """
        for label in reversed(NAME.findall(name)):
            named = [node for node in self._of_kind(kind) if node.attrs.get("name") == label]
            if named:
                return named[0].file, named[0].line
        return self._root.file, self._root.line

    def _of_kind(self, kind: str) -> list[Node]:
        """Return the elements of a kind, and after them all others."""
        if kind in SECTIONS:
            first = [node for part in sections(self._root, kind) for node in below(part)]
        else:
            first = [node for node in below(self._root) if node.tag in TAGS.get(kind, (kind,))]
        return [*first, *below(self._root)]
