"""Find and read scenes: by file, model of a package, scene of the lesson, or MuJoCo model."""

from __future__ import annotations

import importlib.util
import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore import checks
from stepcore.checks import brief, flag, nearest
from stepcore.engine.sim import Sim
from stepcore.engine.stiffness import warn_of_stiffness
from stepcore.engine.world import compiled
from stepcore.mjcf.from_mujoco import is_mujoco, read_mujoco
from stepcore.mjcf.nodes import MJCFError
from stepcore.mjcf.reader import read_file, read_text
from stepcore.scene.scene import Scene

if TYPE_CHECKING:
    import mujoco  # type: ignore[import-untyped,unused-ignore]

    from stepcore.engine.model import Model

# Folders of a package with models for its tests only.
TESTS = {"test", "tests", "testing", "test_assets"}
# Packages with models that the documentation mentions.
WITH_MODELS = ("gymnasium", "dm_control")
LESSON = ("spring", "drop", "stack", "grasp")


def load(
    path: str | os.PathLike[str] | mujoco.MjModel | mujoco.MjSpec,
    *,
    without: Iterable[str] = (),
    fuse: bool | None = None,
    free: bool = False,
    ground: bool = False,
) -> Scene:
    """Read a scene from an MJCF or a URDF file, or from an MjModel or an MjSpec of MuJoCo.

    `loads` reads a text.

    A URDF gives the same scene as in MuJoCo: the root link is fixed to the world, efforts clamp the
    actuator forces on joints, mimic joints become joint equalities, visuals are not read, and a
    link on a fixed joint is merged into its parent body.

    path: the path of a file, "package:name" for a model among the files of an installed package
        (such as "gymnasium:ant"), or "lesson:name" for a scene of the lesson. The file's
        ``<option>`` becomes ``scene.settings``. Angles become radians and orientations unit
        quaternions; default classes, includes and frames are resolved.
        An `mujoco.MjSpec` is read from the XML that MuJoCo writes, with all digits of its numbers.
        An `mujoco.MjModel` is read in the same way, with the present values of its arrays. MuJoCo
        keeps the XML only of the model that was loaded last from a file or a text; every other
        MjModel raises a ValueError.
    without: kinds of elements that are left out of the file on purpose, with all references to
        them: an element ("weld", "actuator/muscle"), an attribute ("geom/surfacevel"), a section
        ("contact", "tendon", "equality", "actuator", "sensor", "keyframe"), "flex" or "plugin".
        `Scene.notes` lists the consequences. Every result states that its scene is reduced.
    fuse: True merges bodies without joints into their parents, as MJCF's ``fusestatic`` does. None
        takes the value of the file; for a URDF that gives no value, True. False keeps every link as
        a named body. `Scene.fused` maps the name of each merged body to the body that contains it.
    free: whether the base of a URDF gets a free joint, as a legged robot needs. The base is the
        root link, or the link that is fixed to a root link "world"; the joint has its name.
    ground: whether a URDF gets a floor, a plane at z = 0. A free base is moved up or down until the
        lowest geom touches the floor; under a fixed base the floor is at the lowest geom.

    The meshes of ``package://NAME`` are searched in the folders that contain the URDF, on
    ``ROS_PACKAGE_PATH``, and in ``share`` of the folders of ``AMENT_PREFIX_PATH``.

    Raises FileNotFoundError for a missing file, IsADirectoryError for a folder, ValueError for an
    unknown name or kind, and MJCFError for a file that cannot be read. MJCFError is a ValueError;
    its text begins with ``file:line:`` and has a line for each error or unsupported feature. Warns
    (`StiffnessWarning`) if the scene's time step has a stability margin below 2.

    >>> load("lesson:stack").compile().nv
    2
    """
    if not isinstance(path, (str, bytes, os.PathLike)) and not is_mujoco(path):
        limit = 'the path of an MJCF file, "package:name", or a MjModel or MjSpec of mujoco'
        raise checks.refuse("load", "path", path, limit)
    scene = find_scene(path, without, fuse, free, ground)
    warn_of_stiffness(scene)
    return scene


def loads(
    text: str | bytes,
    *,
    base: str | os.PathLike[str] | None = None,
    name: str = "<string>",
    without: Iterable[str] = (),
    fuse: bool | None = None,
    free: bool = False,
    ground: bool = False,
) -> Scene:
    """Read a scene from a text in MJCF or URDF; `load` reads a file.

    text: the XML.
    base: the folder of included files.
    name: the name of the text in error messages.
    without, fuse, free, ground: see `load`.

    Raises and warns as `load` does.

    >>> scene = loads('<mujoco><option timestep="0.01"/><worldbody/></mujoco>')
    >>> scene.settings.dt
    0.01
    >>> loads("<mujoco><wordbody/></mujoco>")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    stepcore.mjcf.nodes.MJCFError: <string>:1: unknown element <wordbody> in <mujoco>; nearest: ...
    """
    scene = Scene()
    if isinstance(text, str) and text.strip() and "<" not in text:
        raise MJCFError(checks.word("name", name), 1, "is no XML; `load` reads a file by its path")
    read_text(scene, text, base=base, name=name, without=without, fuse=fuse, free=free)
    if flag("loads", "ground", ground):
        add_ground(scene)
    warn_of_stiffness(scene)
    return scene


