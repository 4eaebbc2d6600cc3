"""Measurements of a model with adaptive steps, which has no fixed step length."""

import pytest

import stepcore as sc

BALL = """<mujoco model="ball"><option timestep=".02"/><worldbody>
 <geom name="floor" type="plane" size="1 1 .1"/><body name="ball" pos="0 0 .6"><freejoint/>
 <geom name="skin" size=".1" mass="1"/></body></worldbody></mujoco>"""
SPRING = """<mujoco model="spring"><option timestep=".02" gravity="0 0 0"/><worldbody>
 <body name="mass"><joint name="rail" type="slide" stiffness="100"/>
 <geom size=".1" mass="1"/></body></worldbody>
 <keyframe><key name="out" qpos=".2"/></keyframe></mujoco>"""


def model(text, accuracy="1mm"):
    return sc.loads(text).compile().with_settings(accuracy=accuracy)


def test_a_diagnosis_names_the_body_and_the_contact_that_make_steps_short():
    found = sc.diagnose(model(BALL), horizon=0.6, progress=False)
    inner = found.inner
    # It falls 0.5 m, for 0.319 s; that is in the step which starts at 0.30 s.
    step = inner.hardest["body `ball`"]
    assert step.time == pytest.approx(0.30)
    assert [element.name for element in step.begins] == ["contact `floor`/`skin`"]
    assert inner.shares["body `ball`"] > 0.5
    assert inner.shortest == step.shortest < 0.02 / 64
    text = str(found).replace("\n", " ")
    assert text.startswith("Within 1 mm a second, a step of 20 ms takes ")
    assert "where contact `floor`/`skin` begins" in text


def test_its_count_is_that_of_the_run():
    own = model(BALL)
    inner = sc.diagnose(own, horizon=0.6, progress=False).inner
    sim = sc.Sim(own)
    before = sim._core.evaluations
    for _ in range(30):
        sim.step()
    assert inner.evaluations == sim._core.evaluations - before
    assert inner.mean == pytest.approx(0.6 / inner.evaluations)


def test_a_smooth_motion_has_nobody_to_blame():
    found = sc.diagnose(model(SPRING, "10cm"), key="out", horizon=0.4, progress=False)
    assert found.inner.shares == {}
    assert "No body makes steps shorter than that" in str(found).replace("\n", " ")
    # Steps of a fixed length have a limit as always: 2/ω.
    assert found.limit("semi-implicit") == pytest.approx(0.2, rel=2e-3)


def test_fixed_steps_have_no_inner_ones():
    assert sc.diagnose(sc.loads(BALL), horizon=0.1, progress=False).inner is None


def test_a_map_of_a_model_with_adaptive_steps_has_fixed_ones():
    grid = {"path": "joint/rail/stiffness", "values": [100.0], "dts": [0.01, 0.3]}
    result = sc.stability_map(model(SPRING), **grid, key="out", progress=False)
    assert [cell.state for cell in result.rows] == ["accurate", "exploded"]
