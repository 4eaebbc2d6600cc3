"""Gaps of connects and welds, and how far joints go beyond their limits."""

from __future__ import annotations

from typing import Any

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.coordinates import Coordinates, rotated, turned
from stepcore.scene import tying
from stepcore.scene.layout import QPOS, Layout


class Joints:
    """The connects and welds and the limits of a scene.

    connected: it has any of the former. tied: the indices of those that are active, limited: those
    of the joints with a range; in the order of the columns of `gaps` and `violations`.
    """

    def __init__(self, model: Model, layout: Layout, coordinates: Coordinates) -> None:
        scene = model.scene
        self.ranges = [(kind, q, limits) for kind, q, _, limits in coordinates.joints if limits]
        self.limited = [k for k, joint in enumerate(coordinates.joints) if joint[3]]
        works = scene.features.equality and scene.features.constraint
        self.tied = [
            k
            for k, e in enumerate(scene.equalities)
            if works and e.active and e.type in ("connect", "weld")
        ]
        ties = [scene.equalities[k] for k in self.tied]
        self.connected = bool(ties)
        # (body 1, the point in its frame, body 2, the point in its frame).
        self.ties: list[tuple[int, np.ndarray, int, np.ndarray]] = []
        if ties:
            sim = Sim(model, model.settings.replace(precision="f64"))
            place, turn = sim.xpos, sim.xmat
            for tie in ties:
                self.ties.append(_ends(tying.plain(layout, tie), place, turn))

    def apart(self, frames: np.ndarray) -> float | None:
        """The widest gap of a connection [m], None without one; frames: see `States`."""
        return float(self.gaps(frames).max()) if self.connected else None

    def gaps(self, frames: np.ndarray) -> np.ndarray:
        """How far each connection gapes [m], (n, connections)."""
        gaps = []
        for a, near, b, far in self.ties:
            here = frames[:, a, :3] + rotated(frames[:, a, 3:], near)
            there = frames[:, b, :3] + rotated(frames[:, b, 3:], far)
            gaps.append(np.linalg.norm(here - there, axis=1))
        return np.array(gaps).T.reshape(len(frames), len(gaps))

    def beyond(self, qpos: np.ndarray) -> float | None:
        """The furthest that a joint was outside of its range [rad or m], None without ranges."""
        return float(self.violations(qpos).max(initial=0.0)) if self.ranges else None

    def violations(self, qpos: np.ndarray) -> np.ndarray:
        """How far each joint with a range is outside of it [rad or m], 0 within; (n, ranges)."""
        beyond = []
        for kind, q, (low, high) in self.ranges:
            if kind in ("hinge", "slide"):
                value = qpos[:, q]
            else:
                quat = qpos[:, q + QPOS[kind] - 4 : q + QPOS[kind]]
                value = np.linalg.norm(turned(quat), axis=1)
            beyond.append(np.maximum(0.0, np.maximum(low - value, value - high)))
        return np.array(beyond).T.reshape(len(qpos), len(beyond))


def _ends(
    tie: dict[str, Any], place: np.ndarray, turn: np.ndarray
) -> tuple[int, np.ndarray, int, np.ndarray]:
    """Where a connect or weld acts on its two bodies: what is not given follows from this pose."""
    bodies = (tie["first"], tie["second"])
    near, far = (frame and np.array(frame["pos"]) for frame in (tie["frame1"], tie["frame2"]))
    (a, b) = bodies
    if near is None:
        near = turn[a].T @ (place[b] + turn[b] @ far - place[a])
    if far is None:
        far = turn[b].T @ (place[a] + turn[a] @ near - place[b])
    return a, near, b, far
