"""Read a `mujoco.MjModel` or `mujoco.MjSpec` through its MJCF, with exact numbers."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stepcore.mjcf.reader import read_text
from stepcore.mjcf.through_mujoco import differing_array, exact_numbers, quiet, xml_of

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

NAMES = ("MjModel", "MjSpec")


def is_mujoco(source: object) -> bool:
    """Return whether this is an MjModel or an MjSpec, without importing mujoco."""
    kind = type(source)
    return kind.__name__ in NAMES and kind.__module__.partition(".")[0] == "mujoco"


def read_mujoco(
    scene: Scene, source: Any, without: Iterable[str] = (), fuse: bool | None = None
) -> None:
    """Fill an empty scene from an MjModel or an MjSpec; see `stepcore.load`."""
    name = type(source).__name__
    with exact_numbers(), quiet(), tempfile.TemporaryDirectory() as folder:
        if name == "MjModel":
            text, base = _saved(source, os.path.join(folder, "model.xml"))
        else:
            text, base = xml_of(source), _with_assets(source, folder)
        read_text(scene, text, base=base, name=name, without=without, fuse=fuse)


def _with_assets(spec: Any, folder: str) -> str | None:
    """Return the folder of a spec's files; files in memory are first written to `folder`."""
    for name, data in spec.assets.items():
        file = Path(folder, name)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data.encode() if isinstance(data, str) else data)
    return folder if spec.assets else spec.modelfiledir or None


def _saved(model: Any, path: str) -> tuple[str, str | None]:
    """Return the XML of a model, and the folder to which its file names are relative.

    MuJoCo writes the values of the model into the XML that it loaded last, even if that was another
    model's. The result is therefore compiled and compared with the model.
    """
    import mujoco  # type: ignore[import-untyped,unused-ignore]

    kept = "MuJoCo keeps the XML of the model that it loaded last"
    better = "pass the MjSpec that it was compiled from, or its file"
    try:
        mujoco.mj_saveLastXML(path, model)
    except Exception as error:  # of a type of mujoco's own
        raise ValueError(f"MjModel: {kept}, which is another one ({error}); {better}") from None
    spec = mujoco.MjSpec.from_file(path)
    base = spec.modelfiledir = _folder(model, spec)
    other = differing_array(model, spec.compile())
    if other:
        raise ValueError(f"MjModel: {kept}, whose {other} differs; {better}")
    return Path(path).read_text(encoding="utf-8"), base or None


def _folder(model: Any, spec: Any) -> str:
    """Return the folder that a model's file names are relative to; "" if it names no files."""
    named = [(spec.meshdir, m.file) for m in spec.meshes] + [("", h.file) for h in spec.hfields]
    ends = [os.path.join(folder, file) for folder, file in named if file]
    for path in bytes(model.paths).decode("utf-8", "replace").split("\0"):
        for end in ends:
            if path.endswith(end) and path != end:
                return path.removesuffix(end)
    return ""
