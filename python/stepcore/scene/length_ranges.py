"""Find the length range of muscles that give no range, by MuJoCo's simulation.

MuJoCo documentation, "Length range": a force pulls each actuator both ways along its transmission,
until limits or geometry stop the motion. Needs the extra `mujoco`.
"""

from __future__ import annotations

import functools
import re
from typing import TYPE_CHECKING, Any

from stepcore import checks

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene


def fill(scene: Scene, data: dict[str, Any]) -> None:
    """Write the missing length ranges into the plain data of a scene.

    Raises ValueError, naming the actuator, if the simulation does not come to rest.
    """
    left = asked(scene)
    if not left:
        return
    # In MuJoCo the inputs of a controller are no actuators of their own.
    actuators = [index for index, each in enumerate(scene.actuators) if each.type != "input"]
    try:
        ranges = _ranges(scene.to_mjcf())
    except ImportError:
        text = 'MuJoCo finds its lengthrange: give one, or pip install "stepcore[mujoco]"'
        raise checks.ElementError(scene.actuators[left[0]], text) from None
    except ValueError as error:
        at = re.search(r"actuator (\d+)", str(error))
        actuator = scene.actuators[actuators[int(at[1])] if at else left[0]]
        cure = "Give its lengthrange, limit what it moves, or change Scene.lengthrange"
        text = f"its range of lengths was not found: {checks.one_line(error)}. {cure}"
        raise checks.ElementError(actuator, text) from None
    for index in left:
        data["actuators"][index]["lengthrange"] = list(ranges[actuators.index(index)])


def asked(scene: Scene) -> list[int]:
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


@functools.lru_cache(maxsize=64)
def _ranges(text: str) -> tuple[tuple[float, float], ...]:
    """Return the length ranges of the actuators of an MJCF text."""
    import mujoco  # type: ignore[import-untyped,unused-ignore]

    model = mujoco.MjModel.from_xml_string(text)
    return tuple((low, high) for low, high in model.actuator_lengthrange.tolist())
