"""`World`: what the stages of a step read, and what the last of them moves."""

from __future__ import annotations

import numpy as np

from .model import Model
from .settings import Settings


class World:
    """A model in motion: its settings, its state and what acts on it."""

    def __init__(self, model: Model, settings: Settings) -> None:
        self.model, self.settings = model, settings
        self.qpos, self.qvel = np.array(model.qpos0, float), np.zeros(model.nv)
        self.ctrl = np.zeros(len(model.scene["actuators"]))
        self.qfrc_applied = np.zeros(model.nv)
        self.xfrc_applied = np.zeros((len(model.scene["bodies"]), 6))
        self.steps = 0
