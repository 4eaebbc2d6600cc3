"""A model of a file made whole: checked, and with its attached models and copies in place."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from stepcore.mjcf.compiler import Compiler
from stepcore.mjcf.defaults import Defaults
from stepcore.mjcf.expand.attach import Attacher, Model
from stepcore.mjcf.expand.replicate import expand_replicates
from stepcore.mjcf.include import expand, read_file
from stepcore.mjcf.left_out import LeftOut
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.refusals import Refusals
from stepcore.mjcf.validation import validate

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents


class Models:
    """Makes models whole, those that are attached to others included."""

    def __init__(self, scene: Contents, refusals: Refusals, left_out: LeftOut) -> None:
        self.scene = scene
        self.refusals = refusals
        self.left_out = left_out
        # The files of the models that are being made, the outermost first.
        self.open: list[str] = []

    def prepared(self, root: Node, directory: str | None) -> Model:
        """The model of a root whose includes are expanded; directory: of its main file."""
        self.scene.ignored += validate(root, self.refusals, self.left_out)
        compiler = Compiler(sections(root, "compiler"), directory, root.file)
        model = Model(root, compiler, Defaults(sections(root, "default")))
        attacher = Attacher(model, lambda node: self._load(node, compiler))
        attacher.run()
        self.scene.notes += attacher.notes
        expand_replicates(root, compiler)
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
        shown = str(path)
        try:
            root = read_file(shown)
        except FileNotFoundError as error:
            raise FileNotFoundError(f"{node.file}:{node.line}: {error}") from None
        self.scene.notes += expand(root, path.parent, path)
        self.open.append(here)
        model = self.prepared(root, os.path.abspath(path.parent))
        self.open.pop()
        return model


def sections(root: Node, tag: str) -> list[Node]:
    """The sections of this tag."""
    return [node for node in root.children if node.tag == tag]


def inside(root: Node, tag: str) -> list[Node]:
    """The elements of all sections of this tag."""
    return [node for section in sections(root, tag) for node in section.children]
