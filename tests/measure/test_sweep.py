"""`sweep`: every point of the grid, in its order, failures kept; and the table it returns."""

from concurrent.futures import ThreadPoolExecutor

import pytest

import stepcore as sc
from stepcore import lesson


def height(sim):
    sim.reset(key="start")
    sim.step(10)
    return {"height": float(sim.qpos[0]), "dt": sim.settings.dt}


def test_a_grid_of_settings_meets_the_closed_form():
    # v-first free fall: after n steps h - g dt² n (n + 1) / 2.
    model = lesson.drop().compile()
    table = sc.sweep(model, {"dt": [0.001, 0.002], "sweeps": [1, 2, 3]}, height, threads=1)
    assert table["dt"] == [0.001] * 3 + [0.002] * 3
    assert table["sweeps"] == [1, 2, 3] * 2
    for record in table:
        assert record["height"] == pytest.approx(0.3 - 9.81 * record["dt"] ** 2 * 55, abs=1e-13)


def test_a_model_may_be_named_by_its_file(tmp_path):
    path = tmp_path / "drop.xml"
    lesson.drop().save(path)
    grid = {"dt": [0.001, 0.002]}
    own = sc.sweep(lesson.drop(), grid, height, threads=1)
    assert sc.sweep(path, grid, height, threads=1).records == own.records
    assert sc.sweep("lesson:drop", grid, height, threads=1).records == own.records
    with pytest.raises(ValueError, match=r'no "sweep"; nearest: .sweeps'):
        sc.sweep("lesson:drop", {"sweep": [1]}, height)


def test_the_order_is_the_grids_whoever_computes():
    model = lesson.spring().compile()
    grid = {"dt": [0.001 * k for k in range(1, 40)]}

    def measure(sim):
        sim.reset(key="start")
        sim.step(50)
        return float(sim.qpos[0])

    alone = sc.sweep(model, grid, measure, threads=1)
    assert sc.sweep(model, grid, measure, threads=4).records == alone.records
    with ThreadPoolExecutor(3) as pool:
        assert sc.sweep(model, grid, measure, executor=pool).records == alone.records


def test_values_of_the_scene_are_paths():
    def acceleration(sim):
        sim.reset(key="start")
        sim.forward()
        return float(sim.qacc[0])

    model = lesson.spring(k=100).compile()
    table = sc.sweep(model, {"joint/spring/stiffness": [100.0, 400.0]}, acceleration)
    assert table["value"] == pytest.approx([-100.0, -400.0])


def test_a_function_makes_what_is_measured():
    def make(k, law):
        return lesson.drop(law, penalty_stiffness=k)

    grid = {"law": ["penalty"], "k": [1e3, 1e4]}
    table = sc.sweep(make, grid, lambda sim: sim.settings.penalty_stiffness)
    assert table["value"] == [1e3, 1e4]
    assert sc.sweep(lambda a: a, {"a": [1, 2]}, lambda a: -a)["value"] == [-1, -2]


def test_failures_stay_in_the_table():
    # Explicit Euler grows by (1 + (ω dt)²)^½ a step: 1e8 times here, beyond the doubles.
    model = lesson.spring(k=1e20, integrator="explicit").compile()

    def measure(sim):
        sim.reset(key="start")
        sim.step(200)
        return float(sim.qpos[0])

    table = sc.sweep(model, {"dt": [0.01, -1.0, 1e-14]}, measure)
    assert "spring" in table["failure"][0]
    assert "dt" in table["failure"][1] and "> 0" in table["failure"][1]
    assert table["failure"][2] is None
    assert table["value"][:2] == [None, None] and table["value"][2] == pytest.approx(1, abs=0.1)


def test_what_is_no_failure_of_a_point_is_raised():
    model = lesson.spring().compile()
    with pytest.raises(ValueError, match=r'no "sweps".*sweeps'):
        sc.sweep(model, {"sweps": [1]}, height)
    for values in ([], 0.1, "0.1"):
        with pytest.raises(ValueError, match=r"grid\['dt'\] = .*: must be a list of at least one"):
            sc.sweep(model, {"dt": values}, height)
    with pytest.raises(ValueError, match=r"grid = .*: must be a dict"):
        sc.sweep(model, [0.1], height)
    with pytest.raises(
        ValueError, match="make_or_model = 3: must be a Model, a Scene, a path or a func"
    ):
        sc.sweep(3, {"dt": [0.1]}, height)
    with pytest.raises(ValueError, match="threads"):
        sc.sweep(model, {"dt": [0.1]}, height, threads=0)
    with pytest.raises(ZeroDivisionError):
        sc.sweep(model, {"dt": [0.1, 0.2]}, lambda sim: 1 / 0)


def test_progress_is_told():
    seen = []
    sc.sweep(
        lambda a: a,
        {"a": range(3)},
        float,
        threads=1,
        progress=lambda label, done, total: seen.append((done, total)),
    )
    assert seen == [(1, 3), (2, 3), (3, 3)]
