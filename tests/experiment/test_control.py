"""A user's control function: how often it is sampled, and the error of one that cannot run."""

import numpy as np
import pytest

import stepcore as sc
from stepcore.engine.control import ControlError, control_name
from stepcore.experiment.engines import run
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import scheduled

QUIET = {"by": "flops", "threads": 1, "progress": False, "starts": 1}

LEG = """<mujoco><option timestep="0.002"/><worldbody><body name="leg" pos="0 0 1">
<joint name="ankle" axis="0 1 0"/><geom type="capsule" size=".04" fromto="0 0 0 0 0 -.4" mass="2"/>
</body></worldbody><actuator><motor name="ankle" joint="ankle"/></actuator>
<keyframe><key name="out" qpos="0.3"/></keyframe></mujoco>"""


def leg():
    return sc.loads(LEG)


def pd(time, sim, kp=2000.0, kd=20.0):
    return [-kp * sim.qpos[0] - kd * sim.qvel[0]]


def sampled(period, dt):
    """The times at which a run at the step dt [s] calls for controls, with or without a period."""
    times = []

    def counted(time, sim):
        times.append(time)
        return pd(time, sim)

    model, motion = leg().compile(), Motion(horizon=0.04, control=counted, control_dt=period)
    schedule = scheduled(motion, model, motion.period(0.002), starts=1)
    run(model.with_settings(dt=dt), schedule, [0])
    return np.array(times)


@pytest.mark.parametrize(("given", "period"), [(None, 0.002), (0.004, 0.004)])
def test_a_control_is_sampled_every_shipped_step_whatever_step_is_tried(given, period):
    for dt in (0.002, 0.0005):
        times = sampled(given, dt)
        assert times == pytest.approx(period * np.arange(round(0.04 / period)), abs=1e-12)


def test_rows_of_controls_are_steps_and_a_constant_has_no_period():
    assert Motion(ctrl=[[0.0], [1.0]]).period(0.002) == 0.002
    assert Motion(ctrl=[[1.0], [1.0]]).period(0.002) is None and Motion().period(0.002) is None
    assert Motion(ctrl=[[0.0], [1.0]], control_dt=0.01).period(0.002) == 0.01


def test_a_healthy_pd_is_accurate_at_the_step_at_which_it_is_sampled():
    # Held over four steps it lost its damping: 341 mm wrong, and unpredictable.
    result = sc.trade(leg(), control=pd, horizon=0.5, **QUIET)
    assert result.error(result.shipped) < 2e-3 and np.isinf(result.predictable)
    assert all(row.settings.dt <= 0.002 for row in result.rows)
    # The judged run is the shipped run itself, made by hand.
    sim = sc.Sim(leg())
    sim.reset(key="out")
    by_hand = sim.run(0.5, control=pd).qpos[-1, 0]
    truth = sc.Sim(leg(), dt=0.00002, integrator="rk4")
    truth.reset(key="out")
    exact = truth.run(0.5, control=pd, control_dt=0.002).qpos[-1, 0]
    assert abs(by_hand - exact) < 2e-3


@pytest.mark.parametrize(
    ("returned", "words"),
    [
        ([np.nan], "returned NaN for motor `ankle` at time 0 s: must return 1 finite number"),
        ([1.0, 2.0, 3.0], r"returned an array of shape \(3,\) at time 0 s"),
        (None, "returned None at time 0 s"),
        ("much", "returned 'much' at time 0 s"),
    ],
)
@pytest.mark.parametrize("measure", [sc.trade, sc.diagnose, sc.converge, sc.predict])
def test_a_control_that_returns_no_controls_is_named_with_what_it_returned(
    measure, returned, words
):
    def policy(time, sim):
        return returned

    fields = {"control": policy, "horizon": 0.02, "threads": 1, "progress": False}
    with pytest.raises(ControlError, match=f"`policy` of test_control.py {words}"):
        measure(leg(), **fields)


