"""A motion is one object or its fields; one schedule makes it definite."""

import pickle

import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.experiment.motion import Motion
from stepcore.experiment.motion_words import motion_in_words
from stepcore.experiment.schedule import scheduled

QUIET = {"by": "flops", "threads": 1, "progress": False}


def test_an_object_and_its_fields_are_the_same_motion():
    motion = sc.Motion(horizon=0.2, starts=2, seed=3)
    by_object = sc.trade("lesson:spring", motion, dts=[0.01], **QUIET)
    by_fields = sc.trade("lesson:spring", horizon=0.2, starts=2, seed=3, dts=[0.01], **QUIET)
    assert by_object.to_json() == by_fields.to_json()
    assert by_object.to_dict()["motion"]["seed"] == 3


def test_an_object_with_fields_beside_it_is_refused():
    with pytest.raises(ValueError, match="motion and seed are both given"):
        sc.trade("lesson:spring", sc.Motion(), seed=1)
    with pytest.raises(ValueError, match=r"motion = 0.2: must be a stepcore.Motion"):
        sc.predict("lesson:spring", 0.2)


@pytest.mark.parametrize(
    ("word", "nearest"), [("horizn", "horizon"), ("controls", "control"), ("thread", "threads")]
)
def test_a_misspelt_argument_names_the_nearest_of_both_kinds(word, nearest):
    with pytest.raises(
        TypeError, match=rf'trade\(\) has no argument "{word}"; nearest.*"{nearest}"'
    ):
        sc.trade("lesson:spring", **{word: 1})


def test_a_field_that_a_measurement_does_not_use_is_refused():
    with pytest.raises(TypeError, match=r'diagnose\(\) has no argument "starts"'):
        sc.diagnose("lesson:spring", starts=2)
    with pytest.raises(ValueError, match="motion: diagnose does not use starts"):
        sc.diagnose("lesson:spring", sc.Motion(starts=2))


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"horizon": -1}, "horizon = -1: must be a finite number of seconds > 0"),
        ({"starts": 0}, "starts = 0: must be a whole number >= 1"),
        ({"seed": 0.5}, "seed = 0.5: must be a whole number >= 0"),
        ({"control": 1}, r"control = 1: must be a function of \(time, sim\)"),
        ({"control": lambda time, sim: [0.0], "ctrl": [[0.0]]}, "control and ctrl are both given"),
    ],
)
def test_a_motion_checks_its_fields_when_it_is_made(fields, said):
    with pytest.raises(ValueError, match=said):
        sc.Motion(**fields)


def words(scene, motion, period=0.002, starts=3):
    model = scene.compile()
    return motion_in_words(model, motion, scheduled(motion, model, period, starts))


def test_the_motion_is_told_in_words():
    scene = sc.Scene(name="cart")
    cart = scene.add_body("cart", mass=1.0, inertia=(1, 1, 1))
    assert cart is not None
    joint = scene.add_joint(cart, "slide")
    short = Motion(horizon=0.1)
    assert words(scene, short) == (
        "100 ms from the pose of the scene and 2 starts near it; no motors; law solref"
    )
    scene.add_actuator(joint, name="drive")
    scene.add_key("home", qpos=(0.0,), ctrl=(0.0,))
    assert words(scene, short, starts=1) == (
        "100 ms from keyframe `home`; test motion: a PD controller drives the joints point to "
        "point over 800 ms to poses up to 40.9 mm away (minimum jerk); top speed 0.098 "
        "m/s (joint 0 of body `cart`), never saturated; law solref"
    )
    # It rests there for 200 ms, and comes back.
    assert " away and back (minimum jerk)" in words(scene, Motion(horizon=1.5), starts=1)
    waving = Motion(horizon=0.1, kind="sines")
    assert words(scene, waving, starts=1) == (
        "100 ms from keyframe `home`; motors are held at zero, because nothing gives their range; "
        "law solref"
    )
    scene.actuators[0].ctrlrange = (-1, 1)
    said = (
        "; test motion: random sines of 0.3 to 3 Hz, ±40 % of the control range, as policies look"
    )
    assert f"{said}; law" in words(scene, waving)
    scene.add_actuator(joint, name="free")
    scene.keys[0].ctrl = (0.0, 0.0)
    assert f"{said}; free without a range held at zero; law" in words(scene, waving)
    given = Motion(horizon=0.1, ctrl=[[0.0, 1.0]])
    assert "; motors hold 0, 1; law" in words(scene, given)
    rows = Motion(horizon=0.1, ctrl=[[0.0, 1.0], [1.0, 0.0]])
    assert "; motors driven by the controls given, a row every 2 ms; law" in words(scene, rows)

    def policy(time, sim):
        return [0.0, 0.0]

    told = words(scene, Motion(horizon=0.1, control=policy))
    assert "by the control function `policy` of test_motion.py, sampled every 2 ms; law" in told


def test_part_of_a_schedule_keeps_its_starts_and_their_controls():
    scene = sc.Scene()
    cart = scene.add_body("cart", mass=1.0, inertia=(1, 1, 1))
    scene.add_actuator(scene.add_joint(cart, "slide"), ctrlrange=(-1, 1))
    whole = scheduled(Motion(horizon=0.4, starts=5, kind="sines"), scene.compile(), 0.1)
    part = whole.part(1, 3)
    assert part.starts == whole.starts[1:3] and len(part.ctrl) == 2
    assert (part.ctrl == whole.ctrl[1:3]).all() and part.horizon == whole.horizon
    moved = scheduled(Motion(horizon=0.4, starts=5), scene.compile(), 0.1)
    rows = moved.controls.log.rows
    assert (moved.part(1, 3).controls.log.rows == rows[1:3]).all()
    assert (moved.part(0, 1).joined(moved.part(1)).controls.log.rows == rows).all()


def test_times_are_texts_with_units_too():
    motion = sc.Motion(horizon="500ms", control_dt="2 ms")
    assert (motion.horizon, motion.control_dt) == (0.5, 0.002)
    with pytest.raises(ValueError, match="horizon = 'soon': must be a finite number of seconds"):
        sc.Motion(horizon="soon")
    quick = {"horizon": "80ms", "progress": False}
    trade = sc.trade("lesson:spring", dts=["5ms", 0.01], starts=1, by="flops", **quick)
    assert {row.settings.dt for row in trade.rows} == {0.005, 0.01}
    assert "20 ms" in str(sc.diagnose("lesson:spring", dt="20ms", **quick))
    drawn = {
        "path": "joint/spring/stiffness",
        "values": [10],
        "integrators": ["euler"],
        "horizon": "500ms",
        "progress": False,
    }
    two = sc.stability_map("lesson:spring", dts=["10ms", 0.1], **drawn)
    assert list(two.dts) == [0.01, 0.1]


def test_a_motion_shows_what_was_set():
    assert repr(sc.Motion()) == "Motion()"
    assert repr(sc.Motion(horizon=2.0, key="home")) == "Motion(horizon=2.0, key='home')"
    assert sc.trade(lesson.spring(), horizon=0.1, starts=1, **QUIET).motion.horizon == 0.1


def test_a_result_pickles_whatever_function_controlled_it():
    made = sc.trade(
        "lesson:spring", horizon=0.2, starts=1, dts=[0.01], control=lambda time, sim: (), **QUIET
    )
    copy = pickle.loads(pickle.dumps(made))
    assert str(copy) == str(made)
    with pytest.raises(ValueError, match="lambda>` could not be pickled"):
        copy.motion.control(0.0, None)
