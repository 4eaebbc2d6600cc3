"""What one action of a single environment computes, as numbers of calls."""

import sys
from collections import Counter

import pytest

from stepcore.gymnasium import tasks
from stepcore.gymnasium.moment import Moment

# Functions that serve several terms of a step.
COMPUTED_ONCE = ("state_vector", "healthy", "terminated", "contact_forces", "way")


def calls_of_an_action(task):
    """Count the calls of Python functions in one action, by module and name, and the readings."""
    env = tasks.make(task)
    env.reset(seed=0)
    calls, readings = Counter(), Counter()

    def count(frame, event, _):
        if event == "call":
            code = frame.f_code
            name = code.co_name
            if name == "__getattr__" and isinstance(frame.f_locals["self"], Moment):
                readings[frame.f_locals["name"]] += 1
            calls[code.co_filename.split("stepcore/")[-1], code.co_qualname] += 1

    action = env.action_space.sample()
    sys.setprofile(count)
    try:
        env.step(action)
    finally:
        sys.setprofile(None)
    return calls, readings


@pytest.mark.parametrize("task", tasks.TASKS)
def test_an_action_computes_nothing_twice(task):
    calls, readings = calls_of_an_action(task)
    assert readings and max(readings.values()) == 1
    for (file, name), count in calls.items():
        if file == "gymnasium/tasks.py" and name.split(".")[-1] in COMPUTED_ONCE:
            assert count == 1, name
    assert calls["gymnasium/moment.py", "state_vector"] <= 1
    axes = {"Swimmer": 2, "Ant": 2, "Humanoid": 2}.get(task, 1)
    assert calls["gymnasium/tasks.py", "velocity"] <= axes


@pytest.mark.parametrize("task", tasks.TASKS)
def test_an_action_has_no_checked_assignment_and_one_moment(task):
    calls, _ = calls_of_an_action(task)
    assert calls["checks.py", "KnownNames.__setattr__"] == 0
    assert calls["gymnasium/moment.py", "Moment.__init__"] == 1
