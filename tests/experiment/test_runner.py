"""One loop over control periods: what probes see of it."""

import pickle

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.experiment.engines import run
from stepcore.experiment.motion import Motion
from stepcore.experiment.recorder import Means, Positions
from stepcore.experiment.run import Probe
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import scheduled

# A schedule of 8 periods of 0.04 s: 4 steps of 0.01 s each.
PERIODS, STEPS = 8, 4


def driven():
    """A cart with a motor, its schedule and its runner."""
    scene = sc.Scene(gravity=(0, 0, -9.81))
    cart = scene.add_body("cart", mass=1.0, inertia=(1, 1, 1))
    scene.add_actuator(scene.add_joint(cart, "slide", axis=(1, 0, 0)), ctrlrange=(-1, 1))
    scene.options = {"dt": 0.01, "integrator": "semi-implicit", "solver": "pgs"}
    model = scene.compile()
    motion = Motion(horizon=PERIODS * 0.04, starts=2, kind="random")
    return Runner(model, scheduled(motion, model, 0.04))


def stiff_spring():
    """ω dt = 1: stable under rk4; explicit Euler grows by √2 a step."""
    return lesson.spring(k=1e6, dt=1e-3, integrator="rk4").compile()


def test_a_run_starts_with_the_keyframes_mocap_poses():
    """A ball welded to a mocap body that only the keyframe puts aside."""
    model = sc.loads(
        """<mujoco><option gravity="0 0 0"/><worldbody>
        <body name="hand" mocap="true"/>
        <body name="ball" pos="1 0 0"><freejoint/><geom size=".1"/></body></worldbody>
        <equality><weld body1="hand" body2="ball" relpose="0 0 0 1 0 0 0"/></equality>
        <keyframe><key qpos="1 0 0 1 0 0 0" mpos="1 0 0"/></keyframe></mujoco>"""
    ).compile()
    runner = Runner(model, scheduled(Motion(horizon=0.2, starts=1), model, 0.02))
    together = run(model, runner.schedule, [0, 0])["xpos"]
    for ball in (runner.run(model.settings, 0).com[:, 0], *together[:, :, 2]):
        assert ball == pytest.approx(np.tile([1.0, 0.0, 0.0], (len(ball), 1)))


class Log(Probe):
    """The time of every call. every: its stride, or None."""

    def __init__(self, every=None):
        self.every, self.calls = every, []

    def stride(self, steps):
        return self.every

    def begin(self, sim):
        self.calls.append(("begin", 0))

    def period(self, sim, period):
        self.calls.append(("period", round(sim.time / 0.01)))

    def step(self, sim):
        self.calls.append(("step", round(sim.time / 0.01)))

    def sample(self, sim):
        self.calls.append(("sample", round(sim.time / 0.01)))

    def at(self, what):
        return [step for name, step in self.calls if name == what]


@pytest.mark.parametrize(
    ("every", "steps"),
    [(None, [4, 8]), (1, [1, 2, 3, 4, 5, 6, 7, 8]), (3, [3, 4, 7, 8])],
)
def test_probes_are_called_at_periods_at_strides_and_at_samples(every, steps):
    runner, log = driven(), Log(every)
    runner.follow(runner.sim(runner.model.settings), 0, [log])
    assert log.calls[:2] == [("begin", 0), ("period", 0)]
    assert log.at("period") == [STEPS * k for k in range(PERIODS)]
    assert log.at("step")[: len(steps)] == steps
    assert log.at("sample") == [round(t / 0.01) for t in runner.schedule.times]


def test_probes_of_two_strides_are_called_at_the_shorter():
    runner, often, seldom = driven(), Log(1), Log(4)
    runner.follow(runner.sim(runner.model.settings), 0, [often, seldom])
    assert often.at("step") == seldom.at("step") == list(range(1, PERIODS * STEPS + 1))


def test_what_looks_at_a_run_does_not_change_it():
    runner = driven()
    settings = runner.model.settings
    whole, light = runner.run(settings, 1), runner.run(settings, 1, [Positions(runner.bodies)])
    assert np.array_equal(whole.com, light.com) and np.array_equal(whole.quat, light.quat)
    copy = pickle.loads(pickle.dumps(runner)).run(settings, 1)
    assert np.array_equal(whole.com, copy.com) and np.array_equal(whole.balance, copy.balance)


def test_a_failure_ends_the_runs_and_says_why():
    model = stiff_spring()
    runner = Runner(model, scheduled(Motion(horizon=4.0, starts=3), model, 0.5))
    paths = runner.runs(model.settings.replace(integrator="explicit"))
    assert len(paths) == 1 and "diverged" in paths[0].failure
    assert not any(path.failure for path in runner.runs(model.settings))


def test_means_are_recorded_as_in_a_full_record():
    model = sc.load("gymnasium:hopper").compile()
    runner = Runner(model, scheduled(Motion(horizon=0.4, starts=2), model, 0.008))
    full, few = (runner.run(model.settings, 1, p) for p in (None, [Means(runner.bodies)]))
    assert full.touching.any()
    for name in ("height", "kinetic", "touching"):
        np.testing.assert_allclose(getattr(few, name), getattr(full, name), rtol=1e-13)
