"""A model of a file made whole: checked, and with its attached models and copies in place."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from stepcore.mjcf.attach import Attacher, Model
from stepcore.mjcf.compiler import Compiler
from stepcore.mjcf.copies import Copies
from stepcore.mjcf.defaults import Defaults
from stepcore.mjcf.exclusions import Exclusions
from stepcore.mjcf.include import expand, read_named
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.refusals import Refusals
from stepcore.mjcf.replicate import expand_replicates
from stepcore.mjcf.validation import validate

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents


# The most models that attach each other in turn.
MOST_NESTED = 50


class Models:
    """Makes models whole, those that are attached to others included."""

    def __init__(self, scene: Contents, refusals: Refusals, exclusions: Exclusions) -> None:
        self.scene = scene
        self.refusals = refusals
        self.exclusions = exclusions
        # The files of the models that are being made, the outermost first.
        self.open: list[str] = []
        # Those that are made, by their files; they stay as they are.
        self.made: dict[str, Model] = {}
        self.copies = Copies()

    def prepared(self, root: Node, directory: str | None) -> Model:
        """The model of a root whose includes are expanded; directory: of its main file."""
        self.scene.ignored += validate(root, self.refusals, self.exclusions)
        compiler = Compiler(sections(root, "compiler"), directory, root.file)
        model = Model(root, compiler, Defaults(sections(root, "default")))
        attacher = Attacher(model, lambda node: self._load(node, compiler), self.copies)
        attacher.run()
        self.scene.notes += attacher.notes
        expand_replicates(root, compiler, self.copies)
        return model

    def _load(self, node: Node, compiler: Compiler) -> Model:
        """The model that an <asset><model> names."""
        name = node.values["file"]
        if not name or "\0" in name:
            raise node.error('<model> needs a file="…"')
        if compiler.directory is None and not os.path.isabs(name):
            raise node.error(f'<model file="{name}"> in a text needs loads(text, base=folder)')
        path = Path(compiler.path(node, name))
        here = os.path.realpath(path)
        if here in (*self.open, os.path.realpath(node.file)):
            raise node.error(f'<model file="{name}">: the file attaches itself')
        if here in self.made:
            return self.made[here]
        if len(self.open) >= MOST_NESTED:
            raise node.error(f"attached models are nested deeper than {MOST_NESTED}")
        root = read_named(node, str(path))
        self.scene.notes += expand(root, path.parent, path)
        self.open.append(here)
        model = self.prepared(root, os.path.abspath(path.parent))
        self.open.pop()
        self.made[here] = model
        return model


def sections(root: Node, tag: str) -> list[Node]:
    """The sections of this tag."""
    return [node for node in root.children if node.tag == tag]


def inside(root: Node, tag: str) -> list[Node]:
    """The elements of all sections of this tag."""
    return [node for section in sections(root, tag) for node in section.children]
