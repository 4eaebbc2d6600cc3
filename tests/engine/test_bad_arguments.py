"""Arguments of a wrong type or size: a ValueError in one short line, never another exception."""

import multiprocessing
import warnings
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
from small import pendulum

import stepcore as sc
from stepcore import executors
from stepcore.report.progress import Progress

LONG = "b" * 1_000_000


@pytest.fixture(scope="module")
def model():
    return pendulum().compile()


def text_of(call):
    with pytest.raises(ValueError) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 1500
    return text


@pytest.mark.parametrize("duration", [1e9, 1e308])
def test_a_run_that_never_ends_is_refused_before_its_arrays_are_made(model, duration):
    assert "at most 1e+09 steps" in text_of(lambda: sc.Sim(model).run(duration))


def test_a_run_whose_record_exceeds_the_memory_says_so(model, monkeypatch):
    def full(*_args, **_kwargs):
        raise MemoryError

    sim = sc.Sim(model)
    monkeypatch.setattr(np, "empty", full)
    assert "exceed the memory" in text_of(lambda: sim.run(1.0))


@pytest.mark.parametrize("record", [3, [3], [["qpos"]], None, {"qpos"}])
def test_record_takes_names(model, record):
    assert text_of(lambda: sc.Sim(model).run(0.1, record=record)).startswith("record = ")


@pytest.mark.parametrize(
    "settings", [3, "dt", {"dt": "a"}, {3: 1}, {"integrator": ["euler"]}, {"tolerence": 1}]
)
def test_with_settings_refuses_at_once(settings):
    text_of(lambda: pendulum().with_settings(settings))


@pytest.mark.parametrize("joints", ["upper", 3, ["upper"], [("upper", 2.0)]])
def test_the_joints_of_a_tendon_are_a_dict(joints):
    said = text_of(lambda: pendulum().add_tendon(joints=joints))
    assert said == f"joints = {joints!r}: must be a dict of joints and coefficients"


@pytest.mark.parametrize("kind", [3, None, "bodies", ["body"]])
def test_an_index_of_no_kind(model, kind):
    assert "must be one of body, joint" in text_of(lambda: model.index(kind, "upper"))


@pytest.mark.parametrize("index", [range(2), slice(1), 1.0, [0], 4, -5])
def test_an_index_that_is_none(model, index):
    assert "an index below" in text_of(lambda: model.index("body", index))


def test_an_index_where_there_are_none(model):
    bare = sc.Scene().compile()
    assert text_of(lambda: sc.Sim(bare).reset(3)) == "key = 3: the model has no keyframes"
    assert text_of(lambda: model.index("equality", 0)) == (
        "equality = 0: the model has no equalities"
    )


@pytest.mark.parametrize(
    "call",
    [
        lambda scene: sc.diagnose(scene, dt=1e308),
        lambda scene: sc.ablate(scene, starts=1e308),
        lambda scene: sc.trade(scene, starts=1e308),
        lambda scene: sc.trade(scene, horizon=1e308),
    ],
    ids=["diagnose dt", "ablate starts", "trade starts", "trade horizon"],
)
def test_numbers_beyond_all_use(call):
    text_of(lambda: call(pendulum()))


@pytest.mark.parametrize(
    "axis",
    [
        {"solvers": ["a"]},
        {"solvers": [["pgs"]]},
        {"integrators": [3]},
        {"precisions": ["f16"]},
        {"sweeps": ["many"]},
        {"dts": [0.0]},
    ],
    ids=str,
)
def test_a_grid_of_values_that_do_not_exist_is_refused_also_where_nothing_would_try_them(axis):
    text_of(lambda: sc.trade(sc.lesson.spring(), horizon=0.1, progress=False, **axis))


