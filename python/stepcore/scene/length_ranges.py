"""Find the length range of muscles that give no range, by simulation as in MuJoCo.

MuJoCo documentation, "Length range": a force pulls each actuator both ways along its transmission.
The norm of the joint acceleration under this force is `accel`. Gravity, contacts, friction, passive
forces and other actuators are left out, and velocities decay. Limits or geometry must stop the
motion within `inttotal`. Here all actuators are worlds of one batch, two worlds each.
"""

from __future__ import annotations

import hashlib
import math
import pickle
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore import _core, checks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stepcore.scene.elements import Actuator
    from stepcore.scene.elements.world import LengthRange
    from stepcore.scene.scene import Scene

# Effects that MuJoCo leaves out of the simulation.
OFF = ("contact", "spring", "damper", "gravity", "frictionloss", "sensor")
# MuJoCo's lower bound of norms.
LEAST_NORM = 1e-15
# A cache of ranges, by a hash of the simulated scene.
_found: dict[bytes, list[list[float]]] = {}


def fill_ranges(scene: Scene, data: dict[str, Any]) -> None:
    """Write the missing length ranges into the plain data of a scene.

    Raises ValueError, naming the actuator, if the simulation does not come to rest.
    """
    rules = scene.lengthrange
    left = missing_ranges(scene)
    if not left:
        return
    limits = {index: _limits(scene.actuators[index]) if rules.uselimit else None for index in left}
    free = [index for index in left if limits[index] is None]
    if free:
        limits |= dict(zip(free, _simulated(scene, data, free), strict=True))
    for index in left:
        data["actuators"][index]["lengthrange"] = list(limits[index] or ())


def missing_ranges(scene: Scene) -> list[int]:
    """Return the indices of the actuators whose range must be found."""
    rules, left = scene.lengthrange, []
    for index, actuator in enumerate(scene.actuators):
        missing = actuator.lengthrange is None
        if not actuator.law.is_muscle or not (missing or not rules.useexisting):
            continue
        if rules.mode != "none":
            left.append(index)
        elif missing:
            limit = 'given for a muscle where Scene.lengthrange has mode="none"'
            raise checks.refuse(actuator, "lengthrange", None, limit)
    return left


def _limits(actuator: Actuator) -> Sequence[float] | None:
    """Return the range of the joint or tendon; like MuJoCo, do not multiply it by the gear."""
    field, target = actuator.target
    if field not in ("joint", "jointinparent", "tendon") or getattr(target, "type", "") == "free":
        return None
    bounds: Sequence[float] | None = target.range
    return bounds


def _simulated(scene: Scene, data: dict[str, Any], indices: list[int]) -> list[list[float]]:
    rules = scene.lengthrange
    bare = _bare(data)
    timestep = rules.timestep or scene.settings.dt
    key = hashlib.sha256(pickle.dumps((bare, rules.record(), timestep, indices))).digest()
    if key not in _found:
        lengths = _extremes(bare, rules, timestep, indices, scene.actuators)
        ranges = [
            _settled(scene.actuators[index], rules, *each)
            for index, each in zip(indices, lengths, strict=True)
        ]
        if len(_found) >= 64:
            _found.pop(next(iter(_found)))
        _found[key] = ranges
    return _found[key]


def _bare(data: dict[str, Any]) -> dict[str, Any]:
    """Return the scene for the simulation: all actuators are motors whose force is the control."""
    motor = {
        **{"gain": [1.0, 0.0, 0.0], "bias": [0.0, 0.0, 0.0], "dampratio": 0.0},
        **{"muscle_gain": None, "muscle_bias": None, "dynamics": "none", "delay": 0.0},
        **{"controller": None, "orientation": None, "feeds": None},
        **dict.fromkeys(("ctrlrange", "actrange", "forcerange")),
        **{"damping": [0.0, 0.0, 0.0], "actearly": False, "enabled": True},
    }
    free = {"actuatorfrcrange": None}
    return data | {
        "features": dict.fromkeys(data["features"], True) | dict.fromkeys(OFF, False),
        **{"density": 0.0, "viscosity": 0.0, "keys": [], "sensors": []},
        "bodies": [body | {"gravcomp": 0.0} for body in data["bodies"]],
        "joints": [joint | free for joint in data["joints"]],
        "tendons": [tendon | free for tendon in data["tendons"]],
        "actuators": [actuator | motor for actuator in data["actuators"]],
    }


Lengths = list[tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]]


def _extremes(
    bare: dict[str, Any],
    rules: LengthRange,
    timestep: float,
    indices: list[int],
    actuators: Sequence[Actuator],
) -> Lengths:
    """Return the least and greatest length in the last interval of both pulls, by actuator."""
    model = _core.compile(bare)
    settings = _core.Settings(dt=timestep, integrator="euler")
    twice = 2 * len(indices)
    batch = _core.Batch(model, settings, twice, 1, True, False)
    arrays = dict(batch.arrays())
    pulled, world = np.repeat(indices, 2), np.arange(twice)
    way = np.tile([-rules.accel, rules.accel], len(indices))[:, None]
    ctrl, act = np.zeros((twice, arrays["ctrl"].shape[1])), np.zeros((twice, 0))
    ctrl[world, pulled] = 1.0
    # 10 ms is MuJoCo's lower bound of the time constant.
    decay = math.exp(-timestep / max(0.01, rules.timeconst))
    least, greatest = np.full(twice, math.inf), np.full(twice, -math.inf)
    time = 0.0
    while time < rules.inttotal:
        arrays["qvel"][...] *= decay
        length = batch.readout("actuator_length")[world, pulled]
        arms = model.element_force("actuator", ctrl, act, arrays["qpos"], arrays["qvel"])
        gained = np.linalg.solve(batch.readout("mass_matrix"), arms[..., None])[..., 0]
        force = arms * (way / np.maximum(LEAST_NORM, np.linalg.norm(gained, axis=1, keepdims=True)))
        if rules.maxforce > 0:
            size = np.linalg.norm(force, axis=1, keepdims=True)
            force *= np.minimum(1.0, rules.maxforce / np.maximum(LEAST_NORM, size))
        arrays["qfrc_applied"][...] = force
        try:
            batch.step(1)
        except _core.SimulationError as error:
            text = f"the motion diverged after {time:g} s of pulling it"
            raise _not_found(actuators[pulled[error.world]], text) from None
        time += timestep
        if time > rules.inttotal - rules.interval:
            least, greatest = np.minimum(least, length), np.maximum(greatest, length)
    return list(zip(least.reshape(-1, 2), greatest.reshape(-1, 2), strict=True))


def _settled(
    actuator: Actuator,
    rules: LengthRange,
    least: np.ndarray[Any, Any],
    greatest: np.ndarray[Any, Any],
) -> list[float]:
    low, high = float(least[0]), float(greatest[1])
    for least_end, greatest_end in zip(least, greatest, strict=True):
        moved = greatest_end - least_end
        if not (low < high and moved <= rules.tolrange * (high - low)):
            ends = f"from {least_end:g} to {greatest_end:g}"
            text = f"after {rules.inttotal:g} s of pulling it went {ends}"
            raise _not_found(actuator, f"{text}, of {low:g} to {high:g}")
    return [low, high]


def _not_found(actuator: Actuator, why: str) -> checks.ElementError:
    cure = "Give its lengthrange, limit what it moves, or change Scene.lengthrange"
    return checks.ElementError(actuator, f"its range of lengths was not found: {why}. {cure}")
