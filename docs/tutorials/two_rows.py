# %% [markdown]
# # PGS by hand on two rows
#
# **Two balls rest on each other: with one sweep per step the lower contact is
# 0.39 mm deep, with twenty sweeps 0.15 µm.** A step solves two rows, one for each
# contact. Projected Gauss-Seidel (PGS) visits one row after the other, and each
# visit disturbs the row before it. This page does it in numbers.

# %%
import inspect

import matplotlib.pyplot as plt
import numpy as np

import stepcore as sc
from stepcore import lesson
from stepcore.lesson.loop import Loop

# %% [markdown]
# ## The two rows
#
# Each ball has 1 kg and slides along a vertical line. `Loop` is the simulation loop
# of the lesson in plain numpy. Its stage `place` gives the velocities that gravity
# alone causes in a step of 2 ms, and `detect` gives the rows:
#
# - J: the velocity of a row is J v. Row 0 is the floor contact, and J picks the
#   lower ball. Row 1 is the contact between the balls, and J is the difference
#   of their velocities.
# - t: the target velocity of the row. It is 0 here, because the balls just touch.
# - s: the denominator of the row, J M⁻¹ Jᵀ plus the softness 0.5 of the lesson's
#   stack.

# %%
loop = Loop(lesson.stack())
v, _ = loop.place()
J, t, c, s = loop.detect(v)
print("velocities without contacts:", v, "m/s")
for i in range(len(J)):
    print(f"row {i}: J = {J[i]}, t = {t[i] + 0:.3f} m/s, s = {s[i]:.1f}")

# %% [markdown]
# ## One sweep by hand
#
# A visit of a row finds the impulse that brings its velocity to the target, and
# changes the velocities at once. Row 0 gets 0.01962/1.5 = 0.01308 N·s, and the
# lower ball then has −0.00654 m/s. Row 1 sees a difference of 0.01308 m/s and
# gets 0.01308/2.5 = 0.005232 N·s, which pushes the lower ball down again. Row 0
# is no longer solved.

# %%
floor = 0.01962 / 1.5
lower = -0.01962 + floor
between = (lower + 0.01962) / 2.5
print(f"row 0: {floor:.5f} N·s, lower ball {lower:.5f} m/s")
print(f"row 1: difference {lower + 0.01962:.5f} m/s, {between:.6f} N·s")
print(f"lower ball afterwards: {lower - between:.6f} m/s")

# %% [markdown]
# `Loop.sweep` is the same for any number of rows. The impulse is clamped to 0 or
# more, since a contact pushes and does not pull:

# %%
print(inspect.getsource(Loop.sweep))

# %% [markdown]
# ## Sweep after sweep
#
# At rest the floor carries both balls: 0.03924 N·s in a step. The contact
# between the balls carries one: 0.01962 N·s. Each line is one sweep, and the
# error is the largest distance of an impulse from these two values.

# %%
exact = np.array([0.03924, 0.01962])


def errors_of_sweeps(scene, sweeps, table=False):
    """The error of the impulses after each sweep [N·s]."""
    loop = Loop(scene)
    v, _ = loop.place()
    rows = loop.detect(v)
    loop.impulse = np.zeros(2)
    errors = []
    for k in range(1, sweeps + 1):
        loop.sweep(v, *rows)
        errors.append(np.abs(loop.impulse - exact).max())
        if table:
            numbers = "".join(f"{x:12.6f}" for x in (*loop.impulse, *v, errors[-1]))
            print(f"{k:5}{numbers}")
    return errors


print("sweep     floor     between   lower m/s   upper m/s       error")
soft = errors_of_sweeps(lesson.stack(), 20, table=True)

# %% [markdown]
# The error falls by nearly the same factor in each sweep. Softness in the
# denominator makes each change smaller than the row needs, so sweeps converge
# more slowly: the factor is 0.71. With softness 0 it is 0.50, the share of the
# upper ball in the mass of both.

# %%
rigid = errors_of_sweeps(lesson.stack(softness=0.0), 20)
for name, errors in (("softness 0.5", soft), ("softness 0", rigid)):
    print(f"{name}: factor {errors[-1] / errors[-2]:.2f}")
fig, ax = plt.subplots(figsize=(7, 3))
ax.semilogy(range(1, 21), soft, "o-", label="softness 0.5")
ax.semilogy(range(1, 21), rigid, "s-", label="softness 0")
ax.set(xlabel="sweeps", ylabel="error [N·s]", title="error of the impulses")
ax.set_xticks([1, 5, 10, 15, 20])
ax.legend()
fig.tight_layout()

# %% [markdown]
# ## From an impulse to a depth
#
# A step that leaves the impulses too small lets the balls sink. A deeper
# overlap raises the target β depth/dt, until the unfinished solve gives just
# the impulses that carry the balls. That depth does not grow further: it is the
# same after 2 s and after 20 s. For one sweep it is (1 + 2 softness m) g dt²/β
# with β = 0.2, which is 392.4 µm or 0.39 mm. With twenty sweeps 0.15 µm remain.

# %%


def depth(sweeps, law, softness, seconds=2):
    """The depth of the lower contact at rest [µm]."""
    loop = Loop(lesson.stack(sweeps, law, softness=softness))
    loop.step(round(seconds / 0.002))
    return -1e6 * loop.qpos[0]


for softness in (0.5, 0.0):
    formula = (1 + 2 * softness * 1.0) * 9.81 * 0.002**2 / 0.2
    print(f"softness {softness}: {1e6 * formula:.1f} µm or {1e3 * formula:.2f} mm")
print(f"after 20 s, one sweep: {depth(1, 'relaxed', 0.5, 20):.1f} µm")
print("sweeps   relaxed, 0.5   lesson, 0.5   softness 0   [µm]")
for sweeps in (1, 2, 5, 10, 20):
    depths = (
        depth(sweeps, "relaxed", 0.5),
        depth(sweeps, "lesson", 0.5),
        depth(sweeps, "lesson", 0.0),
    )
    print(f"{sweeps:6}" + "{:15.2f}{:14.2f}{:13.2f}".format(*depths))

# %% [markdown]
# The columns are three meanings of softness:
#
# - `relaxed`: softness is in the denominator alone. More sweeps remove its effect.
# - `lesson`: softness is also in the residual of the row (a regulariser). More
#   sweeps converge to a soft contact, which is 196.2 µm deep.
# - softness 0: no softness. One sweep leaves 196.2 µm, since the formula then
#   has no second term. [The lesson](../lesson/) shows this column.
#
# ## The same in the engine
#
# `sim.rows` is the table of rows of the last solve. It has the impulses of the
# sweep above, 0.013080 and 0.005232 N·s.

# %%
sim = sc.Sim(lesson.stack(1))
sim.reset("start")
sim.forward()
for row in sim.rows:
    print(f"{row['name']}: {row['impulse']:.6f} N·s")
for sweeps in (1, 20):
    sim = sc.Sim(lesson.stack(sweeps))
    sim.reset("start")
    sim.step(1000)
    print(f"sweeps {sweeps}: {-1e6 * sim.qpos[0]:.2f} µm deep")