@pytest.mark.parametrize(
    "value", [1j, np.complex64(1j), np.array(1j), [1j, 0, 0], np.array([1j, 0, 0])]
)
def test_an_imaginary_part_is_refused_and_not_dropped(value):
    scene = sc.Scene()
    pos = value if np.ndim(value) else [value, 0, 0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text_of(lambda: scene.add_body("a", pos=pos))
    assert len(scene.bodies) == 1


@pytest.mark.parametrize(
    "call",
    [
        lambda model: model.index("body", LONG),
        lambda model: sc.Sim(model, integrator=LONG),
        lambda model: sc.Sim(model, **{LONG: 1}),
        lambda model: sc.load(LONG),
        lambda model: sc.loads(f"<mujoco><{LONG}/></mujoco>"),
        lambda model: sc.loads(f"<mujoco {LONG}='1'/>"),
        lambda model: sc.loads("<mujoco/>", name=LONG) and sc.loads("<mujoc/>", name=LONG),
        lambda model: sc.loads(f'<mujoco><include file="{LONG}"/></mujoco>', base="."),
        lambda model: model.with_values({f"geom/{LONG}/mass": 1.0}),
        lambda model: model.with_values({f"geom/rod/{LONG}": 1.0}),
        lambda model: sc.sweep(model, {LONG: [1]}, lambda sim: 1),
        lambda model: pendulum().add_geom("world", "sphere", **{LONG: 1}),
        lambda model: pendulum().add_geom(LONG, "sphere"),
        lambda model: sc.Sim(model).run(0.1, record=LONG),
        lambda model: sc.Sim(model).reset(key=LONG),
    ],
)
def test_a_name_of_a_megabyte_makes_no_text_of_a_megabyte(model, call):
    text_of(lambda: call(model))


class Unsendable(Exception):
    def __init__(self, text, code):
        super().__init__(f"{text} ({code})")


def fails(point):
    raise Unsendable("the sensor of point 3 broke", point)


def test_an_error_that_cannot_be_sent_back_keeps_its_text():
    with (
        ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool,
        pytest.raises(RuntimeError, match=r"Unsendable: the sensor of point 3 broke \(3\)"),
    ):
        executors.each(fails, [3, 4], bar=Progress("", 2, False), executor=pool)


WRONG = [None, {}, [], "x", -1, float("nan"), 10**400, object(), True, 1j, b"x", [None], "a\0b"]
WRONG += [np.float16(3), np.zeros((2, 3, 4)), np.array(["a"]), len, lambda: 0, np.array(np.nan)]
EMPTY = np.zeros(0)
# A call of every kind with one argument that may be anything.
CALLS = {
    "run control": lambda model, x: sc.Sim(model).run(0.01, control=x),
    "run control_dt": lambda model, x: sc.Sim(model).run(0.01, control_dt=x),
    "batch progress": lambda model, x: sc.Batch(model, 2).step(progress=x),
    "diagnose progress": lambda model, x: sc.diagnose(model, progress=x),
    "predict progress": lambda model, x: sc.predict(
        model, horizon=0.02, starts=2, progress=x, threads=1
    ),
    "batch.model_of": lambda model, x: sc.Batch(model, 2).model_of(x),
    "batch.reset": lambda model, x: sc.Batch(model, 2).reset(worlds=x),
    "batch.contacts_of": lambda model, x: sc.Batch(model, 2).contacts_of(x),
    "batch.ray": lambda model, x: sc.Batch(model, 2).ray(x, [0, 0, 1]),
    "called": lambda model, x: model.called(x),
    "contact_pair": lambda model, x: model.contact_pair(x),
    "element_name kind": lambda model, x: model.element_name(x, 0),
    "element_name index": lambda model, x: model.element_name("spring", x),
    "element_name part": lambda model, x: model.element_name("contact", 0, x),
    "element_force kind": lambda model, x: model.element_force(x, [0], EMPTY, [0, 0], [0, 0]),
    "element_force ctrl": lambda model, x: model.element_force("spring", x, EMPTY, [0], [0]),
    "element_force qvel": lambda model, x: model.element_force("spring", [0], EMPTY, [0], x),
    "geom_hull": lambda model, x: model.geom_hull(x),
    "root": lambda model, x: model.root(x),
    "touches geom": lambda model, x: model.touches(x, 1, [0, 0]),
    "touches qpos": lambda model, x: model.touches(0, 1, x),
    "touches lanes": lambda model, x: model.touches(0, 1, [0, 0], lanes=x),
    "touches precision": lambda model, x: model.touches(0, 1, [0, 0], precision=x),
    "ray groups": lambda model, x: sc.Sim(model).ray([0, 0, 1], [0, 0, 1], groups=x),
    "jacobian": lambda model, x: sc.Sim(model).jacobian(x),
    "restore": lambda model, x: sc.Sim(model).restore(x),
    "run": lambda model, x: sc.Sim(model).run(x),
    "add_mesh name": lambda model, x: sc.Scene().add_mesh(x),
    "add_mesh file": lambda model, x: sc.Scene().add_mesh(file=x),
    "add_hfield file": lambda model, x: sc.Scene().add_hfield(file=x, size=(1, 1, 1, 1)),
    "scene.save": lambda model, x: sc.Scene().save(x),
    "loads base": lambda model, x: sc.loads("<mujoco/>", base=x),
    "loads name": lambda model, x: sc.loads("<mujoco/>", name=x),
    "load": lambda model, x: sc.load(x),
    "replay": lambda model, x: sc.replay(x),
    "Replay.load": lambda model, x: sc.Replay.load(x),
    "Trajectory.load": lambda model, x: sc.Trajectory.load(x),
    "trajectory.save": lambda model, x: sc.Sim(model).run(0.01).save(x),
    "trajectory.plot": lambda model, x: sc.Sim(model).run(0.01).plot(x),
    "trajectory.save_html": lambda model, x: sc.Sim(model).run(0.01).save_html(x),
    "trajectory.save_mcap": lambda model, x: sc.Sim(model).run(0.01).save_mcap(x),
    "trajectory.save_video": lambda model, x: sc.Sim(model).run(0.01).save_video(x),
    "picture": lambda model, x: sc.picture(sc.Sim(model), x),
    "plan.to_html": lambda model, x: sc.plan(model).to_html(x),
    "plan.plot": lambda model, x: sc.plan(model).plot(x),
}


@pytest.mark.parametrize("name", CALLS)
def test_any_argument_is_taken_or_refused_by_its_name(model, name, tmp_path, monkeypatch):
    """It works, or a ValueError or OSError says in one line what is wrong."""
    monkeypatch.chdir(tmp_path)
    for wrong in WRONG:
        try:
            CALLS[name](model, wrong)
        except (ValueError, OSError) as error:
            text = str(error)
            assert text and "\n" not in text and len(text) < 1500
