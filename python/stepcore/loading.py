"""Find a scene by file, model of a package, scene of the lesson, or MuJoCo model."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stepcore.checks import brief, nearest
from stepcore.mjcf.from_mujoco import is_mujoco, read_mujoco
from stepcore.mjcf.reader import read_file
from stepcore.scene.scene import Scene

if TYPE_CHECKING:
    from stepcore.engine.model import Model

# Folders of a package with models for its own tests only.
TESTS = {"test", "tests", "testing", "test_assets"}
# Packages with models that the documentation mentions.
WITH_MODELS = ("gymnasium", "dm_control")
LESSON = ("spring", "drop", "stack", "grasp")


def find_scene(source: Any, without: Iterable[str] = (), fuse: bool | None = None) -> Scene:
    """Return the scene that `source` names.

    source: "lesson:stack" is a scene of the lesson. "package:name" is the MJCF file name.xml among
        the files of an installed package, such as "gymnasium:half_cheetah"; the package is not
        imported. If several files have this name, give more of the path: "package:folder/name".
        Files in a folder of tests count only if there are no others. An MjModel or an MjSpec is
        read from its XML. Every other source is the path of an MJCF file.
    without, fuse: see `stepcore.load`.

    Raises ValueError for an unknown name, and the errors of `stepcore.load` for a path.
    """
    if is_mujoco(source):
        scene = Scene()
        read_mujoco(scene, source, without, fuse)
        return scene
    text = os.fsdecode(source)
    package, _, name = text.partition(":")
    # "C:" is a drive.
    if ":" not in text or len(package) == 1 or os.path.exists(text):
        return _read(text, without, fuse)
    if package == "lesson":
        if name not in LESSON:
            raise ValueError(brief(f"lesson:{name}: the lesson's scenes are {', '.join(LESSON)}"))
        from stepcore.lesson import scenes

        lesson: Scene = getattr(scenes, name)()
        lesson.name = name
        return lesson
    scene = _read(find_asset(package, name), without, fuse)
    scene.name = scene.name or name
    return scene


def find_model(source: Any) -> Model:
    """Return the compiled model of a Model, a Scene or a source that `find_scene` accepts.

    Raises ValueError for anything else.
    """
    from stepcore.engine.world import compiled

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


def _read(path: str | Path, without: Iterable[str], fuse: bool | None) -> Scene:
    scene = Scene()
    read_file(scene, path, without, fuse)
    return scene
