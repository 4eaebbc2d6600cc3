"""Bad input is a ValueError that names the field and the limit, before any state changes."""

import collections
import copy
import math

import numpy as np
import pytest
from covering import every_pair
from hypothesis import given, settings
from hypothesis import strategies as st
from small import ball, pendulum

import stepcore as sc
from stepcore import _core

NOT_FINITE = [math.nan, math.inf, -math.inf]


@pytest.fixture(scope="module")
def model():
    return pendulum().compile()


def refuses(text, call, *args, **kwargs):
    with pytest.raises(ValueError, match=text) as caught:
        call(*args, **kwargs)
    assert "\n" not in str(caught.value)


# Settings.


NUMBERS = [
    "dt",
    "tolerance",
    "beta",
    "softness",
    "restitution",
    "slop",
    "penalty_stiffness",
    "penalty_damping_ratio",
    "impratio",
]


@every_pair(value=[*NOT_FINITE, -1.0, "1", None, True, [0.1], 1j, 10**400], field=NUMBERS)
def test_settings_refuse_what_is_no_number_within_the_limits(field, value):
    refuses(f"^{field} = .*: must be", sc.Settings, **{field: value})


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"dt": 0.0}, "dt = 0: must be finite and > 0 s"),
        ({"beta": 0.0}, "beta"),
        ({"beta": 1.0001}, r"in \(0, 1\]"),
        ({"restitution": 1.5}, r"in \[0, 1\]"),
        ({"sweeps": -1}, "sweeps = -1: must be a whole number from 0"),
        ({"sweeps": 1.5}, "sweeps = 1.5"),
        ({"sweeps": 2**32}, "sweeps = 4294967296"),
        ({"max_contacts": 10**18}, "max_contacts"),
        ({"max_contacts": -1}, "max_contacts"),
        ({"warm_start": 1}, "warm_start = 1: must be True or False"),
        ({"warm_start": "no"}, "warm_start"),
        ({"integrator": "euler "}, "integrator = 'euler ': must be one of explicit, "),
        ({"integrator": 4}, "integrator = 4: must be a string"),
        ({"solver": "\ud800"}, "solver"),
        ({"law": "newton"}, "law = 'newton': must be one of solref, "),
        ({"cone": None}, "cone"),
        ({"precision": "f16"}, "must be one of f32, f64"),
        ({"law": "rigid", "solver": "newton"}, "'pgs' under a Coulomb law"),
        ({"timestep": 0.1}, "no '?(argument \")?timestep"),
        ({"tolerence": 0.1}, 'nearest: "?tolerance'),
    ],
)
def test_settings_refuse(fields, text):
    refuses(text, sc.Settings, **fields)
    refuses(text, sc.Settings().replace, **fields)
    refuses(text, sc.Sim, pendulum(), **fields)


# The arrays of a Sim.

ARRAYS = [
    ("qpos", 1, r"qpos\[1\] = .*: must be finite \(joint `elbow`"),
    ("qvel", 0, r"qvel\[0\] = .*: must be finite \(joint `shoulder`"),
    ("ctrl", 0, r"ctrl\[0\] = .*: must be finite \(motor `motor`"),
    ("qfrc_applied", 1, r"qfrc_applied\[1\] = .*joint `elbow`"),
    ("xfrc_applied", (2, 4), r"xfrc_applied\[2, 4\] = .*body `lower`"),
]


@every_pair(**{"name, index, text": ARRAYS}, value=NOT_FINITE, precision=["f64", "f32"])
def test_a_sim_steps_nothing_while_an_entry_is_not_finite(
    model, name, index, text, value, precision
):
    sim = sc.Sim(model, precision=precision)
    sim.step(10)
    good = sim.state()
    getattr(sim, name)[index] = value
    text = text.replace("finite ", "finite (in single precision )?") if precision == "f32" else text
    bad = sim.state()
    for call in (sim.step, sim.forward, lambda: sim.xpos, lambda: sim.run(0.01)):
        refuses(text, call)
    assert sim.state() == bad
    sim.restore(good)
    sim.step()
    twin = sc.Sim(model, precision=precision)
    twin.step(11)
    assert twin.state() == sim.state()


def test_single_precision_refuses_what_it_cannot_hold(model):
    sim = sc.Sim(model, precision="f32")
    sim.qpos[0] = 1e39
    refuses("qpos.* must be finite in single precision", sim.step)


