"""Parse an MJCF text into a tree of `Node`; entity declarations are refused."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, cast
from xml.parsers import expat

from stepcore.checks import brief
from stepcore.mjcf.refusal_texts import effect

# An "&" that does not begin a reference.
_AMPERSAND = re.compile(rb"&(?!(?:\w+|#\d+|#x[0-9a-fA-F]+);)", re.ASCII)
_BLANKS = re.compile(rb"(?:\xef\xbb\xbf)?(\s+)(<\?xml[^>]*>)")
# A start tag with attributes that may lack blanks between them.
_TAG = re.compile(rb"""(<[^\s<>!?/"'=]+)((?:\s*[^\s<>"'=/]+\s*=\s*(?:"[^"<]*"|'[^'<]*'))*)""")
_ATTRIBUTE = re.compile(rb"""(\s*)([^\s<>"'=/]+\s*=\s*(?:"[^"<]*"|'[^'<]*'))""")
# The maximum nesting depth of elements, as in MuJoCo's parser.
DEPTH = 500


class MJCFError(ValueError):
    """The error for an MJCF file or text that cannot be read.

    The message begins with ``file:line: ``.

    file: the name of the file as the caller gave it.
    line: the line number, counted from 1.
    text: the message without file and line.
    kind: for a feature that is not built yet, the kind that ``stepcore.load(without=[kind])``
        leaves out; "" for other errors.
    errors: all errors of the file, this one first. Reading ends after 100 errors.
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
        """Return this error with the other errors of the file and a message that lists all."""
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
    """Unpickle an error."""
    message, others = more
    return kind(file, line, text, what).with_others(others, message)


@dataclass(frozen=True)
class Source:
    """The source text of a scene.

    data: the MJCF text; empty for a URDF.
    directory: the folder of the main file, in which includes are found.
    urdf: the text of a URDF.
    fuse: the argument `fuse` of `stepcore.load`.
    files: the files that were read, the main file first.
    unread: files that the text names only for drawing; the reader does not open them.
    read_bytes: the total size of the mesh and height field files that were read [bytes].
    asset_bytes: the total size of all mesh and height field files that exist [bytes].
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
        """Return this source with the file names of a model whose includes are expanded."""
        files, unread = [root.file], []
        pending = [root]
        while pending:
            node = pending.pop()
            files.append(node.file)
            unread += [value for name, value in node.attrs.items() if name.startswith("file")]
            pending += reversed(node.children)
        return replace(self, files=tuple(dict.fromkeys(files)), unread=tuple(dict.fromkeys(unread)))


class Node:
    """An XML element.

    values: the attributes as numbers and words; `validate` sets them.
    path: section and tag, such as "sensor/touch"; `validate` sets it.
    compiler: for an element of an attached model, the compiler settings of that model.
    parts: for a keyframe of an attached model, each vector as (element, numbers of the element).
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
        """Return the error about this element, with its file and line."""
        return MJCFError(self.file, self.line, text)

    def missing(self, error: FileNotFoundError) -> FileNotFoundError:
        """Return the error about a missing file that this element names, with file and line."""
        return FileNotFoundError(f"{brief(self.file)}:{self.line}: {error}")

    def unbuilt(self, what: str, attribute: str = "") -> MJCFError:
        """Return the error for a feature that would change the motion and is not built yet.

        attribute: the attribute that selects the feature, if the element is readable without it.
        """
        kind = f"{self.tag}/{attribute}" if attribute else self.path
        does = effect(kind)
        return MJCFError(
            self.file, self.line, f"{what} is not built yet{does and f': {does}'}", kind
        )

    def asset_name(self) -> str:
        """Return the asset's name, or by default its file name without folder and extension."""
        file = self.attrs.get("file", "").replace("\\", "/").rpartition("/")[2]
        return self.attrs.get("name", file.rpartition(".")[0] or file)

    def listed(self, why: str) -> str:
        """Return the line about this element for `Scene.ignored`."""
        name = self.attrs.get("name", "")
        label = f'<{self.tag}> "{name}"' if name else f"<{self.tag}>"
        return f"{self.file}:{self.line}: {label} ({why})"


def below(node: Node) -> Iterator[Node]:
    """Yield a node and all its descendants."""
    pending = [node]
    while pending:
        node = pending.pop()
        yield node
        pending += node.children


def sections(root: Node, tag: str) -> list[Node]:
    """Return the sections with this tag."""
    return [node for node in root.children if node.tag == tag]


def inside(root: Node, tag: str) -> list[Node]:
    """Return the elements of all sections with this tag."""
    return [node for section in sections(root, tag) for node in section.children]


def parse(data: str | bytes, file: str) -> Node:
    """Return the root of an XML document; raise MJCFError if the text is not well-formed.

    Texts that only MuJoCo's parser accepts are repaired first (`repaired`).
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


def repaired(data: str | bytes) -> str | bytes:
    """Return XML that MuJoCo's parser accepts as XML; the same text if there is nothing to repair.

    Repaired are bare "&", "--" in comments, blanks before the document, and attributes without
    blanks between them. Line numbers do not change.
    """
    raw = data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data
    raw = _plain_comments(raw)
    raw = _AMPERSAND.sub(b"&amp;", raw)
    if blanks := _BLANKS.match(raw):
        raw = blanks[2] + blanks[1] + raw[blanks.end() :]
    raw = _TAG.sub(_with_blanks, raw)
    if isinstance(data, str):
        return raw.decode("utf-8", "surrogatepass")
    return raw


def _plain_comments(raw: bytes) -> bytes:
    """Return the text without "--" inside comments, which XML does not allow."""
    parts: list[bytes] = []
    at = 0
    while (start := raw.find(b"<!--", at)) >= 0 and (end := raw.find(b"-->", start + 4)) >= 0:
        parts += [raw[at : start + 4], raw[start + 4 : end].replace(b"-", b" ")]
        at = end
    return b"".join([*parts, raw[at:]])


def _with_blanks(tag: re.Match[bytes]) -> bytes:
    attributes = _ATTRIBUTE.sub(lambda found: (found[1] or b" ") + found[2], cast(bytes, tag[2]))
    return cast(bytes, tag[1]) + attributes
