"""The default motion, without controls by the user, is one that the machine could make."""

import pickle

import menagerie
import numpy as np
import pytest

import stepcore as sc
from stepcore.engine.actuator import actuators
from stepcore.engine.follow import follow
from stepcore.engine.start import Start
from stepcore.experiment.default_motion import KINDS, kind_of
from stepcore.experiment.engines import run
from stepcore.experiment.motion import Motion
from stepcore.experiment.motion_words import motion_in_words
from stepcore.experiment.moves import MOVE, profile
from stepcore.experiment.schedule import scheduled

LINK = '<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/>'
FLOOR = '<geom type="plane" size="2 2 .1"/>'


def scene(bodies, actuators="", key="", gravity="0 0 -9.81", dt=0.002):
    return sc.loads(
        '<mujoco><compiler angle="radian"/>'
        f'<option timestep="{dt}" gravity="{gravity}" integrator="implicitfast"/>'
        f"<worldbody>{bodies}</worldbody><actuator>{actuators}</actuator>"
        f"<keyframe>{key}</keyframe></mujoco>"
    ).compile()


def arm(servo='kp="200" kv="10"', height=1.0, limits="-2 2", joint="", **others):
    """A link that turns about a horizontal axis, with a position servo."""
    body = (
        f'{FLOOR}<body pos="0 0 {height}"><joint name="hinge" axis="0 1 0" range="{limits}" '
        f'limited="true" {joint}/>{LINK}</body>'
    )
    return scene(body, f'<position name="servo" joint="hinge" {servo}/>', **others)


def torque_arm(key='<key qpos=".5 -1"/>', limit=30, **others):
    """Two links with motors in N·m."""
    motor = f'ctrllimited="true" ctrlrange="-{limit} {limit}"'
    return scene(
        f'<body pos="0 0 1"><joint name="shoulder" axis="0 1 0" range="-3 3" limited="true"/>{LINK}'
        f'<body pos=".3 0 0"><joint name="elbow" axis="0 1 0" range="-3 3" limited="true"/>{LINK}'
        "</body></body>",
        f'<motor name="m1" joint="shoulder" {motor}/><motor name="m2" joint="elbow" {motor}/>',
        key,
        **others,
    )


def planned(model, period=0.008, **fields):
    """The schedule of the motion, and the motion in words."""
    motion = Motion(**fields)
    schedule = scheduled(motion, model, period)
    return schedule, motion_in_words(model, motion, schedule)


def ways(schedule):
    """How far the controls of each start go, (starts, nu)."""
    rows = schedule.controls.log.rows
    return rows[:, -1] - rows[:, 0]


def watched(model, schedule, start=0):
    """Positions and forces at every step, and the deepest overlap."""
    rows, hold = schedule.rows([start], dt := model.settings.dt)
    driven, steps = schedule.driven_model(model), schedule.periods * schedule.steps(dt)
    ran = follow(
        *(driven, [schedule.starts[start]], steps),
        ctrl=rows,
        hold=hold,
        record=("qpos", "actuator_force", "overlap"),
    )
    return ran["qpos"][0, 1:], ran["actuator_force"][0, 1:], ran["overlap"].max()


# --- the rules ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bodies", "actuators", "kind"),
    [
        (f"<body><freejoint/>{LINK}</body>", "", "fall"),
        (f'<body><joint name="j"/>{LINK}</body>', '<position joint="j"/>', "move"),
        (f'<body><joint name="j"/>{LINK}</body>', '<velocity joint="j"/>', "move"),
        (
            f'<body><joint name="j"/>{LINK}</body>',
            '<general joint="j" gainprm="5" biastype="affine" biasprm="0 -5 -1"/>',
            "move",
        ),
        (
            f'<body><joint name="j"/>{LINK}</body>',
            '<motor joint="j" ctrllimited="true" ctrlrange="-1 1"/>',
            "move",
        ),
        (
            f'<body><freejoint/>{LINK}<body><joint name="j"/>{LINK}</body></body>',
            '<motor joint="j" ctrllimited="true" ctrlrange="-20 20"/>',
            "move",
        ),
        (
            f'<body><freejoint/>{LINK}<body><joint name="j"/>{LINK}</body></body>',
            '<motor joint="j" ctrllimited="true" ctrlrange="-1 1" gear="20"/>',
            "sines",
        ),
        (
            f'<body><joint name="j"/>{LINK}</body>',
            '<muscle joint="j" lengthrange="0 1"/>',
            "sines",
        ),
    ],
)
def test_the_model_chooses_the_kind(bodies, actuators, kind):
    assert kind_of(scene(bodies, actuators)) == kind


def test_a_body_without_actuators_falls_and_says_so():
    model = scene(f'{FLOOR}<body pos="0 0 1"><freejoint/><geom size=".1"/></body>')
    schedule, words = planned(model)
    assert "; no motors; law" in words and schedule.ctrl.size == 0 and not schedule.notes


