"""Work in other processes: the same bits, failures in their rows, lost workers, clear errors."""

import copy
import functools
import multiprocessing
import pickle
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
import workers
import zoo

import stepcore as sc
from stepcore import executors as jobs
from stepcore import lesson
from stepcore.report.progress import Progress

SPAWN = multiprocessing.get_context("spawn")


@pytest.fixture(scope="module")
def pool():
    with ProcessPoolExecutor(2, mp_context=SPAWN) as pool:
        yield pool


def test_two_processes_give_the_bits_of_one(pool):
    """300 runs over settings, values of the scene, and steps that fail; in the grid's order."""
    model = lesson.stack().compile()
    grid = {
        "dt": [1e-4 * k for k in range(1, 15)] + [-1.0],
        "sweeps": [1, 2, 5, "auto"],
        "geom/shape1/mass": [0.1, 1.0, 10.0, 1e3, -2.0],
    }
    model = model.with_settings(tolerance=1e-9)
    alone = sc.sweep(model, grid, workers.height, threads=1, progress=False)
    seen = []
    others = sc.sweep(
        model, grid, workers.height, executor=pool, progress=lambda *told: seen.append(told[1:])
    )
    assert others.records == alone.records
    assert len(alone) == 300
    failed = [record for record in alone if record["failure"]]
    assert len(failed) == 20 + 56
    assert seen[-1] == (300, 300)
    assert [done for done, _ in seen] == sorted({done for done, _ in seen})


def test_a_worker_compiles_a_scene_once(pool):
    """What crosses for a point is its values; for a chunk, some kB of model besides."""
    model = lesson.stack().compile()
    sc.sweep(model, {"sweeps": list(range(1, 40))}, workers.where, executor=pool)
    again = pickle.loads(pickle.dumps(model))
    assert again.core is pickle.loads(pickle.dumps(model.with_settings(dt=0.5))).core
    assert again.scene is not pickle.loads(pickle.dumps(model)).scene
    work = functools.partial(jobs._run_chunk, functools.partial(print, model))
    sent = [len(pickle.dumps((work, [{"dt": 0.1, "sweeps": 3}] * n))) for n in (1, 20)]
    assert sent[0] < 2500
    assert sent[1] - sent[0] < 20 * 100


def test_errors_of_the_users_own_are_raised(pool):
    model = lesson.drop().compile()
    with pytest.raises(ZeroDivisionError, match="a mistake of the user"):
        sc.sweep(model, {"sweeps": [1, 2, 3]}, workers.broken, executor=pool)
    with pytest.raises(ValueError, match=r"this work cannot be sent.*functions of a module"):
        sc.sweep(model, {"sweeps": [1]}, lambda sim: 1.0, executor=pool)
    with pytest.raises(ValueError, match="executor = 3: must be"):
        sc.sweep(model, {"sweeps": [1]}, workers.where, executor=3)


def test_a_pool_whose_process_dies_says_so():
    with ProcessPoolExecutor(2, mp_context=SPAWN) as pool:
        with pytest.raises(RuntimeError, match=r"workers died .* of 8 points to do"):
            jobs.each(workers.dies, range(8), bar=Progress("", 8, False), executor=pool)
        with pytest.raises(RuntimeError, match="8 points to do; it cannot be used again"):
            jobs.each(workers.dies, range(8), bar=Progress("", 8, False), executor=pool)


class Interrupted(ThreadPoolExecutor):
    """Ctrl-C while the work is handed out."""

    def __init__(self):
        super().__init__(1)
        self.made = []

    def submit(self, *work):
        if len(self.made) == 5:
            raise KeyboardInterrupt
        self.made.append(super().submit(*work))
        return self.made[-1]


def test_ctrl_c_cancels_what_has_not_begun():
    over = threading.Event()
    with Interrupted() as pool:
        with pytest.raises(KeyboardInterrupt):
            points = [600.0] * 20
            jobs.each(over.wait, points, bar=Progress("", 20, False), executor=pool)
        # One of the five may have begun.
        assert sum(future.cancelled() for future in pool.made) >= 4
        over.set()


def test_a_long_point_ends_at_its_next_checkpoint():
    """Of two points at once one fails, and the other would never end."""

    def point(fails):
        if fails:
            raise ValueError("this one")
        while True:
            jobs.checkpoint()
            time.sleep(1e-3)

    with pytest.raises(ValueError, match="this one"):
        jobs.each(point, [False, True], bar=Progress("", 2, False), threads=2)
    jobs.checkpoint()  # outside of a pool there is nothing to end


