"""A user's control function in the linear step: its limit against the z-map and the real step."""

import collections
import functools
import math

import numpy as np
import pytest
from covering import first

import stepcore as sc
from stepcore.engine.sim import unwatched

INTEGRATORS = (
    *("explicit", "semi-implicit", "euler", "implicitfast"),
    *("implicit", "discrete", "midpoint", "rk4"),
)
INERTIA, KP, KD = 0.115, 2000.0, 20.0
QUIET = {"horizon": 1.0, "threads": 1, "progress": False}


def leg(joint="", option=""):
    """One hinge of given inertia, with a motor."""
    return sc.loads(
        f"""<mujoco><option timestep="0.002" gravity="0 0 0" {option}/><worldbody>
        <body name="leg"><joint name="ankle" axis="0 1 0" {joint}/>
        <inertial pos="0 0 0" mass="1" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/></body>
        </worldbody><actuator><motor name="ankle" joint="ankle"/></actuator></mujoco>"""
    )


def pd(time, sim, kp=KP, kd=KD):
    return [-kp * sim.qpos[0] - kd * sim.qvel[0]]


class Delayed:
    """The PD, delayed by this many samples."""

    def __init__(self, samples):
        self.waiting = collections.deque([0.0] * samples)

    def __call__(self, time, sim):
        self.waiting.append(pd(time, sim)[0])
        return [self.waiting.popleft()]


class Filtered:
    """The PD behind a low-pass filter of first order."""

    def __init__(self):
        self.value = 0.0

    def __call__(self, time, sim):
        self.value += 0.3 * (pd(time, sim)[0] - self.value)
        return [self.value]


class Integrating:
    """A PID; it sums up its error at every call."""

    def __init__(self):
        self.sum = 0.0

    def __call__(self, time, sim):
        self.sum += sim.qpos[0]
        return [pd(time, sim)[0] - 50.0 * self.sum]


