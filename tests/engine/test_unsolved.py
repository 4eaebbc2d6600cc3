"""Rows that stay unsolved are told without being asked, by `Sim.run` and by `Batch`.

Law: what the warning says is what the run shows, its cure ends it, and healthy scenes hear nothing.
"""

import re
import warnings

import numpy as np
import pytest

import stepcore as sc

# Each ball three times as heavy as the one below: one sweep a step does not hold them.
STACK = (
    '<mujoco><worldbody><geom type="plane" size="1 1 1"/>'
    + "".join(
        f'<body pos="0 0 {0.1 + 0.2 * i}"><joint type="slide" axis="0 0 1"/>'
        f'<geom size=".1" mass="{3**i}"/></body>'
        for i in range(10)
    )
    + "</worldbody></mujoco>"
)


def test_a_run_tells_and_its_cure_ends_it():
    scene = sc.loads(STACK)
    sim = sc.Sim(scene, solver="pgs", sweeps=1)
    with pytest.warns(sc.UnsolvedWarning, match="rows stay unsolved: contact") as caught:
        run = sim.run(0.6, record=("residual",))
    text = str(caught[0].message)
    assert run.unsolved == text
    told = re.search(r"by ([0-9.]+) (cm|mm|m)/s with 1 sweep of pgs", text)
    told = float(told[1]) * {"cm": 1e-2, "mm": 1e-3, "m": 1.0}[told[2]]
    assert told == pytest.approx(np.median(run.residual[1:]), rel=0.2)
    assert 'solver="newton" solves them' in text
    assert sc.Sim(scene, solver="newton").run(0.6).unsolved == ""


def test_a_batch_tells_once_and_names_the_world():
    batch = sc.Batch(sc.loads(STACK), 3, solver="pgs", sweeps=1)
    batch.step(100)
    batch.step(100)
    with pytest.warns(sc.UnsolvedWarning, match=r"world \d: rows stay unsolved: contact") as caught:
        for _ in range(12):
            batch.step(100)
    assert len(caught) == 1


@pytest.mark.parametrize("name", ["ant", "half_cheetah", "hopper"])
def test_violent_healthy_runs_hear_nothing(name):
    """Motors at full tilt, falls and impacts, as shipped: the rows are solved."""
    from stepcore.loading import find_asset

    scene = sc.load(str(find_asset("gymnasium", name)))
    rng = np.random.default_rng(1)
    with warnings.catch_warnings():
        warnings.simplefilter("error", sc.UnsolvedWarning)
        sim = sc.Sim(scene)
        assert sim.run(1.0, control=lambda t, sim: rng.uniform(-1, 1, sim.model.nu)).unsolved == ""


def test_single_impacts_hear_nothing():
    """One hard step is no matter: a pile that lands under few sweeps, and then rests."""
    balls = "".join(
        f'<body pos="0 0 {0.3 + 0.21 * i}"><joint type="slide" axis="0 0 1"/>'
        '<geom size=".1" mass="1"/></body>'
        for i in range(4)
    )
    scene = sc.loads(
        f'<mujoco><worldbody><geom type="plane" size="1 1 1"/>{balls}</worldbody></mujoco>'
    )
    sim = sc.Sim(scene, solver="pgs", law="rigid", sweeps=8)
    run = sim.run(1.0, record=("residual",))
    assert run.residual.max() > 0.05
    assert run.unsolved == ""