def test_the_profile_begins_and_ends_at_rest_and_returns():
    way, rate = profile(np.array([0.0, MOVE / 2, MOVE, 0.99, 1.0, 1.0 + MOVE / 2, 1.99]))
    assert way == pytest.approx([0, 0.5, 1, 1, 1, 0.5, 0])
    assert rate == pytest.approx([0, 1.875 / MOVE, 0, 0, 0, -1.875 / MOVE, 0])
    times = np.linspace(0, 2, 20001)
    assert np.gradient(profile(times)[0], times) == pytest.approx(profile(times)[1], abs=2e-3)


# --- servos ---------------------------------------------------------------------------------------


def test_servos_move_by_a_tenth_of_their_range_within_their_forces():
    model = arm('kp="200" kv="10" forcelimited="true" forcerange="-20 20"')
    schedule, words = planned(model)
    assert "test motion: servos move point to point over 800 ms to poses up to " in words
    assert "never saturated" in words and "top speed" in words and "(`hinge`)" in words
    far = [np.ptp(schedule.ctrl[k]) for k in range(8)]
    assert 0.19 < min(far) <= max(far) <= 0.4 and len(set(far)) == 8
    for k in range(8):
        qpos, force, _ = watched(model, schedule, k)
        assert np.abs(force).max() < 0.6 * 20
        # It arrives, but for the sag under its weight.
        sag = 9.81 * 0.15 / 200
        assert qpos[-1] == pytest.approx(schedule.ctrl[k, -1], abs=2 * sag)


def test_a_joint_near_its_limit_moves_away_from_it():
    model = arm(limits="-2 2", key='<key qpos="1.9" ctrl="1.9"/>', gravity="0 0 0")
    schedule, _ = planned(model)
    for k in range(8):
        qpos, _, _ = watched(model, schedule, k)
        assert qpos.max() < 2.0 and qpos[-1, 0] < 1.8


def test_an_arm_does_not_reach_into_the_floor():
    """Half of the poses that a tenth of the range allows are below the floor."""
    model = arm(height=0.06, gravity="0 0 0", servo='kp="50" kv="5"')
    schedule, words = planned(model)
    moving = [k for k in range(8) if np.ptp(schedule.ctrl[k]) > 0]
    assert moving and "servos move" in words
    assert max(watched(model, schedule, k)[2] for k in range(8)) == 0.0


def test_a_load_that_needs_most_of_the_force_leaves_half_of_the_rest():
    """The weight needs 1.47 of 2 N·m; the motion uses at most half of the rest."""
    weight = 9.81 * 0.15
    model = arm('kp="200" kv="2" forcelimited="true" forcerange="-2 2"')
    schedule, words = planned(model)
    for k in range(8):
        late = watched(model, schedule, k)[1][60:]
        assert np.abs(late).max() <= (weight + 2) / 2 + 0.05
    assert "never saturated" in words


def test_a_servo_that_cannot_hold_its_load_is_told():
    model = arm('kp="200" kv="2" forcelimited="true" forcerange="-1 1"')
    assert "`servo` saturated" in planned(model)[1]


@pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")
def test_a_servo_that_explodes_at_once_is_told():
    """Under explicit Euler a step multiplies the error by more than ten."""
    scene_ = arm('kp="2e6" kv="0"').scene.with_settings(integrator="explicit", dt=0.01)
    assert "it only holds the start, and that fails: " in planned(scene_.compile(), 0.04)[1]


def test_controls_do_not_jump_within_a_period():
    """A stiff servo answers a jump of 8 ms with its force; steps longer than 1 ms get the means."""
    model = arm('kp="2000" kv="50"')
    schedule, _ = planned(model)
    steps = schedule.rows([0], 0.002)[0][0, 200:204, 0]
    assert len(set(steps.tolist())) == 4
    assert schedule.ctrl[0, 50, 0] == pytest.approx(np.mean(steps), abs=1e-12)
    whole, _ = planned(model, control_dt=0.008)
    assert whole.log is None and whole.rows([0], 0.002)[1] == 4


def test_velocity_servos_get_the_velocity_of_the_profile():
    model = scene(
        f'<body><joint name="j" axis="0 0 1" damping=".1"/>{LINK}</body>',
        '<velocity name="v" joint="j" kv="50"/>',
        gravity="0 0 0",
    )
    schedule, words = planned(model, starts=1)
    qpos, _, _ = watched(model, schedule, 0)
    there = abs(qpos[-1, 0])
    assert 0.2 < there < 0.5 and f"up to {1e3 * there:.3g}"[:8] in words
    assert schedule.ctrl[0, -1] == pytest.approx(0.0, abs=1e-9)


