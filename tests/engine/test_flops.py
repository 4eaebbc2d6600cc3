"""Counted work: `Sim.count_flops`, `Sim.stage_flops` and `Sim.nbytes`."""

import signal
import threading

import numpy as np
import pytest
from small import ball, pendulum
from zoo import ZOO

import stepcore as sc
from stepcore import Sim, lesson

STAGES = [
    "place/kinematics",
    "place/inertia",
    "place/factor",
    "place/bias",
    "place/forces",
    "place/guess",
    "detect",
    "solve/rows",
    "solve/impulses",
    "commit",
]


def test_a_spring_by_hand():
    """A slide with a spring and a damper, semi-implicit, no contact: what its formulas ask for.

    forces: −(d v), k (q − rest) subtracted: 4; less the bias, 1. guess: D⁻¹ f, v + dt a: 3.
    velocity: (v⁺ − v)/dt: 2. commit: q + dt v⁺: 2. kinematics: the body's place: 7.
    """
    scene = sc.Scene(gravity=(0, 0, 0)).with_settings(integrator="semi-implicit")
    cart = scene.add_body("cart")
    scene.add_joint(cart, "slide", name="rail", stiffness=3.0, damping=0.2)
    scene.add_geom(cart, "sphere", 0.1, mass=1.0, contype=0, conaffinity=0)
    flops = Sim(scene).stage_flops()
    assert list(flops) == STAGES
    assert flops["place/forces"] == 5 and flops["place/guess"] == 3
    assert flops["solve/impulses"] == 2 and flops["commit"] == 2
    assert flops["place/kinematics"] <= 7
    assert flops["detect"] == flops["solve/rows"] == 0
    assert flops["place/inertia"] == flops["place/factor"] == flops["place/bias"] == 0


def test_contacts_that_hold_take_no_axes():
    """A box at rest under PGS, elliptic with condim 6; by the axes of four cones it is 25,000."""
    text = """<mujoco><option cone="elliptic" solver="PGS" iterations="2" tolerance="0"
      gravity="{} 0 -9.81"/><worldbody><geom type="plane" size="5 5 1" condim="6"
      friction=".3 .05 .01"/><body pos="0 0 .1"><freejoint/><geom type="box" size=".1 .1 .1"
      condim="6" friction=".3 .05 .01"/></body></worldbody></mujoco>"""
    work = []
    for along in (1, 4):
        sim = Sim(sc.loads(text.format(along)))
        sim.step(50)
        assert len(sim.rows) == 24 and (abs(sim.qvel[0]) > 0.05) == (along == 4)
        work.append(sim.stage_flops()["solve/impulses"])
    assert work[0] < 10_000 < 20_000 < work[1]


def test_sweeps_are_counted_by_the_row():
    """Under PGS: a constant, and the same for every sweep of every row on as many dofs."""
    model = lesson.tower([1.0] * 6).compile()
    work, updates = [], []
    for sweeps in (2, 4, 8, 16):
        sim = Sim(model, solver="pgs", sweeps=sweeps, tolerance=0.0, law="lesson", softness=1e-4)
        sim.forward()
        updates.append(sim.row_updates)
        assert sim.most_rows == len(sim.rows) > 0
        work.append(sim.stage_flops()["solve/impulses"])
    slopes = np.diff(work) / np.diff(updates)
    assert updates[0] > 0 and np.ptp(slopes) == 0 and 5 < slopes[0] < 40


@pytest.mark.parametrize("name", ["all_together", "free_offset", "motors"])
@pytest.mark.parametrize("integrator", ["semi-implicit", "implicitfast", "rk4", "midpoint"])
def test_counting_is_exact_and_moves_nothing(name, integrator):
    """n steps counted at once are the n steps counted one by one along the real run."""
    sim = Sim(sc.loads(ZOO[name].text), integrator=integrator)
    sim.qvel[:] = 0.3
    sim.step(5)
    before, together, alone = sim.state(), sim.count_flops(4), 0
    assert sim.state() == before
    for _ in range(4):
        flops = sim.stage_flops()
        assert sum(flops.values()) == sim.count_flops() and min(flops.values()) >= 0
        alone += sim.count_flops()
        sim.step()
    assert together == alone > 0


def test_integrators_by_their_stages():
    """rk4 places and detects four times; a step in the air makes no rows."""
    one = Sim(pendulum(integrator="semi-implicit")).stage_flops()
    four = Sim(pendulum(integrator="rk4")).stage_flops()
    for stage in ("place/kinematics", "place/inertia", "place/factor", "place/bias", "detect"):
        assert four[stage] == 4 * one[stage] > 0
    high = Sim(ball())
    low = high.stage_flops()["solve/rows"]
    high.qpos[2] = 5.0
    assert high.stage_flops()["solve/rows"] == 0 < low


def test_arguments():
    sim = Sim(pendulum())
    assert sim.count_flops(0) == 0
    with pytest.raises(ValueError, match="n = -1"):
        sim.count_flops(-1)
    sim.qvel[0] = np.inf
    with pytest.raises(ValueError, match=r"qvel\[0\]"):
        sim.count_flops()
    with pytest.raises(ValueError, match=r"qvel\[0\]"):
        sim.stage_flops()


def test_memory():
    """More dofs and contacts hold more; single precision less; stepping in place nothing more."""
    small, large = Sim(pendulum()), Sim(sc.loads(ZOO["all_together"].text))
    assert 2000 < small.nbytes < large.nbytes < 1_000_000
    assert Sim(pendulum(precision="f32")).nbytes < small.nbytes
    resting = Sim(ball())
    resting.step(500)
    held = resting.nbytes
    resting.step(500)
    assert resting.nbytes == held


def test_an_interrupt_stops_it_and_the_sim_stays_free_meanwhile():
    """What is counted is a copy: other threads read and step the Sim itself."""
    sim, seen = Sim(pendulum()), []

    def meddle():
        sim.step(3)
        seen.append((sim.time, sim.linearize().nv))
        signal.raise_signal(signal.SIGINT)

    started = threading.Timer(0.1, meddle)
    with pytest.raises(KeyboardInterrupt):
        started.start()
        sim.count_flops(10**9)
    started.join()
    assert seen == [(pytest.approx(0.006), 2)]
