"""Noise of contact forces and force sensors: its size, and the parameter that lowers it, as run."""

import re

import numpy as np
import pytest
from test_findings import watched

import stepcore as sc
from stepcore.measure.monitors.contacts import noise

BOX = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1" {fields}/>
<body pos="0 0 .0999"><freejoint/><geom name="box" type="box" size=".1 .1 .1" mass="1" {fields}/>
<site name="s" type="box" size=".11 .11 .11"/></body></worldbody>
<sensor><touch name="t" site="s"/></sensor></mujoco>"""


def test_noise_is_the_rms_of_white_noise_and_none_of_a_slow_wave():
    white = 10 + np.random.default_rng(0).normal(0, 0.3, 4000)
    assert noise(white) == (pytest.approx(0.3, rel=0.05), pytest.approx(10, rel=0.01))
    assert noise(np.sin(np.linspace(0, 6.28, 500)))[0] < 1e-4


@pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")
def test_a_force_sensor_that_rattles_is_told_with_what_quiets_it():
    """A spring without damping: its force is read at other phases in each step."""
    text = BOX.format(fields='solref="-200000 0"')
    findings = watched(sc.loads(text))[1]
    one = next(one for one in findings if one.element == "sensor `t`")
    assert one.kind == "force noise" and one.value > 1 and one.unit == "N"
    solref, left = re.search(r'solref="([^"]+)" .* leaves (\S+) N', one.text).groups()
    sim = sc.Sim(sc.loads(BOX.format(fields=f'solref="{solref}"')))
    sim.step(400)
    read = []
    for _ in range(100):
        sim.step()
        read.append(float(sim.sensordata[0]))
    assert np.std(read) < 0.05 * 9.81 and float(left) < 0.05 * 9.81


def test_a_box_at_rest_is_quiet():
    assert watched(sc.loads(BOX.format(fields="")))[1] == []


def test_a_load_that_swings_slowly_is_no_noise():
    scene = sc.loads(
        """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .0996"><freejoint/>
        <geom type="box" size=".1 .1 .1" mass="1"/><body pos="0 0 .3"><joint type="slide"
        axis="0 0 1" stiffness="40"/><geom size=".05" mass=".5"/></body></body></worldbody>
        </mujoco>"""
    )
    watch, findings = watched(scene, time=2.0)
    assert not [one for one in findings if one.kind == "force noise"]
    late = watch.contacts.reading > len(watch) / 5
    forces = np.bincount(watch.contacts.reading[late], watch.contacts.force[late])
    assert forces.max() > 1.5 * forces[forces > 0].min()
