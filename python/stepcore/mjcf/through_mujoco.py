"""Let MuJoCo expand what this reader does not, and write what MuJoCo holds as MJCF.

`<replicate>`, `<attach>`, builtin meshes, aligned free bodies and `discardvisual` describe another
file. MuJoCo (the extra `mujoco`) writes it, as plain MJCF with exact numbers. The file is checked
first, with every file that it attaches, so that errors name file and line; MuJoCo's own errors get
the line of the element that they are about.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import sys
import tempfile
import threading
import warnings
from bisect import bisect
from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from stepcore.checks import cut, nearest
from stepcore.mjcf.defaults import Compiler
from stepcore.mjcf.nodes import (
    SECTIONS,
    MJCFError,
    Node,
    below,
    expand,
    parse,
    read_named,
    section_nodes,
    sections,
)
from stepcore.mjcf.validation import bad
from stepcore.needs import installing
from stepcore.scene.element import field_rows
from stepcore.scene.elements import MassRules

# The maximum number of elements that one file makes, and the maximum depth of attached models.
MOST_ELEMENTS = 1_000_000
MOST_NESTED = 50
# By the form of a builtin mesh: how many of its first parameters are counts of vertices, and their
# maximum. MuJoCo 4.0.0 compiles a mesh of these sizes in up to 0.6 s, which Ctrl-C cannot end; the
# time for a cone grows with the square of its count.
MOST_VERTICES = {
    "cone": (1, 2000),
    "supersphere": (1, 128),
    "supertorus": (1, 128),
    **dict.fromkeys(("wedge", "plate", "square", "disc"), (2, 128)),
    **dict.fromkeys(("grid", "box", "cylinder", "ellipsoid"), (3, 40)),
}
# Name prefixes of the MjModel arrays that affect the simulation.
PHYSICS = (
    *("body_", "jnt_", "dof_", "geom_", "site_", "tendon_", "actuator_", "eq_", "sensor_", "pair_"),
    *("exclude_", "key_", "mesh_vert", "hfield_data", "qpos0", "qpos_spring"),
)
# Name suffixes of arrays used only for drawing or for MuJoCo's broad phase.
ASIDE = ("_rgba", "_matid", "_bvhadr", "_bvhnum", "_user")
# Attributes of <compiler> that name folders.
_FOLDERS = ("meshdir", "texturedir", "assetdir", "strippath")


def first_to_expand(root: Node) -> Node | None:
    """Return the first element of a validated file that MuJoCo has to expand."""
    return next((node for node in below(root) if _needs_mujoco(node)), None)


def _needs_mujoco(node: Node) -> bool:
    match node.tag:
        case "replicate" | "attach":
            return True
        case "mesh":
            return "builtin" in node.values
        case "freejoint":
            return node.values.get("align") is True
        case "compiler":
            return any(node.values.get(name) is True for name in ("alignfree", "discardvisual"))
    return False


# A start or end tag, and its element.
Line = tuple[str, Node]


@dataclass(frozen=True)
class Attached:
    """A model to attach.

    size: the number of elements that it makes.
    file: a file with its text.
    named: the names of the elements outside its tree.
    """

    name: str
    size: int
    file: str
    named: tuple[str, ...]


class Expansion:
    """A model with the models that it attaches, expanded by MuJoCo.

    check: validates the root of an attached model.
    files: the files of all models.
    notes: a line for each warning of MuJoCo, and for each file outside the main file's folder.
    """

    def __init__(self, root: Node, compiler: Compiler, check: Callable[[Node], None]) -> None:
        self.root, self.compiler, self.check = root, compiler, check
        self.files = [node.file for node in below(root)]
        self._classes = _classes(root)
        self.notes: list[str] = []
        # The attached models by path.
        self._made: dict[str, Attached] = {}
        self._folder = ""

    def expanded(self, cause: Node) -> Node:
        """Return the root of the expanded model. cause: the first element to expand."""
        try:
            import mujoco  # type: ignore[import-untyped,unused-ignore]
        except ImportError:
            how = f"MuJoCo, which is not installed: {installing('mujoco')}"
            raise cause.error(f"<{cause.tag}> is expanded by {how}") from None
        heard = warnings.catch_warnings(record=True, action="always")
        with tempfile.TemporaryDirectory() as self._folder, quiet(), heard as warned:
            _check_meshes(self.root)
            models = self._models(self.root, self.compiler, [self.root.file])
            _size(self.root, models)
            lines = _lines(self.root, self.compiler)
            try:
                text = _written(mujoco.MjSpec.from_string(_text(lines)))
            except Exception as error:  # of a type of mujoco's own
                raise self._located(error, lines, cause) from None
        tree = parse(text, self.root.file)
        messages = dict.fromkeys(" ".join(str(warning.message).split()) for warning in warned)
        # An empty prefix can only prevent saving, which is not done.
        notable = (line for line in messages if "empty prefix" not in line)
        self.notes += [f"{cause.file}:{cause.line}: MuJoCo: {line}" for line in notable]
        self.notes += _left_out(self.root, models, tree)
        return _placed(tree, self.root, cause)

    def _located(self, error: Exception, lines: list[Line], cause: Node) -> MJCFError:
        """Return MuJoCo's error, at the line that it names unless that may be another model's."""
        at = re.search(r"\bline (\d+)", str(error))
        number = int(at[1]) if at and not self._made else 0
        node = lines[number - 1][1] if 0 < number <= len(lines) else cause
        return node.error(f"MuJoCo: {re.sub(r',? *line [0-9]+', '', str(error))}")

    def _models(self, root: Node, compiler: Compiler, chain: list[str]) -> dict[str, Attached]:
        """Return the models that a model can attach, by name, and rename their texts in this model.

        chain: the files of the models around this one, and its file.
        """
        models: dict[str, Attached] = {}
        attached = [node for node in below(root) if node.tag == "attach"]
        bare = {node.attrs.get("model", "") for node in attached if not node.attrs.get("prefix")}
        for node in section_nodes(root, "asset"):
            if node.tag == "model":
                model = self._model(node, compiler, chain, bare)
                name = node.values.get("name", model.name)
                if name in models:
                    raise node.error(f'model "{name}": the name is used twice')
                models[name] = model
                node.attrs["name"], node.attrs["file"] = name, model.file
        return models

    def _model(self, node: Node, compiler: Compiler, chain: list[str], bare: Set[str]) -> Attached:
        """Check the model that an <asset><model> names, and write its text.

        bare: names of models that are attached without a prefix.
        """
        name = node.values["file"]
        if not name or "\0" in name:
            raise node.error('<model> needs a file="…"')
        if compiler.directory is None and not os.path.isabs(name):
            raise node.error(f'<model file="{name}"> in a text needs loads(text, base=folder)')
        path = Path(compiler.path(node, name))
        here = os.path.realpath(path)
        if here in map(os.path.realpath, (*chain, node.file)):
            raise node.error(f'<model file="{name}">: the file attaches itself')
        if len(chain) > MOST_NESTED:
            raise node.error(f"attached models are nested deeper than {MOST_NESTED}")
        if here not in self._made:
            root = read_named(node, str(path))
            self.notes += expand(root, path.parent, path)
            self.check(root)
            _check_meshes(root)
            self.files += [inner.file for inner in below(root)]
            if node.values.get("name", root.attrs.get("model", "")) in bare:
                _name_classes(root, f"{len(self.files)}.", self._classes)
            self._classes |= _classes(root)
            rules = Compiler(sections(root, "compiler"), os.path.abspath(path.parent), root.file)
            size = _size(root, self._models(root, rules, [*chain, str(path)]))
            file = Path(self._folder, f"{len(self._made)}.xml")
            file.write_text(_text(_lines(root, rules)), encoding="utf-8")
            rest = [node for tag in SECTIONS for node in section_nodes(root, tag)]
            named = tuple(node.attrs["name"] for node in rest if node.attrs.get("name"))
            self._made[here] = Attached(root.attrs.get("model", ""), size, str(file), named)
        return self._made[here]


def _classes(root: Node) -> set[str]:
    inner = [node for top in section_nodes(root, "default") for node in below(top)]
    return {node.attrs["class"] for node in inner if "class" in node.attrs}


def _name_classes(root: Node, prefix: str, classes: Set[str]) -> None:
    """Give the defaults of a model other names than known ones.

    MuJoCo writes those of models that are attached without a prefix under one name, and cannot read
    that.
    """
    names = _classes(root) & classes
    for node in below(root):
        for name in ("class", "childclass"):
            if node.attrs.get(name) in names:
                node.attrs[name] = prefix + node.attrs[name]


_quiets, _handlers = threading.Lock(), list[Any]()


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep MuJoCo from writing warnings to stderr and into a file, and from timing its stages."""
    import mujoco as mj  # type: ignore[import-untyped,unused-ignore]

    with _quiets:
        _handlers.append((mj.get_mju_user_warning(), mj.get_mjcb_time()))
        if len(_handlers) == 1:
            mj.set_mju_user_warning(lambda text: None)
            mj.set_mjcb_time(None)
    try:
        yield
    finally:
        with _quiets:
            # The last of several threads puts back what the first one found.
            warning, timer = _handlers.pop()
            if not _handlers:
                mj.set_mju_user_warning(warning)
                mj.set_mjcb_time(timer)


