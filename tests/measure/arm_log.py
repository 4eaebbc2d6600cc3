"""An arm with hidden values, and logs of its motion that MuJoCo or stepcore made."""

import numpy as np
import pytest

import stepcore as sc

ARM = """<mujoco><option timestep="0.002" integrator="Euler"/><worldbody>
 <body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0" damping="{damping}"
  armature=".01"/><geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass="1"/>
 <body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0" damping=".05"
  frictionloss="{loss}"/><geom name="rod" type="capsule" size=".03" fromto="0 0 0 .3 0 0"
  mass="{mass}"/><site name="hand" pos=".3 0 0"/></body></body></worldbody>
 <actuator><position name="a" joint="shoulder" kp="{kp}" kv="2"/><motor joint="elbow"/></actuator>
 <sensor>{sensors}</sensor></mujoco>"""
SENSORS = """<jointpos name="angle" joint="shoulder"/><gyro name="gyro" site="hand"/>
 <accelerometer name="imu" site="hand"/><framepos name="hand" objtype="site" objname="hand"/>
 <actuatorfrc name="pull" actuator="a"/>"""
TRUE = {"damping": 0.3, "loss": 0.04, "mass": 0.7, "kp": 60.0}
GUESS = {"damping": 0.1, "loss": 0.1, "mass": 0.4, "kp": 30.0}
RANGES = {
    "joint/shoulder/damping": (0.01, 2.0),
    "joint/elbow/frictionloss": (0.001, 0.5),
    "body/fore/mass": (0.1, 3.0),
    "actuator/a/kp": (5.0, 200.0),
}
HIDDEN = dict(zip(RANGES, TRUE.values(), strict=True))
DAMPING = "joint/shoulder/damping"


def controls(steps):
    time = np.arange(steps) * 0.002
    return np.stack([0.8 * np.sin(4 * time), 0.4 * np.sign(np.sin(7 * time))], axis=1)


def mujoco_log(steps=600, every=5, sensors="", **hidden):
    """The states that MuJoCo steps through, read every 10 ms.

    hidden: values of the first joint in MuJoCo's model, by the names of its arrays.
    """
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(ARM.format(**TRUE, sensors=sensors))
    for name, value in hidden.items():
        getattr(model, name)[0] = value
    data, ctrl = mujoco.MjData(model), controls(steps)
    rows = {"time": [], "qpos": [], "qvel": [], "ctrl": [], "sensordata": []}
    for step in range(steps):
        if step % every == 0:
            data.ctrl[:] = ctrl[step]
            mujoco.mj_forward(model, data)
            rows["time"].append(data.time)
            for key in ("qpos", "qvel", "ctrl", "sensordata"):
                rows[key].append(np.copy(getattr(data, key)))
        mujoco.mj_step(model, data)
    if not sensors:
        del rows["sensordata"]
    return {key: np.array(value) for key, value in rows.items()}


def noisy(log, seed=0):
    """A log with noise of 0.2 mrad and 2 mrad/s."""
    rng = np.random.default_rng(seed)
    sizes = {"qpos": 2e-4, "qvel": 2e-3}
    return log | {key: log[key] + rng.normal(0, s, log[key].shape) for key, s in sizes.items()}


def guess(sensors="", **known):
    """The arm with wrong values, except the given ones."""
    return sc.loads(ARM.format(**(GUESS | known), sensors=sensors)).compile()
