"""The error of a run, from a finer run beside it: true, of the motion alone, and kept."""

import math
import pickle

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.cli import main

PENDULUM = """<mujoco><option timestep="0.01" integrator="{integrator}" gravity="0 0 -9.81"/>
 <worldbody><body name="bob"><joint name="pivot" axis="0 1 0"/>
 <geom size=".05" pos="0 0 -1" mass="1"/></body></worldbody>
 <actuator><motor joint="pivot"/></actuator></mujoco>"""
DOUBLE = """<mujoco><option timestep="0.01" gravity="0 0 -9.81"/><worldbody>
 <body><joint axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 0 0 -.5" contype="0"
  conaffinity="0"/><body pos="0 0 -.5"><joint axis="0 1 0"/><geom type="capsule" size=".02"
  fromto="0 0 0 0 0 -.5" contype="0" conaffinity="0"/></body></body></worldbody></mujoco>"""
BALL = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="1 1 .1"/>
 <body name="ball" pos="0 0 .6"><freejoint/><geom size=".1" mass="1"/></body></worldbody>
 </mujoco>"""


def at(model, angle, **fields):
    sim = sc.Sim(model, **fields)
    sim.qpos[0] = angle
    return sim


@pytest.mark.parametrize(
    "integrator, fields",
    [("Euler", {}), ("RK4", {"dt": 0.05}), ("Euler", {"accuracy": 1e-3, "dt": 0.1})],
)
def test_it_is_the_true_error(integrator, fields):
    """Truth: classical Runge-Kutta of a tiny step, 1e-12 from itself at half of it."""
    model = sc.loads(PENDULUM.format(integrator=integrator)).compile()
    sim = at(model, 2.0, error_bar=True, **fields)
    true = at(model, 2.0, dt=1e-4, integrator="rk4")
    for _ in range(10):
        sim.advance(0.1)
        true.advance(0.1)
    # Of its centre of mass, and of its turn times the radius of gyration.
    far = abs(sim.qpos[0] - true.qpos[0]) * np.hypot(1.0, 0.05 * math.sqrt(0.6))
    assert far / 3 < sim.error.largest < 3 * far
    assert sim.error.rms == sim.error.largest
    assert list(sim.body_error) == [0.0, sim.error.largest]
    assert sim.predictable_until == math.inf


@pytest.mark.parametrize("integrator", ["euler", "semi-implicit", "implicitfast", "rk4"])
@pytest.mark.parametrize("seed", range(4))
def test_it_is_no_smaller_than_the_true_error(integrator, seed):
    """Of first order to a tenth; of a higher order it may be a third larger."""
    angle, dt = np.random.default_rng(seed).uniform([0.5, 0.005], [2.5, 0.02])
    model = sc.loads(PENDULUM.format(integrator="Euler")).compile()
    sim = at(model, angle, error_bar=True, dt=dt, integrator=integrator)
    true = at(model, angle, dt=dt / 64, integrator="rk4")
    sim.step(40)
    true.step(40 * 64)
    far = abs(sim.qpos[0] - true.qpos[0]) * np.hypot(1.0, 0.05 * math.sqrt(0.6))
    assert 0.9 * far <= sim.error.largest <= (1.5 if integrator == "rk4" else 1.1) * far


@pytest.mark.parametrize("dt", [0.002, 0.005, 0.01])
@pytest.mark.parametrize("height", [0.2, 0.3, 0.6])
@pytest.mark.parametrize("tc", [0.02, 0.04])
def test_a_landing_does_not_hide_it(height, tc, dt):
    """Both runs may be near each other for a moment, alike off; truth: steps of 20 µs."""
    xml = BALL.replace(".6", f"{height}").replace("1 1 .1", f'1 1 .1" solref="{tc} 1')
    model = sc.loads(xml.replace('size=".1" mass', f'size=".1" solref="{tc} 1" mass')).compile()
    sim, true = sc.Sim(model, dt=dt, error_bar=True), sc.Sim(model, dt=2e-5)
    for _ in range(40):
        sim.advance(0.02)
        true.advance(0.02)
        assert abs(sim.qpos[2] - true.qpos[2]) <= 2 * sim.error.largest + 1e-6


def test_the_motion_is_that_without_it():
    plain, judged = (sc.Sim(sc.loads(BALL), error_bar=bar) for bar in (False, True))
    plain.step(400)
    judged.step(150)
    judged.step(250)
    assert judged.state() == plain.state()
    with pytest.raises(ValueError, match=r"error: not measured; ask for it with .*error_bar=True"):
        plain.error  # noqa: B018


def test_a_copy_goes_on_and_a_written_state_begins_anew():
    sim = sc.Sim(sc.loads(BALL), error_bar=True)
    sim.step(160)
    others = sim.copy(), pickle.loads(pickle.dumps(sim))
    for one in (sim, *others):
        one.step(10)
    assert sim.error.largest > 1e-4
    assert others[0].error == others[1].error == sim.error
    sim.qvel[2] = 0.0
    assert sim.error == (0.0, 0.0)
    before = sim.copy()
    sim.step(50)
    before.step(50)
    assert 0 < sim.error.largest == before.error.largest


def test_a_control_function_looks_at_the_run_that_it_controls():
    """An upright pendulum, held by feedback: under the controls of the first run the finer one
    would fall."""
    model = sc.loads(PENDULUM.format(integrator="Euler")).compile()

    def hold(time, sim):
        return [-40 * (sim.qpos[0] - math.pi) - 10 * sim.qvel[0]]

    class Delayed:
        """It remembers: each run has its own."""

        def __init__(self):
            self.last = 0.0

        def __call__(self, time, sim):
            command, self.last = self.last, hold(time, sim)[0]
            return [command]

    for make in (lambda: hold, Delayed):
        sim = at(model, math.pi + 0.3, error_bar=True)
        trajectory = sim.run(3.0, control=make(), record=("qpos", "energy"))
        # Once it stands, both stand in the same place.
        assert trajectory.error[:100].max() > 1e-3
        assert trajectory.error[-1].max() < 1e-5
        plain = at(model, math.pi + 0.3).run(3.0, control=make())
        assert np.array_equal(plain.qpos, trajectory.qpos)


def test_where_perturbations_grow_it_says_from_when_on():
    sim = sc.Sim(sc.loads(DOUBLE), error_bar=True)
    sim.qpos[:] = 3.0, 0.5
    sim.step(20)
    assert sim.predictable_until == math.inf
    assert sim.error.largest < 0.05
    sim.step(1500)
    until = sim.predictable_until
    assert 0.2 < until < 15
    assert sim.error == (math.inf, math.inf)
    sim.step(200)
    assert sim.predictable_until == until
    sim.reset()
    assert sim.error == (0.0, 0.0)


def test_after_a_failure_no_error_is_known():
    sim = sc.Sim(lesson.spring(), dt=0.205, integrator="explicit", ledger=True, error_bar=True)
    sim.reset("start")
    with pytest.raises(sc.SimulationError):
        sim.step(100_000)
    assert sim.error == (math.inf, math.inf)
    sim.reset("start")
    assert sim.error == (0.0, 0.0)


def test_what_cannot_be_judged_is_refused():
    late = """<mujoco><worldbody><body><joint name="a" type="slide"/><geom size=".1"/></body>
     </worldbody><actuator><motor joint="a" delay="0.01" nsample="5"/></actuator></mujoco>"""
    with pytest.raises(ValueError, match="error_bar = True: must be False in a scene with late"):
        sc.Sim(sc.loads(late), error_bar=True)
    with pytest.raises(ValueError, match="error_bar"):
        sc.Sim(sc.loads(BALL), error_bar="yes")
    with pytest.raises(ValueError, match="accuracy = 1e-10: must be at least ten times"):
        sc.Sim(sc.loads(BALL), accuracy=1e-10, error_bar=True)


def test_a_run_says_what_was_asked_and_delivered(tmp_path, capsys):
    model = sc.loads(BALL).compile().with_settings(dt=0.02, accuracy="1mm")
    result = sc.run(model, horizon=0.5, record=("energy", "xpos"))
    assert "requested: 1 mm" in result.judged
    assert result.judged in " ".join(str(result).split())
    # The accuracy is that of the end: twice as much a second.
    assert result.sim.settings.accuracy == 2e-3
    assert result.trajectory["error"].shape == (26, 2)
    assert result.trajectory["error"].max() < 1e-3
    assert result.details()["estimated_error"]["largest"] == result.sim.error.largest
    pytest.importorskip("matplotlib")
    result.plot(tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 1000
    assert sc.run(model, horizon=0.5, error_bar=False).judged == ""
    file = tmp_path / "ball.xml"
    file.write_text(BALL)
    assert main(["run", str(file), "--horizon", "0.4", "--error-bar"]) == 0
    assert "The error is estimated as" in capsys.readouterr().out


def test_a_view_shows_it_beside_the_residual():
    from stepcore.viewing.frames import instant_of
    from stepcore.viewing.panel import figures_of

    plain, judged = (sc.Sim(sc.loads(BALL), error_bar=bar) for bar in (False, True))
    for sim in (plain, judged):
        sim.step(160)
    assert "estimated error" not in dict(figures_of(instant_of(plain)))
    assert dict(figures_of(instant_of(judged)))["estimated error"].endswith("mm")
    assert judged.error.largest == instant_of(judged).error


def test_a_random_control_function_has_no_error_bar():
    rng = np.random.default_rng(0)
    model = sc.loads("""<mujoco><worldbody><body><joint name="a"/><geom size=".1" pos=".2 0 0"/>
     </body></worldbody><actuator><motor joint="a"/></actuator></mujoco>""").compile()

    def control(time, sim):
        return rng.uniform(-1, 1, 1)

    with pytest.raises(ValueError, match=r"`control`.* returned other controls when a finer run"):
        sc.run(model, control=control, horizon=0.1, error_bar=True, progress=False)
    assert sc.run(model, control=control, horizon=0.1, progress=False).success


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_a_control_function_that_feels_the_contacts(precision):
    """The finer run's forces are others, at the same state: that is no randomness."""
    model = sc.loads("""<mujoco><option timestep=".005"/><worldbody>
     <geom type="plane" size="1 1 .1"/><body pos="0 0 .099"><joint name="z" type="slide"
     axis="0 0 1"/><geom size=".1" mass="1"/><site name="s" size=".12"/></body></worldbody>
     <actuator><motor joint="z"/></actuator><sensor><touch site="s"/></sensor></mujoco>""")
    model = model.compile().with_settings(precision=precision)

    def control(time, sim):
        return -0.1 * sim.sensordata

    run = sc.run(model, control=control, horizon=0.2, error_bar=True, progress=False)
    assert run.success
    assert 0 < run.sim.error.largest < 1e-3
