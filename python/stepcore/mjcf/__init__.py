"""MJCF, MuJoCo's model format, read into a `Scene`.

The reader is strict: an element, attribute, keyword or reference that MJCF does not have is an
error with file, line and the nearest name. What would change the motion and is not built yet is
refused by name. What only draws or senses is listed in `Scene.ignored`, and what is translated in
`Scene.notes`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from stepcore.checks import ElementError
from stepcore.mjcf import actuators, custom, drawn, option, sections, values
from stepcore.mjcf.compiler import Compiler
from stepcore.mjcf.defaults import Defaults
from stepcore.mjcf.include import expand, read_bytes
from stepcore.mjcf.source import MJCFError, Node, Source, parse
from stepcore.mjcf.tree import Tree
from stepcore.scene.layout import Layout, check
from stepcore.scene.scene import Scene

__all__ = ["MJCFError", "load", "loads"]


def load(path: str | os.PathLike[str]) -> Scene:
    """The scene in an MJCF file; its ``<option>`` becomes ``scene.settings``.

    Angles become radians, orientations unit quaternions; classes, includes and frames are
    resolved. Raises MJCFError (a ValueError whose text is ``file:line: …``) for what cannot be
    read, and FileNotFoundError for a file that is not there.

    >>> from pathlib import Path
    >>> text = '<mujoco><worldbody><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    >>> _ = Path("ball.xml").write_text(text)
    >>> load("ball.xml")
    <Scene: 1 body, 1 joint (nq 7, nv 6), 1 geom>
    """
    shown = os.fsdecode(path)
    main = Path(shown)
    data = read_bytes(main, shown)
    root = parse(data, shown)
    expand(root, main.parent, main)
    return _scene(root, Source(data, os.path.abspath(main.parent)))


def loads(
    text: str | bytes, *, base: str | os.PathLike[str] | None = None, name: str = "<string>"
) -> Scene:
    """The scene in an MJCF text.

    base: the directory in which its includes lie. name: what error messages call the text.

    Raises what `load` raises. Warns (`StiffnessWarning`) of a scene whose own dt has less than a
    factor of two in hand.

    >>> scene = loads('<mujoco><option timestep="0.01"/><worldbody/></mujoco>')
    >>> scene.settings.dt
    0.01
    >>> loads("<mujoco><wordbody/></mujoco>")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    stepcore.mjcf.source.MJCFError: <string>:1: unknown element <wordbody> in <mujoco>; nearest: ...
    """
    from stepcore.measure.diagnosis.load import warn_of_stiffness

    scene = read_text(text, base=base, name=name)
    warn_of_stiffness(scene)
    return scene


def read_text(
    text: str | bytes, *, base: str | os.PathLike[str] | None = None, name: str = "<string>"
) -> Scene:
    """`loads` without its warning."""
    if not isinstance(text, (str, bytes)):
        raise MJCFError(name, 1, "an MJCF text must be a str or bytes")
    root = parse(text, name)
    expand(root, None if base is None else Path(base), None)
    data = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
    return _scene(root, Source(data, None if base is None else os.path.abspath(base)))


def _scene(root: Node, source: Source) -> Scene:
    """Builds the scene of a whole model, its includes already in place."""
    scene = Scene(name=root.attrs.get("model", ""))
    scene._source = source.of(root)
    scene.ignored += values.check(root)
    compiler = Compiler(_sections(root, "compiler"))
    defaults = Defaults(_sections(root, "default"))
    tree = Tree(scene, compiler, defaults)
    try:
        scene.mass_rules = compiler.mass_rules()
        for node in _sections(root, "option"):
            _at(node, lambda node: option.read(scene, node))
        for node in _sections(root, "worldbody"):
            tree.read(node)
        for node in _inside(root, "contact"):
            _at(node, lambda node: sections.exclude(tree, node))
        for node in _inside(root, "equality"):
            _at(node, lambda node: sections.connect(tree, defaults, node))
        for node in _inside(root, "actuator"):
            _at(node, lambda node: actuators.actuator(tree, defaults, node))
        layout = Layout(scene)
        for node in _inside(root, "keyframe"):
            _at(node, lambda node: sections.key(tree, layout, node))
        sections.add_empty_keys(scene, _sections(root, "size"))
        sections.check_references(tree, root)
        drawn.list_drawn(tree, layout)
        for node in custom.found(_inside(root, "custom")):
            _at(node, lambda node: custom.read(scene, node))
        check(layout)
    except ElementError as error:
        # Found in the whole scene: the line is that of the element it is about.
        node = tree.nodes.get(id(error.owner), root)
        raise node.error(str(error)) from None
    scene.ignored.sort(key=_place)
    return scene


def _place(line: str) -> tuple[str, int]:
    file, number, _ = line.rsplit(" <", 1)[0].rsplit(":", 2)
    return file, int(number)


def _sections(root: Node, tag: str) -> list[Node]:
    return [node for node in root.children if node.tag == tag]


def _inside(root: Node, tag: str) -> list[Node]:
    return [node for section in _sections(root, tag) for node in section.children]


def _at(node: Node, read: Callable[[Node], None]) -> None:
    """Runs `read` on a node; whatever it finds wrong gets the node's file and line."""
    try:
        read(node)
    except MJCFError:
        raise
    except ValueError as error:
        raise node.error(str(error)) from None
