"""Axes of a recorded array after time, with the names of their entries."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stepcore.engine.model import Model

UNITS = {
    "time": "s",
    "energy": "J",
    **dict.fromkeys(("overlap", "unrecovered_overlap", "error", "body_error"), "m"),
    **dict.fromkeys(("xpos", "geom_xpos", "site_xpos", "subtree_com", "mocap_pos"), "m"),
    **dict.fromkeys(("residual",), "m/s"),
}
XYZ, WXYZ = ("x", "y", "z"), ("w", "x", "y", "z")
FORCE = ("fx", "fy", "fz", "tx", "ty", "tz")
QUATERNION, TURNING = ("qw", "qx", "qy", "qz"), ("wx", "wy", "wz")
# Names of coordinates and dofs, for joints that have several.
COORDINATES = {"free": (*XYZ, *QUATERNION), "ball": QUATERNION}
DOFS = {"free": ("vx", "vy", "vz", *TURNING), "ball": TURNING}
# The named axes of each array; further axes are numbered.
AXES = {
    **dict.fromkeys(("qvel", "qacc", "qfrc_applied", "bias", "passive"), ("dof",)),
    **dict.fromkeys(("constraint_force", "qfrc_constraint"), ("dof",)),
    **dict.fromkeys(("qfrc_bias", "qfrc_passive"), ("dof",)),
    **dict.fromkeys(("ctrl", "actuator_length", "actuator_velocity"), ("actuator",)),
    **dict.fromkeys(("actuator_force",), ("actuator",)),
    **dict.fromkeys(("xpos", "subtree_com"), ("body", "xyz")),
    **dict.fromkeys(("xmat", "cinert", "cvel", "cacc", "cfrc_ext", "cfrc_int"), ("body",)),
    **dict.fromkeys(("ten_length", "ten_velocity"), ("tendon",)),
    "qpos": ("coordinate",),
    "xfrc_applied": ("body", "force"),
    "xquat": ("body", "wxyz"),
    "geom_xpos": ("geom", "xyz"),
    "geom_xmat": ("geom",),
    "site_xpos": ("site", "xyz"),
    "site_xmat": ("site",),
    "mocap_pos": ("mocap", "xyz"),
    "mocap_quat": ("mocap", "wxyz"),
    "energy": ("part",),
    "error": ("measure",),
    "body_error": ("body",),
    "sensordata": ("reading",),
}


@dataclass(frozen=True)
class Axis:
    """An axis of a recorded array. name: such as "body"; entries: the names of the entries."""

    name: str
    entries: tuple[str, ...]


def axes_of(model: Model | None, array: str, shape: Sequence[int]) -> tuple[Axis, ...]:
    """Return the axes of an array after time; axes without names are numbered."""
    known = AXES.get(array, ()) if model is not None else ()
    axes = []
    for k, length in enumerate(shape):
        name = known[k] if k < len(known) else ""
        entries = _entries(model, name) if model is not None and name else ()
        if len(entries) != length:
            name, entries = f"{array}_{k}", tuple(map(str, range(length)))
        axes.append(Axis(name, tuple(entries)))
    return tuple(axes)


def _entries(model: Model, axis: str) -> Sequence[str]:
    fixed = {
        "xyz": XYZ,
        "wxyz": WXYZ,
        "force": FORCE,
        "part": ("kinetic", "potential"),
        "measure": ("rms", "largest"),
    }
    if axis in fixed:
        return fixed[axis]
    if axis in model.names:
        return model.called(axis)
    lists: dict[str, Callable[[], Sequence[str]]] = {
        "dof": lambda: _of_joints(model, DOFS),
        "coordinate": lambda: _of_joints(model, COORDINATES),
        "reading": lambda: [
            name if count == 1 else f"{name}.{part}"
            for name, count in zip(model.called("sensor"), model.sensor_dim.tolist(), strict=True)
            for part in range(count)
        ],
    }
    return lists[axis]() if axis in lists else ()


def _of_joints(model: Model, parts: Mapping[str, Sequence[str]]) -> list[str]:
    """Return an entry for each coordinate: "knee", or "root.x", … for several coordinates."""
    entries: list[str] = []
    for k, name in enumerate(model.called("joint")):
        own = parts.get(model.jnt_type[k], ())
        entries += [f"{name}.{part}" for part in own] or [name]
    return entries
