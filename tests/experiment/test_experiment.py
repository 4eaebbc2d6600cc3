"""`Experiment`: one model and one motion; its runs, its judgements and their thresholds."""

import dataclasses

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.engine.control import ControlError
from stepcore.experiment.batched_runs import WIDTH
from stepcore.experiment.experiment import Experiment
from stepcore.experiment.failure import FAR, LARGE, failure
from stepcore.experiment.motion import Motion
from stepcore.experiment.run import Run
from stepcore.experiment.runner import positions
from stepcore.experiment.schedule import scheduled
from stepcore.experiment.sizes import scene_size


def experiment(starts=3, horizon=0.4):
    """A cart on a spring, driven by a motor."""
    scene = sc.Scene(gravity=(0, 0, -9.81))
    cart = scene.add_body("cart", mass=1.0, inertia=(1, 1, 1))
    rail = scene.add_joint(cart, "slide", axis=(1, 0, 0), stiffness=40.0)
    scene.add_geom(cart, "sphere", 0.1)
    scene.add_actuator(rail, ctrlrange=(-1, 1))
    scene.options = {"dt": 0.01, "integrator": "semi-implicit", "solver": "pgs"}
    model = scene.compile()
    return Experiment(model, scheduled(Motion(horizon=horizon, starts=starts), model, 0.04))


def test_runs_of_positions_have_the_bits_of_full_runs_in_batches_too():
    made = experiment(starts=2 * WIDTH)
    full, bare = (made.run(made.model.settings, **p) for p in ({}, {"probes": positions}))
    assert made.workers.speedup.batches > 0
    for one, other in zip(full, bare, strict=True):
        assert np.array_equal(one.com, other.com) and np.array_equal(one.quat, other.quat)
        assert one.kinetic.any() and not len(other.kinetic)


def test_the_score_is_a_number_of_the_errors():
    made = experiment()
    reference = made.reference(finest=0.005, effort=1e6)
    assert made.size == scene_size(made.model.scene, reference.runs)
    errors = made.errors(made.run(made.model.settings), reference)
    assert errors.high == max(errors.each) > 0
    # Runs from the first starts are compared with the reference from these.
    assert made.errors(made.run(made.model.settings, [0]), reference).each == errors.each[:1]


def moved(run, by):
    """The same run, its bodies moved along x [m]."""
    return dataclasses.replace(run, com=run.com + np.array([by, 0.0, 0.0]))


def test_a_run_that_is_far_has_failed():
    made = experiment()
    reference = made.reference(finest=0.005, effort=1e6)
    near, far = (
        [moved(run, factor * FAR * made.size) for run in reference.runs] for factor in (0.99, 1.01)
    )
    assert made.failure(near, reference) is None
    assert made.failure(far, reference).startswith("start 0: far off")
    early = [reference.runs[0], Run(failure="diverged")]
    assert made.failure(early, reference) == "start 1: diverged"


def test_a_run_of_large_energy_has_failed():
    """More than `LARGE` times that in motion, and more than lifts the scene by its size."""
    kinetic, size, weight = 2.0, 0.5, 3.0
    com = np.zeros((4, 1, 3))
    truth = Run(com=com, balance=np.zeros(4), kinetic=np.full(4, kinetic))
    limit = LARGE * kinetic + weight * size
    for gained, fails in ((0.99 * limit, False), (1.01 * limit, True)):
        run = dataclasses.replace(truth, balance=np.array([0.0, gained, 0.0, 0.0]))
        assert bool(failure([run], [truth], size, weight)) == fails


def test_the_size_of_a_scene_without_lengths_is_one():
    assert scene_size(sc.Scene()) == 1.0
    drop = lesson.drop()
    still = Run(com=np.zeros((3, 1, 3)))
    fallen = Run(com=np.array([[[0, 0, 0.0]], [[0, 0, -2.0]]]))
    assert scene_size(drop, [still]) == scene_size(drop)
    assert scene_size(drop, [fallen]) == pytest.approx(2.0 + scene_size(drop))


def test_costs_are_of_each_setting():
    made = experiment(starts=1, horizon=0.04)
    fine, coarse = (made.model.settings.replace(dt=dt) for dt in (0.0005, 0.02))
    assert made.cost(fine, coarse)[0] > made.cost(fine, coarse)[1] > 0


@pytest.mark.parametrize("moves", [sc.Sim.step, sc.Sim.reset])
def test_a_control_that_moves_its_sim_is_refused(moves):
    def control(time, sim):
        moves(sim)
        return [0.0]

    model = experiment().model
    made = Experiment(model, scheduled(Motion(horizon=0.4, control=control), model, 0.04))
    made.runner.place(sim := made.runner.sim(model.settings), 0)
    sim.step()
    with pytest.raises(ControlError, match=r"`control` of test_experiment.py must not step, reset"):
        made.runner.control(sim, 0, 0, control)
