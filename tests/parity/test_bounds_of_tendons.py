"""Where a bound of a tendon or a joint holds the force of its actuators, these have no slopes.

Law: one step of each integrator that both have is MuJoCo's to 1e-9 of what moves, in lanes too; the
bound holds where the forces add up to it once each actuator is within its own.
"""

import mujoco
import numpy as np
import peers
import pytest
from covering import every_pair

import stepcore as sc

TEXT = """<mujoco><option timestep=".01" gravity="0 0 0"/><worldbody>
    <body><joint name="j" type="slide" axis="1 0 0" {joint}/><geom size=".1" mass="1"/></body>
  </worldbody>
  <tendon><fixed name="t" {tendon}><joint joint="j" coef="1"/></fixed></tendon>
  <actuator><motor {at} {one}/><motor {at} {two}/><velocity {at} kv="2"/></actuator></mujoco>"""
BOUND = 'actuatorfrcrange="-4 3"'
OWN = ("", 'forcerange="-1.5 1.5"', 'forcerange="-2.5 1"')
# The third pair of motors is at the bound to the last bit.
CTRL = ((-7, 0, 0), (1, 0.5, 1), (3, 0, 1), (-4, 0, 1), (5, 5, 3), (-2, 9, -1), (1.5, 1.5, 0.5))


@every_pair(on=["joint", "tendon"], integrator=["implicitfast", "implicit", "euler"])
def test_slopes_end_where_a_sum_is_bounded(on, integrator):
    seen = set()
    for one in OWN:
        for two in OWN:
            text = TEXT.format(
                joint=BOUND if on == "joint" else "",
                tendon=BOUND if on == "tendon" else "",
                at=f'{on}="{on[0]}"',
                one=one,
                two=two,
            )
            theirs = mujoco.MjModel.from_xml_string(text)
            theirs.opt.integrator = peers.INTEGRATORS[integrator]
            data = mujoco.MjData(theirs)
            sim = sc.Sim(sc.loads(text), integrator=integrator, **peers.EXACT)
            batch = sc.Batch(sim.model, len(CTRL), integrator=integrator, **peers.EXACT)
            batch.qvel[:], batch.ctrl[:] = 1.0, CTRL
            batch.step()
            for world, ctrl in enumerate(CTRL):
                mujoco.mj_resetData(theirs, data)
                sim.reset()
                data.qvel[:] = sim.qvel[:] = 1.0
                data.ctrl[:] = sim.ctrl[:] = ctrl
                mujoco.mj_step(theirs, data)
                sim.step()
                pull = data.qfrc_actuator[0]
                seen.add(round((pull / ((data.qvel[0] - 1) / 0.01) - 1) / 0.01) if pull else 0)
                assert sim.qvel == pytest.approx(data.qvel, abs=1e-11), (ctrl, one, two)
                assert np.array_equal(batch.qvel[world], sim.qvel)
    # With and without the servo's damping; Euler has none.
    assert seen == ({0} if integrator == "euler" else {0, 2})


MOTORS = """<mujoco><option timestep=".01" gravity="0 0 0"/><worldbody>
    <body><joint name="j" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/></body></worldbody>
  <tendon><fixed name="t" actuatorfrcrange="-.5 .7"><joint joint="j" coef="1"/></fixed></tendon>
  <actuator><dcmotor tendon="t" nominal="12 3 20" {motor}/>{other}</actuator></mujoco>"""
COGS, RUBS = 'cogging=".1 7 .3"', 'lugre="10 .1 .2 .3 .1"'


@every_pair(
    motor=["", COGS, RUBS, f'{COGS} {RUBS} saturation=".4"', f'{COGS} inductance=".01"'],
    other=["", '<motor tendon="t"/>'],
    integrator=["euler", "implicitfast"],
)
def test_a_tendon_bounds_what_the_currents_of_its_motors_do(motor, other, integrator):
    """Their own bounds come after that, and then cogging and friction."""
    text = MOTORS.format(motor=motor, other=other)
    theirs = mujoco.MjModel.from_xml_string(text)
    theirs.opt.integrator = peers.INTEGRATORS[integrator]
    data = mujoco.MjData(theirs)
    sim = sc.Sim(sc.loads(text), integrator=integrator, **peers.EXACT)
    for ctrl in (-9, -1, 0.1, 5):
        for one in (data, sim):
            one.qpos[:], one.qvel[:], one.ctrl[:] = 0.2, 1.0, 0.5
            one.ctrl[0] = ctrl
            one.act[:] = 0.01
        mujoco.mj_forward(theirs, data)
        sim.forward()
        assert sim.actuator_force == pytest.approx(data.actuator_force, abs=1e-12)
        mujoco.mj_step(theirs, data)
        sim.step()
        for field in ("qvel", "act"):
            assert getattr(sim, field) == pytest.approx(getattr(data, field), abs=1e-12)
