"""dm_control's dog: where its meshes' frames differ from MuJoCo's, which rounds vertices."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import mujoco
import numpy as np
import peers
import pytest

import stepcore as sc

ROUNDING = 6e-8  # of single precision
STOP = 3e-6  # where MuJoCo's search for principal axes ends [rad]


def dog_path() -> Path:
    suite = importlib.util.find_spec("dm_control")
    assert suite is not None and suite.origin is not None
    return Path(suite.origin).parent / "suite" / "dog.xml"


def moments(model: mujoco.MjModel, mesh: int) -> np.ndarray:
    """The principal moments of one of the dog's meshes, as MuJoCo compiles it alone."""
    name = model.paths[model.mesh_pathadr[mesh] :].split(b"\0")[0].decode().rpartition("/")[2]
    file = dog_path().parent / "dog_assets" / name
    scale = " ".join(map(str, model.mesh_scale[mesh]))
    text = f"""<mujoco><asset><mesh name="m" file="{file}" scale="{scale}"/></asset><worldbody>
    <body><freejoint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""
    return mujoco.MjModel.from_xml_string(text).body_inertia[1]


def test_meshes_turn_by_rounding_over_the_gap_of_their_moments():
    """By a few roundings over ε, the relative difference of the two moments across the axis."""
    theirs = mujoco.MjModel.from_xml_path(str(dog_path()))
    data = mujoco.MjData(theirs)
    mujoco.mj_forward(theirs, data)
    sim = sc.Sim(sc.load(dog_path()))
    sim.qpos = data.qpos
    sim.forward()
    largest = 0.0
    for index, geom in enumerate(peers.kept_geoms(sim, theirs)):
        turn = sim.geom_xmat[index].T @ data.geom_xmat[geom].reshape(3, 3)
        if theirs.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
            continue
        size = np.abs(turn - np.eye(3)).max()
        largest = max(largest, size)
        if size < 1e-6:
            continue
        own = moments(theirs, int(theirs.geom_dataid[geom]))
        for i, j in ((0, 1), (0, 2), (1, 2)):
            gap = abs(own[i] - own[j]) / own.max()
            assert abs(turn[i, j]) < STOP + 5 * ROUNDING / gap, (index, i, j)
    assert 1e-5 < largest < 1e-4
    assert sim.mass_matrix() == _near(peers.mass_matrix(theirs, data), 1e-10)
    assert sim.xpos == _near(data.xpos, 1e-14)


def _near(expected: np.ndarray, share: float):
    return pytest.approx(expected, abs=share * np.abs(expected).max())
