"""What motion was run, in words: from where, how it was driven, and under which law."""

from __future__ import annotations

from collections.abc import Sequence

from stepcore.engine.model import Model
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import Schedule
from stepcore.report.units import counted, seconds

# What actuators of a type are called.
WORDS = {"motor": "motor", "position": "servo", "velocity": "servo"}


def motion_in_words(model: Model, motion: Motion, schedule: Schedule) -> str:
    """What was run: "1 s from keyframe `home`; servos follow seeded sines …; law solref".

    motion: as it was asked for; schedule: as it was run.
    """
    begin = _begin(model, motion)
    count = len(schedule.starts)
    if count > 1:
        begin = f"{begin} and {counted(count - 1, 'start')} near it"
    span = seconds(schedule.period * schedule.periods)
    return f"{span} from {begin}; {_drive(model, motion, schedule)}; law {model.settings.law}"


def _begin(model: Model, motion: Motion) -> str:
    if not model.keys:
        return "the pose of the scene"
    index = 0 if motion.key is None else model.index("key", motion.key)
    name = model.keys[index].name
    return f"keyframe `{name}`" if name else f"keyframe {index}"


def _drive(model: Model, motion: Motion, schedule: Schedule) -> str:
    """How the controls were driven."""
    if model.nu == 0:
        return "no motors"
    held = f"each held {seconds(schedule.period)}"
    if motion.control is not None:
        return f"controls by the function given, {held}"
    if motion.ctrl is not None:
        return "the controls given"
    still = list(schedule.undriven)
    what = _actuators(model)
    if len(still) == model.nu:
        return f"{what} get no control, because nothing gives their range"
    sines = f"{what} follow seeded sines within 0.4 of their range"
    return sines if not still else f"{sines}, but {_names(still)} without a range get none"


def _actuators(model: Model) -> str:
    """What the actuators of a model are called."""
    words = {WORDS.get(actuator.type, "actuator") for actuator in model.scene.actuators}
    return f"{words.pop()}s" if len(words) == 1 else "motors and servos"


def _names(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{len(names)} of them"
