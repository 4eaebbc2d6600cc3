"""The error of a run names step, element, growth and dt; the run can be repeated."""

import math
import pickle

import numpy as np
import pytest
from small import ball, pendulum, unstable

import stepcore as sc
from stepcore import lesson
from stepcore.cli import main


def fails(scene, steps=100_000, start=None, key=None, **settings):
    """The error of a run that must fail, and its Sim."""
    sim = sc.Sim(scene, **settings)
    if key:
        sim.reset(key)
    if start:
        start(sim)
    with pytest.raises(sc.SimulationError) as caught:
        sim.step(steps)
    return caught.value, sim


def spring(z, **settings):
    """The lesson's spring (ω = 10 /s) at ω dt = z."""
    return fails(lesson.spring(), key="start", dt=z / 10, **({"ledger": True} | settings))


# The message.


@pytest.mark.parametrize("z", [2.02, 2.05, 2.5])
def test_a_spring_beyond_its_limit(z):
    """Semi-implicit: the energy grows by exp(2 acosh(z²/2 − 1)) a step; stable below z = 2."""
    error, sim = spring(z, integrator="semi-implicit")
    assert error.gained and error.element == "spring of joint `spring`"
    assert error.element_id == ("spring", 0, -1) == error.share_ids[0]
    assert error.shares[error.element] > 0.99
    assert error.growth == pytest.approx(2 * math.acosh(z * z / 2 - 1) / (z / 10), rel=0.02)
    assert error.stable_dt == pytest.approx(0.2, rel=2e-4)
    assert error.time == sim.time and np.isfinite(sim.qpos).all()
    text = str(error)
    assert "\n" not in text and f"step {error.step}" in text and "spring of joint `spring`" in text


def test_damping_moves_the_limit():
    """Semi-implicit with an explicit damper: z² + 4 ζ z < 4."""
    zeta = 0.1
    scene = lesson.spring(damping=2 * zeta * 10)
    error, _ = fails(scene, key="start", dt=0.185, integrator="semi-implicit", ledger=True)
    assert error.stable_dt == pytest.approx((math.sqrt(4 + 4 * zeta**2) - 2 * zeta) / 10, rel=2e-4)


def test_explicit_euler_feeds_an_oscillator_at_every_dt():
    """The energy grows by 1 + z² a step, and doubles long before anything overflows."""
    z = 0.05
    error, sim = spring(z, integrator="explicit")
    assert error.gained and error.element == "spring of joint `spring`"
    assert 2.0 <= (1 + z * z) ** error.step < 3.0
    assert error.growth == pytest.approx(math.log(1 + z * z) / (z / 10), rel=0.02)
    assert error.stable_dt is None and "No dt is stable" in str(error)
    assert sum(sim.energy) == pytest.approx(50 * (1 + z * z) ** error.step)


def test_the_penalty_contact_of_the_lesson():
    error, _ = fails(
        lesson.drop(law="penalty"), key="start", penalty_stiffness=1e6, dt=2e-3, ledger=True
    )
    assert error.element == "contact `floor`/`shape0`" and error.shares[error.element] > 0.9
    assert error.stable_dt is not None and error.stable_dt <= 1e-3


@pytest.mark.parametrize("integrator", ["semi-implicit", "explicit"])
def test_a_spinning_plate_is_fed_by_the_integrator_itself(integrator):
    scene = sc.Scene(gravity=(0, 0, 0))
    plate = scene.add_body("plate", mass=1.0, inertia=(1.0, 2.0, 2.9))
    scene.add_joint(plate, "free", name="root")

    def spin(sim):
        sim.qvel[3:] = [0.01, 30.0, 0.01]

    error, _ = fails(scene, start=spin, dt=0.01, integrator=integrator, ledger=True)
    assert error.gained and error.element == "inertial force of joint `root`"
    assert error.shares[error.element] > 0.99
    assert error.stable_dt is not None and error.stable_dt < 0.01


def test_without_a_ledger_the_kept_states_tell():
    error, sim = fails(unstable(), start=lambda sim: sim.qpos.fill(1.0))
    assert not error.gained and error.element == "spring of joint `wild`"
    # ω dt = 10: exp(2 acosh(49)) a step.
    assert error.growth == pytest.approx(2 * math.acosh(49) / 0.1, rel=1e-3)
    assert error.stable_dt == pytest.approx(0.02, rel=2e-4)
    again = error.replay.run()
    assert again.same and error.replay.steps == 0
    assert error.step == round(sim.time / 0.1)


def test_a_force_that_overflows_is_named_in_its_first_step():
    sim = sc.Sim(ball(), ledger=True)
    sim.step(10)
    sim.qfrc_applied[:] = 1e300
    with pytest.raises(sc.SimulationError) as caught:
        sim.step(50)
    assert caught.value.element == "force applied to joint `root`"
    assert caught.value.replay.run().same


