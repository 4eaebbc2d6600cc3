"""The answers of `diagnose` on public threads do not contradict themselves."""

import re

import pytest

import stepcore as sc

pytestmark = [
    pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning"),
    pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning"),
]

LEG = """<mujoco><option timestep="0.005"/><default><geom contype="0" conaffinity="0"/></default>
<worldbody><body pos="0 0 .6"><joint name="thigh" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -.213" size=".015" mass=".9"/><body pos="0 0 -.213">
<joint name="calf" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.213" size=".01"
mass=".15"/></body></body></worldbody><actuator><motor joint="thigh" ctrlrange="-23.7 23.7"/>
<motor joint="calf" ctrlrange="-35.5 35.5"/></actuator>
<keyframe><key qpos=".8 -1.5"/></keyframe></mujoco>"""
# Sentences about the same thing that cannot both be true.
PAIRS = (
    (r"explodes|rattles|chatters", r"is stable under|No element limits"),
    (r"a period of up to", r"without success: .*control period"),
    (r"does not limit dt", r"limits? dt to"),
    (r"No change that was tried", r"Not done: .*changes"),
)


def held(t, sim):
    q, v = sim.qpos, sim.qvel
    return [20 * (0.8 - q[0]) - 0.5 * v[0], 20 * (-1.5 - q[1]) - 0.5 * v[1]]


def answered(control_dt):
    scene = sc.loads(LEG)
    d = sc.diagnose(scene, control=held, control_dt=control_dt, integrators=(), progress=False)
    text = " ".join(d.text().split())
    for first, second in PAIRS:
        assert not (re.search(first, text) and re.search(second, text)), (first, second, text)
    assert "index = " not in text
    return d


def test_a_control_that_flutters_at_its_period_is_told_so_and_not_a_limit_of_dt():
    d = answered(20e-3)
    assert d.fails and d.limit() == 0 and d.longest_period == pytest.approx(5e-3)
    assert d.sentences[0].endswith("the control function is sampled too rarely.")
    assert not answered(5e-3).fails


@pytest.mark.parametrize("period, flutters", [(1, False), (4, True)])
def test_the_same_control_in_a_plain_loop(period, flutters):
    sim, fastest = sc.Sim(sc.loads(LEG), dt=5e-3), 0.0
    sim.reset(key=0)
    for step in range(140):
        if step % period == 0:
            sim.ctrl = held(sim.time, sim)
        sim.step()
        fastest = max(fastest, abs(sim.qvel).max())
    assert (fastest > 10) == flutters
