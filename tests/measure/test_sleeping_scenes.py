"""Measurements take scenes whose islands sleep: the reference is awake."""

import pytest

import stepcore as sc

# A slide that comes to rest on its limit.
TEXT = """<mujoco><option timestep=".002"><flag sleep="enable"/></option><worldbody>
  <body><joint name="j" type="slide" axis="0 0 1" range="-.01 1" damping="4"/>
    <geom size=".1" mass="1"/></body></worldbody></mujoco>"""
MEASURES = {
    "trade": lambda scene: sc.trade(
        scene, error=1e-3, horizon=0.2, dts=[0.002, 0.004], solvers=["newton"], precisions=["f64"]
    ),
    "diagnose": lambda scene: sc.diagnose(scene, horizon=0.2),
    "predictability": lambda scene: sc.predict(scene, horizon=0.2),
    "converge": lambda scene: sc.converge(scene, horizon=0.2),
    "ablate": lambda scene: sc.ablate(scene, horizon=0.2),
    "check": lambda scene: sc.check(scene, horizon=0.2),
}


@pytest.mark.parametrize("measure", MEASURES)
def test_a_scene_that_sleeps_is_measured(measure):
    scene = sc.loads(TEXT)
    assert scene.settings.sleep
    sim = sc.Sim(scene.compile())
    sim.step(100)
    assert sim.asleep[1]
    assert str(MEASURES[measure](scene))


def test_a_trade_offers_no_integrator_that_cannot_sleep():
    found = MEASURES["trade"](sc.loads(TEXT))
    assert found.shipped.settings.sleep
    tried = {row.settings.integrator for row in found.rows}
    assert tried and not tried & {"midpoint", "rk4"}