def _lines(root: Node, compiler: Compiler) -> list[Line]:
    """Return the text of a model with full paths of files."""
    lines: list[Line] = []
    pending: list[tuple[Node, bool]] = [(root, False)]
    while pending:
        node, ends = pending.pop()
        if ends:
            lines.append((f"</{node.tag}>", node))
            continue
        attrs = _attributes(node, compiler)
        words = [node.tag, *(f"{name}={quoteattr(value)}" for name, value in attrs.items())]
        lines.append((f"<{' '.join(words)}>", node))
        pending.append((node, True))
        pending += [(child, False) for child in reversed(node.children)]
    return lines


def _text(lines: list[Line]) -> str:
    return "\n".join(text for text, _ in lines)


def _attributes(node: Node, compiler: Compiler) -> dict[str, str]:
    """Return the attributes of an element, with full paths of files."""
    if node.tag == "compiler":
        # Bodies are fused by this reader, except before masses are scaled to a total.
        fused = ("fusestatic",) if compiler.values.get("settotalmass", 0.0) <= 0 else ()
        return {n: text for n, text in node.attrs.items() if n not in (*_FOLDERS, *fused)}
    attrs = dict(node.attrs)
    folder = "texturedir" if node.tag == "texture" else "meshdir"
    for name, text in node.attrs.items():
        if name.startswith("file") and text and node.tag != "model":
            attrs[name] = compiler.asset(node, text, folder) or text
    return attrs