# The account.


def test_gains_add_up_to_the_change_of_energy():
    """In every step, whatever acts: Σ gains = ΔE to rounding."""
    for integrator in ("explicit", "semi-implicit", "euler", "implicitfast", "midpoint", "rk4"):
        sim = sc.Sim(pendulum(), dt=0.01, integrator=integrator)
        sim.ctrl[:] = 0.4
        sim.qfrc_applied[:] = [0.3, -0.1]
        sim.xfrc_applied[2] = [1, 2, 3, 0.1, 0.2, 0.3]
        seen = set()
        for _ in range(60):
            before = sum(sim.energy)
            gains = _by_name(sim, sim._core.taped_step()[2])
            assert sum(gains.values()) == pytest.approx(sum(sim.energy) - before, abs=1e-12)
            seen |= set(gains)
        assert {"motor `motor`", "gravity", "damper of joint `shoulder`"} <= seen
        assert {"force applied to joint `elbow`", "force applied to body `lower`"} <= seen
        assert "contact `tip`/`floor`" in seen or "contact `floor`/`tip`" in seen


def test_midpoint_makes_no_energy_of_its_own():
    """Implicit midpoint on a spring: the spring takes back exactly what it gave."""
    sim = sc.Sim(lesson.spring(), dt=0.05, integrator="midpoint")
    sim.reset("start")
    for _ in range(50):
        before, after, gains = sim._core.taped_step()
        assert after == pytest.approx(before, rel=1e-13)
        gains = _by_name(sim, gains)
        assert abs(gains["spring of joint `spring`"]) < 1e-12 * before


def _by_name(sim, gains):
    return {sim.model._core.element_name(*element): gain for element, gain in gains}


@pytest.mark.parametrize("integrator", ["semi-implicit", "implicitfast", "rk4"])
def test_the_motion_does_not_depend_on_the_ledger(integrator):
    twins = [sc.Sim(pendulum(), integrator=integrator, ledger=on) for on in (False, True)]
    rng = np.random.default_rng(1)
    for _ in range(150):
        ctrl = rng.uniform(-1, 1)
        for sim in twins:
            sim.ctrl[:] = ctrl
            sim.step(3)
    assert twins[0].state() == twins[1].state()


# No false alarms: none of these may raise.


@pytest.mark.parametrize("z", [0.5, 1.9, 1.99, 1.999, 1.9999])
def test_a_spring_below_its_limit_swings_and_stays(z):
    sim = sc.Sim(lesson.spring(), dt=z / 10, integrator="semi-implicit", ledger=True)
    sim.reset("start")
    sim.step(20_000)


@pytest.mark.parametrize("law", ["solref", "lesson", "rigid", "penalty"])
def test_what_is_pressed_in_comes_out(law):
    sim = sc.Sim(ball(law=law, solver="pgs"), dt=1e-3, ledger=True)
    sim.qpos[2] = 0.02
    sim.step(3000)


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_bounces(restitution):
    scene = ball(law="rigid", solver="pgs", restitution=restitution)
    sim = sc.Sim(scene, dt=1e-3, ledger=True)
    sim.qpos[2] = 1.0
    sim.qvel[3:] = [3.0, 0.0, 5.0]
    sim.step(5000)


def test_what_falls_for_ever():
    sim = sc.Sim(pendulum(), integrator="explicit", ledger=True)
    sim.step(2000)
    free = sc.Sim(unstable(dt=1e-3), ledger=True)
    free.step(2000)


# Running again.


def controlled(sim, steps):
    rng = np.random.default_rng(5)
    for _ in range(steps):
        sim.ctrl[:] = rng.uniform(-1, 1)
        sim.qfrc_applied[1] = rng.uniform(-0.1, 0.1)
        sim.step()


def wild_pendulum(**settings):
    scene = pendulum(dt=0.01, integrator="semi-implicit", **settings)
    scene.joint("elbow").stiffness = 2e4
    return scene


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_a_replay_is_the_same_failure(tmp_path, precision):
    sim = sc.Sim(wild_pendulum(), ledger=True, precision=precision)
    with pytest.raises(sc.SimulationError) as caught:
        controlled(sim, 5000)
    error = caught.value
    assert error.element == "spring of joint `elbow`"
    path = tmp_path / "failure.json"
    error.replay.save(path)
    again = sc.replay(path)
    assert again.same and again.paragraph == str(error)
    assert again.time[-1] == pytest.approx(error.time, abs=1e-12)
    assert len(again.time) == error.replay.steps > 0
    # With another recorded state, it is not the same.
    error.replay.happened["state"] = "0" * 64
    assert not error.replay.run().same


