"""MuJoCo's distances and contacts at the poses of a trial."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from .poses import Trial

OPTIONS = '<option ccd_tolerance="1e-12" ccd_iterations="500"/>'


class Found(NamedTuple):
    """By pose: dist and normal of `mj_geomDistance`, in the world, (n,) and (n, 3), NaN where its
    points coincide; the deepest
    distance of the contacts of a step, inf where there is none, and all of them: rows of
    distance, position and normal."""

    dist: np.ndarray
    normal: np.ndarray
    deepest: np.ndarray
    contacts: list[np.ndarray]


def mujoco_touches(trial: Trial, options: str = OPTIONS) -> Found:
    model = mujoco.MjModel.from_xml_string(trial.mjcf(options))
    data = mujoco.MjData(model)
    n = len(trial.poses)
    dist, normal, deepest, contacts = np.empty(n), np.empty((n, 3)), np.full(n, np.inf), []
    fromto = np.empty(6)
    for k, qpos in enumerate(trial.qpos):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        dist[k] = mujoco.mj_geomDistance(model, data, 0, 1, 1e10, fromto)
        between = (fromto[3:] - fromto[:3]) * np.sign(dist[k])
        length = np.linalg.norm(between)
        normal[k] = between / length if length > 0 else np.nan
        one = data.contact
        contacts.append(
            np.concatenate([one.dist[:, None], one.pos, one.frame[:, :3]], axis=1).copy()
        )
        if len(one.dist):
            deepest[k] = one.dist.min()
    return Found(dist, normal, deepest, contacts)
