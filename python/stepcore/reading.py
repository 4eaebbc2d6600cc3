"""`load` and `loads` read scenes from MJCF, URDF or MuJoCo, and warn of a barely stable dt."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import TYPE_CHECKING

from stepcore import checks
from stepcore.engine.stiffness import warn_of_stiffness
from stepcore.loading import find_scene
from stepcore.mjcf.from_mujoco import is_mujoco
from stepcore.mjcf.reader import read_text
from stepcore.scene.scene import Scene

if TYPE_CHECKING:
    import mujoco  # type: ignore[import-untyped,unused-ignore]


def load(
    path: str | os.PathLike[str] | mujoco.MjModel | mujoco.MjSpec,
    *,
    without: Iterable[str] = (),
    fuse: bool | None = None,
) -> Scene:
    """Read a scene from an MJCF or a URDF file, or from an MjModel or an MjSpec of MuJoCo.

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
        a named body; a free joint can then be added to the root link. `Scene.fused` maps the name
        of each merged body to the body that contains it.

    Raises FileNotFoundError for a missing file, IsADirectoryError for a folder, ValueError for an
    unknown name or kind, and MJCFError for a file that cannot be read. MJCFError is a ValueError;
    its text begins with ``file:line:`` and has a line for each error or unsupported feature. Warns
    (`StiffnessWarning`) if the scene's own time step has a stability margin below 2.

    >>> load("lesson:stack").compile().nv
    2
    """
    if not isinstance(path, (str, bytes, os.PathLike)) and not is_mujoco(path):
        limit = 'the path of an MJCF file, "package:name", or a MjModel or MjSpec of mujoco'
        raise checks.refuse("load", "path", path, limit)
    scene = find_scene(path, without, fuse)
    warn_of_stiffness(scene)
    return scene


def loads(
    text: str | bytes,
    *,
    base: str | os.PathLike[str] | None = None,
    name: str = "<string>",
    without: Iterable[str] = (),
    fuse: bool | None = None,
) -> Scene:
    """Read a scene from a text in MJCF or URDF.

    text: the XML.
    base: the folder of included files.
    name: the name of the text in error messages.
    without, fuse: see `load`.

    Raises and warns as `load` does.

    >>> scene = loads('<mujoco><option timestep="0.01"/><worldbody/></mujoco>')
    >>> scene.settings.dt
    0.01
    >>> loads("<mujoco><wordbody/></mujoco>")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    stepcore.mjcf.nodes.MJCFError: <string>:1: unknown element <wordbody> in <mujoco>; nearest: ...
    """
    scene = Scene()
    read_text(scene, text, base=base, name=name, without=without, fuse=fuse)
    warn_of_stiffness(scene)
    return scene