def test_an_error_and_its_replay_pickle():
    error, _ = spring(2.05)
    twin = pickle.loads(pickle.dumps(error))
    assert twin.replay == error.replay and twin.replay.run().same
    assert (str(twin), twin.shares, twin.growth) == (str(error), error.shares, error.growth)


def test_a_file_that_is_none_or_damaged_or_of_another_version(tmp_path):
    error, _ = spring(2.05)
    text = error.replay.to_json()
    path = tmp_path / "failure.json"
    damaged = [
        ("", "not a replay file"),
        (text[: len(text) // 2], "not a replay file, or incomplete"),
        ("[]", "not a replay file"),
        ('{"kind": "something"}', "not a replay file"),
        (text.replace('"version": 2', '"version": 99'), "version 99"),
        (text.replace('"steps": 64', '"steps": 63'), "edited or damaged"),
        (text.replace('"state": "c3Rl', '"state": "d3Rl'), "edited or damaged"),
        (text.replace('"gravity"', '"levity"'), "edited or damaged"),
    ]
    for bad, reason in damaged:
        path.write_text(bad)
        with pytest.raises(ValueError, match=reason) as caught:
            sc.replay(path)
        assert "\n" not in str(caught.value) and str(path) in str(caught.value)
    with pytest.raises(FileNotFoundError, match=r"none\.json: no such file$"):
        sc.replay(tmp_path / "none.json")
    with pytest.raises(IsADirectoryError, match="is a folder, not a replay file"):
        sc.replay(tmp_path)
    with pytest.raises(ValueError, match="must be a path or a Replay"):
        sc.replay(3)


@pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")
def test_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = ["run", "lesson:spring", "--dt", "0.205", "--horizon", "100"]
    assert main([*run, "--set", "integrator=semi-implicit"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "stepcore replay spring-step64.replay.json" in said
    assert main([*run, "--replay", "chosen.json"]) == 1
    capsys.readouterr()
    assert main(["replay", "chosen.json", "--plot", "work.png", "--json"]) == 0
    assert '"same": true' in capsys.readouterr().out
    assert (tmp_path / "work.png").read_bytes().startswith(b"\x89PNG")
    assert main(["replay", "chosen.json"]) == 0
    assert "with the same bits" in capsys.readouterr().out
    assert main(["replay", "work.png"]) == 2
    assert main([*run, "--replay", "nowhere/x.json"]) == 2
    assert main([*run, "--set", "ledger=false", "--horizon", "2.05"]) == 0


# Servos.


def arm(kp, kv, **options):
    """A body of 1 kg on a slide, held by a position servo."""
    scene = sc.Scene(gravity=(0, 0, 0)).with_settings(**options)
    body = scene.add_body("load")
    scene.add_joint(body, "slide", name="rail")
    scene.add_geom(body, "sphere", 0.1, mass=1.0)
    scene.add_actuator("rail", type="position", name="stiff", kp=kp, kv=kv)
    return scene


@pytest.mark.parametrize("zeta", [0.05, 0.3])
def test_a_stiff_servo_and_its_limit(zeta):
    """implicitfast takes kv implicitly: stable while dt < (2ζ + 2√(ζ² + 1))/ω; euler does not."""
    omega = 1000.0
    scene = arm(omega**2, 2 * zeta * omega)
    limits = {
        "implicitfast": (2 * zeta + 2 * math.sqrt(zeta**2 + 1)) / omega,
        "euler": (2 * math.sqrt(zeta**2 + 1) - 2 * zeta) / omega,
    }
    for integrator, limit in limits.items():
        error, _ = fails(
            scene,
            start=lambda sim: sim.ctrl.fill(0.1),
            dt=1.02 * limit,
            integrator=integrator,
            ledger=True,
        )
        assert error.element == "servo `stiff`" and error.shares[error.element] > 0.99
        assert error.stable_dt == pytest.approx(limit, rel=1e-3)
        below = sc.Sim(scene, dt=0.98 * limit, integrator=integrator, ledger=True)
        below.ctrl[:] = 0.1
        below.step(5000)


def test_what_a_moved_control_puts_in_is_no_gain():
    """A stiff servo thrown from end to end, with a bounded force and without."""
    rng = np.random.default_rng(2)
    for forcerange in (None, (-50.0, 50.0)):
        scene = arm(1e4, 1.0, dt=1e-3)
        scene.actuators[0].forcerange = forcerange
        sim = sc.Sim(scene, ledger=True)
        for _ in range(300):
            sim.ctrl[:] = rng.uniform(-1, 1)
            sim.step(int(rng.integers(1, 40)))


# Batches.


def wild_batch(**how):
    batch = sc.Batch(unstable(), 20, on_failure="go on", **how)
    batch.qpos[:] = [1.0, 0.0]
    batch.qpos[17, 1] = 1e100
    batch.qpos[13, 1] = 1.0
    return batch


def alone(start, steps, ledger):
    sim = sc.Sim(unstable(), ledger=ledger)
    sim.qpos[:] = start
    try:
        sim.step(steps)
    except sc.SimulationError as error:
        return sim, error
    return sim, None


@pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")
@pytest.mark.parametrize("lanes", [True, False])
@pytest.mark.parametrize("ledger", [True, False])
def test_the_others_go_on(lanes, ledger):
    batch = wild_batch(lanes=lanes, ledger=ledger, threads=2)
    batch.step(600)
    batch.step(400)
    assert list(batch.failures) == [13, 17] and batch.failures is not batch.failures
    well = alone([1.0, 0.0], 1000, ledger)[0]
    assert all(batch.state()[world] == well.state() for world in range(20) if world not in (13, 17))
    assert batch.time == well.time
    for world, start in ((13, 1.0), (17, 1e100)):
        error, (sim, same) = batch.failures[world], alone([1.0, start], 1000, ledger)
        assert (error.world, error.step, error.element) == (world, same.step, same.element)
        assert (batch.qpos[world] == sim.qpos).all() and (batch.qvel[world] == sim.qvel).all()
        assert f"in world {world}." in str(error) and error.replay.run().same
        assert batch.failures[world] is error
    assert [len(rows) for rows in batch.rows] == [0] * 20 and np.isfinite(batch.energy[:13]).all()
    # Written anew, a world moves again.
    batch.qpos[13], batch.qvel[13] = [1.0, 0.0], 0.0
    batch.step(10)
    assert list(batch.failures) == [17]
    batch.reset()
    assert batch.failures == {}


def test_a_rollout_goes_on():
    batch = wild_batch(ledger=True)
    states = batch.rollout(np.zeros((20, 300, 0)))
    assert np.isfinite(states.qpos).all() and np.isfinite(states.qvel).all()
    step = batch.failures[13].step
    assert (states.qpos[13, step - 1 :] == batch.qpos[13]).all()
    assert (states.qpos[13, step - 2] != batch.qpos[13]).any()
    well = sc.Sim(unstable())
    well.qpos[:] = [1.0, 0.0]
    well.step(300)
    assert (states.qpos[5, -1] == well.qpos).all()


def test_a_batch_that_stops_tells_as_much():
    batch = sc.Batch(unstable(), 9, ledger=True)
    batch.qpos[4, 1] = 1.0
    with pytest.raises(sc.SimulationError, match=r"in world 4\. .*`wild`") as caught:
        batch.step(1000)
    assert caught.value.world == 4 and caught.value.replay.run().same
    with pytest.raises(ValueError, match="on_failure = 'ignore': must be one of"):
        sc.Batch(unstable(), 2, on_failure="ignore")


@pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")
def test_every_world_fails_and_time_goes_on():
    batch = sc.Batch(unstable(), 3, on_failure="go on")
    batch.qpos[:] = 1.0
    batch.step(1000)
    assert list(batch.failures) == [0, 1, 2] and batch.time == pytest.approx(100.0)


def test_a_motor_that_only_drives_is_not_blamed():
    """From rest all energy is the motor's at first; the spring makes it explode in 19 steps."""
    scene = pendulum(dt=0.01, integrator="semi-implicit")
    scene.joint("elbow").stiffness = 800.0
    sim, rng = sc.Sim(scene, ledger=True), np.random.default_rng(0)
    with pytest.raises(sc.SimulationError) as caught:
        for _ in range(3000):
            sim.ctrl[:] = rng.uniform(-1, 1)
            sim.step()
    assert caught.value.element == "spring of joint `elbow`"
    assert caught.value.replay.run().same


def test_an_unstable_controller_is_named_by_its_motor():
    """A user's spring, applied by ctrl with ω dt = 2.5: the motor does have that energy."""
    scene = sc.Scene(gravity=(0, 0, 0))
    body = scene.add_body("load")
    scene.add_joint(body, "slide", name="rail")
    scene.add_geom(body, "sphere", 0.1, mass=1.0)
    scene.add_actuator("rail", name="drive", gear=(1e6,))
    sim = sc.Sim(scene, dt=0.01, integrator="semi-implicit", ledger=True)
    sim.qpos[0] = 1.0
    with pytest.raises(sc.SimulationError) as caught:
        for _ in range(5000):
            sim.ctrl[0] = -(250.0**2) / 1e6 * sim.qpos[0]
            sim.step()
    assert not caught.value.gained and caught.value.element == "motor `drive`"
    assert caught.value.replay.run().same


def test_the_picture_of_what_overflowed(tmp_path):
    sim = sc.Sim(wild_pendulum(), ledger=True)
    with pytest.raises(sc.SimulationError) as caught:
        controlled(sim, 5000)
    again = caught.value.replay.run()
    again.plot(tmp_path / "work.png")
    assert "</html>" in again.to_html() and '"same": true' in again.to_json()
