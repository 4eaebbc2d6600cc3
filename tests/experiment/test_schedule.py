"""The time steps and the starts of a schedule, and the extent of its motion."""

import numpy as np
import pytest

import stepcore as sc
from stepcore.engine.coordinates import Coordinates
from stepcore.experiment.engines import run
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import scheduled, time_steps
from stepcore.report.units import metres, seconds


def test_time_steps_divide_the_period():
    steps, period = time_steps(0.002, None, None, 1.0)
    assert period == steps[0] == pytest.approx(0.008) and len(steps) == 6
    steps, period = time_steps(0.01, None, 0.05, 1.0)
    assert 0.01 in steps and period == 0.05
    assert all(abs(period / dt - round(period / dt)) < 1e-9 for dt in steps)
    steps, period = time_steps(0.002, [0.003], None, 1.0)
    assert steps == [0.003, 0.002] and period == pytest.approx(0.006)


def test_the_first_start_is_the_first_key_named_or_not():
    scene = sc.Scene()
    body = scene.add_body("body", mass=1.0, inertia=(1, 1, 1))
    scene.add_joint(body, "slide")
    for height in (1.0, 2.0, 3.0):
        scene.add_key(qpos=[height])
    model = scene.compile()
    for key, height in ((None, 1.0), (1, 2.0), (-1, 3.0)):
        start = scheduled(Motion(horizon=0.1, starts=1, key=key), model, 0.1).starts[0]
        assert start.qpos.tolist() == [height]


def test_starts_respect_quaternions_and_ranges():
    scene = sc.Scene(gravity=(0, 0, -9.81))
    ball = scene.add_body("ball", pos=(0, 0, 1))
    scene.add_joint(ball, "free")
    scene.add_geom(ball, "sphere", 0.1, mass=1.0)
    arm = scene.add_body("arm", "ball", mass=0.1, inertia=(1e-3, 1e-3, 1e-3))
    scene.add_joint(arm, "hinge", range=(0.0, 0.005))
    model = scene.compile()
    coordinates = Coordinates(model)
    got = scheduled(Motion(horizon=1.0, starts=8, seed=3), model, 0.04)
    assert np.array_equal(got.starts[0].qpos, model.qpos0)
    for start in got.starts:
        assert np.linalg.norm(start.qpos[3:7]) == pytest.approx(1, abs=1e-14)
        assert 0 <= start.qpos[7] <= 0.005
    assert len({start.qpos.tobytes() for start in got.starts}) == 8
    # A change of the dofs and its inverse.
    change = np.random.default_rng(0).uniform(-0.5, 0.5, coordinates.nv)
    moved = coordinates.moved(got.starts[1].qpos, change)
    assert coordinates.change(got.starts[1].qpos, moved) == pytest.approx(change, abs=1e-14)


@pytest.mark.parametrize(
    ("value", "text"), [(9.996e-4, "1 mm"), (9.99e-4, "999 µm"), (0.9996, "1 m"), (12.0, "12 m")]
)
def test_a_length_is_told_in_the_unit_that_it_is_rounded_to(value, text):
    assert metres(value) == text
    assert seconds(value) == text[:-1] + "s"


def test_a_horizon_that_cannot_end_is_refused_up_front():
    spring = sc.load("lesson:spring")
    said = "horizon = 1e9 s with dt = 0.01 s: .* would take 8e11 steps; must be at most 1e9"
    for measured in (sc.trade, sc.predict):
        with pytest.raises(ValueError, match=said):
            measured(spring, horizon=1e9, progress=False)
    with pytest.raises(ValueError, match=r"horizon = 2e9 s .* would take 2e11 steps"):
        sc.stability_map(
            spring,
            path="joint/spring/stiffness",
            values=[10],
            dts=[0.01],
            horizon=2e9,
            progress=False,
        )


def test_how_far_matter_moves_is_its_error_if_it_stood_still():
    """A mass on a spring from its keyframe: x = a cos ωt, less where it is first seen."""
    scene = sc.Scene(gravity=(0, 0, 0))
    mass = scene.add_body("mass", mass=1, inertia=(1, 1, 1))
    scene.add_joint(mass, "slide", stiffness=(2 * np.pi) ** 2)
    scene.add_key(qpos=[0.1])
    scene.options = {"dt": 0.01, "integrator": "rk4"}
    found = sc.trade(scene, horizon=1.0, starts=1, dts=[0.01, 0.02], by="flops", progress=False)
    x = 0.1 * np.cos(2 * np.pi * np.linspace(0.02, 1.0, 50))
    true = np.sqrt(np.mean((x - x[0]) ** 2))
    assert found.moved == pytest.approx(true, rel=1e-6)


@pytest.mark.parametrize("kind", ["sines", "random", "move"])
def test_a_start_is_the_same_however_many_there_are(kind):
    """Trade has 8 starts and ablate 136: their errors as shipped are of the same motions."""
    model = sc.loads(
        """<mujoco><worldbody><body><joint name="j" axis="0 1 0" range="-90 90"/>
        <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/></body></worldbody><actuator>
        <position joint="j" kp="20" kv="1" ctrlrange="-1 1"/></actuator></mujoco>"""
    ).compile()
    few, many = (scheduled(Motion(horizon=0.2, kind=kind), model, 0.01, starts=n) for n in (2, 5))
    ends = [run(model, schedule, [1])["xquat"][0, -1].tolist() for schedule in (few, many)]
    assert ends[0] == ends[1]


def test_a_joint_that_its_damping_locks_starts_at_rest():
    """A base held by dampers, as in gymnasium_robotics' fetch, would explode with a speed."""
    joint = '<joint type="slide" axis="{}" damping="{}"/>'
    joints = joint.format("1 0 0", 1e11) + joint.format("0 1 0", 1.0)
    body = f'<body>{joints}<geom size=".1" mass="5"/></body>'
    model = sc.loads(f"<mujoco><worldbody>{body}</worldbody></mujoco>").compile()
    starts = scheduled(Motion(horizon=0.1, starts=4), model, 0.01).starts[1:]
    assert all(start.qvel[0] == 0.0 != start.qvel[1] for start in starts)
