# %% [markdown]
# # The lesson
#
# **Five small scenes show how a simulation goes wrong, each with a number that can
# be calculated by hand.** An integrator can create energy. A contact that is a
# spring sinks in or explodes. A contact that is a constraint does neither, but it
# rests too deep if the time step is large. Bodies that rest on each other need more
# than one sweep of the solver. A grasp then puts everything into five rows.

# %%
import warnings

import matplotlib.pyplot as plt

import stepcore as sc
from stepcore import lesson
from stepcore.lesson.loop import Loop


def started(scene, **settings):
    """A simulation that stands at the scene's keyframe "start"."""
    sim = sc.Sim(scene, **settings)
    sim.reset("start")
    return sim


# %% [markdown]
# ## A step has four stages
#
# Every step of every scene is *place, detect, solve, commit*:
#
# - **place**: the velocities that forces alone would cause.
# - **detect**: one row for each contact, limit and friction, with the velocity
#   that it requires.
# - **solve**: the impulses that satisfy the rows, by sweeps over them.
# - **commit**: the velocities, and with them the new positions.
#
# `stepcore.lesson.loop` has them in numpy. Two balls of 1 kg at rest on each other
# would have −0.01962 m/s after a step of 2 ms. The rows require 0 m/s. One sweep
# leaves −0.011772 m/s for the lower ball, and the step moves it by −23.5 µm.

# %%
loop = Loop(lesson.stack(sweeps=1))
guess, last = loop.place()
J, target, softness, denominator = loop.detect(guess)
solved = loop.solve(guess, J, target, softness, denominator)
loop.commit(solved, last + (solved - guess))
print(f"place:  {guess[0]:.5f} and {guess[1]:.5f} m/s")
required = " and ".join(f"{abs(t):.0f}" for t in target)
print(f"detect: {len(J)} rows that require {required} m/s")
print(f"solve:  impulses {loop.impulse[0]:.6f} and {loop.impulse[1]:.6f} N·s,")
print(f"        velocities {solved[0]:.6f} and {solved[1]:.6f} m/s")
print(f"commit: heights {1e6 * loop.qpos[0]:.1f} and {1e6 * loop.qpos[1]:.1f} µm")

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
# ## Five rows: a grasp
#
# Two fingers hold a cube of 0.1 kg by friction, on an arm at the limit of its
# wrist. A step solves five rows together: two pushes, two slidings and one limit.
# Each sliding has two directions, of which only one carries the cube here. Each
# finger pushes with 3 N, friction carries half of the cube's 0.981 N at each side,
# and the limit holds the arm with 0.942 N·m.

# %%
sim = started(lesson.grasp())
sim.step(1000)
for row in sim.rows:
    force = abs(row["force"].round(9))
    print(
        f"{row['name']:28} {force:.4g} {'N·m' if row['kind'] == 'limit' else 'N'}"
    )
print(f"weight of the cube: {0.1 * 9.81:.3f} N, half of it {0.1 * 9.81 / 2:.4g} N")
print(f"limit: {sim.rows['force'][0]:.3f} N·m")

# %% [markdown]
# No row can be solved alone, since every one acts on the bodies of others. If the
# rows are solved to 1e-13 m/s, the cube has slipped by less than 1e-7 nm after
# 10 000 steps. With 5 sweeps from zero it slips by 0.161 mm.

# %%
_, *slips = lesson.run(sections=(5,))
print(slips[0].section)
for row in slips:
    if row.reference is None:
        print(f"{row.name}: {1e-6 * row.value:.3f} mm")
    else:
        print(f"{row.name}: {row.value:.1e} nm, below 1e-7: {row.value < 1e-7}")

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
