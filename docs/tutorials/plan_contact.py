# %% [markdown]
# # Plan through contact
#
# **A finger pushes a puck to a place 0.25 m away. Before it touches the puck, the
# gradient of the puck's place by the controls is zero: it says nothing. Sampling
# finds the first touch, and exact gradients take the miss from there to below
# 0.1 mm. Steps of 5 ms make 4 mm of it: the error bar says so, and the plan is made
# again with shorter ones.** The way: `rollout`, `vjp`, and `error_bar`.

# %%
import numpy as np

import stepcore as sc

TABLE = """
<mujoco model="pusher">
  <option timestep="0.005" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0" mass="0.2"/></default>
  <worldbody>
    <body name="finger" pos="-0.1 0 0">
      <joint name="push" type="slide" axis="1 0 0" damping="2"/>
      <geom name="tip" size="0.02" contype="1"/>
    </body>
    <body name="puck">
      <joint name="slide" type="slide" axis="1 0 0" damping="0.5"
        frictionloss="0.2"/>
      <geom name="side" type="box" size="0.03 0.03 0.03" conaffinity="1"/>
    </body>
  </worldbody>
  <actuator><motor joint="push" ctrlrange="-5 5"/></actuator>
</mujoco>
"""
model = sc.loads(TABLE).compile()
KNOTS, GOAL = 10, 0.25


def controls(model, plans):
    """Each of ten forces [N] is held for a tenth of the second."""
    held = round(1 / KNOTS / model.settings.dt)
    return np.repeat(plans, held, axis=1)[:, :, None]


def miss(run):
    """How far the puck is from its goal at the end, and its speed in 0.1 s."""
    return np.stack([run.qpos[:, -1, 1] - GOAL, 0.1 * run.qvel[:, -1, 1]], axis=1)


# %% [markdown]
# ## Where a gradient says nothing
#
# At rest nothing touches. Whatever a small force changes, the puck stays.

# %%
nothing = controls(model, np.zeros((1, KNOTS)))
last = np.zeros((1, nothing.shape[1], 2))
last[0, -1, 1] = 1.0
found = sc.Batch(model, 1).vjp(nothing, last)
print(f"gradient of the puck's place by the controls: {np.abs(found.ctrl).max()}")

# %% [markdown]
# That is no error: the derivative is exact, and right for small changes. A plan has
# to touch first, and which plans do, only trying tells.

# %%
rng = np.random.default_rng(0)
tried = rng.normal(0, 1.5, (256, KNOTS)).clip(-5, 5)
batch = sc.Batch(model, len(tried))
off = np.linalg.norm(miss(batch.rollout(controls(model, tried))), axis=1)
plan = tried[off.argmin()]
print(f"256 plans: the best misses by {1e3 * off.min():.0f} mm")

# %% [markdown]
# ## Where it says all
#
# From a plan that touches, `vjp` gives the derivative of the two numbers that
# count, place and speed, by all forces at once: two worlds, each with the gradient
# of one. Gauss and Newton's step follows, in as many lengths as a batch has worlds,
# and the best is kept.


# %%
def refined(model, plan):
    """The plan after 15 steps of Gauss and Newton, and what it misses [m]."""
    two, lengths = sc.Batch(model, 2), sc.Batch(model, 8)
    steps = controls(model, plan[None]).shape[1]
    by = {name: np.zeros((2, steps, 2)) for name in ("qpos", "qvel")}
    by["qpos"][0, -1, 1], by["qvel"][1, -1, 1] = 1.0, 0.1
    for _ in range(15):
        two.reset()
        found = two.vjp(controls(model, np.tile(plan, (2, 1))), **by)
        slopes = found.ctrl.reshape(2, KNOTS, -1).sum(axis=2)
        way = np.linalg.lstsq(slopes, miss(found.rollout)[0], rcond=1e-6)[0]
        tried = (plan - np.outer(0.5 ** np.arange(8), way)).clip(-5, 5)
        lengths.reset()
        off = np.linalg.norm(miss(lengths.rollout(controls(model, tried))), axis=1)
        plan = tried[off.argmin()]
    return plan, off.min()


plan, off = refined(model, plan)
print(f"after 15 steps it misses by less than 0.1 mm: {off < 1e-4}")
print(f"the forces [N]: {plan.round(1).tolist()}")

# %% [markdown]
# ## Does the plan hold when steps are short?
#
# It was made with steps of 5 ms, and an impact is in it. The error bar runs finer
# steps beside.


# %%
def error(model, plan):
    """What finer steps change at the end [mm]."""
    sim = sc.Sim(model, error_bar=True)
    for force in controls(model, plan[None])[0]:
        sim.ctrl[:] = force
        sim.step()
    return 1e3 * sim.error.largest


print(f"finer steps miss by {error(model, plan):.0f} mm")

# %% [markdown]
# So the plan is as good as its steps. Made again with steps of 0.5 ms, from where
# it is, finer ones change 0.6 mm.

# %%
fine = model.with_settings(dt=0.0005)
plan, off = refined(fine, plan)
print(f"with steps of 0.5 ms it misses by less than 0.1 mm: {off < 1e-4}")
print(f"finer steps miss by {error(fine, plan):.1f} mm")