def stays(scene, control, dt, hold=1, seconds=3.0, **settings):
    """Whether the real step brings a small kick to rest, with controls held for this many steps."""
    sim = unwatched(sc.Sim(scene, dt=dt, **settings))
    sim.qvel[:] = 1e-3
    count = max(400, math.ceil(seconds / dt))
    speeds = np.empty(count)
    for k in range(count):
        if k % hold == 0:
            sim.ctrl = control(sim.time, sim)
        try:
            sim.step()
        except sc.SimulationError:
            return False
        speeds[k] = np.abs(sim.qvel).max()
    return bool(speeds[-count // 4 :].max() < min(1.0, speeds[: count // 4].max()))


def z_map_limit(integrator, kp=KP, kd=KD, inertia=INERTIA):
    """The closed form: Jury's conditions for the characteristic polynomial of each z-map."""
    if integrator in ("rk4", "midpoint"):
        # q⁺ = q + T v + T² u/2I: z² − (2 − T kd/I − T² kp/2I) z + 1 − T kd/I + T² kp/2I.
        return min(2 * inertia / kd, 2 * kd / kp)
    if integrator == "explicit":
        # z = 1 + T s of the roots of I s² + kd s + kp, here complex.
        return kd / kp
    # v⁺ = v + T u/I, q⁺ = q + T v⁺: T² kp + 2 T kd = 4 I.
    return (math.sqrt(kd**2 + 4 * inertia * kp) - kd) / kp


@functools.cache
def of_the_pd():
    return sc.diagnose(leg(), control=pd, **QUIET)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_pd_on_a_hinge_has_the_limit_of_its_z_map(integrator):
    d = of_the_pd()
    assert d.limit(integrator) == pytest.approx(z_map_limit(integrator), rel=1e-2)
    assert d.stiffest(integrator) == "control of motor `ankle`"


@first(3, make=[lambda: Delayed(2), Integrating, Filtered, lambda: pd])
def test_the_limit_is_that_of_the_real_step_whatever_the_function_remembers(make):
    d = sc.diagnose(leg(), control=make(), **QUIET)
    for integrator in ("euler", "rk4", "explicit"):
        limit = d.limit(integrator)
        # Three seconds show slower growth than a thousand steps.
        assert stays(leg(), make(), 0.95 * limit, integrator=integrator)
        assert not stays(leg(), make(), 1.03 * limit, integrator=integrator)


def test_damping_of_the_joint_that_euler_treats_implicitly_helps():
    scene = leg('damping="5"')
    d = sc.diagnose(scene, control=pd, **QUIET)
    for integrator in ("euler", "semi-implicit"):
        assert stays(scene, pd, 0.98 * d.limit(integrator), integrator=integrator)
        assert not stays(scene, pd, 1.02 * d.limit(integrator), integrator=integrator)
    assert d.limit("euler") > 1.1 * d.limit("semi-implicit")


def arm():
    """Two links in a plane, both driven."""
    return sc.loads(
        """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody>
        <body name="upper" pos="0 0 1">
        <joint name="hip" axis="0 1 0"/><geom type="capsule" size=".03" fromto="0 0 0 .4 0 0"
        mass="3"/><body name="lower" pos=".4 0 0"><joint name="ankle" axis="0 1 0"/>
        <geom type="capsule" size=".02" fromto="0 0 0 .1 0 0" mass=".1"/></body></body></worldbody>
        <actuator><motor name="hip" joint="hip" gear="2"/><motor name="ankle" joint="ankle"/>
        </actuator></mujoco>"""
    )


def both(time, sim):
    return -np.array([200.0, 20.0]) * sim.qpos - np.array([15.0, 0.3]) * sim.qvel


def test_of_two_motors_the_one_is_named_whose_control_limits():
    scene = arm()
    d = sc.diagnose(scene, control=both, dt=0.006, **QUIET)
    assert d.stiffest() == "control of motor `ankle`"
    limit = d.limit("euler")
    assert stays(scene, both, 0.98 * limit, integrator="euler")
    assert not stays(scene, both, 1.02 * limit, integrator="euler")
    assert "control of motor `ankle` limits dt to" in d.sentences[0]


def test_a_policy_in_single_precision_is_differentiated():
    weights = np.float32([-KP, -KD]) / np.float32(100.0)

    def policy(time, sim):
        seen = np.float32([sim.qpos[0], sim.qvel[0]])
        return 100.0 * np.tanh(weights @ seen)

    d = sc.diagnose(leg(), control=policy, **QUIET)
    assert d.limit("euler") == pytest.approx(z_map_limit("euler"), rel=2e-2)


def test_controls_that_do_not_depend_on_the_state_are_no_element():
    d = sc.diagnose(leg(), control=lambda time, sim: [math.sin(9 * time)], **QUIET)
    assert math.isinf(d.limit("euler")) and d.element("control of motor `ankle`") is None


def test_a_table_by_time_is_never_asked_outside_the_motion():
    table = np.zeros(500)

    def replayed(time, sim):
        assert 0 <= time < 1.0 - 1e-6
        return [table[round(time / 0.002)] - KP * sim.qpos[0] - KD * sim.qvel[0]]

    d = sc.diagnose(leg(), control=replayed, **QUIET)
    assert d.limit("euler") == pytest.approx(z_map_limit("euler"), rel=1e-2)


def advised(d, what):
    return next(a for a in d.advice if a.what == what)


def test_a_lower_gain_that_is_advised_holds_on_the_real_step():
    """Law: the z-map of the same control with all gains at the share that is printed."""
    wanted = 0.0085  # the z-map's limit is 8.17 ms
    d = sc.diagnose(leg(), control=pd, dt=wanted, **QUIET)
    assert d.sentences[0].startswith("A step of 8.5 ms explodes")
    assert not stays(leg(), pd, wanted)
    armature = advised(d, "armature").values[0].after[0]
    assert stays(leg(f'armature="{armature}"'), pd, 1.46 * wanted)
    share = math.exp(-advised(d, "control gain").size)
    assert z_map_limit("euler", share * KP, share * KD) >= 1.5 * wanted
    assert stays(leg(), lambda t, s: pd(t, s, share * KP, share * KD), 1.46 * wanted)


def test_a_period_of_its_own_is_limited_however_short_the_steps():
    # The z-map of an exact hold: 2 I/kd = 11.5 ms and 2 kd/kp = 20 ms.
    d = sc.diagnose(leg(), control=pd, control_dt=0.02, dt=0.0001, **QUIET)
    assert d.limit("euler") == 0 and d.stiffest("euler") == "control of motor `ankle`"
    assert d.longest_period == pytest.approx(2 * INERTIA / KD, rel=0.02)
    assert "is sampled every 20 ms; at steps of 100 µs a period of up to" in d.sentences[1]
    assert not stays(leg(), pd, 0.0005, hold=40)
    # The advice keeps a margin of 1.5.
    assert "sample the control every 7." in advised(d, "control_dt").text
    assert stays(leg(), pd, 0.0001, hold=76, seconds=0.5)


def test_the_longest_period_is_that_of_the_real_step():
    d = sc.diagnose(leg(), control=pd, control_dt=0.02, dt=0.0005, **QUIET)
    longest = d.longest_period
    for share, held in ((0.98, True), (1.02, False)):
        dt = share * longest / 22
        assert stays(leg(), pd, dt, hold=22, integrator="euler", seconds=1.0) is held


def test_a_spring_beside_a_held_control_keeps_its_own_limit():
    # ω = 2000/s alone: 1 ms; the control is held for 4 ms in any case.
    with pytest.warns(sc.StiffnessWarning, match="spring of joint"):
        scene = leg('stiffness="460000"')
    d = sc.diagnose(scene, control=lambda t, s: pd(t, s, 20.0, 2.0), control_dt=0.004, **QUIET)
    assert d.stiffest("euler") == "spring of joint `ankle`"
    alone = 2 / math.sqrt(460_000 / INERTIA)
    assert d.held("euler") == pytest.approx(alone, rel=0.02)
    # The control, held for a whole number of steps, takes some of it.
    assert 0.9 * alone < d.limit("euler") < 1.02 * alone


class Player:
    """Plays recorded controls: it counts its calls, and never reads the time."""

    def __init__(self, rows):
        self.rows, self.calls = rows, 0

    def __call__(self, time, sim):
        row = self.rows[min(self.calls, len(self.rows) - 1)]
        self.calls += 1
        return row


def test_recorded_controls_are_played_from_their_beginning_in_every_run():
    """Law: a player that counts its calls is one that reads the clock. From 0.4 s on the table
    drives the leg into its limit, so a run that starts anywhere else in it is another motion."""
    scene = leg('range="-.5 .5" solreflimit="-4e5 -40" damping=".1"')
    table = np.zeros((50, 1))
    table[20:] = 3.0
    fields = {"control_dt": 0.02, "dt": 0.004, **QUIET}
    played = sc.diagnose(scene, control=Player(table), **fields)

    def by_time(time, sim):
        return table[min(int(time / 0.02 + 1e-9), 49)]

    given = sc.diagnose(scene, control=by_time, **fields)
    # Its controls start with a call, not at a time, so steps that do not divide a period differ.
    for name in given.limits:
        assert played.limit(name) == pytest.approx(given.limit(name), rel=0.03)
    assert "limit of joint" in given.stiffest()