def find_scene(
    source: Any,
    without: Iterable[str] = (),
    fuse: bool | None = None,
    free: bool = False,
    ground: bool = False,
) -> Scene:
    """Return the scene that `source` names; see `load`, whose warning is left to the caller.

    The package of "package:name" is not imported. If several of its files have this name, give more
    of the path: "package:folder/name". Files in a folder of tests count only if there are no
    others. Raises ValueError for an unknown name, and the errors of `load` for a path.
    """
    scene = Scene()
    if flag("load", "ground", ground):
        scene = find_scene(source, without, fuse, free)
        add_ground(scene)
        return scene
    if is_mujoco(source):
        if flag("load", "free", free):
            raise ValueError("free: only a URDF takes it, not a model of MuJoCo")
        read_mujoco(scene, source, without, fuse)
        return scene
    text = os.fsdecode(source)
    if text.startswith("lesson:") and not os.path.exists(text):
        name = text.removeprefix("lesson:")
        if name not in LESSON:
            raise ValueError(brief(f"lesson:{name}: the lesson's scenes are {', '.join(LESSON)}"))
        from stepcore.lesson import scenes

        if flag("load", "free", free):
            raise ValueError(f"free: only a URDF takes it, not lesson:{name}")
        scene = getattr(scenes, name)()
        scene.name = name
    else:
        file = model_file(text)
        read_file(scene, file, without, fuse, free)
        if file != text:
            scene.name = scene.name or text.partition(":")[2]
    return scene


def model_file(text: str) -> str:
    """Return the path of the file that a path or "package:name" names."""
    package, _, name = text.partition(":")
    # "C:" is a drive.
    if ":" not in text or len(package) == 1 or package == "lesson" or os.path.exists(text):
        return text
    return str(find_asset(package, name))


def add_ground(scene: Scene) -> None:
    """Add a floor to a scene that was read from a URDF; see `load`."""
    if scene._source is None or not scene._source.urdf:
        raise ValueError("ground: only a URDF takes it; in MJCF the world needs a plane")
    lowest = lowest_point(Sim(scene)) if scene.geoms else 0.0
    bases = [joint.body for joint in scene.joints if joint.type == "free"]
    for base in bases:
        x, y, z = base.pos
        base.pos = (x, y, z - lowest)
    names = {geom.name for geom in scene.geoms}
    name = next(name for name in ("ground", "floor", "") if name not in names)
    height = 0.0 if bases else lowest
    scene.add_geom("world", "plane", (0, 0, 1), name=name, pos=(0, 0, height))


def lowest_point(sim: Sim) -> float:
    """Return the height of the lowest point of a world's geoms [m]; no geom is a plane."""
    model, heights = sim.model, list[float]()
    down = -np.reshape(sim.geom_xmat, (-1, 3, 3))[:, 2]
    for geom, kind in enumerate(model.geom_type):
        (x, y, z), way = model.geom_size[geom], down[geom]
        if kind == "mesh":
            reach = float((model.geom_hull(geom)[0] @ way).max(initial=0.0))
        elif kind == "box":
            reach = float(np.abs(way) @ (x, y, z))
        elif kind == "cylinder":
            reach = x * math.hypot(way[0], way[1]) + y * abs(way[2])
        else:
            # A sphere has no half length.
            reach = x + (y * abs(way[2]) if kind == "capsule" else 0.0)
        heights.append(sim.geom_xpos[geom, 2] - reach)
    return min(heights)


def find_model(source: Any) -> Model:
    """Return the compiled model of a Model, a Scene or a source that `find_scene` accepts.

    Raises ValueError for anything else.
    """
    if isinstance(source, (str, os.PathLike)) or is_mujoco(source):
        source = find_scene(source)
    return compiled(source)


def find_asset(package: str, name: str) -> Path:
    """Return the MJCF file with this name in a package, without importing the package."""
    if not package.isidentifier():
        raise ValueError(brief(f"{package}:{name}: '{package}' is not the name of a package"))
    spec = importlib.util.find_spec(package)
    roots = list(spec.submodule_search_locations or ()) if spec else []
    if not roots:
        how = f" (pip install {package})" if package in WITH_MODELS else ""
        raise ValueError(brief(f"{package}:{name}: no package '{package}' is installed{how}"))
    wanted = Path(name if name.endswith(".xml") else name + ".xml")
    files = sorted(file for root in roots for file in Path(root).rglob("*.xml"))
    matches = [file for file in files if file.parts[-len(wanted.parts) :] == wanted.parts]
    if not matches:
        near = nearest(wanted.stem, [file.stem for file in files])
        raise ValueError(brief(f"{package}:{name}: the package has no {wanted}{near}"))
    if len(matches) > 1:
        inner = [(file, root) for file in matches for root in roots if file.is_relative_to(root)]
        shown = [f for f, root in inner if TESTS.isdisjoint(f.relative_to(root).parts[:-1])]
        matches = shown or matches
    if len(matches) > 1:
        several = ", ".join(str(file.relative_to(roots[0]).with_suffix("")) for file in matches[:6])
        raise ValueError(
            brief(f"{package}:{name}: several files have this name; give more: {several}")
        )
    return matches[0]
