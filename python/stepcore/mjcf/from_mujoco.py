"""The MJCF of a `mujoco.MjModel` or `mujoco.MjSpec`, with every digit of its numbers."""

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
    from stepcore.scene.contents import Contents

# So many digits give a number back exactly; MuJoCo writes six by default.
EXACT = 17
NAMES = ("MjModel", "MjSpec")
# Arrays of an MjModel that say what is simulated, by the beginnings of their names.
PHYSICS = (
    *("body_", "jnt_", "dof_", "geom_", "site_", "tendon_", "actuator_", "eq_", "sensor_", "pair_"),
    *("exclude_", "key_", "mesh_vert", "hfield_data", "qpos0", "qpos_spring"),
)
# MuJoCo computes these for drawing and for its own search for contacts.
ASIDE = ("_rgba", "_matid", "_bvhadr", "_bvhnum", "_user")
# What two compilations of one text agree to.
RELATIVE, ABSOLUTE = 1e-6, 1e-9


def is_mujoco(source: object) -> bool:
    """Whether this is an MjModel or an MjSpec; mujoco is not imported."""
    kind = type(source)
    return kind.__name__ in NAMES and kind.__module__.partition(".")[0] == "mujoco"


def read_mujoco(
    scene: Contents, source: Any, without: Iterable[str] = (), fuse: bool | None = None
) -> None:
    """Fills an empty scene from an MjModel or an MjSpec; see `stepcore.load`."""
    name = type(source).__name__
    with _exact_numbers(), tempfile.TemporaryDirectory() as folder:
        if name == "MjModel":
            text, base = _saved(source, os.path.join(folder, "model.xml"))
        else:
            text, base = _text(source), _with_assets(source, folder)
        read_text(scene, text, base=base, name=name, without=without, fuse=fuse)


def _with_assets(spec: Any, folder: str) -> str | None:
    """Where the files of a spec lie; those that it holds itself are written to `folder`."""
    for name, data in spec.assets.items():
        file = Path(folder, name)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data.encode() if isinstance(data, str) else data)
    return folder if spec.assets else spec.modelfiledir or None


def _text(spec: Any) -> str:
    """The XML of a spec; it is left as it is."""
    text: str
    try:
        text = spec.to_xml()
    except Exception:  # of a type of mujoco's own: some versions write what is compiled only
        compiled = spec.copy()
        compiled.compile()
        text = compiled.to_xml()
    return text


def _saved(model: Any, path: str) -> tuple[str, str | None]:
    """The XML of a model, and the folder from which its files are named.

    MuJoCo writes the values of the model into the XML that it loaded last, whatever model that was
    of: what comes out is compiled and compared.
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
    """The folder of the file that a model was loaded from, where it names other files."""
    named = [(spec.meshdir, m.file) for m in spec.meshes] + [("", h.file) for h in spec.hfields]
    ends = [os.path.join(folder, file) for folder, file in named if file]
    for path in bytes(model.paths).decode("utf-8", "replace").split("\0"):
        for end in ends:
            if path.endswith(end) and path != end:
                return path.removesuffix(end)
    return ""


def _difference(model: Any, other: Any) -> str:
    """The name of the first array in which two models differ in what they simulate, or ""."""
    import numpy as np

    if bytes(model.names) != bytes(other.names):
        return "names"
    for name in dir(model):
        if not name.startswith(PHYSICS) or name.endswith(ASIDE):
            continue
        mine, theirs = getattr(model, name), getattr(other, name)
        if isinstance(mine, np.ndarray) and mine.dtype.kind in "fiu":
            same = mine.shape == theirs.shape
            if not same or not np.allclose(mine, theirs, RELATIVE, ABSOLUTE, equal_nan=True):
                return name
    return ""


@contextlib.contextmanager
def _exact_numbers() -> Iterator[None]:
    """MuJoCo writes numbers with all their digits; with six if this version cannot."""
    own = _precision()
    if own is None:
        yield
        return
    read, write = own
    before = read()
    write(EXACT)
    try:
        yield
    finally:
        write(before)


def _precision() -> tuple[Any, Any] | None:
    """How many digits MuJoCo writes: the functions of its library that read and set it."""
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
    return None
