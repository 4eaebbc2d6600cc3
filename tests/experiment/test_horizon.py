"""How long a motion without a horizon is simulated: until it rests, repeats, or is too long."""

import numpy as np
import pytest

import stepcore as sc
from stepcore.experiment.horizon import COST_SHARE, MOST_COST, Horizon, horizon_of
from stepcore.experiment.motion import Motion

SCENE = """<mujoco><option timestep="0.002" {option}/><worldbody>
  <geom type="plane" size="5 5 1"/>{bodies}</worldbody>{more}</mujoco>"""


def scene(bodies, option="", more=""):
    return sc.loads(SCENE.format(bodies=bodies, option=option, more=more)).compile()


def body(pos, joint="<freejoint/>", geom='type="box" size=".1 .1 .1" mass="1"'):
    return f'<body pos="{pos}">{joint}<geom {geom}/></body>'


HINGE = '<joint name="h" axis="0 1 0" damping="{}"/>'
ROD = 'type="capsule" size=".02" fromto="0 0 0 .5 0 0" mass="1" contype="0" conaffinity="0"'


def test_what_rests_keeps_the_default():
    assert horizon_of(scene(body("0 0 .1")), Motion()) == Horizon(1.0)


def test_a_given_horizon_is_kept():
    assert horizon_of(scene(body("0 0 5")), Motion(horizon=0.3)) == Horizon(0.3)


def test_a_fall_goes_on_until_the_body_lies():
    """From 9 m a body falls for 1.35 s."""
    found = horizon_of(scene(body("0 0 9.1")), Motion())
    assert 1.35 + 0.25 <= found.length < 3
    assert found.words == f"not at rest after 1 s: went on to {found.length:.3g} s"
    assert found.after("1.8 s of fall") == f"1.8 s of fall ({found.words})"


def test_an_instability_that_has_hardly_begun_is_waited_for():
    """A rod on its tip: its tilt grows e-fold every 0.18 s, from 1e-5."""
    rod = 'type="capsule" size=".02" fromto="0 0 0 0 0 .5" mass="1" contype="0" conaffinity="0"'
    model = scene(
        body("0 0 1", HINGE.format(0.2), rod), more='<keyframe><key qpos="1e-5"/></keyframe>'
    )
    found = horizon_of(model, Motion())
    sim = sc.Sim(model)
    sim.reset(key=0)
    sim.step(round(found.length / 0.002))
    assert abs(abs(sim.qpos[0]) - np.pi) < 0.1


def test_a_slow_creep_goes_on_to_the_bound():
    """An overdamped arm that sinks: at 1 s it moves 20 mm/s, and an eighth of that later."""
    model = scene(body("0 0 1", HINGE.format(60.0), ROD))
    found = horizon_of(model, Motion())
    assert found.length == 10 and found.words == "still moving at 10 s, the longest run"


def test_what_repeats_ends_after_it_has_repeated():
    """A pendulum without damping."""
    rod = 'type="capsule" size=".02" fromto="0 0 0 .3 0 -.4" mass="1" contype="0" conaffinity="0"'
    model = scene(body("0 0 1", HINGE.format(0.0), rod))
    found = horizon_of(model, Motion())
    assert 2 * 1.1 < found.length < 4 and found.words.endswith("where it repeats")


@pytest.mark.filterwarnings("ignore")
def test_a_failure_lies_within_the_horizon():
    """A spring just beyond its stable step explodes after the first second."""
    joint = '<joint type="slide" axis="1 0 0" stiffness="{}"/>'
    model = scene(body("0 0 1", joint.format(1.0002e6)), option='integrator="Euler"')
    model.scene.add_key("moved", qpos=[1e-9])
    model = model.scene.compile()
    found = horizon_of(model, Motion())
    sim = sc.Sim(model)
    sim.reset(key=0)
    sim.step(round(found.length / 0.002))
    assert found.length > 1 and abs(sim.qpos[0]) > 1e-3


