"""`run`: momentum against impulse, what a run shows, and one that fails."""

import json

import numpy as np
import pytest

import stepcore as sc
from stepcore.experiment.schedule import scheduled
from stepcore.measure.run import run

CART = """<mujoco model="cart"><option timestep="0.01" gravity="0 0 0"/><worldbody>
<body name="cart"><joint name="x" type="slide" axis="1 0 0"/><geom size=".1" mass="2"/></body>
</worldbody><actuator><motor name="a" joint="x" ctrlrange="-10 10"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def cart():
    return sc.loads(CART).compile()


@pytest.mark.parametrize(
    "push",
    ["cart:6,0,0@0.5+0.2", ("cart", (6, 0, 0), 0.5, 0.2), ("cart", np.array([6, 0, 0]), 0.5, 0.2)],
)
def test_a_push_is_an_impulse(cart, push):
    result = sc.run(cart, pushes=[push])
    assert result.sim.qvel[0] == pytest.approx(6 * 0.2 / 2, abs=1e-12)
    assert "push cart:6,0,0@0.5+0.2" in result.ran


def test_it_is_the_motion_of_a_sim(cart):
    result = sc.run(cart, horizon=0.5, control=lambda time, sim: [time], record=("qpos", "ctrl"))
    sim = sc.Sim(cart)
    own = sim.run(0.5, lambda time, sim: [time], record=("qpos", "ctrl"))
    np.testing.assert_array_equal(result.trajectory["qpos"], own["qpos"])
    np.testing.assert_array_equal(result.sim.qpos, sim.qpos)
    assert result.steps == 50 and result.success and result.us_per_step > 0


@pytest.mark.parametrize("form", [dict, sc.Motion])
def test_sines_are_the_controls_of_a_measurement(cart, form):
    """A measurement of one start with this seed has these controls: impulses, m Δv = Σ F Δt."""
    motion = form(horizon=0.2, kind="sines", control_dt=0.02, seed=3)
    result = sc.run(cart, motion) if form is sc.Motion else sc.run(cart, **motion)
    (rows,) = scheduled(sc.Motion(horizon=0.2, starts=1, seed=3, kind="sines"), cart, 0.02).ctrl
    assert result.sim.qvel[0] == pytest.approx(0.02 * rows.sum() / 2, abs=1e-12) != 0
    assert "test motion: random sines" in result.ran


def test_it_says_what_went_wrong():
    """A mass of 2 kg hangs on a servo of 80 N/m."""
    hoist = CART.replace('gravity="0 0 0"', "").replace('axis="1 0 0"', 'axis="0 0 1"')
    hoist = hoist.replace("<motor", '<position kp="80" kv="20"').replace('ctrlrange="-10 10"', "")
    result = sc.run(sc.loads(hoist.replace('name="x"', 'name="x" range="-1 1"')), horizon=4.0)
    (finding,) = result.findings
    assert finding.kind == "servo sags" and finding.text in str(result).replace("\n", " ")
    data = json.loads(result.to_json())
    keys = {"kind", "ran", "steps", "time", "qpos", "qvel", "kinetic", "potential", "contacts"}
    assert keys | {"residual", "us_per_step", "notes", "findings", "settings"} <= set(data)
    assert data["kind"] == "run" and data["kinetic"] == pytest.approx(result.sim.energy.kinetic)


def test_a_run_that_fails_is_a_result_with_its_replay():
    result = sc.run(
        sc.lesson.spring().with_settings(dt=0.205, integrator="semi-implicit"), horizon=1e4
    )
    assert not result.success and isinstance(result.error, sc.SimulationError)
    assert result.steps == result.error.step and str(result.error)[:20] in str(result)
    assert result.error.replay.run() is not None


def test_a_plot_needs_a_record(cart, tmp_path):
    with pytest.raises(ValueError, match=r"nothing was recorded: run\(…, record="):
        sc.run(cart, horizon=0.05).plot()
    sc.run(cart, horizon=0.05, record="energy").plot(tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 0


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"pushes": ["crat:1,0,0@0"]}, "no body is named 'crat'; nearest: \"cart\""),
        ({"pushes": ["cart:1,0@0"]}, "BODY:FX,FY,FZ@T"),
        ({"pushes": [("world", (1, 0, 0))]}, "no body is named 'world'"),
        ({"pushes": [("cart", (1, 0))]}, "must be 3 finite numbers"),
        ({"horizon": 0.0}, "horizon = 0"),
        ({"record": "qpso"}, 'nearest: "qpos"'),
        ({"control_dt": 0.015}, "whole number of steps"),
        ({"starts": 2}, "no argument"),
    ],
)
def test_bad_arguments_are_named(cart, given, text):
    with pytest.raises(ValueError, match=text.replace("(", r"\(")):
        run(cart, **given)
