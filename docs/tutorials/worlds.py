# %% [markdown]
# # Thousands of worlds
#
# **A `Batch` steps 4096 inverted pendulums at once, each with the same bits as a
# single run: a linear controller catches 57% of the starts that we try.** The
# controller comes from the exact derivative of a step. The batch then shows where
# it works, in a few lines of numpy.

# %%
import time

import matplotlib.pyplot as plt
import numpy as np

import stepcore as sc

scene = sc.load("gymnasium:inverted_pendulum")

# %% [markdown]
# ## A controller from the derivative
#
# `Sim.linearize` gives the derivative of the step itself, x → A x + B u, for a step
# of 20 ms. The Riccati iteration of textbooks gives the gains K of u = −K x from A
# and B.

# %%
sim = sc.Sim(scene)
step = sim.linearize()
A, B = step.A, step.B
Q, R = np.diag([1.0, 1.0, 0.1, 0.1]), np.eye(1)
P = Q
for _ in range(2000):
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    P = Q + A.T @ P @ (A - B @ K)
grows = np.abs(np.linalg.eigvals(A)).max()
decays = np.abs(np.linalg.eigvals(A - B @ K)).max()
print(f"a step of {1e3 * sim.settings.dt:.0f} ms")
print(f"alone × {grows:.3f} a step, with K × {decays:.3f}")

# %% [markdown]
# Without control the pendulum's distance grows by a factor of 1.095 in every step.
# With the controller it shrinks by a factor of 0.964.
#
# ## Where does it work?
#
# 64 angles times 64 angular velocities are 4096 worlds. Worlds are the first axis
# of all arrays: `batch.qpos` has the shape (4096, 2).

# %%
angles, rates = np.linspace(-1.0, 1.0, 64), np.linspace(-4.0, 4.0, 64)
batch = sc.Batch(scene, 4096)
grid = np.meshgrid(angles, rates)
batch.qpos[:, 1], batch.qvel[:, 1] = grid[0].ravel(), grid[1].ravel()
print(batch.qpos.shape)


def control(qpos, qvel):
    """u = −K x of one world or many: the same sum in the same order."""
    states = (qpos[..., 0], qpos[..., 1], qvel[..., 0], qvel[..., 1])
    return np.clip(
        -sum(k * x for k, x in zip(K[0], states, strict=True)), -3.0, 3.0
    )


begun = time.perf_counter()
for _ in range(250):
    batch.ctrl[:, 0] = control(batch.qpos, batch.qvel)
    batch.step()
seconds = time.perf_counter() - begun
caught = np.abs(batch.qpos[:, 1]) < 0.1
print(f"{caught.sum()} of {len(caught)} worlds: {caught.mean():.0%}")

# %%
fig, ax = plt.subplots(figsize=(6, 4))
ax.pcolormesh(angles, rates, caught.reshape(64, 64), cmap="Blues", vmax=1.5)
ax.set(xlabel="angle [rad]", ylabel="angular velocity [rad/s]", title="caught")
fig.tight_layout()

# %% [markdown]
# The speed depends on the machine. On this one, controller included:

# %%
print(f"{4096 * 250 / seconds:.3g} steps a second")

# %% [markdown]
# ## The bits are those of one world
#
# Worlds are stepped together in the lanes of the processor's vector registers, and
# on all its cores. World 2000, stepped alone, has the same bits:

# %%
alone = sc.Sim(scene)
alone.qpos[1], alone.qvel[1] = grid[0].ravel()[2000], grid[1].ravel()[2000]
for _ in range(250):
    alone.ctrl[0] = control(alone.qpos, alone.qvel)
    alone.step()
print(alone.qpos.tobytes() == batch.qpos[2000].tobytes())
