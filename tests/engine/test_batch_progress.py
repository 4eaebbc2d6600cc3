"""Long calls of a batch: they say how far they are; interrupted they stand between two steps."""

import io
import signal
import sys
import threading
from functools import partial

import numpy as np
import pytest
from busy import when_busy

import stepcore as sc
from stepcore.report import progress as bars


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def model():
    return sc.lesson.spring().compile().with_settings(dt=1e-4)


def calls(batch, progress):
    """The ways to take 100 steps."""
    ctrl = np.zeros((len(batch), 100, 0))
    return (
        lambda: batch.step(100, progress=progress),
        lambda: batch.rollout(ctrl, progress=progress),
        lambda: batch.rollout(ctrl, record="energy", progress=progress),
    )


def test_a_function_is_told_of_all_steps_and_changes_no_bit(model):
    for lanes in (True, False, "auto"):
        for way in range(3):
            batch, quiet = (sc.Batch(model, 5, lanes=lanes) for _ in range(2))
            told = []
            calls(batch, lambda *call: told.append(call))[way]()  # noqa: B023
            calls(quiet, False)[way]()
            done = [steps for _, steps, _ in told]
            assert {(label, total) for label, _, total in told} == {("steps", 100)}
            assert done == sorted(set(done)) and done[-1] == 100
            assert batch.state() == quiet.state()
    told.clear()
    batch.step(1, progress=lambda *call: told.append(call))
    assert told == [("steps", 1, 1)]


def test_a_bar_shows_in_long_calls_only(model, monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    batch = sc.Batch(model, 5)
    for call in calls(batch, None):
        call()
    batch.step()
    assert sys.stderr.getvalue() == ""
    monkeypatch.setattr(bars, "BEGUN", 0.0)
    for call in calls(batch, None):
        call()
        assert "100/100" in sys.stderr.getvalue()
        assert sys.stderr.getvalue().endswith("\r")
        sys.stderr = Terminal()
    for call in calls(batch, False):
        call()
    assert sys.stderr.getvalue() == ""


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_what_was_stepped_before_an_interrupt_counts(model, error):
    def ends(label, done, total):
        if done > 20:
            if error is KeyboardInterrupt:
                signal.raise_signal(signal.SIGINT)
            raise error

    for way in range(3):
        batch, sim = sc.Batch(model, 5), sc.Sim(model)
        with pytest.raises(error):
            calls(batch, ends)[way]()
        steps = round(batch.time / model.settings.dt)
        assert 20 < steps <= 100
        sim.step(steps)
        assert set(batch.state()) == {sim.state()}
        batch.step(100 - steps)
        sim.step(100 - steps)
        assert set(batch.state()) == {sim.state()}


def test_a_rollout_is_interrupted_between_two_steps():
    batch = sc.Batch("gymnasium:inverted_pendulum", 9, threads=2)
    ctrl = np.broadcast_to(np.linspace(-1, 1, 10**5)[:, None], (9, 10**5, 1))
    for record in ((), "energy"):
        batch.reset()
        begun = threading.Event()

        def told(*_, begun=begun):
            begun.set()

        with pytest.raises(KeyboardInterrupt):
            when_busy(batch, begun.wait, partial(signal.raise_signal, signal.SIGINT))
            batch.rollout(ctrl, record, progress=told)
        steps = round(batch.time / batch.settings.dt)
        assert 0 < steps < 10**5
        assert (batch.ctrl == ctrl[:, steps - 1]).all()
        alone = sc.Batch(batch.model, 9)
        alone.rollout(ctrl[:, :steps])
        assert alone.state() == batch.state()


def test_progress_is_checked(model):
    batch = sc.Batch(model, 2)
    for call in calls(batch, 3):
        with pytest.raises(ValueError, match="progress = 3: must be True, False, None or a func"):
            call()
    with pytest.raises(ValueError, match="n = -2: must be a whole number"):
        batch.step(-2)
    assert batch.time == 0


def test_a_recorded_rollout_has_every_name_and_refuses_shapes_as_the_plain_one():
    batch = sc.Batch("gymnasium:inverted_pendulum", 2)
    run = batch.rollout(np.zeros((2, 3, 1)), record=("qpos", "energy"))
    assert list(run.recorded) == ["qpos", "energy"]
    assert np.array_equal(run.recorded["qpos"], run.qpos)
    for shape in ((3, 3, 1), (2, 3, 2), (2, 3)):
        for record in ((), ("energy",)):
            with pytest.raises(ValueError) as error:
                batch.rollout(np.zeros(shape), record=record)
            assert f"ctrl has shape {shape}: must be (2, steps, 1)" in str(error.value)