@pytest.mark.parametrize("quat", [(0, 0, 0, 0), (1e-200, 0, 0, 0), (0, 1e200, 0, 0)])
def test_a_quaternion_needs_a_length(quat):
    # A step on the floor may turn the ball by rounding.
    for precision, rounding in (("f64", 1e-15), ("f32", 1e-7)):
        sim = sc.Sim(ball(), precision=precision)
        sim.qpos[3:] = quat
        refuses(r"^qpos\[", sim.step)
        assert sim.time == 0.0
        sim.qpos[3:] = (0, 0, 3.0, 0)
        sim.step()
        assert sim.xquat[1] == pytest.approx([0, 0, 1, 0], abs=rounding)


@every_pair(
    value=[np.zeros(99), np.zeros((9, 9)), "1", ["a"], None, [[1], [2, 3]], 1j, [None], True, {}],
    name=["qpos", "qvel", "ctrl", "qfrc_applied", "xfrc_applied"],
)
def test_assignment_refuses_other_shapes_and_types(model, name, value):
    sim = sc.Sim(model)
    before = sim.state()
    refuses(f"^{name} ", setattr, sim, name, value)
    assert sim.state() == before


def test_assignment_takes_every_layout_of_numbers(model):
    sim = sc.Sim(model)
    odd = np.arange(12, dtype=np.float32)[::-2][:2]
    frozen = np.array([3, 4], dtype=">i2")
    frozen.flags.writeable = False
    for value in (odd, frozen, (5, 6), np.asfortranarray([[7.0], [8.0]])[:, 0]):
        sim.qpos = value
        assert sim.qpos.tolist() == list(map(float, value))
    sim.xfrc_applied = np.ones((6, 3)).T
    sim.step()


def test_an_axis_of_one_entry_is_not_stretched(model):
    """A number fills an array and a row serves every body; a list of one number is too short."""
    sim = sc.Sim(model)
    sim.qpos = 0.5
    sim.xfrc_applied = np.arange(6.0)
    assert sim.qpos.tolist() == [0.5, 0.5] and (sim.xfrc_applied == np.arange(6.0)).all()
    refuses("^qpos has shape ", setattr, sim, "qpos", [0.1])
    refuses("^xfrc_applied has shape ", setattr, sim, "xfrc_applied", np.ones((1, 6)))
    # A model without activations: nothing would take the number.
    refuses("^act has shape ", setattr, sim, "act", [1.0])
    assert sim.qpos.tolist() == [0.5, 0.5]


# Calls of a Sim.


@pytest.mark.parametrize("n", [-1, 1.5, "1", None, True, [1], 2**64, math.nan])
def test_step_needs_a_whole_number(model, n):
    sim, batch = sc.Sim(model), sc.Batch(model, 2)
    refuses("^n = .*: must be a whole number from 0", sim.step, n)
    refuses("^n = .*: must be a whole number from 0", batch.step, n)
    assert sim.time == batch.time == 0.0


@pytest.mark.parametrize("wrong", [None, 3, {}, []])
def test_a_sim_needs_a_model_or_a_scene(wrong):
    refuses("must be a stepcore.Model, a stepcore.Scene or the path", sc.Sim, wrong)
    refuses("must be a stepcore.Model, a stepcore.Scene or the path", sc.Batch, wrong, 2)
    refuses("must be a stepcore.Scene", sc.Model, wrong)


def test_other_calls_refuse(model):
    sim = sc.Sim(model)
    refuses("settings = .*: must be a stepcore.Settings", sc.Sim, model, {"dt": 0.1})
    refuses('no key is named "bnt"; nearest: "bent"', sim.reset, key="bnt")
    refuses("key = 7: must be", sim.reset, key=7)
    refuses("body = 1.5: must be", sim.jacobian, 1.5)
    refuses('no body is named ""', sim.body, "")
    refuses("time = NaN", setattr, sim, "time", math.nan)
    refuses("time = 'now'", setattr, sim, "time", "now")
    assert sim.time == 0.0


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"duration": -1.0}, "duration = -1"),
        ({"duration": math.nan}, "duration = nan"),
        ({"duration": "1"}, "duration = '1'"),
        ({"duration": 0.0031}, "duration = 0.0031: must be a whole number of steps"),
        ({"duration": 0.1, "control_dt": 0.003}, "control_dt"),
        ({"duration": 0.1, "control_dt": 0.0}, "control_dt"),
        ({"duration": 0.1, "control": np.zeros((3, 2))}, "control has shape"),
        ({"duration": 0.1, "control": np.zeros(3)}, "control has shape"),
        ({"duration": 0.1, "control": np.zeros((0, 1))}, "control has shape"),
        ({"duration": 0.1, "control": [["a"]]}, "control = "),
        ({"duration": 0.1, "control": [[math.nan]]}, r"ctrl\[0\] = NaN"),
        (
            {"duration": 0.1, "control": lambda time, sim: [1, 2]},
            r"returned an array of shape",
        ),
        ({"duration": 0.1, "record": ("qpso",)}, 'nearest: "qpos"'),
    ],
)
def test_run_refuses(model, arguments, text):
    sim = sc.Sim(model)
    refuses(text, sim.run, **arguments)
    assert sim.time == 0.0


