"""Derivatives of rollouts forward: by parameters, controls and the first state."""

import numpy as np
import pytest
from test_linearize_by_parameters import ARM, PATHS

import stepcore as sc
from stepcore.engine.gradients import Steps, sensitivities

STEPS = 40


def rollout(integrator="implicitfast", paths=PATHS, **settings):
    model = sc.loads(ARM.format(integrator=integrator)).compile().with_settings(**settings)
    batch = sc.Batch(model, 1, threads=1)
    batch.qvel[0] = np.random.default_rng(0).normal(0, 0.3, model.nv)
    batch.qpos[0, 0] = 0.2
    ctrl = 0.5 * np.sin(np.arange(STEPS) / 5)[None, :, None]
    return Steps(batch, ctrl, paths).roll()


@pytest.mark.parametrize("settings", [{}, {"solver": "pgs", "sweeps": 3}, {"law": "solref"}])
def test_many_steps_at_once_are_linearised_as_each_alone(settings):
    """With contacts, friction loss and limits; bit for bit."""
    steps = rollout(**settings)
    together, sim = steps.linear(range(1), range(STEPS)), sc.Sim(steps.models[0])
    for step in range(STEPS):
        for name, rows in steps.states.items():
            getattr(sim, name)[:] = rows[0, step]
        sim.ctrl[:] = steps.ctrl[0, step]
        alone = sim.linearize(PATHS)
        for name in "ABP":
            assert np.array_equal(getattr(together, name)[0, step], getattr(alone, name)), name


def test_friction_loss_where_it_slips_and_where_it_sticks():
    """The slope of the speed: −dt/I, and 0; nothing of the models beside the switch is in it."""
    text = """<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody><body>
     <joint name="j" axis="0 1 0" frictionloss="{}"/><geom size=".1" mass="1"/></body></worldbody>
     <actuator><motor joint="j"/></actuator></mujoco>"""
    slips = np.zeros(40, bool)
    for k, loss in enumerate(np.linspace(0.8, 1.2, 40)):
        batch = sc.Batch(sc.loads(text.format(loss)), 1, threads=1)
        steps = Steps(batch, np.ones((1, 2, 1)), ["joint/j/frictionloss"]).roll()
        slope = sensitivities(steps)[1, 1, 0]
        slips[k] = slope != 0.0
        # I = 2/5 m r².
        assert slope == pytest.approx(-0.01 / 0.004 if slips[k] else 0.0, rel=1e-9)
    assert slips[:5].all() and not slips[-5:].any()


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
