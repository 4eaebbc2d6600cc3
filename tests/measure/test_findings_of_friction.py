"""Joints that creep under less than their friction loss: the closed form, and fixes when made."""

import re

import menagerie
import numpy as np
import pytest
from test_findings import G, the, watched

import stepcore as sc

# MuJoCo's issue 2082.
ARM = """<mujoco><worldbody><body pos="0 0 1">
<joint name="j" axis="0 1 0" frictionloss="5"{}/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".5"/></body></worldbody></mujoco>"""
# MuJoCo's issue 2430.
WRITTEN = r'solreffriction="([^"]+)" with solimpfriction="([^"]+)" leaves ([\d.]+) µrad/s'


def creep(scene, time=1.0):
    """The one finding, and the solver parameters and the creep [rad/s] of its fix."""
    one = the(watched(scene, time)[1], "creep")
    solref, solimp, left = re.search(WRITTEN, one.text).groups()
    fields = f' solreffriction="{solref}" solimpfriction="{solimp}"'
    return one, fields, float(left) * 1e-6


def test_the_creep_of_an_arm_held_by_friction_is_r_f_over_b():
    one, fields, left = creep(sc.loads(ARM.format("")))
    load = 0.5 * G * 0.15
    # d = 0.9, tc = 0.02, dmax = 0.95.
    (inverse,) = sc.loads(ARM.format("")).compile().dof_invweight0
    rate = load * inverse * (0.1 / 0.9) * 0.95 * 0.02 / 2
    assert one.value == pytest.approx(rate, rel=0.02) and one.unit == "rad/s"
    assert one.element == "friction loss of joint `j`" and "15 % of its 5 N·m" in one.text
    sim = sc.Sim(sc.loads(ARM.format(fields)))
    sim.step(250)
    angle = float(sim.qpos[0])
    sim.step(250)
    assert (float(sim.qpos[0]) - angle) / 0.5 == pytest.approx(left, rel=0.05)
    assert left < one.value / 20


@pytest.mark.parametrize(
    "fields", ['damping="5"', 'solreffriction="0.004 1" solimpfriction=".99 .999"']
)
def test_what_falls_or_rests_does_not_creep(fields):
    """Friction of 0.1 N·m slides under 0.74, and a hard row rests."""
    loose = ARM.format(f" {fields}").replace('frictionloss="5"', 'frictionloss=".1"')
    scene = sc.loads(ARM.format(f" {fields}") if "solref" in fields else loose)
    assert watched(scene)[1] == []


@pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")
def test_a_joint_that_a_servo_moves_does_not_creep():
    servo = '<actuator><position name="servo" joint="j" kp="100" kv="10"/></actuator></mujoco>'
    scene = sc.loads(ARM.format("").replace("</mujoco>", servo))
    _, findings = watched(scene, control=lambda time, sim: [0.2 * time])
    assert not [one for one in findings if one.kind == "creep"]


@menagerie.needed
def test_the_creep_of_a_quadruped_that_a_cure_leaves_is_how_far_its_feet_drift():
    """Under a PD controller it sways; the drift of the feet is measured without contacts."""
    scene = sc.load(menagerie.FOLDER / "unitree_go2" / "scene.xml")
    model = scene.compile()
    home = np.array(model.keys[0].qpos[7:])

    def stand(time, sim):
        return 100 * (home - sim.qpos[7:]) - 3 * sim.qvel[6:]

    result = sc.run(scene, control=stand, horizon=2.0, progress=False)
    one = next(f for f in result.findings if f.kind == "creep")
    impratio, left = re.search(r'impratio="(\d+)" leaves ([\d.]+) µm/s', one.text).groups()
    sim = sc.Sim(model.with_settings(cone="elliptic", impratio=float(impratio)))
    sim.reset(0)
    foot, places = model.index("geom", "RR"), []
    for _ in range(1000):
        sim.ctrl = stand(0, sim)
        sim.step()
        places.append(np.array(sim.geom_xpos[foot][:2]))
    drift = float(np.linalg.norm(places[-1] - places[499]))
    assert drift == pytest.approx(float(left) * 1e-6, rel=0.3) and drift < one.value / 20
