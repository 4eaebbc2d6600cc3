"""Axes of a recorded array after time, with the names of their entries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stepcore.engine.model import Model

UNITS = {
    "time": "s",
    "energy": "J",
    "residual": "m/s",
    **dict.fromkeys(("overlap", "unrecovered_overlap", "error", "body_error"), "m"),
    **dict.fromkeys(("xpos", "geom_xpos", "site_xpos", "subtree_com", "mocap_pos"), "m"),
}
QUATERNION, TURNING = ("qw", "qx", "qy", "qz"), ("wx", "wy", "wz")
# Names of coordinates and dofs, for joints that have several.
COORDINATES = {"free": ("x", "y", "z", *QUATERNION), "ball": QUATERNION}
DOFS = {"free": ("vx", "vy", "vz", *TURNING), "ball": TURNING}
# The units of the coordinates and of the dofs of a joint.
POSITIONS = {"hinge": ("rad",), "slide": ("m",), "ball": ("",) * 4, "free": ("m",) * 3 + ("",) * 4}
VELOCITIES = {"hinge": ("rad/s",), "slide": ("m/s",), "ball": ("rad/s",) * 3}
VELOCITIES["free"] = ("m/s",) * 3 + ("rad/s",) * 3
OF_JOINTS = {"qpos": POSITIONS, "qvel": VELOCITIES}
# Axes whose entries have the same names in every model.
FIXED = {
    "xyz": ("x", "y", "z"),
    "wxyz": ("w", "x", "y", "z"),
    "force": ("fx", "fy", "fz", "tx", "ty", "tz"),
    "part": ("kinetic", "potential"),
    "measure": ("rms", "largest"),
}
# The named axes, and the arrays that have them; further axes are numbered.
_ARRAYS = {
    "dof": "qvel qacc qfrc_applied bias passive constraint_force"
    " qfrc_constraint qfrc_bias qfrc_passive",
    "coordinate": "qpos",
    "actuator": "ctrl actuator_length actuator_velocity actuator_force",
    "body": "xmat cinert cvel cacc cfrc_ext cfrc_int body_error",
    "body xyz": "xpos subtree_com",
    "body wxyz": "xquat",
    "body force": "xfrc_applied",
    "geom": "geom_xmat",
    "geom xyz": "geom_xpos",
    "site": "site_xmat",
    "site xyz": "site_xpos",
    "tendon": "ten_length ten_velocity",
    "mocap xyz": "mocap_pos",
    "mocap wxyz": "mocap_quat",
    "part": "energy",
    "measure": "error",
    "reading": "sensordata",
}
AXES = {name: axes.split() for axes, names in _ARRAYS.items() for name in names.split()}


@dataclass(frozen=True)
class Axis:
    """An axis of a recorded array. name: such as "body"; entries: the names of the entries.

    units: the units of joint positions and velocities; empty for other arrays and for files.
    """

    name: str
    entries: tuple[str, ...]
    units: tuple[str, ...] = field(default=(), compare=False)


def axes_of(model: Model | None, array: str, shape: Sequence[int]) -> tuple[Axis, ...]:
    """Return the axes of an array after time; axes without names are numbered."""
    named = AXES.get(array, []) if model is not None else []
    axes = []
    for k, length in enumerate(shape):
        name = named[k] if k < len(named) else ""
        entries = _entries(model, name) if model is not None and name else ()
        if len(entries) != length:
            name, entries = f"{array}_{k}", tuple(map(str, range(length)))
        axes.append(Axis(name, tuple(entries), units_of(model, array)))
    return tuple(axes)


def units_of(model: Model | None, array: str) -> tuple[str, ...]:
    """Return the unit of each position or velocity of the joints; () for another array."""
    units = OF_JOINTS.get(array)
    if model is None or units is None:
        return ()
    return tuple(unit for kind in model.jnt_type for unit in units[kind])


def _entries(model: Model, axis: str) -> Sequence[str]:
    if axis in FIXED:
        return FIXED[axis]
    if axis in model.names:
        return model.called(axis)
    if axis == "reading":
        sensors = zip(model.called("sensor"), model.sensor_dim.tolist(), strict=True)
        return [f"{name}.{k}" if n > 1 else name for name, n in sensors for k in range(n)]
    parts = {"dof": DOFS, "coordinate": COORDINATES}
    return _of_joints(model, parts[axis]) if axis in parts else ()


def _of_joints(model: Model, parts: Mapping[str, Sequence[str]]) -> list[str]:
    """Return an entry for each coordinate: "knee", or "root.x", … for several coordinates."""
    entries: list[str] = []
    for k, name in enumerate(model.called("joint")):
        labels = parts.get(model.jnt_type[k], ())
        entries += [f"{name}.{part}" for part in labels] or [name]
    return entries