@pytest.mark.parametrize("moves", [sc.Sim.step, sc.Sim.reset])
def test_run_refuses_a_control_that_moves_its_sim(model, moves):
    """What it records would be another motion, and time would not go on evenly."""

    def control(time, sim):
        moves(sim)
        return [0.0]

    sim = sc.Sim(model)
    sim.step(3)
    text = r"`control` of test_bad_input.py must not step, reset or restore the Sim"
    refuses(text, sim.run, 0.1, control)


def test_run_refuses_one_number_for_two_actuators():
    scene = sc.Scene()
    for name in "ab":
        scene.add_body(name)
        scene.add_joint(name, "slide", name=name)
        scene.add_geom(name, "sphere", 0.1, mass=1.0)
        scene.add_actuator(name)
    sim = sc.Sim(scene)
    refuses("returned 3.0 at .*: must return 2 finite", sim.run, 0.1, lambda time, sim: 3.0)


def test_restore_refuses_other_bytes_and_changes_nothing(model):
    sim = sc.Sim(model)
    sim.qpos[:] = [1.4, 1.2]
    sim.step(5)
    state, other = sim.state(), sc.Sim(ball()).state()
    wrong = [b"", b"stepcore", other, state[:-1], state + b"\0", state[:200], b"\xff" * 500]
    # Every length, and every count in the head, cut or made absurd.
    wrong += [state[:at] + b"\xff" * 8 + state[at + 8 :] for at in range(16, 64, 8)]
    for data in wrong:
        refuses("state", sim.restore, data)
        assert sim.state() == state
    for data in (None, 5, "state", [1, 2]):
        refuses("must be what state", sim.restore, data)
    sim.restore(bytearray(state))
    batch = sc.Batch(model, 2)
    for data in ((state,), (state, other), state, None, (state, None)):
        refuses("state", batch.restore, data)
    batch.restore((state, state))


# Batches.


@pytest.mark.parametrize("n", [0, -1, 1.5, "2", None, True, 10**15, 2**63, 2**64])
def test_a_batch_needs_a_number_of_worlds(model, n):
    refuses("^n = .*: must be", sc.Batch, model, n)


@pytest.mark.parametrize("threads", [0, -1, 10**6, 1.5, "2"])
def test_a_batch_needs_a_number_of_threads(model, threads):
    refuses("^threads = .*: must be", sc.Batch, model, 2, threads=threads)


def test_other_arguments_of_a_batch(model):
    refuses("lanes = 1: must be one of True, False, 'auto'", sc.Batch, model, 2, lanes=1)
    refuses("precision = 'f8'", sc.Batch, model, 2, precision="f8")
    refuses('no argument "thread"; nearest: "threads"', sc.Batch, model, 2, thread=2)


def test_a_batch_names_the_world(model):
    batch = sc.Batch(model, 12)
    batch.step()
    batch.qvel[10, 1] = math.nan
    before = batch.state()
    for call in (batch.step, batch.forward, lambda: batch.xpos, lambda: batch.energy):
        refuses(r"qvel\[1\] = NaN: must be finite \(joint `elbow`, world 10\)", call)
    refuses("world 10", batch.rollout, np.zeros((12, 5, 1)))
    assert batch.state() == before


@pytest.mark.parametrize(
    ("ctrl", "text"),
    [
        (np.zeros((3, 5, 1)), "ctrl has shape"),
        (np.zeros((2, 5, 2)), "ctrl has shape"),
        (np.zeros((2, 5)), "ctrl has shape"),
        (np.full((2, 5, 1), math.nan), r"ctrl\[0, 0, 0\] = NaN"),
        (np.array([["a"]]), "ctrl = "),
        (None, "ctrl = "),
    ],
)
def test_a_rollout_refuses(model, ctrl, text):
    batch = sc.Batch(model, 2)
    refuses(text, batch.rollout, ctrl)
    assert batch.time == 0.0


# Plain data from outside the Scene class.

SCENE = pendulum().to_dict()


