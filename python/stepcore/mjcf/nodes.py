"""Parse MJCF into a tree of `Node`, with its includes, and collect the errors of a file.

Entity declarations are refused. A *kind* is what can be left out of a file: a section ("tendon"),
an element ("actuator/muscle"), an attribute ("geom/surfacevel"), or a key of `GROUPS`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast
from xml.parsers import expat

from stepcore import files
from stepcore.checks import brief, cut
from stepcore.scene.elements import Body
from stepcore.scene.layout import Layout

# An "&" that does not begin a reference.
_AMPERSAND = re.compile(rb"&(?!(?:\w+|#\d+|#x[0-9a-fA-F]+);)", re.ASCII)
_TWICE = re.compile(rb"(</mujoco(?:include)?\s*>)(?:\s*</mujoco(?:include)?\s*>)+\s*\Z")
_BLANKS = re.compile(rb"(?:\xef\xbb\xbf)?(\s+)(<\?xml[^>]*>)")
# A start tag with attributes that may lack blanks between them.
_TAG = re.compile(rb"""(<[^\s<>!?/"'=]+)((?:\s*[^\s<>"'=/]+\s*=\s*(?:"[^"<]*"|'[^'<]*'))*)""")
_ATTRIBUTE = re.compile(rb"""(\s*)([^\s<>"'=/]+\s*=\s*(?:"[^"<]*"|'[^'<]*'))""")
# The name of stepcore's <text>.
OWN_TEXT = "stepcore"
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
        arguments = (self.file, self.line, self.text, self.kind)
        return _again, (type(self), arguments, self.errors[1:], str(self))

    def with_others(self, errors: tuple[MJCFError, ...], message: str) -> MJCFError:
        """Return this error with the other errors of the file and a message that lists all."""
        self.errors = (self, *errors)
        self.args = (message,)
        return self


def _again(
    kind: type[MJCFError], arguments: tuple[Any, ...], further: tuple[MJCFError, ...], message: str
) -> MJCFError:
    return kind(*arguments).with_others(further, message)


@dataclass(frozen=True)
class Source:
    """The source text of a scene.

    data: the MJCF text; empty for a URDF.
    directory: the folder of the main file, in which includes are found.
    urdf: the text of a URDF. unfilled: its joints whose limit has 0 for effort and velocity, as
        exporters leave it.
    fuse, free: the arguments of `stepcore.load`.
    files: the files that were read, the main file first.
    unread: files that the text names only for drawing; the reader does not open them.
    read_bytes: the total size of the mesh and height field files that were read [bytes].
    asset_bytes: the total size of all mesh and height field files that exist [bytes].
    without: the kinds that are left out.
    """

    data: bytes
    directory: str | None
    urdf: bytes = b""
    unfilled: tuple[str, ...] = ()
    fuse: bool | None = None
    free: bool = False
    files: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()
    read_bytes: int = 0
    asset_bytes: int = 0
    without: tuple[str, ...] = ()

    def of(self, root: Node, files: tuple[str, ...]) -> Source:
        """Return this source with its files, and the file names in the text (below `root`)."""
        named = [v for n in below(root) for name, v in n.attrs.items() if name.startswith("file")]
        return replace(self, files=files, unread=tuple(dict.fromkeys(named)))


class Node:
    """An XML element.

    values: the attributes as numbers and words; `validate` sets them.
    path: section and tag, such as "sensor/touch"; `validate` sets it.
    """

    __slots__ = ("attrs", "children", "file", "line", "path", "tag", "values")

    def __init__(self, tag: str, attrs: dict[str, str], file: str, line: int) -> None:
        self.tag = tag
        self.attrs = attrs
        self.file = file
        self.line = line
        self.children: list[Node] = []
        self.values: dict[str, Any] = {}
        self.path = tag

    def error(self, text: str) -> MJCFError:
        return MJCFError(self.file, self.line, text)

    def missing(self, error: FileNotFoundError) -> FileNotFoundError:
        """Return the error about a missing file that this element names, with file and line."""
        return FileNotFoundError(f"{brief(self.file)}:{self.line}: {error}")

    def unbuilt(self, feature: str, attribute: str = "") -> MJCFError:
        """Return the error for a feature that would change the motion and is not built yet.

        attribute: the attribute that selects the feature, if the element is readable without it.
        """
        kind = f"{self.tag}/{attribute}" if attribute else self.path
        does = effect(kind)
        return MJCFError(
            self.file, self.line, f"{feature} is not built yet{does and f': {does}'}", kind
        )

    def asset_name(self) -> str:
        file = self.attrs.get("file", "").replace("\\", "/").rpartition("/")[2]
        return self.attrs.get("name", file.rpartition(".")[0] or file)

    def ignored_line(self, why: str) -> str:
        """Return the line about this element for `Scene.ignored`."""
        name = self.attrs.get("name", "")
        label = f'<{self.tag}> "{name}"' if name else f"<{self.tag}>"
        return f"{self.file}:{self.line}: {label} ({why})"


def is_own_text(node: Node) -> bool:
    return node.tag == "text" and node.attrs.get("name") == OWN_TEXT


def below(node: Node) -> Iterator[Node]:
    pending = [node]
    while pending:
        node = pending.pop()
        yield node
        pending += node.children


def sections(root: Node, tag: str) -> list[Node]:
    return [node for node in root.children if node.tag == tag]


def section_nodes(root: Node, tag: str) -> list[Node]:
    return [node for section in sections(root, tag) for node in section.children]


def options(root: Node) -> dict[str, Any]:
    """Return the values of all option sections; a later section overrides an earlier one."""
    return {k: value for node in sections(root, "option") for k, value in node.values.items()}


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

    Repaired are bare "&", "--" in comments, blanks before the document, attributes without blanks
    between them, and an end of the document that is there twice. Line numbers do not change.
    """
    raw = data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data
    raw = _plain_comments(raw)
    raw = _TWICE.sub(rb"\1", _AMPERSAND.sub(b"&amp;", raw))
    if blanks := _BLANKS.match(raw):
        raw = blanks[2] + blanks[1] + raw[blanks.end() :]
    spaced = partial(_ATTRIBUTE.sub, lambda match: (match[1] or b" ") + match[2])
    raw = _TAG.sub(lambda tag: cast(bytes, tag[1]) + spaced(tag[2]), raw)
    return raw.decode("utf-8", "surrogatepass") if isinstance(data, str) else raw


def _plain_comments(raw: bytes) -> bytes:
    """Return the text without "--" inside comments, which XML does not allow."""
    parts, at = list[bytes](), 0
    while (start := raw.find(b"<!--", at)) >= 0 and (end := raw.find(b"-->", start + 4)) >= 0:
        parts += [raw[at : start + 4], raw[start + 4 : end].replace(b"-", b" ")]
        at = end
    return b"".join([*parts, raw[at:]])


T = TypeVar("T")
# The number of errors after which reading stops, because looking up nearest names takes time.
MOST_ERRORS = 100


class Refusals:
    """A collection of the errors of a file; `raise_all` raises them as one error."""

    def __init__(self) -> None:
        self.errors: list[MJCFError] = []
        # Names of elements that could not be read; references to them are not new errors.
        self._gone: set[str] = set()

    def at(self, node: Node, read: Callable[[Node], T]) -> T | None:
        if len(self.errors) >= MOST_ERRORS:
            return None
        try:
            return read(node)
        except MJCFError as error:
            self.add(error, node)
        except ValueError as error:
            self.add(node.error(str(error)), node)
        return None

    def add(self, error: MJCFError, node: Node | None = None) -> None:
        """Record an error. node: the element that is not read because of the error."""
        if node is not None:
            follows = (
                bool(self._gone)
                and not error.kind
                and any(
                    self._is_gone(name)
                    for inner in below(node)
                    for attribute, name in inner.attrs.items()
                    if attribute != "name"
                )
            )
            self._gone.update(n.attrs["name"] for n in below(node) if "name" in n.attrs)
            if follows:
                return
        self.errors += error.errors

    def _is_gone(self, name: str) -> bool:
        """Return whether a name is of an element that was not read, or of a body that it makes."""
        maker, _, number = name.rpartition("_")
        return name in self._gone or (number.isdecimal() and maker in self._gone)

    def raise_all(self) -> None:
        if not self.errors:
            return
        files = list(dict.fromkeys(error.file for error in self.errors))
        self.errors.sort(key=lambda error: (files.index(error.file), error.line))
        first, *further = self.errors
        if not further and not first.kind:
            raise first
        raise first.with_others(tuple(further), _message(self.errors))


def _message(errors: list[MJCFError], most: int = 20, width: int = 600, places: int = 4) -> str:
    """Return a line for each error; errors with the same text and file share a line."""
    groups: dict[tuple[str, str], list[MJCFError]] = {}
    for error in errors:
        groups.setdefault((error.file, error.text), []).append(error)
    lines = []
    for first, *further in groups.values():
        also = ", ".join(str(error.line) for error in further[:places])
        also += f" and {len(further) - places} more" if len(further) > places else ""
        lines.append(cut(f"{first} (also in line {also})" if further else str(first), width))
    if len(lines) > most:
        lines[most:] = [f"… and {len(lines) - most} more"]
    kinds = list(dict.fromkeys(error.kind for error in errors))
    advice = list[str]()
    if can_be_left_out(kinds):
        words = ", ".join(f'"{kind}"' for kind in kinds)
        advice.append(f"without=[{words}] leaves these things out")
    if runs_in_mujoco(kinds):
        advice.append('trade(…, engine="mujoco") runs the whole file')
    if advice:
        lines.append(cut("; ".join(advice), width))
    return "\n".join(lines)


def can_be_left_out(kinds: Iterable[str]) -> bool:
    """Return whether `without` takes all these kinds, "" for an error."""
    return all(
        kind and (not kind.startswith("worldbody/") or kind.partition("/")[2] in OF_TREE)
        for kind in kinds
    )


def runs_in_mujoco(kinds: Iterable[str]) -> bool:
    """Return whether MuJoCo has all features of these kinds, "" for an error."""
    return all(kind and not kind.endswith("composite") for kind in kinds)


# Kinds that appear in several sections.
GROUPS = {
    "flex": ("flexcomp", "deformable/flex", "equality/flex", "equality/flexstrain"),
    "plugin": ("plugin",),
}
# Sections that can be left out as a whole.
SECTIONS = ("contact", "tendon", "equality", "actuator", "sensor", "keyframe", "deformable")
# The only elements of the tree that can be left out; the rest of the file needs the others.
OF_TREE = ("flexcomp", "composite", "attach", "replicate", "plugin", "camera", "light")
# The most specific key takes precedence.
_EFFECTS = {
    "flex": "its points move, collide, and pull on what they are pinned to",
    "plugin": "it computes forces, shapes or sensors outside of the file",
    "composite": "MuJoCo 4 has it no more; a replicate or flexcomp takes its place",
    "attach": "it adds bodies of another model",
    "contact/exclude": "it keeps two bodies from colliding",
    "contact/pair": "it decides how two geoms collide",
    "contact": "it decides which geoms collide, and how",
    "tendon": "its springs, limits and actuators pull along a path",
    "equality": "it ties bodies, joints or tendons together",
    "actuator": "it puts a force on bodies that follows a control",
    "sensor": "it measures; nothing moves otherwise without it",
    "keyframe": "it is a state to start from",
    "deformable": "its points move with bodies",
    "geom/surfacevel": "it drags along what touches the geom",
    "geom/adhesion": "it pulls touching geoms together",
    "geom/type": "the shape collides and has mass",
    "option/density": "the fluid slows bodies down",
    "option/viscosity": "the fluid slows bodies down",
    "option/wind": "the fluid moves, and bodies in it",
    "option/integrator": "each step has another error",
    "flag/sleep": "what rests would be left out of the step until something touches it",
    "flag/diagexact": "limits, contacts and equalities would be softer or harder, by their inertia "
    "at each state instead of that at qpos0",
    "flag/ipc": "contacts would be barriers that nothing goes through",
    "flag/speculative": "contacts would act a step before bodies touch, so that none goes through "
    'another; law="rigid" or a smaller timestep does that here',
    "body/gravcomp": "a force holds the body up against gravity",
    "body/mocap": "the body stands where its user puts it",
    "joint/springdamper": "a spring and a damper of given times act on the joint",
    "joint/springyield": "the spring of the joint yields",
    **dict.fromkeys(
        ("fixed/springyield", "spatial/springyield"), "the spring of the tendon yields"
    ),
    "joint/actuatorfrcrange": "it clamps the sum of what actuators put on the joint",
    "frame/scale": "it changes sizes, masses and forces within the frame",
    "frame/massscale": "it changes masses within the frame",
}


def effect(kind: str) -> str:
    """Return the effect of a kind on the motion; "" if there is no text on it."""
    tag = kind.rpartition("/")[2]
    group = next((name for name, tags in GROUPS.items() if kind in tags or tag in tags), "")
    for name in (kind, group, tag, kind.partition("/")[0]):
        if name in _EFFECTS:
            return _EFFECTS[name]
    return ""


def read_main(shown: str) -> bytes:
    try:
        return files.contents(shown, "an MJCF or URDF file")
    except ValueError as error:
        raise MJCFError(shown, 1, str(error)) from None


def read_named(node: Node, shown: str) -> Node:
    """Parse the XML file that an element names; read errors name the line of the element."""
    try:
        data = files.contents(shown, "an MJCF or URDF file")
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
    seen = {os.path.realpath(main)} if main is not None else set()
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
        if base is not None
        and not Path(os.path.realpath(Path(file))).is_relative_to(os.path.realpath(base))
    ]


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
    if os.path.realpath(path) in seen:
        above: str | None = node.file
        while above is not None and os.path.realpath(Path(above)) != os.path.realpath(path):
            above = included_by.get(above)
        why = "was already included" if above is None else "includes itself"
        raise node.error(f'<include file="{name}">: the file {why}')
    seen.add(os.path.realpath(path))
    shown = str(path)
    included_by[shown] = node.file
    root = read_named(node, shown)
    if not root.children:
        raise node.error(f'<include file="{name}">: the file has no elements')
    return root.children


def with_file_lines(error: ValueError, layout: Layout) -> ValueError:
    """Add file and line to the elements that an error names, where they come from a file.

    The engine knows an element by its kind and index, but a user needs its line in the file. The
    error begins with the place of the first element. An element without a name is described by its
    body.
    """
    text, first, end = str(error), "", 0
    parts: list[str] = []
    mentions: list[tuple[int, int, str, int]] = getattr(error, "mentions", [])
    mentioned = [layout.elements(kind)[index] for _, _, kind, index in mentions]
    for at, ((start, stop, _, _), element) in enumerate(zip(mentions, mentioned, strict=True)):
        label, body = text[start:stop], getattr(element, "body", None)
        # The engine may already name the body, right after the element.
        named = getattr(element, "name", "") or mentioned[at + 1 : at + 2] == [body]
        if isinstance(body, Body) and not named:
            label += f" of {layout.body_called(body)}"
        place = str(element.place)
        first = first or place
        if place and place != first:
            label += f" ({place})"
        parts += [text[end:start], label]
        end = stop
    text = "".join([*parts, text[end:]])
    if not first:
        return ValueError(text)
    file, _, line = first.rpartition(":")
    return MJCFError(file, int(line), text)
