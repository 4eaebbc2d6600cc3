"""`load` and `loads`: scenes from MJCF, URDF or MuJoCo, with a warning if their time step is hardly
stable."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import TYPE_CHECKING

from stepcore import checks
from stepcore.loading import find_scene
from stepcore.measure.diagnosis.stiffness_warning import warn_of_stiffness
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
    """Reads a scene from an MJCF or a URDF file, or from a model or a spec of MuJoCo's.

    A URDF becomes the scene that MuJoCo makes of it: its root link stands on the world, efforts
    clamp what actuators put on joints, mimic joints are joint equalities, visuals are never read,
    and a link on a fixed joint is part of the body that it is fixed to.

    path: the path of a file, "package:name" for a model among the files of an installed package
        (such as "gymnasium:ant"), or "lesson:name" for a scene of the lesson. The file's
        ``<option>`` becomes ``scene.settings``. Angles become radians and orientations unit
        quaternions; default classes, includes and frames are resolved.
        An `mujoco.MjSpec` is read from the XML that MuJoCo writes of it, with all digits of its
        numbers, and so is an `mujoco.MjModel` with the values that its arrays have now; but MuJoCo
        keeps the XML only of the model that it loaded last from a file or a text, and any other
        MjModel is a ValueError.
    without: kinds of things that are left out of the file on purpose, with all that refers to
        them: an element ("weld", "actuator/muscle"), an attribute ("geom/surfacevel"), a section
        ("contact", "tendon", "equality", "actuator", "sensor", "keyframe"), "flex" or "plugin".
        `Scene.notes` says what that changes, and every result that of the scene it ran.
    fuse: whether bodies that nothing moves against their parent become part of it, as by MJCF's
        ``fusestatic``; by default as the file says, which for a URDF without a word about it is
        True. False keeps every link a body with a name, and the root link one that a free joint
        can set free. `Scene.fused` says what became of which name.

    Raises FileNotFoundError if there is no such file, IsADirectoryError for a folder, ValueError
    for a name or a kind that does not exist, and MJCFError (a ValueError whose text begins with
    ``file:line:``, with a line for each thing that is wrong or not built yet) for a file that
    cannot be read. Warns (`StiffnessWarning`) if the scene's own time step has a stability margin
    below 2.

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
    """Reads a scene from a text in MJCF or URDF.

    text: the XML. base: the folder in which its includes are looked for. name: what error
        messages call the text. without, fuse: see `load`.

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
