"""Parses an MJCF text into a tree of `Node`; entities are refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any
from xml.parsers import expat

from stepcore.checks import brief
from stepcore.mjcf.lenient_xml import repaired
from stepcore.mjcf.refusal_texts import effect

# MuJoCo's own parser stops at this depth too.
DEPTH = 500


class MJCFError(ValueError):
    """An MJCF file or text that cannot be read; the message begins with ``file:line: ``.

    file: the name of the file as it was given. line: counted from 1. text: the message without
    them. kind: of a thing that is not built yet, what `stepcore.load` can leave out ("" for other
    errors). errors: what is wrong with the file (elements are read until 100 are
    wrong), this one first, where there is more.
    """

    def __init__(self, file: str, line: int, text: str, kind: str = "") -> None:
        super().__init__(f"{brief(file)}:{line}: {brief(' '.join(text.split()))}")
        self.file = file
        self.line = line
        self.text = text
        self.kind = kind
        self.errors: tuple[MJCFError, ...] = (self,)

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (type(self), self.file, self.line, self.text, self.kind, self._more())

    def _more(self) -> tuple[str, tuple[MJCFError, ...]]:
        return str(self), self.errors[1:]

    def with_others(self, errors: tuple[MJCFError, ...], message: str) -> MJCFError:
        """This error with all errors of the file, and a message that lists them."""
        self.errors = (self, *errors)
        self.args = (message,)
        return self


def _again(
    kind: type[MJCFError],
    file: str,
    line: int,
    text: str,
    what: str,
    more: tuple[str, tuple[MJCFError, ...]],
) -> MJCFError:
    """Unpickles an error."""
    message, others = more
    return kind(file, line, text, what).with_others(others, message)


@dataclass(frozen=True)
class Source:
    """The text that a scene was read from.

    data: the text. urdf: that of a URDF, which leaves `data` empty. directory: the folder of its
    includes. fuse: the argument `fuse` of `stepcore.load`.
    files: the files that were read, the main one first.
    unread: files that the text names but that only draw; they are never opened.
    read_bytes: the size of the files of meshes and height fields that were read, and asset_bytes:
        of all of them that are there.
    without: the kinds that are left out.
    """

    data: bytes
    directory: str | None
    urdf: bytes = b""
    fuse: bool | None = None
    files: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()
    read_bytes: int = 0
    asset_bytes: int = 0
    without: tuple[str, ...] = ()

    def of(self, root: Node) -> Source:
        """This source with the files of a model whose includes are expanded."""
        files, unread = [root.file], []
        pending = [root]
        while pending:
            node = pending.pop()
            files.append(node.file)
            unread += [value for name, value in node.attrs.items() if name.startswith("file")]
            pending += reversed(node.children)
        return replace(self, files=tuple(dict.fromkeys(files)), unread=tuple(dict.fromkeys(unread)))


class Node:
    """One XML element.

    values: its attributes as numbers and words, and path: its section and tag, "sensor/touch";
    `validate` sets both. compiler: the compiler sections of an attached model that it is from.
    parts: the vectors of a keyframe of such a model, as (element, its numbers).
    """

    __slots__ = (
        *("attrs", "children", "compiler", "file", "line", "parts", "path", "tag"),
        "values",
    )

    def __init__(self, tag: str, attrs: dict[str, str], file: str, line: int) -> None:
        self.tag = tag
        self.attrs = attrs
        self.file = file
        self.line = line
        self.children: list[Node] = []
        self.values: dict[str, Any] = {}
        self.path = tag
        self.compiler: Any = None
        self.parts: dict[str, list[tuple[Node, tuple[float, ...]]]] | None = None

    def error(self, text: str) -> MJCFError:
        """Returns the error about this element, with its file and line."""
        return MJCFError(self.file, self.line, text)

    def missing(self, error: FileNotFoundError) -> FileNotFoundError:
        """Returns the error about a file that this element names, with the element's place."""
        return FileNotFoundError(f"{brief(self.file)}:{self.line}: {error}")

    def unbuilt(self, what: str, attribute: str = "") -> MJCFError:
        """Returns the error for a feature that would change the motion and is not built yet.

        attribute: that asks for it, where the element without it could be read.
        """
        kind = f"{self.tag}/{attribute}" if attribute else self.path
        does = effect(kind)
        return MJCFError(
            self.file, self.line, f"{what} is not built yet{does and f': {does}'}", kind
        )

    def asset_name(self) -> str:
        """The name of an asset: its own, or that of its file without folder and ending."""
        file = self.attrs.get("file", "").replace("\\", "/").rpartition("/")[2]
        return self.attrs.get("name", file.rpartition(".")[0] or file)

    def listed(self, why: str) -> str:
        """Returns the line about this element in `Scene.ignored`."""
        name = self.attrs.get("name", "")
        label = f'<{self.tag}> "{name}"' if name else f"<{self.tag}>"
        return f"{self.file}:{self.line}: {label} ({why})"


def below(node: Node) -> Iterator[Node]:
    """A node and all that it holds."""
    pending = [node]
    while pending:
        node = pending.pop()
        yield node
        pending += node.children


def sections(root: Node, tag: str) -> list[Node]:
    """The sections of this tag."""
    return [node for node in root.children if node.tag == tag]


def inside(root: Node, tag: str) -> list[Node]:
    """The elements of all sections of this tag."""
    return [node for section in sections(root, tag) for node in section.children]


def parse(data: str | bytes, file: str) -> Node:
    """Returns the root of an XML document; MJCFError if it is not well-formed.

    What MuJoCo's parser lets pass in a comment, in a text or before the document is read too.
    """
    try:
        return _parse(data, file)
    except MJCFError:
        plain = repaired(data)
        if plain == data:
            raise
        return _parse(plain, file)


def _parse(data: str | bytes, file: str) -> Node:
    parser = expat.ParserCreate()
    parser.ordered_attributes = False
    parser.buffer_text = True
    roots: list[Node] = []
    path: list[Node] = []

    def fail(text: str) -> MJCFError:
        return MJCFError(file, parser.CurrentLineNumber, text)

    def start(tag: str, attrs: dict[str, str]) -> None:
        node = Node(tag, attrs, file, parser.CurrentLineNumber)
        if len(path) >= DEPTH:
            raise fail(f"elements are nested deeper than {DEPTH}")
        (path[-1].children if path else roots).append(node)
        path.append(node)

    def end(_tag: str) -> None:
        path.pop()

    def doctype(name: str, system: str | None, public: str | None, internal: int) -> None:
        if system or public or internal:
            raise fail("a DOCTYPE with declarations is refused, because MJCF needs none")

    def entity(name: str, *_: object) -> None:
        raise fail(f'the declaration of entity "{name}" is refused, because MJCF needs none')

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = doctype
    parser.EntityDeclHandler = entity
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        reason = expat.errors.messages.get(error.code, str(error)).removeprefix("not well-formed ")
        if not data.strip():
            reason = "the file is empty"
        raise MJCFError(file, max(error.lineno, 1), f"not well-formed XML: {reason}") from None
    except MJCFError:
        raise
    except (ValueError, LookupError) as error:
        raise fail(f"unreadable text: {error}") from None
    return roots[0]