def test_a_value_error_of_the_function_is_no_failure_of_the_settings():
    def policy(time, sim):
        raise ValueError("no weights")

    with pytest.raises(ControlError, match=r"`policy` of .* raised ValueError: no weights"):
        sc.trade(leg(), control=policy, horizon=0.02, **QUIET)


def test_a_control_that_fails_later_is_named_by_the_reference():
    def policy(time, sim):
        return [np.nan if time > 0.01 else 0.0]

    words = r"`policy` of test_control.py returned NaN for motor `ankle` at time 0.012 s"
    with pytest.raises(ValueError, match=words):
        sc.trade(leg(), control=policy, horizon=0.04, **QUIET)


def test_nothing_is_recommended_for_a_motion_that_its_control_blows_up():
    # Sampled every 2 ms this gain is unstable however short the steps between are:
    # T < 2 kd/kp is the z-map's limit, 0.2 ms.
    def hot(time, sim):
        return pd(time, sim, kp=200_000.0)

    explodes = r"the converged motion fails under .* `hot` .* The cause is motor `ankle`"
    diverged = r"the (reference|converged motion) fails.* under .* `hot` .* The cause is motor"
    for measure, why in (
        (sc.trade, explodes),
        (sc.predict, r"under .* `hot`"),
        (sc.converge, diverged),
    ):
        with pytest.raises(ValueError, match=why):
            measure(leg(), control=hot, starts=1, horizon=1.0, threads=1, progress=False)


def test_a_constant_torque_is_no_explosion():
    # The motion itself grows as a polynomial: a flywheel under 1,000 N·m.
    wheel = sc.loads(
        "<mujoco><worldbody><body><joint name='w' axis='0 0 1'/>"
        "<geom type='cylinder' size='.05 .01' mass='.1'/></body></worldbody>"
        "<actuator><motor joint='w' gear='1000'/></actuator></mujoco>"
    )
    assert sc.trade(wheel, ctrl=[[1.0]], horizon=0.2, dts=[0.01, 0.002], **QUIET).rows


class Late:
    """The PD one sample late."""

    def __init__(self):
        self.last = [0.0]

    def __call__(self, time, sim):
        late, self.last = self.last, pd(time, sim)
        return late


def test_an_object_remembers_in_every_run_for_itself():
    late = Late()
    result = sc.trade(leg(), control=late, horizon=0.1, further=0, **QUIET)
    assert late.last == [0.0]
    sim = sc.Sim(leg())
    sim.reset(key="out")
    by_hand = sim.run(0.1, control=Late()).qpos[:, 0]
    model = leg().compile()
    motion = Motion(horizon=0.1, control=late)
    schedule = scheduled(motion, model, 0.002, 1)
    for _ in range(2):
        assert run(model, schedule, [0], record=("qpos",))["qpos"][0, -1, 0] == by_hand[-1]
    assert result.error(result.shipped) < 1e-2


@pytest.mark.parametrize("measure", [sc.trade, sc.ablate, sc.converge, sc.predict])
def test_a_function_that_answers_otherwise_when_asked_again_is_refused(measure):
    asked, rng = [], np.random.default_rng(0)

    def counting(time, sim):
        asked.append(time)
        return [1e-3 * len(asked)]

    def noisy(time, sim):
        return rng.normal(size=1)

    for function in (counting, noisy):
        name = function.__qualname__.rpartition(".")[2]
        words = rf"`{name}` of test_control.py returned other controls when the same run was made"
        with pytest.raises(ControlError, match=words):
            measure(leg(), control=function, horizon=0.1, starts=1, threads=1, progress=False)


def test_names_of_functions():
    assert control_name(pd) == "the control function `pd` of test_control.py"
    assert control_name(lambda time, sim: []).startswith("the control function `<lambda>, line ")
    assert control_name(Late()) == "the control function `Late`"