@pytest.mark.parametrize("kind", ["move", "sines", "random"])
def test_motions_without_an_end_are_not_tried(kind):
    model = scene(
        body("0 0 1", HINGE.format(0.1), ROD),
        more='<actuator><position joint="h" kp="5" ctrlrange="-1 1"/></actuator>',
    )
    assert horizon_of(model, Motion(kind=kind)) == Horizon(1.0)
    assert horizon_of(model, Motion(kind="hold")).length > 1


def test_the_cost_bounds_it():
    model = scene(body("0 0 300"))
    found = horizon_of(model, Motion(), cost=3e5)
    assert 1 < found.length < 10 and found.words.startswith("still moving at")
    assert horizon_of(model, Motion(), cost=0.0) == Horizon(1.0)
    assert COST_SHARE * 3e10 / 8 < MOST_COST


def test_check_trade_and_converge_say_how_long_they_went_on():
    falls = scene(body("0 0 9.1", geom='size=".1" mass="1"'))
    options = {"progress": False, "threads": 1}
    assert "not at rest after 1 s: went on to" in sc.check(falls, **options).ran
    traded = sc.trade(falls, starts=1, dts=[0.002], by="flops", further=0, **options)
    assert "not at rest after 1 s: went on to" in traded.ran
    assert traded.horizon == pytest.approx(traded.motion.horizon) and traded.horizon > 1.5
    assert "not at rest" in sc.converge(falls, starts=1, **options).ran


@pytest.mark.parametrize(
    ("count", "gap", "length"), [(41, 0.1, 4.0), (11, 0.02, 1.0), (3, 20.0, 10.0)]
)
def test_a_log_is_run_to_its_end(count, gap, length):
    """Whatever moves: 4 s of 10 Hz; a short one as long as any motion; 40 s up to the bound."""
    motor = "<actuator><motor name='x' joint='x'/></actuator>"
    model = scene(body("0 0 5", '<joint name="x" type="slide"/>'), more=motor)
    times = gap * np.arange(count)
    found = horizon_of(model, Motion(ctrl={"time": times, "x": np.sin(times)}))
    assert found.length == pytest.approx(length)
    assert ("lasts" in found.words) == (length > 1)
    assert ("of which 10 s are run" in found.words) == (length == 10)


PENDULUM = (
    'type="capsule" size=".02" fromto="0 0 0 .06 0 -.08" mass="1" contype="0" conaffinity="0"'
)


def test_a_body_that_repeats_does_not_hide_one_that_topples():
    """A pendulum of 0.46 s next to a rod on its tip, which has hardly moved after 1 s."""
    rod = 'type="capsule" size=".02" fromto="0 0 0 0 0 .5" mass="1" contype="0" conaffinity="0"'
    both = body("0 0 1", HINGE.format(0.0), PENDULUM)
    both += body("2 0 1", HINGE.format(0.2).replace('"h"', '"rod"'), rod)
    model = scene(both, more='<keyframe><key qpos="0 1e-5"/></keyframe>')
    found = horizon_of(model, Motion())
    sim = sc.Sim(model)
    sim.reset(key=0)
    sim.step(round(found.length / 0.002))
    assert found.length > 1.5 and abs(sim.qpos[1]) > 0.5


def still(time, sim):
    return ()


def test_what_a_control_drives_on_steadily_repeats():
    """A puck without friction; but neither one that creeps, nor one without a control."""
    for speed, control, length in ((2.0, still, 1.0), (0.02, still, 10.0), (2.0, None, 10.0)):
        joint = '<joint type="slide" axis="1 0 0"/>'
        keys = f'<keyframe><key qvel="{speed}"/></keyframe>'
        puck = scene(body("0 0 1", joint, 'size=".1" mass="1" contype="0"'), more=keys)
        assert horizon_of(puck, Motion(control=control)).length == pytest.approx(length)


def test_calls_of_a_control_count_as_work():
    model = scene(body("0 0 300"))
    lengths = [
        horizon_of(model, Motion(control=still, control_dt=dt), cost=3e8).length
        for dt in (0.002, 0.02)
    ]
    assert lengths[0] < 10 and lengths[1] == 10
