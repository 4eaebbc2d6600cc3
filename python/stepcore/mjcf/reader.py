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
from stepcore.mjcf.bodies import (
    fuse,
    leave_out_visual_geoms,
    place_weightless,
)
from stepcore.mjcf.defaults import Compiler, Defaults, Model
from stepcore.mjcf.nodes import (
    MJCFError,
    Node,
    Refusals,
    Source,
    below,
    expand,
    parse,
    read_main,
    section_nodes,
    sections,
)
from stepcore.mjcf.sections import WorldReader
from stepcore.mjcf.through_mujoco import Expansion, first_to_expand
from stepcore.mjcf.validation import REFERENCES, Exclusions, validate
from stepcore.scene import gc_pause
from stepcore.scene.layout import LISTS, Layout, relabelled
from stepcore.scene.records import check_scene
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


def prepared(
    scene: Scene, root: Node, directory: str | None, refusals: Refusals, exclusions: Exclusions
) -> Model:
    """Validate a model whose includes are expanded, and let MuJoCo expand what it has to.

    directory: the folder of the model's main file.
    """
    scene.ignored += validate(root, refusals, exclusions)
    compiler = Compiler(sections(root, "compiler"), directory, root.file)
    files = dict.fromkeys(node.file for node in below(root))
    cause = first_to_expand(root)
    if cause is not None:
        refusals.raise_all()

        def check(attached: Node) -> None:
            scene.ignored.extend(validate(attached, refusals, exclusions))
            refusals.raise_all()

        expansion = Expansion(root, compiler, check)
        ranges, fusestatic = compiler.ranges, compiler.values.get("fusestatic", False)
        root = expansion.expanded(cause)
        scene.notes += expansion.notes
        validate(root, refusals, exclusions)
        compiler = Compiler(sections(root, "compiler"), directory, root.file)
        compiler.ranges, compiler.values["fusestatic"] = ranges, fusestatic
        files = dict.fromkeys(expansion.files)
    return Model(root, compiler, Defaults(sections(root, "default")), tuple(files))


@gc_pause.paused()
def read_file(
    scene: Scene,
    path: str | os.PathLike[str],
    without: Iterable[str] = (),
    fuse: bool | None = None,
    free: bool = False,
) -> None:
    """Fill an empty scene from an MJCF file; see `stepcore.load`."""
    shown = os.fsdecode(path)
    main = Path(shown)
    data = read_main(shown)
    root = parse(data, shown)
    scene.notes += expand(root, main.parent, main)
    _fill(scene, root, Source(data, os.path.abspath(main.parent), fuse=fuse, free=free), without)


@gc_pause.paused()
def read_text(
    scene: Scene,
    text: str | bytes,
    *,
    base: str | os.PathLike[str] | None = None,
    name: str = "<string>",
    without: Iterable[str] = (),
    fuse: bool | None = None,
    free: bool = False,
) -> None:
    """Fill an empty scene from an MJCF text; see `stepcore.loads`."""
    if not isinstance(text, (str, bytes)):
        raise MJCFError(checks.word("name", name), 1, "an MJCF text must be a str or bytes")
    if base is not None:
        base = files.as_path("base", base)
    root = parse(text, checks.word("name", name))
    scene.notes += expand(root, None if base is None else Path(base), None)
    data = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
    directory = None if base is None else os.path.abspath(base)
    _fill(scene, root, Source(data, directory, fuse=fuse, free=free), without)


def _fill(scene: Scene, root: Node, source: Source, without: Iterable[str]) -> None:
    """Fill the scene from a model whose includes are expanded."""
    if source.fuse is not None:
        flag("load", "fuse", source.fuse)
    if flag("load", "free", source.free) and root.tag != "robot":
        raise root.error("free: only a URDF takes it; in MJCF its root body needs a <freejoint/>")
    urdf = None
    if root.tag == "robot":
        urdf = translate.to_mjcf(root, source.directory, source.free)
        root = urdf.tree
        scene.ignored += urdf.ignored
        scene.notes += urdf.notes()
        # A URDF text cannot be kept when the scene is saved as MJCF.
        source = replace(source, data=b"", urdf=source.data, unfilled=tuple(urdf.unfilled))
    scene.name = root.attrs.get("model", "")
    refusals, exclusions = Refusals(), Exclusions(without)
    try:
        model = prepared(scene, root, source.directory, refusals, exclusions)
        world = read_sections(scene, model, refusals)
    except ValueError as error:
        refusals.add(error if isinstance(error, MJCFError) else root.error(str(error)))
        world = None
    refusals.raise_all()
    assert world is not None
    source = source.of(root, model.files)
    scene._source = replace(source, without=tuple(exclusions.nodes))
    try:
        finish(world, source.fuse)
    except ElementError as error:
        # The check of the whole scene names the element: add its file and line.
        node = world.nodes.get(id(error.owner), root)
        raise node.error(str(relabelled(scene, error))) from None
    except FileNotFoundError as error:
        raise (urdf.missing(error) if urdf is not None else error) from None
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
        refusals.at(node, lambda node: option.read_option(scene, node))
    option.resolve_options(scene, sections(root, "option"))
    for node in sections(root, "worldbody"):
        world.read(node)
    for section, read in SECTIONS.items():
        for node in section_nodes(root, section):
            refusals.at(node, partial(read, world))
    return world


def finish(world: WorldReader, chosen: bool | None) -> None:
    """Complete the scene, after all elements of the file are in it.

    chosen: whether to fuse bodies that cannot move relative to their parent; None: as in the file.
    """
    scene = world.scene
    fusestatic = world.compiler.values.get("fusestatic") if chosen is None else chosen
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
    # The mass of a fused body is the sum of the masses computed above.
    if fusestatic:
        fuse(world)
    if scene._source is not None and scene._source.urdf:
        # Floating links are children of the root link, which stands at the world's origin.
        for joint in scene.joints:
            if joint.type == "free":
                joint.body.parent = scene.world
    # This pass removes names by which the passes above find elements.
    for node in option.own_texts(section_nodes(world.root, "custom")):
        world.refusals.at(node, partial(option.read_own_text, scene))
    world.refusals.raise_all()
    # The check comes last, because nothing may change after it.
    check_scene(Layout(scene))


def _check_references(world: WorldReader) -> None:
    """Check that the references of sensors, cameras, lights and materials exist."""
    scene = world.scene
    targets = {
        **world.names,
        **{kind: {e.name for e in getattr(scene, LISTS[kind])} for kind in NAMED_ANYWHERE},
        "mesh": set(world.assets.nodes["mesh"]),
        "material": set(world.assets.clear),
    }
    sensed = [
        (node, attribute, name, REFERENCES[attribute])
        for node in section_nodes(world.root, "sensor")
        for attribute, name in node.attrs.items()
        if REFERENCES.get(attribute) in targets
    ]
    named = [(node, kind, name, kind) for node, kind, name in world.references]
    for node, attribute, name, kind in named + sensed:
        if name not in targets[kind] or not name:
            near = nearest(name, sorted(targets[kind]))
            raise node.error(f'<{node.tag}> {attribute}="{name}": no such {attribute}{near}')
