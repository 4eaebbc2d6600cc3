"""Save a scene in the text of its own file if only settings have changed.

`<option>`, `<flag>` and `<custom>` are edited in place, or new sections at the end override the
earlier ones. An edited text is used only if it reads back as the scene.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.parsers import expat

from stepcore import files
from stepcore._core import Settings
from stepcore.mjcf import custom
from stepcore.mjcf.option import implied, said, to_say
from stepcore.mjcf.reader import read_text
from stepcore.mjcf.tags import Tag, escaped
from stepcore.mjcf.writer import written

if TYPE_CHECKING:
    from stepcore.mjcf.nodes import Source
    from stepcore.scene.scene import Scene

# The first byte, the byte after the last, and the replacement.
_Edit = tuple[int, int, bytes]


def save(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write the scene to a file; see `Scene.save`."""
    target = Path(files.path("path", path))
    data = kept(scene, os.path.abspath(target.parent))
    target.write_bytes(written(scene).encode() if data is None else data)


def kept(scene: Scene, directory: str) -> bytes | None:
    """Return the text of the scene's file with the current settings; None if not possible.

    directory: the folder in which the text will be saved.
    """
    source = scene._source
    original = None if source is None else _read(type(scene)(), source.data, source)
    if source is None or original is None:
        return None
    same = original.with_settings(scene.settings)
    same.name = scene.name
    if same != scene:
        return None
    try:
        tags = _Tags(source.data)
    except expat.ExpatError:
        return None
    if tags.names_files and directory != source.directory:
        return None
    if original == scene:
        return source.data
    for in_place in (True, False):
        data = _edited(source.data, tags, in_place, original, scene)
        if data is not None and _read(type(scene)(), data, source) == scene:
            return data
    return None


def _read(scene: Scene, data: bytes, source: Source) -> Scene | None:
    """Fill an empty scene from a text and return it; None if the text cannot be read."""
    try:
        read_text(scene, data, base=source.directory)
    except (ValueError, OSError):
        return None
    return scene


@dataclass
class _Tag:
    """A start tag: its byte range in the text, and whether the tag closes itself."""

    start: int
    stop: int
    closed: bool


class _Tags:
    """The start tags with settings: the last of each path. The path of the root is "".

    end: the byte position of the root's end tag.
    names_files: whether any element has a file.
    """

    def __init__(self, data: bytes) -> None:
        self.last: dict[str, _Tag] = {}
        self.end = -1
        self.names_files = False
        path: list[str] = []
        parser = expat.ParserCreate()

        def start(tag: str, attrs: dict[str, str]) -> None:
            path.append(tag)
            where = "/".join(path[1:])
            self.names_files |= "file" in attrs
            if where == "option":
                self.last.pop("option/flag", None)
            ours = where == "custom/text" and attrs.get("name") == custom.NAME
            if ours or where in ("", "option", "option/flag"):
                at = parser.CurrentByteIndex
                # The tag ends at the first ">" outside quotes.
                match = re.compile(rb"""<(?:[^"'>]|"[^"]*"|'[^']*')*>""").match(data, at)
                stop = match.end() if match else at
                self.last[where] = _Tag(at, stop, data[stop - 2 : stop] == b"/>")

        def end(_tag: str) -> None:
            path.pop()
            if not path:
                self.end = parser.CurrentByteIndex

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.Parse(data, True)


def _edited(
    data: bytes, tags: _Tags, in_place: bool, original: Scene, scene: Scene
) -> bytes | None:
    """Return the text with the settings of `scene`, or None if the root has no end tag.

    in_place: whether to edit the last <option>; otherwise a new one is added at the end.
    """
    root = tags.last[""]
    if root.closed:
        return None
    before, after = original.settings.as_dict(), scene.settings.as_dict()
    implications = implied(before).keys() ^ implied(after).keys()
    changed = {
        name: value
        for name, value in after.items()
        if value != before[name] or name in implications
    }
    attributes, flags, _ = said(changed)
    edits: list[_Edit] = []
    added: list[Tag] = []
    if scene.name != original.name:
        edits.append(_with(data, root, {"model": scene.name}))
    option, flag = tags.last.get("option"), tags.last.get("option/flag")
    if not in_place or option is None:
        if attributes or flags:
            added.append(Tag("option", **attributes))
            if flags:
                added[-1].add(Tag("flag", **flags))
    else:
        start, stop, text = _with(data, option, attributes)
        if flags and flag is not None:
            edits.append(_with(data, flag, flags))
        elif flags:
            inner = Tag("flag", **flags).start().encode()
            text = (
                text[:-2].rstrip() + b">" + inner + b"</option>" if option.closed else text + inner
            )
        edits.append((start, stop, text))
    rest = said(to_say(scene.settings))[2]
    held = tags.last.get("custom/text")
    if held is not None:
        edits.append(_custom(data, held, rest))
    elif rest:
        added.append(Tag("custom"))
        added[-1].add(Tag("text", name=custom.NAME, data=custom.data(rest)))
    if added:
        lines = "".join(f"  {_on_one_line(tag)}\n" for tag in added)
        edits.append((tags.end, tags.end, lines.encode()))
    for start, stop, new in sorted(edits, reverse=True):
        data = data[:start] + new + data[stop:]
    return data


def _custom(data: bytes, held: _Tag, rest: dict[str, Any]) -> _Edit:
    """Return the edit of stepcore's own text, which keeps the words other than settings."""
    tag = data[held.start : held.stop].decode("utf-8", "replace")
    match = re.search(r"""\bdata\s*=\s*["']([^"']*)["']""", tag)
    settings = Settings().as_dict()
    words = (match.group(1) if match else "").split()
    others = [word for word in words if word.partition("=")[0] not in settings]
    text = " ".join([*filter(None, [custom.data(rest)]), *others])
    if not text and held.closed:
        # MuJoCo refuses a text without data.
        return held.start, held.stop, b""
    return _with(data, held, {"data": text})


def _with(data: bytes, tag: _Tag, attributes: dict[str, str]) -> _Edit:
    """Return the edit that sets these attributes of a start tag."""
    text = data[tag.start : tag.stop]
    for name, value in attributes.items():
        word = f'{name}="{escaped(value)}"'.encode()
        match = re.search(rb"""(?<=\s)%s\s*=\s*("[^"]*"|'[^']*')""" % name.encode(), text)
        if match:
            text = text[: match.start()] + word + text[match.end() :]
        else:
            cut = len(text) - (2 if tag.closed else 1)
            text = text[:cut].rstrip() + b" " + word + text[cut:]
    return tag.start, tag.stop, text


def _on_one_line(tag: Tag) -> str:
    inside = "".join(map(_on_one_line, tag.inside))
    return tag.start() + (f"{inside}</{tag.kind}>" if inside else "")
