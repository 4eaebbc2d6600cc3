"""What a trade runs: nothing that it knows to fail, and nothing that cannot be judged.

Counted are runs and their steps, which no load of the machine changes.
"""

from collections import Counter

import pytest

import stepcore as sc
from stepcore.experiment.arguments import Workers
from stepcore.experiment.runner import Runner
from stepcore.report.progress import Progress

# Stiff damping of the hinge between two arms: rk4 and semi-implicit, which take it explicitly, are
# unstable at every step that is tried; implicit integrators are not.
STIFF = """<mujoco model="stiff"><option timestep="0.004" integrator="implicitfast"/><worldbody>
<body><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/>
<body pos=".3 0 0"><joint axis="0 1 0" damping="3000"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/></body></body>
</worldbody></mujoco>"""
QUICK = {"by": "flops", "progress": False, "horizon": 0.32, "starts": 4}


@pytest.fixture
def made(monkeypatch):
    """Every run that is made: settings, start and the probes' names."""
    runs = []
    follow = Runner.follow

    def noted(self, sim, start, probes=(), clock=None):
        runs.append((sim.settings, start, tuple(type(probe).__name__ for probe in probes)))
        return follow(self, sim, start, probes, clock)

    monkeypatch.setattr(Runner, "follow", noted)
    return runs


@pytest.mark.parametrize("threads", [1, 2, 3, 8])
def test_results_end_with_the_first_that_fails_on_any_number_of_threads(threads):
    workers, bar = Workers(threads), Progress("", 10, False)
    assert workers.until(lambda x: x == 4, abs, [-1, 2, -3, 4, 5, -4, 7], bar) == [1, 2, 3, 4]
    assert workers.until(lambda x: x > 9, abs, [-1, 2, -3], bar) == [1, 2, 3]
    assert workers.until(lambda x: x > 9, abs, [], bar) == []


def test_an_integrator_that_fails_at_the_finest_step_is_not_run_at_others(made):
    result = sc.trade(sc.loads(STIFF), threads=1, **QUICK)
    reference = [(s.integrator, s.dt) for s, _, probes in made if s.sweeps == 200]
    assert [name for name, _ in reference if name == "rk4"] == ["rk4"]
    assert result.reference.settings.integrator == "implicitfast"
    assert list(result.reference.orders) == ["implicitfast"]


def test_settings_that_fail_in_the_search_are_run_once_and_listed(made):
    result = sc.trade(sc.loads(STIFF), threads=1, **QUICK)
    failed = [row for row in result.rows if row.failure]
    assert {row.settings.integrator for row in failed} >= {"rk4", "semi-implicit"}
    counts = Counter(settings for settings, _, _ in made)
    # The search runs a setting from two starts, and stops at the first that fails.
    assert max(counts[row.settings] for row in failed) <= 2
    assert all("start" in row.failure for row in failed)


def test_a_trade_is_the_same_on_any_number_of_threads():
    one, three = (sc.trade(sc.loads(STIFF), threads=n, **QUICK) for n in (1, 3))
    assert one.to_json() == three.to_json()
