"""Saves a scene in the text of its own file if only settings have changed.

`<option>`, `<flag>` and `<custom>` are edited where they stand, or sections are added at the end,
which replace earlier ones. An edited text is used only if it reads back as the scene.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.parsers import expat

from stepcore import files
from stepcore._core import Settings
from stepcore.mjcf import custom
from stepcore.mjcf.option import said, to_say
from stepcore.mjcf.reader import read_text
from stepcore.mjcf.write import written
from stepcore.mjcf.write.tags import Tag, escaped

if TYPE_CHECKING:
    from stepcore.mjcf.nodes import Source
    from stepcore.scene.contents import Contents


def save(scene: Contents, path: str | os.PathLike[str]) -> None:
    """Writes the scene to a file; see `Scene.save`."""
    target = Path(files.path("path", path))
    data = kept(scene, os.path.abspath(target.parent))
    target.write_bytes(written(scene).encode() if data is None else data)


def kept(scene: Contents, directory: str) -> bytes | None:
    """The text of the scene's file with its present settings; None if that is not possible.

    directory: the folder that the text is saved to.
    """
    source = scene._source
    if source is None:
        return None
    original = _read(type(scene)(), source.data, source)
    if original is None or not _only_settings_differ(original, scene):
        return None
    try:
        marks = _Marks.of(source.data)
    except expat.ExpatError:
        return None
    if marks.names_files and directory != source.directory:
        return None
    if original == scene:
        return source.data
    for place in (marks.option, None):
        data = _edited(source.data, marks, place, original, scene)
        if data is not None and _read(type(scene)(), data, source) == scene:
            return data
    return None


def _read(scene: Contents, data: bytes, source: Source) -> Contents | None:
    """Fills an empty scene from a text; None if the text cannot be read."""
    try:
        read_text(scene, data, base=source.directory)
    except (ValueError, OSError):
        return None
    return scene


def _only_settings_differ(original: Contents, scene: Contents) -> bool:
    same = original.with_settings(scene.settings)
    same.name = scene.name
    return same == scene


@dataclass
class _Open:
    """A start tag: its bytes in the text, and whether it closes itself."""

    start: int
    stop: int
    closed: bool


@dataclass
class _Marks:
    """The tags that hold settings, the last of each kind."""

    root: _Open | None = None
    end: int = -1
    option: _Open | None = None
    flag: _Open | None = None
    text: _Open | None = None
    names_files: bool = False
    path: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, data: bytes) -> _Marks:
        marks = cls()
        parser = expat.ParserCreate()

        def start(tag: str, attrs: dict[str, str]) -> None:
            marks._start(data, parser.CurrentByteIndex, tag, attrs)

        def end(tag: str) -> None:
            marks.path.pop()
            if not marks.path:
                marks.end = parser.CurrentByteIndex

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.Parse(data, True)
        return marks

    def _start(self, data: bytes, at: int, tag: str, attrs: dict[str, str]) -> None:
        where = "/".join([*self.path[1:], tag])
        self.path.append(tag)
        self.names_files |= "file" in attrs
        mark = _tag(data, at)
        if len(self.path) == 1:
            self.root = mark
        elif where == "option":
            self.option, self.flag = mark, None
        elif where == "option/flag":
            self.flag = mark
        elif where == "custom/text" and attrs.get("name") == custom.NAME:
            self.text = mark


def _tag(data: bytes, start: int) -> _Open:
    """The start tag at this byte, up to the ">" that is not quoted."""
    match = re.compile(rb"""<(?:[^"'>]|"[^"]*"|'[^']*')*>""").match(data, start)
    stop = match.end() if match else start
    return _Open(start, stop, data[stop - 2 : stop] == b"/>")


# First byte, last byte, replacement.
_Edit = tuple[int, int, bytes]


def _edited(
    data: bytes, marks: _Marks, option: _Open | None, original: Contents, scene: Contents
) -> bytes | None:
    """The text with the settings of `scene`, in this option tag or in a new one at the end."""
    if marks.root is None or marks.root.closed:
        return None
    before, after = original.settings.as_dict(), scene.settings.as_dict()
    changed = {name: value for name, value in after.items() if value != before[name]}
    attributes, flags, _ = said(changed)
    rest = said(to_say(scene.settings))[2]
    edits: list[_Edit] = []
    if scene.name != original.name:
        edits.append(_with(data, marks.root, {"model": scene.name}))
    late: list[Tag] = []
    if option is None:
        if attributes or flags:
            late.append(Tag("option", **attributes))
            if flags:
                late[-1].add(Tag("flag", **flags))
    else:
        edits += _in_option(data, option, marks.flag, attributes, flags)
    edits += _custom(data, marks, rest, late)
    if late:
        lines = "".join(f"  {_flat(tag)}\n" for tag in late)
        edits.append((marks.end, marks.end, lines.encode()))
    for start, stop, new in sorted(edits, reverse=True):
        data = data[:start] + new + data[stop:]
    return data


def _in_option(
    data: bytes,
    option: _Open,
    flag: _Open | None,
    attributes: dict[str, str],
    flags: dict[str, str],
) -> list[_Edit]:
    start, stop, tag = _with(data, option, attributes)
    if not flags:
        return [(start, stop, tag)]
    if flag is not None:
        return [(start, stop, tag), _with(data, flag, flags)]
    inner = Tag("flag", **flags).start().encode()
    if option.closed:
        return [(start, stop, tag[:-2].rstrip() + b">" + inner + b"</option>")]
    return [(start, stop, tag + inner)]


def _custom(data: bytes, marks: _Marks, rest: dict[str, Any], late: list[Tag]) -> list[_Edit]:
    """The edits of stepcore's own text; a new text is added to `late`."""
    if marks.text is None:
        if rest:
            late.append(Tag("custom"))
            late[-1].add(Tag("text", name=custom.NAME, data=custom.data(rest)))
        return []
    tag = data[marks.text.start : marks.text.stop].decode("utf-8", "replace")
    held = re.search(r"""\bdata\s*=\s*["']([^"']*)["']""", tag)
    settings = Settings().as_dict()
    words = (held.group(1) if held else "").split()
    others = [word for word in words if word.partition("=")[0] not in settings]
    text = " ".join([*filter(None, [custom.data(rest)]), *others])
    if not text and marks.text.closed:
        # MuJoCo refuses a text without data.
        return [(marks.text.start, marks.text.stop, b"")]
    return [_with(data, marks.text, {"data": text})]


def _with(data: bytes, tag: _Open, attributes: dict[str, str]) -> _Edit:
    """The edit that sets these attributes of a start tag."""
    text = data[tag.start : tag.stop]
    for name, value in attributes.items():
        word = f'{name}="{escaped(value)}"'.encode()
        pattern = rb"""(?<=\s)%s\s*=\s*("[^"]*"|'[^']*')""" % name.encode()
        if re.search(pattern, text):
            text = re.sub(pattern, lambda _, word=word: word, text, count=1)  # type: ignore[misc]
        else:
            cut = len(text) - (2 if tag.closed else 1)
            text = text[:cut].rstrip() + b" " + word + text[cut:]
    return tag.start, tag.stop, text


def _flat(tag: Tag) -> str:
    inside = "".join(map(_flat, tag.inside))
    return tag.start() + (f"{inside}</{tag.kind}>" if inside else "")
