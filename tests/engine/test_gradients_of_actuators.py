"""Derivatives of a step against central differences, with every type of actuator."""

import numpy as np
import pytest
import tangents

import stepcore as sc

FLOOR = '<geom type="plane" size="9 9 1" solref=".05 1"/><site name="o" pos="0 0 2"/>'
ARM = """<body pos="0 0 1.5"><joint name="h" axis="0 1 0" damping=".1"/>
<geom size=".1" pos=".3 0 0"/><site name="s" pos=".3 0 0"/><site name="p" pos="0 .2 .1"/>
<body pos=".4 0 0"><joint name="b" type="ball"/><geom type="box" size=".1 .2 .05" pos=".1 0 0"/>
</body></body>"""
LOOSE = """<body name="g{0}" pos="{1} 2 {2}"><freejoint/><geom type="{3}" size=".1 .1 .1" mass="1"/>
<site name="g{0}"/></body>"""
TENDON = '<tendon><spatial name="t"><site site="o"/><site site="s"/></spatial></tendon>'
ACTUATORS = (
    '<motor joint="h" gear="2"/>',
    '<motor site="g{0}" gear="1 .5 0 .1 0 .2"/>',
    '<position joint="h" kp="9" kv=".3" timeconst=".1"/>',
    '<position site="g{0}" refsite="o" gear="1 0 0 0 .2 0" kp="30" kv="1"/>',
    '<velocity tendon="t" kv="2"/>',
    '<intvelocity joint="h" kp="9" actrange="-1 1"/>',
    '<damper joint="h" kv="1" ctrlrange="0 1"/>',
    '<cylinder tendon="t" timeconst=".2" bias="1 -2 -.3"/>',
    '<muscle tendon="t" lengthrange=".2 2" force="5"/>',
    '<adhesion body="g{0}" gain="8" ctrlrange="0 1"/>',
    '<adhesion body="g{0}" gain="5" ctrlrange="0 1"/>',
    '<general cranksite="s" slidersite="o" cranklength="2" gainprm="3" biastype="affine"'
    ' biasprm="1 -3 -.2" dyntype="filterexact" dynprm=".05"/>',
    '<pid joint="h" input="pos vel" kp="4" kv=".2" ki="1" slewmax="2"/>',
    '<dcmotor joint="h" nominal="12 3 20" input="pos" controller="3 1 .1"'
    ' lugre="10 .1 .2 .3 .1" cogging=".1 7 .3" thermal="2 30 0 .004 20 25" inductance=".01"/>',
    '<orientation joint="b" kp="5" kv=".3" input="quat"/>',
)
SETTINGS = (
    *({"integrator": name} for name in ("semi-implicit", "euler", "implicitfast", "implicit")),
    {"integrator": "discrete"},
    {"integrator": "rk4"},
    {"cone": "elliptic"},
    {"law": "penalty", "penalty_stiffness": 3e3},
)
EXACT = {"solver": "newton", "tolerance": 1e-14, "sweeps": 300, "dt": 0.004}


def machine(rng):
    """An arm and a few loose bodies on the floor, with some actuators."""
    count = int(rng.integers(1, 6))
    drop = [(k, 3 * k, rng.uniform(0.09, 0.1), rng.choice(["sphere", "box"])) for k in range(count)]
    loose = "".join(LOOSE.format(*one) for one in drop)
    chosen = rng.choice(len(ACTUATORS), size=rng.integers(1, 5), replace=False)
    driven = "".join(ACTUATORS[k].format(rng.integers(count)) for k in chosen)
    bounds = '<option><flag clampctrl="disable"/></option>'
    world = f"{bounds}<worldbody>{FLOOR}{ARM}{loose}</worldbody>{TENDON}"
    return sc.loads(f"<mujoco>{world}<actuator>{driven}</actuator></mujoco>")


def differences(sim, h):
    """[A B] by central differences."""
    model, start = sim.model, sim.state()
    nv, na = model.nv, model.na
    ctrl, columns = sim.ctrl.copy(), []
    for way in np.eye(2 * nv + na + model.nu):
        ends = []
        for step in (h * way, -h * way):
            dq, dv, dw, du = np.split(step, [nv, 2 * nv, 2 * nv + na])
            sim.restore(start)
            sim.qpos[:] = tangents.moved(model, sim.qpos, dq)
            sim.qvel += dv
            sim.act += dw
            sim.ctrl[:] = ctrl + du
            sim.step()
            ends.append((sim.qpos.copy(), sim.qvel.copy(), sim.act.copy()))
        there, here = ends
        dq = tangents.apart(model, there[0], here[0])
        columns.append(np.concatenate([dq, there[1] - here[1], there[2] - here[2]]) / (2 * h))
    sim.restore(start)
    sim.ctrl[:] = ctrl
    return np.array(columns).T


def check(seed):
    rng = np.random.default_rng([31, seed])
    sim = sc.Sim(machine(rng), **EXACT, **SETTINGS[seed % len(SETTINGS)])
    sim.qvel[:] = 0.1 * rng.normal(size=sim.model.nv)
    sim.ctrl[:] = rng.uniform(0.2, 0.8, sim.model.nu)
    sim.step(3)
    step = sim.linearize()
    got = np.hstack([step.A, step.B])
    # A wide difference may reach over a bound.
    wanted = [differences(sim, h) for h in (1e-6, 1e-7)]
    scale = 1 + np.abs(wanted[0])
    assert min((np.abs(got - w) / scale).max() for w in wanted) < 1e-5, seed


@pytest.mark.parametrize("seed", range(24))
def test_a_step_is_differentiated_whatever_drives_it(seed):
    check(seed)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(24, 324))
def test_many_steps_are_differentiated_whatever_drives_them(seed):
    check(seed)
