# %% [markdown]
# # When simulation stops being predictable
#
# **A double pendulum that falls from a raised pose can be predicted for 3.6 s;
# after that no time step and no integrator gives its position.** Two runs that
# start a nanometre apart are far from each other before 20 s are over. Averages can
# still be compared. `predict` measures how long positions can be predicted.

# %%
import matplotlib.pyplot as plt
import numpy as np

import stepcore as sc

PENDULUM = """
<mujoco model="double pendulum">
  <option timestep="0.01" integrator="RK4"/>
  <default><geom contype="0" conaffinity="0" size="0.02" mass="1"/></default>
  <worldbody>
    <body name="upper">
      <joint name="upper" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -1"/>
      <body name="lower" pos="0 0 -1">
        <joint name="lower" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -1"/>
      </body>
    </body>
  </worldbody>
  <keyframe><key name="raised" qpos="2 0.5"/></keyframe>
</mujoco>
"""
scene = sc.loads(PENDULUM)

# %% [markdown]
# ## For how long?
#
# The motion runs again from states moved by 1.0e-10 of the scene's size. It counts
# as lost when this distance has grown more than 1000 times.

# %%
result = sc.predict(scene, horizon=20.0, starts=1, progress=False)
print(result.sentences[0])
print(result.setup)
print(f"predictable for {result.time:.1f} s")

# %%
result.plot()

# %% [markdown]
# ## The same by hand
#
# Two runs use a step of 1 ms; one of them starts 1e-09 rad away. The integrator is
# not the cause: at this step the total energy, which should stay constant, changes
# by less than 1e-07 of the largest kinetic energy.


# %%
def run(offset):
    sim = sc.Sim(scene, dt=0.001)
    sim.reset("raised")
    sim.qpos[0] += offset
    return sim.run(20.0, record=("qpos", "energy"))


exact, moved = run(0.0), run(1e-9)
apart = np.abs(exact.qpos - moved.qpos).max(axis=1)
for second in (0, 5, 10, 15, 20):
    print(f"{second:2} s: {apart[1000 * second]:.0e} rad apart")
total = exact.energy.sum(axis=1)
change = np.ptp(total) / exact.energy[:, 0].max()
print(f"energy changes by {change:.0e}, below 1e-07: {change < 1e-7}")

# %%
fig, ax = plt.subplots(figsize=(7, 3))
ax.semilogy(exact.time[1:], apart[1:])
ax.axvline(result.time, color="0.5", linestyle="--")
ax.set(xlabel="time [s]", ylabel="apart [rad]", title="two runs, 1e-9 rad apart")
fig.tight_layout()

# %% [markdown]
# ## What can be said beyond
#
# Position errors after that time say nothing about a setting, so measurements do
# not count them, and say so first.

# %%
trade = sc.trade(
    scene,
    horizon=20.0,
    starts=2,
    by="flops",
    integrators=["rk4"],
    dts=[0.01, 0.02],
    progress=False,
)
print(trade.sentences[0])
print(f"positions count until {trade.predictable:.1f} s")
