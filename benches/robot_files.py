"""Where public robots in MJCF are found: the wheels of gymnasium and dm-control, and a folder."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Robot:
    """A file, and the collection that it is from."""

    collection: str
    name: str
    path: Path


def wheels() -> list[Robot]:
    """What the packages ship: gymnasium's MuJoCo tasks and dm_control's suite."""
    places = (
        ("gymnasium", "gymnasium", "envs/mujoco/assets"),
        ("dm_control", "dm_control", "suite"),
    )
    found = []
    for collection, package, folder in places:
        spec = importlib.util.find_spec(package)
        if spec is not None and spec.submodule_search_locations:
            found += folder_of(collection, Path(spec.submodule_search_locations[0]) / folder)
    return found


def folder_of(collection: str, folder: Path) -> list[Robot]:
    """All models below a folder, by name; includes that are no models of their own are left out.

    A link stands for the file that it names, whose meshes lie beside that.
    """
    files = sorted(path for path in folder.rglob("*.xml") if "common" not in path.parts)
    return [
        Robot(collection, str(path.relative_to(folder).with_suffix("")), path.resolve())
        for path in files
    ]