def paths(value, path=()):
    """The place of every value in a scene's plain data."""
    yield path
    if isinstance(value, dict):
        for key in value:
            yield from paths(value[key], (*path, key))
    elif isinstance(value, list):
        for index in range(len(value)):
            yield from paths(value[index], (*path, index))


def with_value(path, value):
    data = copy.deepcopy(SCENE)
    place = data
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = value
    return data


PLACES = [path for path in paths(SCENE) if path]


def shown(path):
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)
    return text.lstrip(".")


@pytest.mark.parametrize("path", PLACES, ids=shown)
def test_compile_names_the_place_of_what_is_of_no_use(path):
    class Odd:
        pass

    with pytest.raises(ValueError) as caught:
        _core.compile(with_value(path, Odd()))
    assert str(caught.value).startswith(shown(path) + " = <")


@pytest.mark.parametrize(
    ("path", "value", "text"),
    [
        (("geoms", 1, "size"), [1.0], r"geoms\[1\].size = \[1.0\]: must be 3 values"),
        (("geoms", 1, "kind"), "mash", r"geoms\[1\].kind = 'mash': must be one of plane"),
        (("geoms", 1, "kind"), "mesh", r"geom 'rod' mesh = none: must be given for a mesh"),
        (("joints", 0, "kind"), 3, r"joints\[0\].kind = 3: must be a string"),
        (("joints", 1, "range", 0), "x", r"joints\[1\].range\[0\] = 'x': must be a number"),
        (("actuators", 0, "target", "joint"), -1, r"actuators\[0\].target.joint = -1: must be"),
        (("actuators", 0, "target", "joint"), 9, "joint = 9"),
        (("bodies", 1, "parent"), 7, "parent"),
        (("bodies", 1, "mass"), 7, r"bodies\[1\].mass: no such field"),
        (("geoms", 0, "mass"), -1.0, "mass"),
        (("geoms", 1, "mass"), math.nan, "mass"),
        (("joints", 0, "axis"), [0, 0, 0], "axis"),
        (("gravity",), [0, 0, math.inf], "gravity"),
        (("bodies",), [], "no world"),
        (("features", "gravity"), 1, "features.gravity = 1: must be True or False"),
    ],
)
def test_compile_refuses(path, value, text):
    refuses(text, _core.compile, with_value(path, value))


def test_compile_refuses_what_is_missing_or_no_scene():
    for key in SCENE:
        data = copy.deepcopy(SCENE)
        del data[key]
        refuses(f"^{key}: missing", _core.compile, data)
    for wrong in (None, 3, "x", [], {}, {1: 2}):
        with pytest.raises(ValueError):
            _core.compile(wrong)


JUNK = st.one_of(
    st.floats(),
    st.integers(-(2**70), 2**70),
    st.sampled_from(
        [None, "", "hinge", "free", "plane", True, [], {}, -1, 0, 1e300, -1e300, 5e-324]
    ),
    st.lists(st.floats(), max_size=7),
)


def test_any_scene_compiles_or_is_a_value_error_and_any_model_steps_or_says_why():
    outcomes = collections.Counter()

    @settings(max_examples=500, deadline=None, derandomize=True)
    @given(st.lists(st.tuples(st.sampled_from(PLACES), JUNK), min_size=1, max_size=2))
    def changed(changes):
        outcomes[outcome(changes)] += 1

    changed()
    # Neither is everything refused nor nothing.
    assert outcomes["refused"] > 50 and outcomes["stepped"] > 50, outcomes


def outcome(changes):
    """What becomes of the scene with these changes: "refused", "stepped" or "failed"."""
    data = copy.deepcopy(SCENE)
    for path, value in changes:
        place = data
        try:
            for step in path[:-1]:
                place = place[step]
            place[path[-1]] = value
        except (KeyError, IndexError, TypeError):
            continue  # the first change took away the place of the second
    try:
        compiled = _core.compile(data)
    except ValueError:
        return "refused"
    stepped = 0
    for options in ({"law": "rigid", "solver": "pgs"}, {"integrator": "rk4"}, {"precision": "f32"}):
        try:
            sim = _core.Sim(compiled, sc.Settings(**options))
            sim.step(3)
            _ = sim.contacts(), sim.rows()
            for name in ("xpos", "energy", "constraint_force"):
                sim.readout(name)
        except (ValueError, sc.SimulationError):
            continue
        state = dict(sim.arrays())
        assert np.isfinite(state["qpos"]).all() and np.isfinite(state["qvel"]).all()
        stepped += 1
    return "stepped" if stepped else "failed"
