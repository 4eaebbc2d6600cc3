"""Finding a scene by what a user writes: a path, a package's asset, or a scene of the lesson."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
from typing import TYPE_CHECKING

from stepcore import checks
from stepcore.checks import nearest

if TYPE_CHECKING:
    from stepcore.engine.model import Model
    from stepcore.scene.scene import Scene

# Where packages keep scenes that only their own tests are for.
TESTS = {"test", "tests", "testing", "test_assets"}
LESSON = ("spring", "drop", "stack", "grasp")


def find_scene(source: str | os.PathLike[str], *, warn: bool = True) -> Scene:
    """The scene that `source` names; a StiffnessWarning where its dt is near its limit.

    "lesson:stack": one of the lesson's scenes. "package:name": an MJCF file called name.xml
    among the files of an installed package, as "gymnasium:half_cheetah"; the package is found,
    not imported. Where several files have the name, give more of the path: "package:folder/name";
    files in a folder of tests count only where there is no other.
    Anything else is the path of an MJCF file.

    Raises ValueError if there is no such scene, and what `stepcore.load` raises.
    """
    scene = _found(os.fsdecode(source))
    if warn:
        from stepcore.measure.diagnosis.load import warn_of_stiffness

        warn_of_stiffness(scene, stacklevel=4)
    return scene


def _found(text: str) -> Scene:
    from stepcore.mjcf import load

    package, _, name = text.partition(":")
    if not _named(text):
        if not os.path.isfile(text):
            raise ValueError(f"{text}: no such file")
        return load(text)
    if package == "lesson":
        return _lesson(name)
    scene = load(find_asset(package, name))
    scene.name = scene.name or name
    return scene


def find_model(source: Model | Scene | str | os.PathLike[str], warn: bool = True) -> Model:
    """The compiled model of what a user gives: a Model, a Scene, or what `find_scene` knows.

    Raises ValueError for anything else.
    """
    from stepcore.engine.model import compiled

    if isinstance(source, (str, os.PathLike)):
        source = find_scene(source, warn=warn)
    return compiled(source)


def load(path: str | os.PathLike[str]) -> Scene:
    """The scene in an MJCF file, or one that `find_scene` knows by its name.

    path: of a file, or as "gymnasium:ant" (a model among an installed package's files) or
        "lesson:stack". A file's ``<option>`` becomes ``scene.settings``. Angles become radians,
        orientations unit quaternions; classes, includes and frames are resolved.

    Raises MJCFError (a ValueError whose text is ``file:line: …``) for what cannot be read,
    ValueError for a name that is not there, and FileNotFoundError for a file. Warns
    (`StiffnessWarning`) of a scene whose own dt has less than a factor of two in hand.

    >>> load("lesson:stack").compile().nv
    2
    """
    from stepcore import mjcf

    if not isinstance(path, (str, bytes, os.PathLike)):
        limit = 'the path of an MJCF file, or "package:name"'
        raise checks.refuse("load", "path", path, limit)
    if _named(os.fsdecode(path)):
        return find_scene(path)
    from stepcore.measure.diagnosis.load import warn_of_stiffness

    scene = mjcf.load(path)
    warn_of_stiffness(scene)
    return scene


def _named(text: str) -> bool:
    """Whether this is "package:name" and no path; one letter before a colon is a drive."""
    package, colon, _ = text.partition(":")
    return bool(colon) and len(package) != 1 and not os.path.exists(text)


def _lesson(name: str) -> Scene:
    from stepcore import lesson

    if name not in LESSON:
        raise ValueError(f"lesson:{name}: the lesson's scenes are {', '.join(LESSON)}")
    scene: Scene = getattr(lesson, name)()
    scene.name = name
    return scene


def find_asset(package: str, name: str) -> Path:
    """The MJCF file called `name` among a package's files; the package is not imported."""
    if not package.isidentifier():
        raise ValueError(f"{package}:{name}: '{package}' is not the name of a package")
    spec = importlib.util.find_spec(package)
    roots = list(spec.submodule_search_locations or ()) if spec else []
    if not roots:
        raise ValueError(f"{package}:{name}: no package '{package}' is installed")
    wanted = Path(name if name.endswith(".xml") else name + ".xml")
    files = sorted(file for root in roots for file in Path(root).rglob("*.xml"))
    found = [file for file in files if file.parts[-len(wanted.parts) :] == wanted.parts]
    if not found:
        near = nearest(wanted.stem, [file.stem for file in files])
        raise ValueError(f"{package}:{name}: the package has no {wanted}{near}")
    if len(found) > 1:
        shipped = [file for file in found if not _is_test(file, roots)]
        found = shipped or found
    if len(found) > 1:
        several = ", ".join(str(file.relative_to(roots[0]).with_suffix("")) for file in found[:6])
        raise ValueError(f"{package}:{name}: which one? {several}")
    return found[0]


def _is_test(file: Path, roots: list[str]) -> bool:
    """Whether a package keeps a file for its own tests."""
    root = next(root for root in roots if file.is_relative_to(root))
    return not TESTS.isdisjoint(file.relative_to(root).parts[:-1])
