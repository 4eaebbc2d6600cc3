"""Without a ledger too, energy that no force can have given is told: once, and never wrongly."""

import dataclasses
import warnings

import numpy as np
import pytest
from violent import play

import stepcore as sc

BALL = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/><body pos="0 0 .5">
<freejoint/><geom name="ball" size=".1" mass="1"/></body></worldbody></mujoco>"""


def loop(n, **settings):
    """n links of 2 m in all between two points, straight: the last one is held by a connect."""
    size = 2 / n
    link = f'<geom type="capsule" size=".01" fromto="0 0 0 {size} 0 0" mass="{size / 2}"'
    bodies = "".join(
        f'<body name="b{k}" pos="{size if k else 0} 0 0"><joint axis="0 1 0"/>'
        f'{link} contype="0" conaffinity="0"/>'
        for k in range(n)
    )
    held = f'<connect body1="b{n - 1}" anchor="{size} 0 0"/>'
    world = f"<worldbody>{bodies}{'</body>' * n}</worldbody>"
    scene = sc.loads(f"<mujoco>{world}<equality>{held}</equality></mujoco>")
    return sc.Sim(scene, solver="pgs", sweeps=50, **settings)


@pytest.mark.parametrize("stiffness", [1e8, 1e10, 1e14])
def test_a_penalty_contact_that_throws(stiffness):
    """At dt = 2 ms a contact of 1e14 N/m multiplies the energy by 1e16 in one bounce."""
    sim = sc.Sim(sc.loads(BALL), law="penalty", penalty_stiffness=stiffness)
    start = sim.energy.total
    with pytest.warns(sc.EnergyWarning, match="The cause is the contact `floor`/`ball`") as said:
        sim.step(2000)
    assert len(said) == 1 and "by step 256 at time 0.512000 s" in str(said[0].message)
    assert sim.energy.total > 1e4 * start


@pytest.mark.parametrize("n", [80, 140])
def test_a_long_closed_chain_of_few_sweeps(n):
    """From rest it has no more than its weight can give, 1 kg through 1 m: 10 J."""
    sim = loop(n, law="rigid", dt=0.005)
    with pytest.warns(sc.EnergyWarning, match="The cause is") as said:
        sim.step(60)
        sim.balance()
    assert len(said) == 1 and sim.energy.kinetic > 30


ROCKING = """<mujoco><worldbody><geom name="floor" type="plane" size="9 9 1" friction="5"/>
<body pos="0 0 .1"><freejoint/><geom name="egg" type="{}" size="{}" mass="1" friction="5"/></body>
</worldbody></mujoco>"""

RIGID = {"law": "rigid", "dt": 0.002, "solver": "pgs", "sweeps": "auto"}


@pytest.mark.parametrize("integrator", ["rk4", "midpoint"])
def test_contacts_after_the_stages_of_a_step_feed_what_rocks(integrator):
    """An ellipsoid that rolls without slip keeps its energy; solved after the stages it gains."""
    scene = sc.loads(ROCKING.format("ellipsoid", ".3 .2 .1"))
    sim = sc.Sim(scene, **RIGID, integrator=integrator)
    sim.qvel[:] = 0.2, 0, 0, 0, 2, 0
    with pytest.warns(sc.EnergyWarning, match="the contact `floor`/`egg`.*semi-implicit") as said:
        sim.step(5000)
    assert len(said) == 1


STONE = """<mujoco><worldbody><geom name="floor" type="plane" size="9 9 1" friction="3"/>
<body pos="0 0 .05"><freejoint/><geom type="ellipsoid" size=".3 .08 .05" mass="0" friction="3"/>
<inertial pos="0 0 -.01" mass="1" fullinertia="0.004 .02 .022 .003 0 0"/></body></worldbody>
</mujoco>"""
PAIR = """<mujoco><worldbody><geom name="ball" size=".5" friction="3" pos="0 0 -.5"/>
<body pos="0 0 .1"><freejoint/><geom type="ellipsoid" size=".3 .2 .1" mass="1" friction="3"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(("text", "spin"), [(STONE, (0.3, 0.3, -3)), (PAIR, (0, 1, 0))])
@pytest.mark.parametrize("integrator", ["rk4", "midpoint", "semi-implicit"])
def test_a_gain_of_less_than_a_doubling_is_told_after_stages(text, spin, integrator):
    """A rattleback and a body that rocks on a ball keep their energy under semi-implicit."""
    sim = sc.Sim(sc.loads(text), **RIGID, integrator=integrator)
    sim.qvel[3:] = spin
    start, staged = sim.energy, integrator != "semi-implicit"
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        sim.step(5000)
    gain = (sim.energy.total - start.total) / start.kinetic
    assert (gain > 0.3) == staged and gain < 1
    assert [told.category for told in said] == [sc.EnergyWarning] * staged


