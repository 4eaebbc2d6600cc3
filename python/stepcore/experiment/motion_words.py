"""Descriptions of a motion in words: the start, the controls and the contact law."""

from __future__ import annotations

import numpy as np

from stepcore.engine.control import control_name
from stepcore.engine.model import Model
from stepcore.experiment.default_motion import actuators_in_words
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import Schedule
from stepcore.report.units import counted, seconds


def motion_in_words(model: Model, motion: Motion, schedule: Schedule, sampled: str = "") -> str:
    """Describe a motion: "1 s from keyframe `home`; test motion: servos move …; law solref".

    motion: as requested. schedule: as run.
    sampled: how often a control function was called, such as "every 2 ms"; by default every period
        of the schedule.
    """
    begin = begin_in_words(model, motion)
    count = len(schedule.starts)
    if count > 1:
        begin = f"{begin} and {counted(count - 1, 'start')} near it"
    sampled = sampled or f"every {seconds(schedule.period)}"
    drive = drive_in_words(model, motion, schedule.drive, sampled)
    return f"{seconds(schedule.horizon)} from {begin}; {drive}; {scene_in_words(model)}"


def scene_in_words(model: Model) -> str:
    """Describe the contact law, and the parts of the scene's file that were left out."""
    return f"law {model.settings.law}{without_in_words(model)}"


def without_in_words(model: Model) -> str:
    """List the parts left out of the scene's file on request: "; without flex (2)", or ""."""
    left_out = ", ".join(model.scene.without)
    return f"; without {left_out}" if left_out else ""


def begin_in_words(model: Model, motion: Motion) -> str:
    """Describe the first start of a motion."""
    if motion.from_log and motion.table is not None and "qpos" in motion.table.placed(model).arrays:
        return f"the first pose of {motion.table.source}"
    return start_in_words(model, motion.key)


def start_in_words(model: Model, key: str | int | None) -> str:
    """Describe the start of a motion; key: see `Motion`."""
    if not model.keys:
        return "the pose of the scene"
    index = 0 if key is None else model.index("key", key)
    name = model.keys[index].name
    return f"keyframe `{name}`" if name else f"keyframe {index}"


def held_in_words(model: Model, ctrl: np.ndarray) -> str:
    """Describe constant controls, shape (nu,)."""
    if model.nu == 0:
        return "no motors"
    words = actuators_in_words(model)
    return f"{words} hold the keyframe's controls" if np.any(ctrl) else f"{words} are held at zero"


def held_motion_in_words(
    model: Model, key: str | int | None, horizon: float, ctrl: np.ndarray
) -> str:
    """Describe a motion with constant controls, (nu,); horizon: [s]."""
    drive = held_in_words(model, ctrl)
    begin = start_in_words(model, key)
    return f"{seconds(horizon)} from {begin}; {drive}; {scene_in_words(model)}"


def drive_in_words(model: Model, motion: Motion, drive: str, sampled: str) -> str:
    """Describe the controls of a motion.

    drive: the default controls in words. sampled: the period of the controls, such as "every 2 ms".
    """
    if model.nu == 0:
        return "no motors"
    drives = actuators_in_words(model)
    if motion.control is not None:
        return f"{drives} driven by {control_name(motion.control)}, sampled {sampled}"
    if (table := motion.table) is not None:
        if not table.varies:
            return f"{drives} hold {table.constants}"
        source = "the controls given" if table.source == "ctrl" else table.source
        verb = "follow the positions of" if motion.follow is not None else "driven by"
        read = f" ({table.told(model)})" if table.pace else ""
        pace = f", a row {sampled}" if motion.control_dt is not None or not table.pace else ""
        return f"{drives} {verb} {source}{read}{pace}"
    return drive
