# %% [markdown]
# # When the step should choose itself
#
# **A ball that bounces needs steps of microseconds for a moment, else long ones.
# With `accuracy="0.1mm"` it takes each where it must; at the same error this is a
# third of the work of the best fixed step.** In smooth motion a fixed step is
# cheaper: `trade` tells which is which.

# %%
import matplotlib.pyplot as plt
import numpy as np

import stepcore as sc

BALL = """
<mujoco model="ball">
  <option timestep="0.002"/>
  <default><geom solref="-20000 -20"/></default>
  <worldbody>
    <geom type="plane" size="1 1 .1"/>
    <body name="ball" pos="0 0 .4"><freejoint/><geom size=".1" mass="1"/></body>
  </worldbody>
</mujoco>
"""
scene = sc.loads(BALL)

# %% [markdown]
# ## Ask, and see what was delivered
#
# `dt` is how often one looks (and the period of a controller); each step of it is
# made of as many shorter ones as 0.1 mm takes. `error_bar=True` runs a finer one
# beside, from which the error of this run is known.

# %%
sim = sc.Sim(scene, dt=0.02, accuracy="0.1mm", error_bar=True)
run = sim.run(1.0, record=("qpos",))
print(f"requested 0.1 mm, at most {1e3 * run.error.max():.3f} mm off")

# %%
fig, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(7, 4))
above.plot(run.time, run.qpos[:, 2])
above.set_ylabel("height [m]")
below.semilogy(run.time[1:], run.error[1:, 1])
below.set(xlabel="time [s]", ylabel="error [m]")
fig.tight_layout()

# %% [markdown]
# ## Is that true?
#
# Very short steps of one length say so, which control nothing.

# %%
true = sc.Sim(scene, dt=1e-5)
heights = [true.qpos[2]]
for _ in range(50):
    true.step(2000)
    heights.append(true.qpos[2])
off = np.abs(run.qpos[:, 2] - heights).max()
print(f"really off by less than 0.1 mm: {off < 1e-4}")

# %% [markdown]
# ## What would a fixed step cost?
#
# `trade` measures both, counts operations and recommends.

# %%
asked = {"error": "0.5mm", "starts": 2, "further": 2, "by": "flops"}
trade = sc.trade(scene, horizon=1.0, **asked, progress=False)
chosen = trade.recommended
print(
    f"recommended: steps within an accuracy: {chosen.settings.accuracy is not None}"
)
fixed = [
    row
    for row in trade.rows
    if row.settings.accuracy is None and trade.error(row) <= 5e-4
]
if fixed:
    best = min(row.work for row in fixed)
    print(
        f"the best fixed step takes {best / chosen.work:.0f} times the operations"
    )
else:
    print("no fixed step tried is as accurate")

# %% [markdown]
# ## A smooth motion is another matter
#
# A chain of hinges, no contact: `rk4` at a fixed step is cheaper, and `trade`
# recommends that.

# %%
LINK = """<body name="link{k}" pos="{x} 0 0"><joint axis="0 1 0"/>
<geom type="capsule" size=".02" fromto="0 0 0 .2 0 0" contype="0"
conaffinity="0"/>"""
links = "".join(LINK.format(k=k, x=0.2 if k else 0) for k in range(3))
chain = sc.loads(f"<mujoco><worldbody>{links}{'</body>' * 3}</worldbody></mujoco>")
smooth = sc.trade(chain, horizon=0.5, **asked, progress=False)
best = smooth.recommended.settings
print(f"recommended: {best.integrator}, a fixed step: {best.accuracy is None}")
