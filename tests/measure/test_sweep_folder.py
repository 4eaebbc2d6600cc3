"""A sweep that ends early keeps its results, and goes on in a folder."""

import json
import os
import signal
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson

GRID = {"dt": [0.001, 0.002], "joint/spring/stiffness": [1.0, 10.0, 100.0]}


def swing(sim):
    """Numbers of every kind that a folder keeps."""
    sim.reset(key="start")
    sim.step(20)
    one = np.float32(sim.qpos[0])
    return {"x": float(sim.qpos[0]), "path": np.array(sim.qvel), "one": one, "n": 3, "s": "a\n"}


def batched(batch):
    batch.reset("start")
    batch.step(20)
    return {"x": batch.qpos[:, 0].copy()}


def same(one, other):
    assert one.columns == other.columns and len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        for name in one.columns:
            assert type(a[name]) is type(b[name]), name
            assert np.array_equal(a[name], b[name]), name


class Counted:
    """A measurement that counts its calls, and stops at one of them."""

    def __init__(self, measure, stop=None, error=KeyboardInterrupt):
        self.measure, self.stop, self.error, self.calls = measure, stop, error, 0
        self.__qualname__, self.__module__ = "counted", "tests"

    def __call__(self, sim):
        self.calls += 1
        if self.calls == self.stop:
            raise self.error
        return self.measure(sim)


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_what_was_done_is_kept_and_the_rest_is_measured_later(tmp_path, error):
    model = lesson.spring().compile()
    whole = sc.sweep(model, GRID, swing, threads=1)
    interrupted = Counted(swing, 4, error)
    with pytest.raises(error) as raised:
        sc.sweep(model, GRID, interrupted, threads=1, folder=tmp_path / "sweep")
    same(raised.value.table, whole[:3])
    later = Counted(swing)
    same(sc.sweep(model, GRID, later, threads=1, folder=tmp_path / "sweep"), whole)
    assert later.calls == 3
    same(sc.sweep(model, GRID, later, threads=2, folder=tmp_path / "sweep"), whole)
    assert later.calls == 3
    # A larger grid measures only new points.
    larger = GRID | {"dt": [0.001, 0.002, 0.004]}
    table = sc.sweep(model, larger, later, threads=1, folder=tmp_path / "sweep")
    assert later.calls == 6 and len(table) == 9


def test_without_a_folder_the_error_has_the_table():
    model = lesson.spring().compile()
    with pytest.raises(KeyboardInterrupt) as raised:
        sc.sweep(model, GRID, Counted(swing, 3), threads=1)
    same(raised.value.table, sc.sweep(model, GRID, swing, threads=1)[:2])


def test_failures_and_batches_are_kept(tmp_path):
    model = lesson.spring().compile()
    grid = {"dt": [0.001, -1.0], "joint/spring/stiffness": [1.0, 10.0]}
    whole = sc.sweep(model, grid, batched, batch=True)
    assert whole["failure"][2].startswith("dt = -1")
    same(sc.sweep(model, grid, batched, batch=True, folder=tmp_path), whole)
    counted = Counted(batched)
    counted.__qualname__, counted.__module__ = batched.__qualname__, batched.__module__
    same(sc.sweep(model, grid, counted, batch=True, folder=tmp_path), whole)
    assert counted.calls == 0
    grid["joint/spring/stiffness"].append(20.0)
    table = sc.sweep(model, grid, counted, batch=True, folder=tmp_path)
    assert (
        counted.calls == 1 and table.records == sc.sweep(model, grid, batched, batch=True).records
    )


def fatal(sim):
    if sim.settings.dt == 0.0625:
        os.kill(os.getpid(), signal.SIGKILL)
    return float(sim.settings.dt)


def test_a_broken_pool_leaves_the_points_that_were_done(tmp_path):
    model = lesson.spring().compile()
    grid = {"dt": [0.001 * k for k in range(1, 21)] + [0.0625]}
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
        pytest.raises(RuntimeError, match="workers died") as raised,
    ):
        sc.sweep(model, grid, fatal, executor=pool, folder=tmp_path)
    assert raised.value.table["dt"] == grid["dt"][:20]
    grid["dt"][-1] = 0.5
    table = sc.sweep(model, grid, fatal, folder=tmp_path, threads=1)
    assert table["value"] == grid["dt"]


def test_a_line_that_was_cut_off_is_measured_again(tmp_path):
    model = lesson.spring().compile()
    whole = sc.sweep(model, GRID, swing, threads=1, folder=tmp_path)
    points = tmp_path / "points.jsonl"
    points.write_bytes(points.read_bytes()[:-30])
    counted = Counted(swing)
    counted.__qualname__, counted.__module__ = swing.__qualname__, swing.__module__
    same(sc.sweep(model, GRID, counted, threads=1, folder=tmp_path), whole)
    assert counted.calls == 1
    assert len(points.read_text().splitlines()) == 6


def test_a_folder_of_another_sweep_is_refused(tmp_path):
    model = lesson.spring().compile()
    with ThreadPoolExecutor(2) as pool:
        sc.sweep(model, GRID, swing, executor=pool, folder=tmp_path)
    for other, measure in ((lesson.spring(k=7.0), swing), (model, fatal)):
        with pytest.raises(ValueError, match="holds a sweep of another m"):
            sc.sweep(other, GRID, measure, folder=tmp_path)
    (tmp_path / "points.jsonl").write_text("{}\n")
    with pytest.raises(ValueError, match="is damaged"):
        sc.sweep(model, GRID, swing, folder=tmp_path)
    kept = json.loads((tmp_path / "sweep.json").read_text())
    assert set(kept) == {"stepcore", "model", "measure"}
    with pytest.raises(ValueError, match=r'"value" = .*: must be numbers, texts, arrays'):
        sc.sweep(model, GRID, Counted(lambda sim: {1}), folder=tmp_path / "other", threads=1)
