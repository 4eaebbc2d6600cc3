"""When the account of energy is balanced, what counts in it, and whom the error names."""

import math

import numpy as np
import pytest
from peers import gym_path
from small import ball

import stepcore as sc
from stepcore.cli import main


def test_a_short_call_is_balanced_at_its_end():
    """ω dt = 6.3: after 50 steps q = 1e77, in one call, in short ones, and in `run`."""
    scene = sc.Scene(gravity=(0, 0, 0))
    body = scene.add_body("load", mass=1.0, inertia=(1.0, 1.0, 1.0))
    scene.add_joint(body, "slide", name="rail", stiffness=1e5)

    def calls(sim):
        for _ in range(10):
            sim.step(5)
        assert abs(sim.qpos[0]) > 1e70
        sim.balance()

    said = set()
    for go in (lambda sim: sim.step(50), calls, lambda sim: sim.run(1.0)):
        sim = sc.Sim(scene, dt=0.02, integrator="euler", ledger=True)
        sim.qpos[0] = 0.01
        with pytest.raises(sc.SimulationError) as caught:
            go(sim)
        error = caught.value
        assert error.gained and error.step == 50 and error.replay.run().same
        assert error.element == "spring of joint `rail`" and np.isfinite(sim.qpos).all()
        assert error.stable_dt == pytest.approx(2 / math.sqrt(1e5), rel=2e-4)
        said.add(str(error))
    assert len(said) == 1


def test_the_end_of_a_long_call_is_balanced():
    """Explicit Euler doubles the energy in 140 steps; the last milestone of 150 is at 128."""
    dt = math.sqrt(2 ** (1 / 140) - 1) / 10
    sim = sc.Sim(sc.lesson.spring(), dt=dt, integrator="explicit", ledger=True)
    sim.reset("start")
    with pytest.raises(sc.SimulationError) as caught:
        sim.step(150)
    error = caught.value
    assert error.gained and error.step == 150


def test_a_balance_changes_nothing_that_can_be_read():
    sims = [sc.Sim(ball(), dt=1e-3, ledger=on) for on in (False, True)]
    for sim in sims:
        sim.qpos[2] = 0.09
        sim.step(150)
        sim.balance()
    off, on = sims
    assert off.state() == on.state() and len(on.contacts)
    assert on.contacts.tobytes() == off.contacts.tobytes()
    assert on.rows.tobytes() == off.rows.tobytes()
    assert (on.qacc == off.qacc).all() and on.row_updates == off.row_updates


def test_a_stiff_limit_that_feeds_is_no_spring_that_gives_back():
    """A limit of 1e5 N/m under 1 kg, ω dt = 6.3: what it holds has been gained as well."""
    scene = sc.Scene()
    body = scene.add_body("load", mass=1.0, inertia=(1.0, 1.0, 1.0))
    scene.add_joint(
        body, "slide", name="rail", axis=(0, 0, 1), range=(0, 1), solreflimit=(-1e5, -20)
    )
    sim = sc.Sim(scene, dt=0.02, ledger=True)
    sim.qpos[0] = 0.5
    with pytest.raises(sc.SimulationError) as caught:
        sim.step(100)
    error = caught.value
    assert error.gained and error.step == 64 and error.element == "limit of joint `rail`"
    below = sc.Sim(scene, dt=1e-3, ledger=True)
    below.qpos[0] = 0.5
    below.step(5000)


@pytest.mark.parametrize("ledger", [True, False])
def test_the_element_is_the_one_that_gave_most(ledger):
    """Many feed: none of them a third, and what is named is still what the shares begin with."""
    model = sc.load(gym_path("half_cheetah")).compile()
    # Of a thousand seeds 27, such as 1, throw it far away, where it glides on and never diverges.
    for seed in (0, 2, 3, 4):
        sim = sc.Sim(model, dt=0.05, integrator="semi-implicit", ledger=ledger)
        sim.ctrl[:] = np.random.default_rng(seed).uniform(-1, 1, model.nu)
        with pytest.raises(sc.SimulationError) as caught:
            sim.step(2000)
        error = caught.value
        assert error.element == max(error.shares, key=error.shares.get)
        assert f"The cause is the {error.element}, the source of " in str(error)


def test_the_command_line_balances_a_run_of_few_steps(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = ["run", "lesson:spring", "--dt", "0.5", "--set", "integrator=semi-implicit"]
    assert main([*run, "--horizon", "3"]) == 1
    assert "diverged in step 6 " in capsys.readouterr().err
