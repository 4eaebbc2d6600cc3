# %% [markdown]
# # The lesson
#
# **Four small scenes show how a simulation goes wrong, each with a number that can
# be calculated by hand.** An integrator can create energy. A contact that is a
# spring sinks in or explodes. A contact that is a constraint does neither, but it
# rests too deep if the time step is large. Bodies that rest on each other need more
# than one sweep of the solver.

# %%
import warnings

import matplotlib.pyplot as plt

import stepcore as sc
from stepcore import lesson


def started(scene, **settings):
    """A simulation that stands at the scene's keyframe "start"."""
    sim = sc.Sim(scene, **settings)
    sim.reset("start")
    return sim


# %% [markdown]
# ## An integrator can create energy
#
# A mass of 1 kg swings on a spring of 100 N/m: 2000 steps of 0.01 s. Its energy
# should stay constant. `explicit` multiplies it by 1 + (ω dt)² = 1.01 in every
# step, by 4.39e+08 in all. `semi-implicit` costs the same, and ends at 1.05 of the
# first energy.

# %%
growth = {}
with warnings.catch_warnings(record=True) as warned:
    warnings.simplefilter("always")
    for integrator in ("explicit", "semi-implicit", "midpoint", "rk4"):
        sim = started(lesson.spring(k=100.0, m=1.0), integrator=integrator, dt=0.01)
        before = sim.energy.total
        sim.step(2000)
        growth[integrator] = sim.energy.total / before
        print(f"{integrator:14} energy × {growth[integrator]:.3g}")
print(f"by theory: × {1.01**2000:.3g}")

# %% [markdown]
# The engine watches the energy, and its warning names the element that injected it:

# %%
print(warned[0].message)

# %% [markdown]
# ## A contact that is a spring
#
# A ball of 1 kg falls 0.30 m onto a floor (law `penalty`, 2 ms). With 1e4 N/m it
# sinks in by 21.8 mm. With 1e6 N/m it is thrown 2.32 m high, because the step is
# too large for such a spring.

# %%
fig, ax = plt.subplots(figsize=(7, 3))
for stiffness in (1e3, 1e4, 1e5, 1e6):
    scene = lesson.drop("penalty", penalty_stiffness=stiffness)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run = started(scene, dt=0.002).run(2.0)
    height = run.qpos[:, 0]
    deep, high = -1e3 * height.min(), height.max()
    print(f"{stiffness:.0e} N/m: {deep:.1f} mm deep, {high:.2f} m high")
    ax.plot(run.time, height, label=f"{stiffness:.0e} N/m")
ax.set(xlabel="time [s]", ylabel="height [m]", title="a ball on a spring, dt 2 ms")
ax.legend()
fig.tight_layout()

# %% [markdown]
# ## A contact that is a constraint
#
# Under the law `lesson` the solver finds the impulse for which the ball does not
# sink in any further. The ball comes to rest at every step size. Its depth is
# s m g dt²/β, with the softness s = 0.5 and β = 0.2: 98.1 µm at 2 ms, and a hundred
# times that at 20 ms.

# %%
for dt in (0.002, 0.01, 0.02):
    sim = started(lesson.drop("lesson"), dt=dt)
    sim.step(round(2.0 / dt))
    deep, theory = -1e6 * sim.qpos[0], 1e6 * 0.5 * 9.81 * dt**2 / 0.2
    print(f"dt {1e3 * dt:2g} ms: {deep:.1f} µm deep, by theory {theory:.1f} µm")

# %% [markdown]
# ## Two contacts, and sweeps
#
# One ball rests on another. The solver goes over the rows one by one, and each
# row undoes a part of the last row's solution. With equal balls and rigid rows
# a sweep halves the error: the lower contact is 196 µm deep with 1 sweep a
# step, and 0.000187 µm with 20. With the softness 0.5 of `lesson.stack` it is
# 0.39 mm: after one sweep the depth is (1 + 2 s m) g dt²/β, and softness 0
# leaves out the second term. [PGS by hand on two rows](../two_rows/) shows
# every sweep in numbers.

# %%
for sweeps in (1, 2, 5, 10, 20):
    sim = started(lesson.stack(sweeps, "lesson", softness=0.0))
    sim.step(1000)
    print(f"{sweeps:2} sweeps: {-1e6 * sim.qpos[0]:.3g} µm deep")
sim = started(lesson.stack(1))
sim.step(1000)
print(f"softness 0.5, one sweep: {-1e3 * sim.qpos[0]:.2f} mm deep")
result = sc.converge(
    lesson.stack(1, "lesson", softness=0.0), horizon=0.2, starts=1, progress=False
)
print(result.sentences[0])

# %% [markdown]
# ## All of it
#
# The whole lesson compares 74 figures with their references.
# `stepcore lesson --all` prints them.

# %%
rows = [row for row in lesson.run() if row.reference is not None]
print(
    f"{sum(row.ok for row in rows)} of {len(rows)} figures agree with the reference"
)
