"""Descriptions of a motion in words: the start, the controls and the contact law."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stepcore.engine.control import control_name
from stepcore.engine.model import Model
from stepcore.experiment.control_table import control_table
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import Schedule
from stepcore.report.units import counted, seconds

# Words for the types of actuators.
WORDS = {"motor": "motor", "muscle": "muscle", "damper": "damper", "cylinder": "cylinder"}
WORDS |= dict.fromkeys(("position", "velocity", "intvelocity"), "servo")


def motion_in_words(
    model: Model, motion: Motion, schedule: Schedule, sampled: str = "", driven: str = ""
) -> str:
    """Describe a motion: "1 s from keyframe `home`; servos follow seeded sines …; law solref".

    motion: as requested. schedule: as run.
    sampled: how often a control function was called, such as "every 2 ms"; by default every period
        of the schedule.
    driven: text to append to the description of the default controls.
    """
    begin = start_in_words(model, motion.key)
    count = len(schedule.starts)
    if count > 1:
        begin = f"{begin} and {counted(count - 1, 'start')} near it"
    sampled = sampled or f"every {seconds(schedule.period)}"
    drive = drive_in_words(model, motion, schedule.undriven, sampled, driven)
    return f"{seconds(schedule.horizon)} from {begin}; {drive}; {scene_in_words(model)}"


def scene_in_words(model: Model) -> str:
    """Describe the contact law, and the parts of the scene's file that were left out."""
    return f"law {model.settings.law}{without_in_words(model)}"


def without_in_words(model: Model) -> str:
    """List the parts left out of the scene's file on request: "; without flex (2)", or ""."""
    left_out = ", ".join(model.scene.without)
    return f"; without {left_out}" if left_out else ""


def start_in_words(model: Model, key: str | int | None) -> str:
    """Describe the start of a motion; key: see `Motion`."""
    if not model.keys:
        return "the pose of the scene"
    index = 0 if key is None else model.index("key", key)
    name = model.keys[index].name
    return f"keyframe `{name}`" if name else f"keyframe {index}"


def actuators_in_words(model: Model) -> str:
    """Return the word for the actuators of a model, in the plural."""
    words = {WORDS.get(actuator.type, "actuator") for actuator in model.scene.actuators}
    return f"{words.pop()}s" if len(words) == 1 else "motors and servos"


def held_in_words(model: Model, ctrl: np.ndarray) -> str:
    """Describe constant controls, shape (nu,)."""
    if model.nu == 0:
        return "no motors"
    what = actuators_in_words(model)
    return f"{what} hold the keyframe's controls" if np.any(ctrl) else f"{what} are held at zero"


def held_motion_in_words(
    model: Model, key: str | int | None, horizon: float, ctrl: np.ndarray
) -> str:
    """Describe a motion with constant controls, (nu,); horizon: [s]."""
    drive = held_in_words(model, ctrl)
    begin = start_in_words(model, key)
    return f"{seconds(horizon)} from {begin}; {drive}; {scene_in_words(model)}"


def drive_in_words(
    model: Model, motion: Motion, undriven: Sequence[str], sampled: str, driven: str = ""
) -> str:
    """Describe the controls of a motion.

    undriven: the actuators whose default controls are constant. sampled: the period of the
    controls, such as "every 2 ms". driven: text to append to the description of the default
    controls.
    """
    if model.nu == 0:
        return "no motors"
    what = actuators_in_words(model)
    if motion.control is not None:
        return f"{what} driven by {control_name(motion.control)}, sampled {sampled}"
    if motion.ctrl is not None:
        table = control_table(motion.ctrl)
        if not table.changes:
            return f"{what} hold {table.constants}"
        source = "the controls given" if table.source == "ctrl" else table.source
        sampled = table.paced(sampled) if motion.control_dt is None else f"a row {sampled}"
        return f"{what} driven by {source}, {sampled}"
    still = list(undriven)
    if len(still) == model.nu:
        return f"{what} are held at zero, because nothing gives their range"
    low, high = model.actuator_ctrlrange.T
    ranged = np.isfinite(low) & np.isfinite(high) & model.scene.features.clampctrl
    swings = int(np.sum(~ranged)) - len(still)
    if swings + len(still) == model.nu:
        sines = f"{what} follow seeded sines within a quarter of the keyframe's controls{driven}"
    else:
        sines = f"{what} follow seeded sines within 0.4 of their range{driven}"
        if swings:
            sines += f", {swings} without a range within a quarter of the keyframe's controls"
    return sines if not still else f"{sines}; {_names(still)} without a range held at zero"


def _names(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{len(names)} of them"
