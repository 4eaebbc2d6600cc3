# %% [markdown]
# # Find your robot's friction
#
# **Two seconds of encoder readings tell the dry friction of two joints, a mass and
# the delay of the controls. With steps of 2 ms the shoulder's friction comes out as
# 0.635 N·m in place of 0.6, and the first line of the answer says that the error of
# the step is to blame.** With short steps all four intervals hold the true value.
# The way: a log, `identify`, and `trade`.

# %%
import numpy as np

import stepcore as sc

ARM = """
<mujoco model="arm">
  <option timestep="0.002" integrator="implicitfast"/>
  <default><geom type="capsule" size="0.02" mass="1"/></default>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.2" frictionloss="0.1"/>
      <geom fromto="0 0 0 0.3 0 0"/>
      <body name="fore" pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0" damping="0.1" frictionloss="0.1"/>
        <geom fromto="0 0 0 0.3 0 0" mass="0.8"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="lift" joint="shoulder" kp="100" kv="4"/>
    <position name="bend" joint="elbow" kp="60" kv="2"/>
  </actuator>
</mujoco>
"""
arm = sc.loads(ARM)

# %% [markdown]
# ## The log
#
# A real log comes from a file: `identify` reads CSV, Parquet, pandas and MCAP, with
# columns by joint and actuator. Here a simulated robot with values of its own makes
# it, in steps of 0.1 ms: positions every 5 ms, with noise of 1 mrad, and controls
# that act 8 ms late. Velocities are not measured.

# %%
TRUE = {
    "joint/shoulder/frictionloss": 0.6,
    "joint/elbow/frictionloss": 0.25,
    "body/fore/mass": 1.1,
}
DELAY, PERIOD = 0.008, 0.005  # 8 ms, 5 ms
time = PERIOD * np.arange(400)
targets = np.stack(
    [0.5 * np.sin(3 * time) + 0.2 * np.sin(11 * time), 0.8 * np.sin(5 * time)],
    axis=1,
)
robot = sc.Sim(arm.compile().with_values(TRUE), dt=0.0001)  # 0.1 ms
fine = robot.settings.dt * np.arange(20000)
acting = np.searchsorted(time, fine - DELAY + 1e-9, "right") - 1
run = robot.run(2.0, control=targets[np.maximum(acting, 0)], record=("qpos",))
noise = np.random.default_rng(0).normal(0, 1e-3, (400, 2))
log = {
    "time": time,
    "qpos": run.qpos[:-1:50] + noise,
    "lift": targets[:, 0],
    "bend": targets[:, 1],
}

# %% [markdown]
# ## The values, and what the step makes of them
#
# Each value has a range. The first guess is what the model has; a delay begins at
# the low end of its range.

# %%
RANGES = dict.fromkeys(TRUE, (0.01, 5)) | {"delay": (0, 0.05)}
found = sc.identify(arm, log, RANGES, progress=False)
print(found)
print(f"shoulder: {found.values['joint/shoulder/frictionloss']:.3f} N·m")

# %% [markdown]
# The residual is hardly more than the noise of 1 mrad. All the same the values are
# off: steps of 2 ms err by more than the noise, and the values make up for it. The
# first line says so, because the prediction was run with shorter steps too, and the
# intervals are wider for it. The column `finer` has what these steps would find.
# Nothing but the step needs to change:

# %%
found = sc.identify(arm.with_settings(dt=0.00025), log, RANGES, progress=False)
for path, value in {**TRUE, "delay": DELAY}.items():
    low, high = found.intervals[path]
    print(f"{path}: {low:.4g} to {high:.4g}, true {value}: {low <= value <= high}")

# %%
found.plot()

# %% [markdown]
# ## The step to simulate with
#
# Values from short steps are the robot's, whatever step it is simulated with
# later. `trade` tells what that may be, on the motion of this very log: for 1 mm
# steps of 8 ms under rk4, at 0.96 times the cost of 2 ms.

# %%
robot = found.model.scene.with_settings(dt=0.002)
ctrl = {"time": time, "lift": targets[:, 0], "bend": targets[:, 1]}
trade = sc.trade(
    robot, ctrl=ctrl, error="1mm", starts=2, further=2, by="flops", progress=False
)
print("\n".join(trade.sentences[:3]))
