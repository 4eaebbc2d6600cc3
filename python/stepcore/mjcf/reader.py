"""Read an MJCF file or text into an empty `Scene`; a URDF is translated first.

The reader is strict. An unknown element, attribute, keyword or reference is an error with file,
line and the nearest known name. A feature that would change the motion and is not built yet is an
error, unless the user leaves out its kind (``without``). All errors of a file are reported
together. `Scene.ignored` lists elements that only draw or sense; `Scene.notes`, translations.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from stepcore import checks, files
from stepcore.checks import ElementError, flag, nearest
from stepcore.mjcf import option
from stepcore.mjcf import sections as of_section
from stepcore.mjcf.assets import Assets
from stepcore.mjcf.attach import Attacher, Copies, Model, expand_replicates
from stepcore.mjcf.bodies import (
    align,
    discard_visual,
    fuse,
    leave_out_visual_geoms,
    place_weightless,
    settle_masses,
)
from stepcore.mjcf.defaults import Compiler, Defaults
from stepcore.mjcf.nodes import (
    MJCFError,
    Node,
    Refusals,
    Source,
    expand,
    inside,
    parse,
    read_main,
    read_named,
    sections,
)
from stepcore.mjcf.sections import WorldReader
from stepcore.mjcf.validation import REFERENCES, Exclusions, validate
from stepcore.scene import gc_pause
from stepcore.scene.layout import LISTS, Layout, named
from stepcore.scene.records import check
from stepcore.urdf import translate

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

# The sections read after the tree, each after the sections that it refers to.
SECTIONS: dict[str, Callable[[WorldReader, Node], None]] = {
    "contact": of_section.contact,
    "tendon": of_section.tendon,
    "equality": of_section.equality,
    "actuator": of_section.actuator,
    "sensor": of_section.sensor,
}
NAMED_ANYWHERE = ("joint", "site", "actuator", "tendon")
# The maximum nesting depth of attached models.
MOST_NESTED = 50


class Models:
    """The models of one load; `prepared` validates one and expands <attach> and <replicate>."""

    def __init__(self, scene: Scene, refusals: Refusals, exclusions: Exclusions) -> None:
        self.scene, self.refusals, self.exclusions = scene, refusals, exclusions
        # `open`: the files of the models being read, the outermost first. `made`: finished models.
        self.open: list[str] = []
        self.made: dict[str, Model] = {}
        self.copies = Copies()

    def prepared(self, root: Node, directory: str | None) -> Model:
        """Return the model of a root whose includes are expanded.

        directory: the folder of the model's main file.
        """
        self.scene.ignored += validate(root, self.refusals, self.exclusions)
        compiler = Compiler(sections(root, "compiler"), directory, root.file)
        model = Model(root, compiler, Defaults(sections(root, "default")))
        attacher = Attacher(model, lambda node: self._load(node, compiler), self.copies)
        attacher.run()
        self.scene.notes += attacher.notes
        expand_replicates(root, compiler, self.copies)
        return model

    def _load(self, node: Node, compiler: Compiler) -> Model:
        """Return the model that an <asset><model> names."""
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


@gc_pause.paused()
def read_file(
    scene: Scene,
    path: str | os.PathLike[str],
    without: Iterable[str] = (),
    fuse: bool | None = None,
) -> None:
    """Fill an empty scene from an MJCF file; see `stepcore.load`."""
    shown = os.fsdecode(path)
    main = Path(shown)
    data = read_main(shown)
    root = parse(data, shown)
    scene.notes += expand(root, main.parent, main)
    _fill(scene, root, Source(data, os.path.abspath(main.parent), fuse=fuse), without)


@gc_pause.paused()
def read_text(
    scene: Scene,
    text: str | bytes,
    *,
    base: str | os.PathLike[str] | None = None,
    name: str = "<string>",
    without: Iterable[str] = (),
    fuse: bool | None = None,
) -> None:
    """Fill an empty scene from an MJCF text; see `stepcore.loads`."""
    if not isinstance(text, (str, bytes)):
        raise MJCFError(checks.word("name", name), 1, "an MJCF text must be a str or bytes")
    if base is not None:
        base = files.path("base", base)
    root = parse(text, checks.word("name", name))
    scene.notes += expand(root, None if base is None else Path(base), None)
    data = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
    directory = None if base is None else os.path.abspath(base)
    _fill(scene, root, Source(data, directory, fuse=fuse), without)


def _fill(scene: Scene, root: Node, source: Source, without: Iterable[str]) -> None:
    """Fill the scene from a model whose includes are expanded."""
    if source.fuse is not None:
        flag("load", "fuse", source.fuse)
    if root.tag == "robot":
        urdf = translate.to_mjcf(root, source.directory)
        root = urdf.tree
        scene.ignored += urdf.ignored
        scene.notes += urdf.notes()
        # A URDF text cannot be kept when the scene is saved as MJCF.
        source = replace(source, data=b"", urdf=source.data)
    scene.name = root.attrs.get("model", "")
    refusals, exclusions = Refusals(), Exclusions(without)
    try:
        model = Models(scene, refusals, exclusions).prepared(root, source.directory)
        world = read_sections(scene, model, refusals)
    except ValueError as error:
        refusals.add(error if isinstance(error, MJCFError) else root.error(str(error)))
        world = None
    refusals.raise_all()
    assert world is not None
    scene._source = replace(source.of(root), without=tuple(exclusions.nodes))
    try:
        finish(world, source.fuse)
    except ElementError as error:
        # The check of the whole scene names the element: add its file and line.
        node = world.nodes.get(id(error.owner), root)
        raise node.error(str(named(scene, error))) from None
    except MJCFError:
        raise
    except ValueError as error:
        raise root.error(str(error)) from None
    scene.ignored.sort(key=_place)
    scene.notes += exclusions.notes()
    scene.without = exclusions.counts()


def _place(line: str) -> tuple[str, int]:
    file, number, _ = line.rsplit(" <", 1)[0].rsplit(":", 2)
    return file, int(number)


def read_sections(
    scene: Scene, model: Model, refusals: Refusals, kind: type[Assets] = Assets
) -> WorldReader:
    """Read all sections without opening asset files; collect errors in `refusals`."""
    root, compiler = model.root, model.compiler
    assets = kind(sections(root, "asset"), compiler, model.defaults)
    world = WorldReader(scene, model, assets, refusals)
    scene.mass_rules, scene.lengthrange = compiler.mass_rules(), compiler.lengthrange()
    for node in sections(root, "option"):
        refusals.at(node, lambda node: option.read(scene, node))
    option.settle(scene, sections(root, "option"))
    for node in sections(root, "worldbody"):
        world.read(node)
    for section, read in SECTIONS.items():
        for node in inside(root, section):
            world.at(node, partial(read, world))
    return world


def finish(world: WorldReader, chosen: bool | None) -> None:
    """Complete the scene, after all elements of the file are in it; each step says why it is there.

    chosen: whether to fuse bodies that cannot move relative to their parent; None: as in the file.
    """
    scene, main = world.scene, world.main.values
    if chosen is not None:
        main["fusestatic"] = chosen
    # A keyframe has numbers for all joints and actuators of the file, in the order of its tree.
    of_section.keyframes(world)
    # Sensors and materials may name bodies and geoms that later passes remove.
    _check_references(world)
    # A file that only the removed geoms use is then not opened.
    leave_out_visual_geoms(world)
    # Every pass below computes masses, which need the meshes.
    world.assets.read_used(scene)
    # A massless body needs the pose of its inertia before a rule (boundmass) gives it mass.
    place_weightless(world)
    # The passes below use one set of mass rules.
    settle_masses(world)
    # A body keeps the mass of a removed geom, and passes it on when the body is fused.
    if main.get("discardvisual"):
        discard_visual(world)
    # The mass of a fused body is the sum of the masses computed above.
    if main.get("fusestatic"):
        fuse(world)
    # A free body is aligned with its inertia after fusing.
    align(world)
    # Free joints that a keyframe of an attached model omits take the final poses of bodies.
    of_section.follow_bodies(world)
    # This pass removes names by which the passes above find elements.
    for node in option.own_texts(inside(world.root, "custom")):
        world.refusals.at(node, partial(option.read_own_text, scene))
    world.refusals.raise_all()
    # The check comes last, because nothing may change after it.
    check(Layout(scene))


def _check_references(world: WorldReader) -> None:
    """Check that the references of sensors, cameras, lights and materials exist."""
    scene = world.scene
    known = {
        **world.names,
        **{kind: {e.name for e in getattr(scene, LISTS[kind])} for kind in NAMED_ANYWHERE},
        "mesh": set(world.assets.nodes["mesh"]),
        "material": set(world.assets.clear),
    }
    sensed = [
        (node, attribute, name, REFERENCES[attribute])
        for node in inside(world.root, "sensor")
        for attribute, name in node.attrs.items()
        if REFERENCES.get(attribute) in known
    ]
    named = [(node, kind, name, kind) for node, kind, name in world.references]
    for node, attribute, name, kind in named + sensed:
        if name not in known[kind] or not name:
            near = nearest(name, sorted(known[kind]))
            raise node.error(f'<{node.tag}> {attribute}="{name}": no such {attribute}{near}')