def test_what_servos_of_a_site_move_is_not_said_to_be_held():
    bodies = f'<body><joint type="slide" axis="1 0 0"/><site name="tip" pos=".3 0 0"/>{LINK}</body>'
    servo = '<velocity site="tip" kv="50" gear="1 0 0 0 0 0"/>'
    model = scene(bodies, servo, gravity="0 0 0")
    schedule, words = planned(model, starts=1)
    most = float(np.abs(schedule.rows([0], 0.002)[0]).max())
    assert most > 1e-3 and np.ptp(watched(model, schedule, 0)[0]) > 1e-3
    assert f"servos move point to point over 800 ms under controls up to {most:.2g} (" in words


def test_controls_of_zero_hold_the_pose_of_the_keyframe():
    model = arm(key='<key qpos="0.7"/>', gravity="0 0 0")
    schedule, _ = planned(model)
    assert schedule.ctrl[:, 0, 0] == pytest.approx(0.7, abs=1e-3)
    held, _ = planned(model, kind="hold")
    assert not held.ctrl.any()


# --- motors ---------------------------------------------------------------------------------------


def test_motors_hold_the_keyframe_and_move_about_it():
    model = torque_arm()
    schedule, words = planned(model)
    assert "a PD controller drives the joints point to point over 800 ms" in words
    changes = ways(schedule)
    for k in range(8):
        qpos, force, _ = watched(model, schedule, k)
        assert np.abs(force).max() < 0.6 * 30
        target = np.array([0.5, -1.0]) + changes[k]
        assert np.abs(changes[k]).max() <= 0.5
        assert qpos[-1] == pytest.approx(target, abs=0.1)
    held, words = planned(model, kind="hold")
    assert "a PD controller holds the start" in words
    assert watched(model, held)[0][-1] == pytest.approx([0.5, -1.0], abs=0.02)


def test_motors_that_are_too_weak_are_told():
    words = planned(torque_arm(limit=2))[1]
    assert "saturated" in words and "never" not in words


def test_a_thing_that_nothing_holds_is_told_and_falls():
    model = scene(
        f'{FLOOR}<body pos="0 0 .5"><freejoint/><geom type="capsule" size=".02 .48" mass="5"/>'
        f'<body pos="0 0 .4"><joint name="j" axis="0 1 0"/>{LINK}</body></body>',
        '<motor joint="j" ctrllimited="true" ctrlrange="-20 20"/>',
    )
    _, words = planned(model)
    assert "a PD controller holds the start" in words
    assert "; nothing holds this pose: the robot falls over within" in words


def legged(actuator):
    """A box on four legs of one joint each."""
    legs = "".join(
        f'<body pos="{x} {y} 0"><joint name="j{x}{y}" axis="0 1 0" range="-1 1" limited="true"/>'
        '<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".3"/></body>'
        for x in (-0.3, 0.3)
        for y in (-0.2, 0.2)
    )
    drives = "".join(actuator.format(joint=f"j{x}{y}") for x in (-0.3, 0.3) for y in (-0.2, 0.2))
    return scene(
        f'{FLOOR}<body pos="0 0 .32"><freejoint/>'
        f'<geom type="box" size=".3 .2 .05" mass="5"/>{legs}</body>',
        drives,
        '<key qpos="0 0 .32 1 0 0 0 0 0 0 0"/>',
    )


@pytest.mark.parametrize(
    "actuator",
    [
        '<position joint="{joint}" kp="200" kv="5" forcelimited="true" forcerange="-40 40"/>',
        '<motor joint="{joint}" ctrllimited="true" ctrlrange="-40 40"/>',
    ],
)
def test_a_legged_robot_stands_and_shifts(actuator):
    model = legged(actuator)
    schedule, words = planned(model)
    assert "up to" in words and "falls" not in words and "only hold" not in words
    for k in range(4):
        sim = sc.Sim(model)
        sim.qpos = watched(model, schedule, k)[0][-1]
        sim.forward()
        assert sim.qpos[2] > 0.25 and abs(sim.qpos[3]) > 0.98 and len(sim.contacts) >= 4


def test_a_cart_turns_its_wheels_where_a_castor_must_slide():
    wheels = "".join(
        f'<body pos="0 {y} .03" quat="1 1 0 0"><joint name="{name}" axis="0 0 -1" damping=".1"/>'
        '<geom type="cylinder" size=".03 .01" mass=".1"/></body>'
        for name, y in (("left", 0.1), ("right", -0.1))
    )
    castors = "".join(f'<geom size=".01" pos="{x} 0 .01" mass=".1"/>' for x in (-0.08, 0.08))
    model = scene(
        f'{FLOOR}<body><freejoint/><geom type="box" size=".1 .07 .02" pos="0 0 .05" mass="1"/>'
        f"{castors}{wheels}</body>",
        '<velocity joint="left" kv="2"/><velocity joint="right" kv="2"/>',
    )
    schedule, words = planned(model)
    assert "servos move point to point" in words
    turned = np.array([np.ptp(watched(model, schedule, k)[0][:, -2:], axis=0) for k in range(8)])
    assert (turned > 0.05).all() and turned.max() < 0.5