def _check_meshes(root: Node) -> None:
    """Raise MJCFError if a builtin mesh has too many vertices."""
    for node in section_nodes(root, "asset"):
        if node.tag == "mesh" and node.values.get("builtin") in MOST_VERTICES:
            counts, most = MOST_VERTICES[node.values["builtin"]]
            params = node.values.get("params", ())
            if any(number > most for number in params[:counts]):
                raise bad(node, "params", params, f"at most {most} where it counts vertices")


def _size(root: Node, models: Mapping[str, Attached]) -> int:
    """Return the number of elements that a model makes; raise MJCFError if there are too many.

    An element outside the tree counts once for each copy of a body, which it may refer to.
    """
    size, most = 0, 1
    pending = [(node, 1) for node in section_nodes(root, "worldbody")]
    while pending:
        node, copies = pending.pop()
        size += copies
        if node.tag == "replicate":
            count = node.values["count"]
            if count < 0:
                raise bad(node, "count", count, ">= 0")
            copies *= count
            most = max(most, copies)
        elif node.tag == "attach":
            size += copies * _attached(node, models).size
        if max(size, most) > MOST_ELEMENTS:
            raise node.error(f"<{node.tag}>: a model has at most {MOST_ELEMENTS} copied elements")
        pending += [(child, copies) for child in node.children]
    rest = sum(1 for part in root.children if part.tag != "worldbody" for _ in below(part))
    if size + most * rest > MOST_ELEMENTS and most > 1:
        raise root.error(f"a model has at most {MOST_ELEMENTS} copied elements")
    return size + most * rest


def _attached(node: Node, models: Mapping[str, Attached]) -> Attached:
    name = node.values.get("model")
    if name is None:
        raise node.unbuilt("an <attach> of a part of the same model")
    if name not in models:
        raise node.error(f'<attach model="{name}">: no such model{nearest(name, sorted(models))}')
    return models[name]


