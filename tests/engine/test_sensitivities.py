"""Derivatives of rollouts forward: by parameters, controls and the first state."""

import numpy as np
import pytest
from test_linearize_by_parameters import ARM, PATHS

import stepcore as sc
from stepcore.engine.gradients import Steps
from stepcore.engine.sensitivities import parameter_slopes, sensitivities

STEPS = 40


def rollout(integrator="implicitfast", paths=PATHS, **settings):
    model = sc.loads(ARM.format(integrator=integrator)).compile().with_settings(**settings)
    batch = sc.Batch(model, 1, threads=1)
    batch.qvel[0] = np.random.default_rng(0).normal(0, 0.3, model.nv)
    batch.qpos[0, 0] = 0.2
    ctrl = 0.5 * np.sin(np.arange(STEPS) / 5)[None, :, None]
    return Steps(batch, ctrl, paths).roll()


@pytest.mark.parametrize("settings", [{}, {"solver": "pgs", "sweeps": 3}, {"law": "solref"}])
def test_slopes_of_many_steps_are_those_of_linearize(settings):
    """With contacts, friction loss and limits: 1e-9 of the largest of each parameter."""
    steps = rollout(**settings)
    slopes, exact = parameter_slopes(steps, 0), steps.share([0]).linear(range(STEPS)).P[0]
    largest = np.abs(exact).max(axis=(0, 1))
    off = np.abs(slopes - exact).max(axis=(0, 1))
    # The floor's friction does nothing while the box rests.
    assert (off <= 1e-9 * np.where(largest > 1e-12, largest, 1.0)).all()


def test_a_row_that_switches_between_the_models_is_differentiated_exactly():
    """Friction loss about the force that slips: the slope jumps where models nearby differ."""
    text = """<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody><body>
     <joint name="j" axis="0 1 0" frictionloss="{}"/><geom size=".1" mass="1"/></body></worldbody>
     <actuator><motor joint="j"/></actuator></mujoco>"""
    both = []
    for loss in np.linspace(0.8, 1.2, 40):
        batch = sc.Batch(sc.loads(text.format(loss)), 1, threads=1)
        steps = Steps(batch, np.ones((1, 2, 1)), ["joint/j/frictionloss"]).roll()
        both.append((parameter_slopes(steps, 0), steps.share([0]).linear(range(2)).P[0]))
    slopes, exact = map(np.array, zip(*both, strict=True))
    assert np.ptp(np.abs(exact).max(axis=(1, 2, 3))) > 1.0
    assert np.abs(slopes - exact).max() <= 1e-9 * np.abs(exact).max()


def test_controls_may_change_with_a_number():
    """By a common shift of all controls: the difference of two rollouts, 1e-6 of it."""
    paths = ("joint/shoulder/damping",)
    slopes = sensitivities(rollout(paths=paths), 0, np.ones((STEPS, 1, 1)))
    nv = rollout(paths=paths).models[0].nv
    ends = []
    for shift in (-1e-5, 1e-5):
        steps = rollout(paths=paths)
        batch = steps.batch
        for name in ("qpos", "qvel"):
            getattr(batch, name)[...] = steps.start[name]
        ends.append(batch.rollout(steps.ctrl + shift).qvel[0])
    difference = (ends[1] - ends[0]) / 2e-5
    assert slopes.shape == (STEPS + 1, 2 * nv, 1 + 1 + 2 * nv)
    assert np.abs(slopes[1:, nv:, 1] - difference).max() <= 1e-6 * np.abs(difference).max()
    assert np.array_equal(slopes[0, :, 2:], np.eye(2 * nv))
