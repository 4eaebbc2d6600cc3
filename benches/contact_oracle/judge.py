"""One trial judged: the engine's answers against the oracle, and MuJoCo's beside them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import stepcore as sc
from stepcore.engine.tables import Touches

from .certificate import certify
from .cover import upper_bound
from .peer import Found, mujoco_touches
from .poses import Trial
from .search import search


@dataclass
class Verdict:
    """Errors of one trial, each times 1/scale, by pose, shape (n,), NaN where not asked.

    overlap: the shapes overlap. searched: which poses of these were searched. true: the distance,
    or where not searched the lower bound that the engine's own normal proves.
    dist: the engine's smallest distance less the true one; below 0 where it missed the shortest
    way out. plane, point, support, unit: what that contact claims, see `certify`; manifold: how
    far the points of any of its contacts stand out of the shapes.
    unproven: how far above the true distance the covering cannot exclude a better one.
    peer: MuJoCo's distance less the true one; peer_contact: the same of its deepest contact.
    """

    trial: Trial
    touches: Touches
    overlap: np.ndarray
    searched: np.ndarray
    true: np.ndarray
    dist: np.ndarray
    plane: np.ndarray
    point: np.ndarray
    support: np.ndarray
    unit: np.ndarray
    manifold: np.ndarray
    unproven: np.ndarray
    peer: np.ndarray
    peer_contact: np.ndarray
    found: Found | None


def touched(trial: Trial, **how: Any) -> Touches:
    """The engine's contacts at a trial's poses, in the world."""
    return sc.loads(trial.mjcf()).compile().touches("a", "b", trial.qpos, **how)


def judge(
    trial: Trial, *, searched: int | None = None, covered: int = 0, peer: bool = False
) -> Verdict:
    """searched: at most so many of the overlapping poses are searched for a shorter way out; where
    shapes are apart the answer proves itself. covered: so many are bounded from above as well.
    peer: MuJoCo's answers too."""
    posed, touches = trial.posed, touched(trial)
    scale = posed.scale
    n = len(scale)
    rows = np.arange(n)
    listed = np.where(touches.exists, touches.dist, np.inf)
    slot = listed.argmin(axis=1)
    dist = listed[rows, slot]
    pos, normal = trial.points_into(touches.pos), trial.into(touches.normal)
    certificate = certify(posed, dist, pos[rows, slot], normal[rows, slot])
    # Any direction proves a lower bound; two points prove an upper one.
    claimed = posed.gap(normal[rows, slot][:, None])[:, 0]
    true = claimed.copy()
    # Distances between the two bounds count as right.
    high = np.where(claimed > 0, np.maximum(dist - claimed - certificate.point, 0), 0)
    some = np.flatnonzero(~(claimed > 0))[:searched]
    if len(some):
        true[some] = np.fmax(search(posed.take(some)).dist, claimed[some])
    searched_at, proof = some, np.full(n, np.nan)
    # Out of a half-space there is one direction only.
    some = some[: 0 if posed.a.kind == "plane" else covered]
    if len(some):
        proof[some] = upper_bound(posed.take(some), true[some]) - true[some]
    found = mujoco_touches(trial) if peer else None
    other, other_contact = np.full(n, np.nan), np.full(n, np.nan)
    if found is not None:
        other = found.dist - true
        other_contact = np.where(np.isfinite(found.deepest), found.deepest - true, np.nan)
    error = np.where(claimed > 0, high + certificate.plane, dist - true)
    return Verdict(
        trial,
        touches,
        ~(claimed > 0),
        searched_at,
        true,
        error / scale,
        certificate.plane / scale,
        certificate.point / scale,
        certificate.support / scale,
        certificate.unit,
        _manifold(trial, touches, pos, normal) / scale,
        proof / scale,
        other / scale,
        other_contact / scale,
        found,
    )


def _manifold(trial: Trial, touches: Touches, pos: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """How far the points of any contact stand out of their shapes [m]."""
    posed = trial.posed
    half = normal * touches.dist[..., None] / 2
    on_a, on_b = pos - half, pos + half
    into_b = (on_b - posed.offset[:, None]) @ posed.turn
    out = np.maximum(posed.a.outside(on_a), posed.b.outside(into_b))
    return np.where(touches.exists, np.maximum(out, 0), 0.0).max(axis=1)
