"""What a step of a run costs: timed apart from what looks at the run."""

import pytest
from small import unstable

import stepcore as sc
from stepcore import lesson
from stepcore.experiment.single_run import STATES, Pace, SingleRun


def test_it_times_steps_along_the_run():
    sim = sc.Sim(lesson.stack())
    pace = Pace(100)
    SingleRun(sim, probes=[pace]).run(100)
    assert len(pace.states) == STATES + 1
    other = sc.Sim(sim.model, sim.settings)
    assert 0 < pace.seconds(other) < 1


@pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")
def test_states_that_fail_are_left_out():
    sim = sc.Sim(unstable(integrator="euler"))
    sim.qvel[:] = 1.0
    pace = Pace(1)
    with pytest.raises(sc.SimulationError):
        while True:
            pace.begin(sim)
            sim.step()
    # Those before the failure, out of which the last cannot be stepped so often.
    pace.states = pace.states[-1:]
    assert pace.seconds(sc.Sim(sim.model, sim.settings)) == 0
