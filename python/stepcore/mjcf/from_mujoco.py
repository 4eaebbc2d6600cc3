"""Read a `mujoco.MjModel` or `mujoco.MjSpec` through its MJCF, with exact numbers."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stepcore.mjcf.reader import read_text

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

NAMES = ("MjModel", "MjSpec")
# Name prefixes of the MjModel arrays that affect the simulation.
PHYSICS = (
    *("body_", "jnt_", "dof_", "geom_", "site_", "tendon_", "actuator_", "eq_", "sensor_", "pair_"),
    *("exclude_", "key_", "mesh_vert", "hfield_data", "qpos0", "qpos_spring"),
)
# Name suffixes of arrays used only for drawing or for MuJoCo's broad phase.
ASIDE = ("_rgba", "_matid", "_bvhadr", "_bvhnum", "_user")


def is_mujoco(source: object) -> bool:
    """Return whether this is an MjModel or an MjSpec, without importing mujoco."""
    kind = type(source)
    return kind.__name__ in NAMES and kind.__module__.partition(".")[0] == "mujoco"


def read_mujoco(
    scene: Scene, source: Any, without: Iterable[str] = (), fuse: bool | None = None
) -> None:
    """Fill an empty scene from an MjModel or an MjSpec; see `stepcore.load`."""
    name = type(source).__name__
    with _exact_numbers(), tempfile.TemporaryDirectory() as folder:
        if name == "MjModel":
            text, base = _saved(source, os.path.join(folder, "model.xml"))
        else:
            text, base = _text(source), _with_assets(source, folder)
        read_text(scene, text, base=base, name=name, without=without, fuse=fuse)


def _with_assets(spec: Any, folder: str) -> str | None:
    """Return the folder of a spec's files; files in memory are first written to `folder`."""
    for name, data in spec.assets.items():
        file = Path(folder, name)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data.encode() if isinstance(data, str) else data)
    return folder if spec.assets else spec.modelfiledir or None


def _text(spec: Any) -> str:
    """Return the XML of a spec, without changing the spec."""
    text: str
    try:
        text = spec.to_xml()
    except Exception:  # of a type of mujoco's own: some versions write what is compiled only
        compiled = spec.copy()
        compiled.compile()
        text = compiled.to_xml()
    return text


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
    other = _difference(model, spec.compile())
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


def _difference(model: Any, other: Any) -> str:
    """Return the name of the first array in which the physics of two models differs, or ""."""
    import numpy as np

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
def _exact_numbers() -> Iterator[None]:
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