DRIVEN = """<mujoco><worldbody><body><joint name="x" type="slide"/><geom size=".1" mass="1"/>
</body></worldbody><actuator><motor name="m" joint="x" gear="1e3"/></actuator></mujoco>"""
COARSE = {"dt": 0.05, "integrator": "semi-implicit"}


@pytest.mark.parametrize("go", [1, 4])
@pytest.mark.parametrize("worlds", [None, 1, 16])
def test_controls_that_feed_a_motion_without_end_are_told(go, worlds):
    """x'' = -3000 x by a control that is written between steps: all its work counts as put in."""
    scene = sc.loads(DRIVEN)
    sim = sc.Batch(scene, worlds, **COARSE) if worlds else sc.Sim(scene, **COARSE)
    sim.qpos[:] = 0.1
    with pytest.warns(sc.EnergyWarning, match="velocity of joint `x` is .*motor `m`") as said:
        for _ in range(200 // go):
            sim.ctrl[:] = -3 * sim.qpos
            sim.step(go)
    assert len(said) == 1 and np.isfinite(sim.qpos).all()


def test_a_replay_of_what_is_too_fast_ends_in_that_state():
    """And one of what is not finite in a further step, however fast the last state was."""
    sim = sc.Sim(sc.loads(DRIVEN), **COARSE, ledger=True)
    sim.qpos[:] = 0.1
    with pytest.raises(sc.SimulationError, match="faster than anything moves") as caught:
        for _ in range(200):
            sim.ctrl[:] = -3 * sim.qpos
            sim.step()
    failure = caught.value.replay.run()
    assert failure.same and not caught.value.gained and "faster" in failure.to_html()
    sim = sc.Sim(sc.loads(DRIVEN), **COARSE)
    sim.qvel[:], sim.ctrl[:] = 1e12, 1e307
    with pytest.raises(sc.SimulationError, match="not finite") as caught:
        sim.step()
    failure = caught.value.replay
    assert failure.run().same
    calm = [(failure.steps, [0.0], [0.0], [0.0] * 12, [], [], [])]
    assert not dataclasses.replace(failure, inputs=calm).run().same


@pytest.mark.parametrize("shape", [("sphere", ".1"), ("capsule", ".1 .1"), ("cylinder", ".2 .05")])
@pytest.mark.parametrize("integrator", ["semi-implicit", "rk4", "midpoint"])
def test_what_rolls_exactly_is_not_warned_of(shape, integrator):
    sim = sc.Sim(sc.loads(ROCKING.format(*shape)), **RIGID, integrator=integrator)
    sim.qpos[3:] = np.sqrt([0.5, 0.5, 0, 0])
    sim.qpos[2] = 0.2 if shape[0] == "cylinder" else 0.1
    sim.qvel[:] = 0.4, 0, 0, 0, 2, 0.3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim.step(3000)


def test_an_explosion_is_told_once_and_changes_nothing():
    """Explicit Euler: E grows by 1 + (ω dt)² a step, which nobody need learn from an overflow."""
    watched, unwatched = (sc.Sim(sc.lesson.spring(), dt=0.05, integrator="explicit") for _ in "ab")
    unwatched._core.unwatch()
    for sim in (watched, unwatched):
        sim.reset("start")
    with pytest.warns(sc.EnergyWarning, match="the spring of joint `spring`.*goes on") as said:
        for _ in range(20):
            watched.step(50)
    unwatched.step(1000)
    assert len(said) == 1 and watched.state() == unwatched.state()
    assert watched.energy.total / 50.0 == pytest.approx(1.25**1000, rel=1e-9)


def test_the_warning_points_to_the_call_of_step():
    sim = sc.Sim(sc.lesson.spring(), dt=0.25, integrator="semi-implicit")
    sim.reset("start")
    with pytest.warns(sc.EnergyWarning) as said:
        sim.step(64)
    assert said[0].filename == __file__


@pytest.mark.parametrize(
    ("go", "when"), [("step", 64), ("steps", 64), ("run", 40), ("balance", 40)]
)
def test_a_short_run_is_looked_at_where_it_ends(go, when):
    """ω dt = 2.5: E grows 16-fold a step."""
    sim = sc.Sim(sc.lesson.spring(), dt=0.25, integrator="semi-implicit")
    sim.reset("start")
    with pytest.warns(sc.EnergyWarning, match=f"by step {when} "):
        if go == "step":
            sim.step(64)
        elif go == "run":
            sim.run(40 * 0.25)
        else:
            for _ in range(4 if go == "balance" else 7):
                sim.step(10)
        if go == "balance":
            sim.balance()


def test_below_its_limit_a_spring_may_swing():
    """ω dt = 1.999: a symplectic method conserves an energy of its own; E swings 1,000-fold."""
    sim = sc.Sim(sc.lesson.spring(), dt=0.1999, integrator="semi-implicit")
    sim.reset("start")
    most = 0.0
    for _ in range(2000):
        sim.step(8)
        most = max(most, sim.energy.total)
    assert most > 500 * 50.0


@pytest.mark.parametrize("integrator", ["euler", "implicitfast", "rk4"])
@pytest.mark.parametrize("force", [5, 52])
def test_a_servo_that_swings_at_its_bounds_is_let_go_on(integrator, force):
    """1.5e-4 kg·m², kp 500, kv 50: in a step its force turns it by more than it is off.

    It chatters, and stays finite: no faster than two steps of that force make it."""
    text = f"""<mujoco><worldbody><body><joint name="wrist" axis="1 0 0"/>
    <inertial pos="0 0 0" mass=".1" diaginertia="1.5e-4 1.5e-4 1.5e-4"/></body></worldbody>
    <actuator><position joint="wrist" kp="500" kv="50" forcerange="-{force} {force}"/></actuator>
    </mujoco>"""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sc.StiffnessWarning)
        sim = sc.Sim(sc.loads(text), integrator=integrator, dt=2e-3)
    sim.qvel[0] = 2.0
    sim.step(3000)
    assert abs(sim.qvel[0]) < 2 * force * 2e-3 / 1.5e-4 + 2