# --- seeds, processes, batches --------------------------------------------------------------------


@pytest.mark.parametrize("model", [arm(), torque_arm()])
def test_the_motion_follows_from_model_seed_and_period(model):
    def drive(**fields):
        schedule, _ = planned(model, **fields)
        return schedule.controls.log.rows

    some = drive(starts=3)
    np.testing.assert_array_equal(some, drive(starts=3))
    np.testing.assert_array_equal(some, drive(starts=6)[:3])
    assert (some != drive(starts=3, seed=1)).any()


@pytest.mark.parametrize("model", [arm(), torque_arm()])
def test_runs_have_the_same_bits_in_another_process_and_in_batches(model):
    schedule, _ = planned(model, horizon=0.2)
    together = run(model, schedule, range(8))["xpos"]
    alone = [run(model, schedule, [k])["xpos"][0] for k in range(8)]
    other = run(*pickle.loads(pickle.dumps((model, schedule))), range(8))["xpos"]
    for k in range(8):
        np.testing.assert_array_equal(together[k], alone[k])
        np.testing.assert_array_equal(other[k], alone[k])
    for part, k in ((schedule.part(3), 3), (schedule.part(0, 2).joined(schedule.part(5)), 0)):
        np.testing.assert_array_equal(run(model, part, [0])["xpos"][0], alone[k])


# --- kinds defined by the user --------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_a_measurement_takes_a_kind_in_place_of_a_motion(kind):
    model = arm()
    by_name = sc.predict(model, kind, horizon=0.1, starts=1, progress=False)
    by_field = sc.predict(model, kind=kind, horizon=0.1, starts=1, progress=False)
    by_object = sc.predict(model, Motion(kind=kind, horizon=0.1, starts=1), progress=False)
    assert by_name.motion.kind == kind
    assert by_name.ran == by_field.ran == by_object.ran
    assert pickle.loads(pickle.dumps(by_name.motion)).kind == kind


def test_a_wrong_kind_and_two_drives_are_refused():
    with pytest.raises(ValueError, match=r"kind = 'hld': must be one of .*nearest: .hold"):
        sc.predict(arm(), "hld")
    with pytest.raises(ValueError, match="kind and ctrl are both given"):
        Motion(kind="hold", ctrl=[[0.0]])
    with pytest.raises(ValueError, match="kind and control are both given"):
        Motion(kind="move", control=lambda time, sim: [0.0])


def test_a_run_follows_a_kind():
    model = torque_arm()
    ran = sc.run(model, "move", horizon=1.0)
    target = [0.5, -1.0] + ways(planned(model, starts=1)[0])[0]
    assert ran.sim.qpos == pytest.approx(target, abs=0.1)
    assert "a PD controller drives the joints" in ran.ran
    assert "motors are held at zero" in sc.run(model, "fall", horizon=0.1).ran


def test_check_runs_a_kind_and_says_it_in_its_commands():
    result = sc.check(arm(), "move", progress=False)
    assert "servos move point to point" in result.ran
    assert all("--motion move" in command for command, _ in result.commands[:2])


# --- robots ---------------------------------------------------------------------------------------


@menagerie.needed
@pytest.mark.parametrize("name", ["PANDA", "UR5E", "SO101", "SO101_CUBE", "GO2"])
def test_robots_move_within_their_forces(name):
    file = getattr(menagerie, name, menagerie.FOLDER / "unitree_go2" / "scene.xml")
    model = sc.load(file).compile()
    schedule, words = planned(model, 4 * model.settings.dt)
    # Panda's light wrist saturates at the speed of a start.
    assert "point to point" in words and ("never saturated" in words) == (name != "PANDA")
    assert "falls" not in words and "only hold" not in words and not schedule.notes
    bounds = np.array([drive.bound for drive in actuators(model)])
    for k in range(3):
        # The first tenth of a second belongs to the start.
        force = np.abs(watched(model, schedule, k)[1])[round(0.1 / model.settings.dt) :]
        assert np.mean(force > 0.65 * bounds) < 0.05


def test_a_state_is_put_without_its_time():
    """Trials start at time 0, whatever the time of the keyframe."""
    model = arm(key='<key time="59" qpos=".1" ctrl=".1"/>', gravity="0 0 0")
    assert isinstance(scheduled(Motion(), model, 0.008).starts[0], Start)
    ran = sc.run(model, "move", horizon=1.0)
    assert abs(float(ran.sim.qpos[0]) - 0.1) > 0.1