def _left_out(root: Node, models: Mapping[str, Attached], expanded: Node) -> list[str]:
    """Return a note on each <attach> without some elements that refer to parts left out."""
    names = sorted(node.attrs.get("name", "") for node in below(expanded))
    notes = []
    for node in (node for node in below(root) if node.tag == "attach"):
        gone = []
        for name in models[node.values["model"]].named:
            full = node.values["prefix"] + name
            at = bisect(names, full) - 1
            # A copy by <replicate> has a longer name.
            if not any(place.startswith(full) for place in names[max(at, 0) : at + 2]):
                gone.append(name)
        if gone:
            shortened = cut(", ".join(gone), 200)
            notes.append(f"{node.file}:{node.line}: <attach> leaves out {shortened}")
    return notes


def _placed(expanded: Node, root: Node, cause: Node) -> Node:
    """Give each expanded element the file and line of the element that it came from.

    That is the element of the same name, or else the element around it.
    """
    places = {(node.tag, node.attrs["name"]): node for node in below(root) if "name" in node.attrs}
    pending = [(expanded, cause)]
    while pending:
        node, around = pending.pop()
        place = places.get((node.tag, node.attrs.get("name", "")), around)
        node.file, node.line = place.file, place.line
        pending += [(child, place) for child in node.children]
    return expanded


def xml_of(spec: Any) -> str:
    """Return the MJCF of a spec, without changing the spec."""
    copy = spec.copy()
    # Some versions write what is compiled only.
    copy.compile()
    text: str = copy.to_xml()
    return text


def _written(spec: Any) -> str:
    """Return the MJCF of a spec with exact numbers; raise ValueError if it is another model's."""
    import mujoco  # type: ignore[import-untyped,unused-ignore]

    model = _compiled(spec)
    other = ""
    # Free bodies are aligned now; and where models have other rules for masses, every body's
    # inertia is written in place of the rules.
    for followed in (("alignfree",), ("alignfree", *field_rows(MassRules))):
        spec.compiler.saveinertial |= len(followed) > 1
        with exact_numbers():
            text = re.sub(rf' ({"|".join(followed)})="[^"]*"', "", spec.to_xml())
        other = differing_array(model, _compiled(mujoco.MjSpec.from_string(text)))
        if not other:
            return text
    raise ValueError(f"the expanded model cannot be written without a change of its {other}")


def _compiled(spec: Any) -> Any:
    """Compile a spec without lengths of muscles: MuJoCo's search for these may have no end."""
    spec.compiler.LRopt.mode = 0
    return spec.compile()


def differing_array(model: Any, other: Any) -> str:
    """Return the name of the first array in which the physics of two models differs, or ""."""
    if bytes(model.names) != bytes(other.names):
        return "names"
    for name in dir(model):
        if not name.startswith(PHYSICS) or name.endswith(ASIDE):
            continue
        mine, theirs = getattr(model, name), getattr(other, name)
        if isinstance(mine, np.ndarray) and mine.dtype.kind in "fiu":
            same = mine.shape == theirs.shape
            # Two compilations of the same text may differ by this.
            if not same or not np.allclose(mine, theirs, 1e-6, 1e-9, equal_nan=True):
                return name
    return ""


@contextlib.contextmanager
def exact_numbers() -> Iterator[None]:
    """Make MuJoCo write all digits of numbers, if this version can."""
    read, write = _precision()
    before = read()
    # So many digits represent a double exactly; MuJoCo writes six by default.
    write(17)
    try:
        yield
    finally:
        write(before)


def _precision() -> tuple[Any, Any]:
    """Return MuJoCo's functions that read and set the number of digits written, if it has them."""
    import mujoco  # type: ignore[import-untyped,unused-ignore]

    folder = Path(mujoco.__file__).parent
    pattern = {"win32": "mujoco*.dll", "darwin": "libmujoco*.dylib"}.get(
        sys.platform, "libmujoco.so*"
    )
    for library in sorted(folder.glob(pattern)):
        try:
            loaded = ctypes.CDLL(str(library))
            read = loaded._mjPRIVATE__get_xml_precision
            write = loaded._mjPRIVATE__set_xml_precision
        except (OSError, AttributeError):
            continue
        read.restype, write.argtypes, write.restype = ctypes.c_int, [ctypes.c_int], None
        return read, write
    return (lambda: 0), (lambda _: None)