def test_after_an_error_threads_begin_no_other_point():
    """Of two threads one fails while the other is in its point, which ends after the error."""
    called = []
    failed = threading.Event()

    def first_fails(point):
        called.append(point)
        if point == 0:
            failed.set()
            raise ValueError("zero")
        assert failed.wait(600)
        # Until the error has stopped the others, which it does whatever else this machine does.
        while True:
            jobs.checkpoint()
            time.sleep(1e-3)

    with pytest.raises(ValueError, match="zero"):
        jobs.each(first_fails, range(640), bar=Progress("", 640, False), threads=2)
    assert set(called) <= {0, 1, 2}


@pytest.mark.parametrize("name", ["grasp", "stack"])
def test_a_pickle_holds_the_whole_model(name):
    """Scene, settings, the numbers to the last bit; the pickle is the same again."""
    scene = getattr(lesson, name)()
    body = scene.bodies[-1]
    body.quat = (0.1, 0.7, -0.3, 0.2)
    scene.ignored, scene.notes = ["a mesh"], ["a note"]
    scene.options["dt"] = np.float64(0.003)
    model = scene.with_settings(tolerance=1e-7, sweeps="auto").compile()
    data = pickle.dumps(model)
    again = pickle.loads(data)
    assert pickle.dumps(again) == data
    assert again.scene == model.scene and again.settings == model.settings
    assert again.scene.bodies[-1].quat == body.quat
    assert (again.scene.ignored, again.scene.notes) == (["a mesh"], ["a note"])
    sims = [sc.Sim(one) for one in (model, again, copy.deepcopy(again))]
    for sim in sims:
        sim.reset(key="start")
        sim.step(100)
    assert sims[0].state() == sims[1].state() == sims[2].state()
    changed = [one.with_values({"gravity": (0, 0, -1.0)}) for one in (model, again)]
    assert changed[0].scene == changed[1].scene != model.scene


def test_excluded_pairs_and_places_survive():
    scene = sc.loads(
        """<mujoco><worldbody><body name="a"><freejoint/><geom name="g" size="1"/></body>
        <body name="b" pos="3 0 0"><freejoint/><geom size="1"/></body></worldbody>
        <contact><exclude body1="a" body2="b"/></contact></mujoco>"""
    )
    again = pickle.loads(pickle.dumps(scene.compile())).scene
    assert again == scene
    assert [(a.name, b.name) for a, b in again.excludes] == [("a", "b")]
    assert again.excludes[0][0] is again.bodies[1]
    assert again.geom("g").place == scene.geom("g").place != ""
    assert sc.Model(again).pairs == ()


def test_a_process_compiles_the_same_scene_once():
    """Whatever its settings; and the text of its file, which no step needs, stays at home."""
    body = "<body><joint/><geom size='1'/></body>"
    text = f"<mujoco><!--{'x' * 100_000}--><worldbody>{body}</worldbody></mujoco>"
    model = sc.loads(text).compile()
    data = [pickle.dumps(model.with_settings(dt=dt)) for dt in (0.001, 0.002)]
    assert max(map(len, data)) < 5_000
    one, other = map(pickle.loads, data)
    assert one.core is other.core and (one.settings.dt, other.settings.dt) == (0.001, 0.002)


def short(what, executor):
    """A small measurement, as data that no clock is in."""
    scene, some = lesson.spring(damping=0.3), {"executor": executor, "progress": False}
    if what == "diagnose":
        return sc.diagnose(scene, **some).to_dict()
    if what == "stability_map":
        grid = {"values": [50.0, 400.0], "dts": [0.002, 0.02, 0.2]}
        path = "joint/spring/stiffness"
        return sc.stability_map(scene, path=path, **grid, horizon=0.4, **some).to_dict()
    motion = {"horizon": 0.2, "starts": 2}
    if what == "trade":
        found = sc.trade(scene, **motion, dts=[0.01, 0.02], **some)
        return [(row.settings, row.errors, row.failure) for row in found.rows]
    if what == "ablate":
        found = sc.ablate(scene, **motion, **some)
        return {k: v for k, v in found.to_dict().items() if k in ("name", "horizon", "starts")}
    return getattr(sc, what)(scene, **motion, **some).to_dict()


LONG = ["trade", "predict", "diagnose", "ablate", "converge", "stability_map"]


@pytest.mark.parametrize("what", LONG)
def test_everything_long_takes_an_executor(pool, what):
    assert repr(short(what, pool)) == repr(short(what, None))


@pytest.mark.parametrize("name", sorted(zoo.ZOO))
def test_a_pickle_holds_every_kind_of_scene(name):
    """The zoo: equal scenes, the same MJCF."""
    model = sc.loads(zoo.ZOO[name].text).compile()
    again = pickle.loads(pickle.dumps(model))
    assert again.scene == model.scene and again.scene.to_mjcf() == model.scene.to_mjcf()
