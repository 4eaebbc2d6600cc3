"""Replace each `<include>` by the elements of the included file."""

from __future__ import annotations

import os
from pathlib import Path

from stepcore import files
from stepcore.mjcf.nodes import DEPTH, MJCFError, Node, parse


def read_main(shown: str) -> bytes:
    """Return the bytes of a model's main file."""
    try:
        return files.read(shown, "an MJCF or URDF file")
    except ValueError as error:
        raise MJCFError(shown, 1, str(error)) from None


def read_named(node: Node, shown: str) -> Node:
    """Parse the XML file that an element names; read errors name the line of the element."""
    try:
        data = files.read(shown, "an MJCF or URDF file")
    except FileNotFoundError as error:
        raise node.missing(error) from None
    except (IsADirectoryError, ValueError) as error:
        raise node.error(str(error)) from None
    return parse(data, shown)


def expand(root: Node, base: Path | None, main: Path | None) -> list[str]:
    """Replace every include below `root`, in place.

    As in MuJoCo, a file is searched in the folder of the main file (`base`), then in the folder of
    the including file. A file can be included once, and may be outside these folders. Only regular
    files are read. Returns a note on each file outside the folder of the main file.
    """
    seen = {_identity(main)} if main is not None else set()
    included_by: dict[str, str] = {}
    pending = [(root, 1)]
    while pending:
        node, depth = pending.pop()
        waiting = node.children[::-1]
        node.children = []
        while waiting:
            child = waiting.pop()
            if child.tag == "include":
                waiting.extend(reversed(_included(child, base, seen, included_by)))
            else:
                if depth >= DEPTH:
                    raise child.error(f"elements are nested deeper than {DEPTH}, with includes")
                node.children.append(child)
                pending.append((child, depth + 1))
    return [
        f"{by}: <include> reads {file}, which is outside the folder of the main file"
        for file, by in included_by.items()
        if base is not None and not Path(_identity(Path(file))).is_relative_to(_identity(base))
    ]


def _identity(path: Path) -> str:
    return os.path.realpath(path)


def _included(
    node: Node, base: Path | None, seen: set[str], included_by: dict[str, str]
) -> list[Node]:
    name = node.attrs.get("file", "")
    if set(node.attrs) != {"file"} or not name or node.children or "\0" in name:
        raise node.error('<include> needs exactly one attribute, file="…", and no content')
    if base is None:
        raise node.error(f'<include file="{name}"> in a text needs loads(text, base=folder)')
    places = [base / name, Path(node.file).parent / name]
    path = next((place for place in places if os.path.isfile(place)), places[0])
    if _identity(path) in seen:
        above: str | None = node.file
        while above is not None and _identity(Path(above)) != _identity(path):
            above = included_by.get(above)
        why = "was already included" if above is None else "includes itself"
        raise node.error(f'<include file="{name}">: the file {why}')
    seen.add(_identity(path))
    shown = str(path)
    included_by[shown] = node.file
    root = read_named(node, shown)
    if not root.children:
        raise node.error(f'<include file="{name}">: the file has no elements')
    return root.children