def told_rightly(seed):
    """Nothing was said of a seed's energy; or at some finer dt, in f64, it has less than half."""
    said, most, dt = play(seed)
    finer = (play(seed, dt / parts, precision="f64")[1] for parts in (1, 8, 32, 128))
    return not said or any(energy < 0.4 * most for energy in finer)


def test_violent_runs_raise_no_false_alarm():
    assert [seed for seed in range(48) if not told_rightly(seed)] == []


@pytest.mark.long
@pytest.mark.parametrize("part", range(4))
def test_a_thousand_violent_runs_raise_no_false_alarm(part):
    """Dropped, pressed, spun, driven by servos and motors, pushed, sprung, in loops."""
    seeds = range(1000 + 250 * part, 1250 + 250 * part)
    assert [seed for seed in seeds if not told_rightly(seed)] == []


@pytest.mark.parametrize("lanes", [False, True, "auto"])
@pytest.mark.parametrize("how", ["step", "steps", "rollout"])
def test_a_batch_says_it_once_and_names_the_world(lanes, how):
    """ω dt = 2.5 in one world, which alone moves: E grows 16-fold a step."""
    batch = sc.Batch(sc.lesson.spring(), 20, lanes=lanes, dt=0.25, integrator="semi-implicit")
    batch.qpos[13, 0] = 1e-60
    with pytest.warns(sc.EnergyWarning, match="world 13: by step .*`spring`.*goes on") as said:
        for _ in range(3 if how == "steps" else 1):
            if how == "rollout":
                batch.rollout(np.zeros((20, 200, 0)))
            else:
                batch.step(70)
        batch.step(70)
    assert len(said) == 1


def test_a_batch_of_many_is_looked_at_here_and_there():
    """Of 400 worlds 32, evenly spread: what is wrong in all of them is found."""
    batch = sc.Batch(sc.lesson.spring(), 400, dt=0.25, integrator="semi-implicit")
    batch.qpos[:, 0] = 1e-60
    with pytest.warns(sc.EnergyWarning, match="world"):
        batch.step(64)
        batch.step(64)


def test_a_batch_that_is_watched_has_the_bits_of_one_that_is_not():
    model = sc.load("gymnasium:half_cheetah").compile()
    runs = []
    for watched in (True, False):
        batch = sc.Batch(model, 24)
        if not watched:
            batch._core.unwatch()
        batch.qvel[:] = np.random.default_rng(0).normal(size=batch.qvel.shape)
        batch.rollout(np.random.default_rng(1).uniform(-1, 1, (24, 300, model.nu)))
        runs.append(b"".join(batch.state()))
    assert runs[0] == runs[1]
