# %% [markdown]
# # A grasp that holds
#
# **A cube that a gripper holds by friction sinks at 1.89 mm/s, and a smaller time
# step does not help. `stiction=True` stops it: below 1e-6 µm/s, at no smaller
# step.** The creep comes from MuJoCo's soft contact, stepcore's default: it softens
# friction rows as it softens normals, and they have no position to return to.
# `check` finds the creep and names its fixes.

# %%
import stepcore as sc

GRIPPER = """
<mujoco model="gripper">
  <option timestep="0.002" cone="elliptic"/>
  <default><geom friction="0.6" solref="0.01 1"/></default>
  <worldbody>
    <body name="left" pos="0 0.03 0.5">
      <joint name="left" type="slide" axis="0 -1 0" damping="5"/>
      <geom name="left" type="box" size="0.01 0.01 0.02" mass="0.05"/>
    </body>
    <body name="right" pos="0 -0.03 0.5">
      <joint name="right" type="slide" axis="0 1 0" damping="5"/>
      <geom name="right" type="box" size="0.01 0.01 0.02" mass="0.05"/>
    </body>
    <body name="cube" pos="0 0 0.5">
      <freejoint/>
      <geom name="cube" type="box" size="0.02 0.02 0.02" mass="0.1"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="left" joint="left"/>
    <motor name="right" joint="right"/>
  </actuator>
  <equality><joint joint1="left" joint2="right"/></equality>
  <keyframe>
    <key name="held" qpos="0 0  0 0 0.5 1 0 0 0" ctrl="2 2"/>
  </keyframe>
</mujoco>
"""
scene = sc.loads(GRIPPER)

# %% [markdown]
# ## Does it hold?
#
# Each finger presses with 2 N, so friction can carry 2 × 0.6 × 2 N = 2.40 N, and
# the cube weighs 0.981 N, 41% of that. By Coulomb's law it stands still.

# %%
weight, most = 0.1 * 9.81, 2 * 0.6 * 2.0
print(f"weight {weight:.3f} N, friction up to {most:.2f} N: {weight / most:.0%}")
print(sc.check(scene, progress=False).findings[0].text)

# %% [markdown]
# This page replays two seconds. Drag to turn, and watch the cube between the
# fingers:

# %%
sim = sc.Sim(scene)
sim.reset("held")
sim.run(2.0)

# %% [markdown]
# ## What helps
#
# The cube settles for a second; then we measure how far it sinks in the next two.
# A quarter of the time step changes nothing. `impratio` divides the creep by its
# value, but it makes friction stiffer and harder to solve. MuJoCo's
# `noslip_iterations` sweep over friction again after each solve. Only `stiction`
# changes the law of the contact: a spring holds the cube where it was gripped.


# %%
def creep(**settings):
    """How fast the cube sinks once it is gripped [µm/s]."""
    sim = sc.Sim(scene, **settings)
    sim.reset("held")
    second = round(1.0 / sim.settings.dt)
    sim.step(second)
    before = sim.body("cube").xpos[2]
    sim.step(2 * second)
    return 1e6 * (before - sim.body("cube").xpos[2]) / 2


shipped = creep()
print(f"as shipped         {shipped:8.0f} µm/s, {1e-3 * shipped:.2f} mm/s")
print(f"dt 0.5 ms          {creep(dt=0.0005):8.0f} µm/s")
print(f"pyramidal cone     {creep(cone='pyramidal'):8.0f} µm/s")
print(f"impratio 100       {creep(impratio=100):8.2f} µm/s")
print(f"noslip 20 sweeps   {abs(creep(noslip_iterations=20)):8.2f} µm/s")
held = creep(stiction=True)
print(f"stiction           {abs(held):8.2f} µm/s, below 1e-6: {abs(held) < 1e-6}")

# %% [markdown]
# `stiction` also holds the cube at 5 ms, two and a half times the step. If the
# weight is more than friction can carry, the cube slips, as it should:

# %%
print(f"stiction, dt 5 ms  {abs(creep(stiction=True, dt=0.005)):8.2f} µm/s")
sim = sc.Sim(scene, stiction=True)
sim.reset("held")
sim.ctrl[:] = 0.7
sim.step(500)
fallen = 0.5 - sim.body("cube").xpos[2]
print(f"gripped with 0.7 N each: {100 * fallen:.1f} cm lower after 1 s")

# %% [markdown]
# ## Keep it
#
# The file keeps the setting. stepcore reads it, and MuJoCo ignores it.

# %%
holds = scene.with_settings(scene.settings.replace(stiction=True))
text = holds.to_mjcf()  # holds.save("gripper.xml") writes it to a file
print(sc.loads(text).settings.stiction)
