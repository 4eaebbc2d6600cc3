"""docs/atlas.md: its table is made from the kept rows, and MuJoCo recomputes some of these."""

import json
from pathlib import Path

import atlas
import mujoco
import numpy as np
import pytest

import stepcore as sc
from stepcore.experiment import Study
from stepcore.experiment.schedule import Schedule

KEPT = json.loads(atlas.KEPT.read_text())
# The reference of MuJoCo's loop: rk4 with this part of the file's step.
FINER = 64
# Nineteen rows agree to 10 %; of the quadruped MuJoCo has 9.9 mm where the row has 8.7 mm.
TOLERANCE = 0.15


def test_table_states_kept_rows() -> None:
    page = Path(atlas.PAGE).read_text()
    assert page.split("<!-- atlas -->\n")[1].split("<!-- end of atlas -->")[0] == atlas.table(KEPT)


def drive(model: mujoco.MjModel, schedule: Schedule) -> None:
    """Make servos of the motors that the motion drives as PD controllers."""
    for servo in schedule.controls.servos:
        k = model.actuator(servo.actuator).id
        model.actuator_gaintype[k] = mujoco.mjtGain.mjGAIN_FIXED
        model.actuator_biastype[k] = mujoco.mjtBias.mjBIAS_AFFINE
        model.actuator_gainprm[k, 0] = servo.kp
        model.actuator_biasprm[k, :3] = 0.0, -servo.kp, -servo.kv
        model.actuator_ctrllimited[k] = False
        model.actuator_forcelimited[k] = bool(np.isfinite(servo.forcerange).all())
        model.actuator_forcerange[k] = servo.forcerange


def path(model: mujoco.MjModel, schedule: Schedule, start: int, finer: int) -> tuple:
    """Run MuJoCo in a plain loop; return centres and orientations of all bodies, at samples."""
    data, dt = mujoco.MjData(model), model.opt.timestep
    begin = schedule.starts[start]
    data.qpos[:], data.qvel[:] = begin.qpos, begin.qvel
    if model.na:
        data.act[:] = begin.act
    rows, hold = schedule.rows([start], dt)
    every = schedule.every * schedule.steps(dt)
    com, quat = [], []
    for step in range(every * len(schedule.times)):
        if rows is not None:
            data.ctrl[:] = rows[0, min(step // hold, rows.shape[1] - 1)]
        mujoco.mj_step(model, data)
        if (step + 1) % every == 0:
            mujoco.mj_kinematics(model, data)
            com.append(np.array(data.xipos))
            quat.append(np.array(data.xquat))
    return np.array(com), np.array(quat)


def distance(model: mujoco.MjModel, a: tuple, b: tuple, samples: int) -> float:
    """Return the RMS of the distances of centres and of arcs at the radius of gyration."""
    moving = np.flatnonzero(model.body_weldid != 0)
    radius = np.sqrt(model.body_inertia.sum(axis=1)[moving] / 2 / model.body_mass[moving])
    away = np.linalg.norm(a[0] - b[0], axis=-1)[:samples, moving]
    cosine = np.abs((a[1] * b[1]).sum(axis=-1)).clip(0, 1)[:samples, moving]
    return float(np.sqrt(np.mean(away**2 + (2 * np.arccos(cosine) * radius) ** 2)))


def sampled() -> list[str]:
    """Draw twenty rows of installed collections."""
    # gymnasium's point slides on a plane that it touches at distance 0: rounding decides.
    names = {robot.key for robot in atlas.robots({})} - {"gymnasium/point"}
    rows = sorted(
        key
        for key, row in KEPT.items()
        if key in names and row.get("failure") == "" and row["error"] > 20 * row["uncertainty"]
    )
    rng = np.random.default_rng(20261201)
    return [rows[k] for k in rng.permutation(len(rows))[:20]]


@pytest.mark.long
@pytest.mark.parametrize("key", sampled())
def test_mujoco_recomputes_error_as_shipped(key: str) -> None:
    robot = next(robot for robot in atlas.robots({}) if robot.key == key)
    row = KEPT[key]
    study = Study(sc.load(robot.path), horizon=row["horizon"])
    schedule = study.schedule
    coarse, fine = (mujoco.MjModel.from_xml_path(str(robot.path)) for _ in range(2))
    fine.opt.timestep /= FINER
    fine.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    fine.opt.tolerance, fine.opt.iterations = 1e-15, 200
    drive(coarse, schedule)
    drive(fine, schedule)
    samples = int(np.sum(schedule.times <= row["predictable"]))
    errors = [
        distance(
            coarse,
            path(coarse, schedule, start, 1),
            path(fine, schedule, start, FINER),
            samples,
        )
        for start in study.starts
    ]
    assert max(errors) == pytest.approx(row["error"], rel=TOLERANCE)
