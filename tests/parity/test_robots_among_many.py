"""A robot among loose bodies and many geoms is solved as a robot, and as MuJoCo solves it."""

import mujoco
import numpy as np
import pytest

import stepcore as sc

LEGS = "".join(
    f"""<body pos="{x} {y} 0"><joint axis="0 1 0" frictionloss=".3" damping=".1"/>
    <geom type="capsule" size=".03" fromto="0 0 0 0 0 -.2" mass=".4"/><body pos="0 0 -.2">
    <joint axis="0 1 0" frictionloss=".2" damping=".1"/>
    <geom type="capsule" size=".025" fromto="0 0 0 .05 0 -.18" mass=".2"/></body></body>"""
    for x in (-0.2, 0.2)
    for y in (-0.12, 0.12)
)


def scene(bumps):
    """Legs that give way, ten balls on the floor, and so many bumps: without any, pairs are listed;
    among many they are found in each step."""
    balls = "".join(
        f"""<body pos="{0.3 * (i % 5) - 0.6} {0.8 * (i // 5) - 0.4} .06"><freejoint/>
        <geom size=".05" mass=".3"/></body>"""
        for i in range(10)
    )
    ground = "".join(
        f"""<geom size=".1" pos="{0.2 * (i % 12) - 1.1} {0.2 * (i // 12) - 1} -.08"/>"""
        for i in range(bumps)
    )
    return f"""<mujoco><option solver="Newton" tolerance="0" iterations="200" ls_iterations="100"
    ls_tolerance="1e-12"/><worldbody><geom type="plane" size="0 0 1"/>{ground}{balls}
    <body pos="0 0 .45"><freejoint/><geom type="capsule" size=".1" fromto="-.2 0 0 .2 0 0"
    mass="3"/>{LEGS}</body>
    </worldbody></mujoco>"""


@pytest.mark.parametrize("bumps", [0, 130])
def test_its_steps_are_mujocos(bumps):
    model = mujoco.MjModel.from_xml_string(scene(bumps))
    data, sim = mujoco.MjData(model), sc.Sim(sc.loads(scene(bumps)))
    assert sim.model.is_heap == (bumps > 0)
    for step in range(400):
        sim.qpos, sim.qvel = data.qpos, data.qvel
        mujoco.mj_step(model, data)
        sim.step()
        np.testing.assert_allclose(sim.qvel, data.qvel, rtol=0, atol=1e-8, err_msg=f"step {step}")


@pytest.mark.parametrize("bumps", [0, 130])
def test_its_bits_do_not_depend_on_threads_or_on_the_past(bumps):
    """What touches what changes from step to step, and with it how it is solved."""
    sim, threaded = (sc.Sim(sc.loads(scene(bumps)), threads=n) for n in (1, 2))
    sim.step(150)
    threaded.step(150)
    fresh = sc.Sim(sim.model)
    fresh.restore(sim.state())
    for world in (sim, threaded, fresh):
        world.step(350)
    assert sim.state() == threaded.state() == fresh.state()
