"""Geoms and pairs that adhere, against MuJoCo and by closed forms."""

import mujoco
import numpy as np
import peers
import pytest
from covering import every_pair

import stepcore as sc

BALL = """<mujoco><option cone="{cone}" integrator="{integrator}" impratio="3"/>
  <worldbody><geom name="floor" type="plane" size="3 3 .1" gap=".01" adhesion="{floor}"/>
    <body name="b" pos="0 0 {height}"><freejoint/>
      <geom name="g" size=".1" mass="1" condim="{condim}" adhesion="{ball}" {more}/>
      <site name="s" size=".2"/></body></worldbody>{extra}
  <sensor><touch site="s"/><contact geom1="g" data="found force" num="1"/></sensor></mujoco>"""


def ball(**given):
    usual = {
        **{"cone": "pyramidal", "integrator": "Euler", "height": 0.0995, "condim": 3},
        **{"floor": 0, "ball": 20, "more": "", "extra": ""},
    }
    text = BALL.format(**(usual | given))
    model = peers.strict(mujoco.MjModel.from_xml_string(text))
    return model, mujoco.MjData(model), sc.Sim(sc.loads(text), **peers.EXACT)


def same(model, data, sim, steps=20):
    """Acceleration, and what sensors read, to 1e-9 at every step."""
    speed = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    data.qvel[:] = sim.qvel[:] = speed
    for _ in range(steps):
        mujoco.mj_forward(model, data)
        sim.forward()
        assert peers.apart(sim.qacc, data.qacc) < 1e-9
        assert sim.sensordata == pytest.approx(data.sensordata, rel=1e-9, abs=1e-9)
        total = data.qfrc_constraint + data.qfrc_passive
        forces = sum(sim.element_forces().values()) + 0.0
        assert peers.apart(forces - sim.element_forces()["gravity", 0], total) < 1e-9
        mujoco.mj_step(model, data)
        sim.step(1)
        assert peers.apart(sim.qvel, data.qvel) < 1e-9


@every_pair(height=[0.0995, 0.1, 0.102, 0.108], condim=[1, 3, 4, 6], cone=["pyramidal", "elliptic"])
def test_runs_are_mujocos(cone, condim, height):
    """On the floor, exactly at it, and within the gap, where it pulls without friction."""
    condim_of = {"condim": condim, "more": ""}
    same(*ball(cone=cone, height=height, **condim_of))


@pytest.mark.parametrize("integrator", ["implicitfast", "implicit", "RK4"])
def test_every_integrator(integrator):
    same(*ball(integrator=integrator), steps=5)


@pytest.mark.parametrize(
    "given",
    [
        {"floor": 7},
        {"floor": 7, "more": 'priority="1"'},
        {"extra": '<contact><pair geom1="floor" geom2="g" adhesion="3" gap=".02"/></contact>'},
        {"more": 'margin=".02"'},
    ],
)
def test_of_two_geoms_and_pairs(given):
    same(*ball(**given))


@every_pair(
    off=[(), ("spring",), ("damper",), ("spring", "damper")],
    condim=[1, 3, 6],
    cone=["pyramidal", "elliptic"],
    height=[0.0995, 0.102],
)
def test_without_passive_forces_contacts_do_not_pull(cone, condim, height, off):
    flags = " ".join(f'{flag}="disable"' for flag in off)
    extra = f"<option><flag {flags}/></option>"
    same(*ball(cone=cone, condim=condim, height=height, extra=extra), steps=5)


def test_a_ball_hangs_from_a_ceiling_until_it_is_too_heavy():
    """It holds 20 N and no more: with 19.9 N it stays within the gap, with 20.1 N it falls."""
    for weight, stays in ((19.9, True), (20.1, False)):
        sim = sc.Sim(
            sc.loads(
                f"""<mujoco><option gravity="0 0 {-weight}"/><worldbody>
        <geom type="box" size="1 1 .1" pos="0 0 .1"/>
        <body pos="0 0 -.0999"><freejoint/><geom size=".1" mass="1" adhesion="20" gap=".01"/></body>
        </worldbody></mujoco>"""
            )
        )
        sim.step(2000)
        assert (sim.qpos[2] > -0.11) == stays


def test_a_load_rests_as_deep_with_adhesion_as_without():
    ends = []
    for adhesion in (0, 20):
        _, _, sim = ball(ball=adhesion, cone="elliptic")
        sim.step(5000)
        ends.append(sim.qpos[2])
    assert ends[0] == pytest.approx(ends[1], abs=1e-10)


def test_lanes_are_single_worlds():
    """Bit for bit: some on the floor, some within the gap, some beyond."""
    for cone in ("pyramidal", "elliptic"):
        model = ball(cone=cone, condim=4)[2].model
        heights = np.linspace(0.099, 0.113, 16)
        batch = sc.Batch(model, 16, lanes=True)
        single = [sc.Sim(model) for _ in heights]
        for world, height in enumerate(heights):
            batch.qpos[world, 2] = single[world].qpos[2] = height
            batch.qvel[world] = single[world].qvel[:] = np.linspace(-0.2, 0.3, 6)
        batch.step(20)
        for world, sim in enumerate(single):
            sim.step(20)
            assert batch.qpos[world].tobytes() == sim.qpos.tobytes()


def test_the_ledger_balances():
    """What contacts that pull take and give is theirs: nothing is left over."""
    sim = ball(height=0.105)[2]
    sim = sc.Sim(sim.model, ledger=True)
    sim.step(2000)


def test_laws_on_velocities_refuse_it():
    model = ball()[2].model
    with pytest.raises(ValueError, match="adhere"):
        sc.Sim(model, law="rigid", solver="pgs")


def test_who_pulls_is_named():
    scene = ball()[2].model.scene
    assert "adhesion" in sc.plan(scene).text(1000, full=True)
