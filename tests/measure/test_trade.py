"""The trade's figures against closed forms, its recommendations, and its book-keeping.

No time is judged here: choices are made by counted work.
"""

import copy
import json
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from small import by
from zoo import ZOO

import stepcore as sc
from stepcore import deadline, lesson
from stepcore.experiment.change import Change
from stepcore.experiment.choose import Proof
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import default_horizon
from stepcore.experiment.study import Study
from stepcore.experiment.truth import Converging
from stepcore.measure.trade import search
from stepcore.report.units import compact, metres

G = 9.81
BALL = """<mujoco model="ball"><option timestep="0.004"/><worldbody>
<geom type="plane" size="5 5 .1"/><body pos="0 0 .16"><joint type="slide" axis="0 0 1"/>
<geom size=".1" mass="1"/></body></worldbody></mujoco>"""
COUNTED = {"by": "flops", "progress": False, "horizon": 0.32, "threads": 1}


def falling(mass=2.0, **options):
    """A ball in free fall, with nothing to meet."""
    scene = sc.Scene(gravity=(0, 0, -G), name="falling")
    ball = scene.add_body("ball", pos=(0, 0, 1))
    scene.add_joint(ball, "free")
    scene.add_geom(ball, "sphere", 0.1, mass=mass)
    scene.options = {"dt": 0.01, "integrator": "semi-implicit", "solver": "pgs"} | options
    return scene


def pushed(damping=0.0, **options):
    """1 kg on a slide, without gravity, and a motor."""
    scene = sc.Scene(gravity=(0, 0, 0), name="pushed")
    cart = scene.add_body("cart", mass=1.0, inertia=(1, 1, 1))
    slide = scene.add_joint(cart, "slide", axis=(1, 0, 0), damping=damping)
    scene.add_actuator(slide, name="motor", gear=[2.0])
    scene.options = {"dt": 0.01, "integrator": "semi-implicit", "solver": "pgs"} | options
    return scene


def few(scene, **options):
    """A trade with one thread, double precision and no bar."""
    chosen = {"precisions": ["f64"], "threads": 1, "progress": False, "horizon": 1.0}
    return sc.trade(scene, **(chosen | options))


@pytest.fixture(scope="module")
def ball():
    return sc.trade(sc.loads(BALL), error=1e-4, starts=4, further=8, **COUNTED)


def test_free_fall_is_wrong_by_half_g_dt_t():
    result = few(falling(), integrators=["semi-implicit"], starts=3, horizon=1.0)
    assert result.reference.error < 1e-9
    for row in result.rows:
        assert row.largest.max() == pytest.approx(G * row.dt / 2, rel=1e-6)
        # Samples every dt_max: the root mean square of t over them.
        times = np.arange(1, 26) * 0.04
        rms = G * row.dt / 2 * np.sqrt(np.mean(times**2))
        assert row.errors == pytest.approx([rms] * 3, rel=1e-6)


def test_the_orders_of_the_integrators_on_a_spring():
    orders = {"semi-implicit": 1, "explicit": 1, "midpoint": 2, "rk4": 4}
    dts = [0.01, 0.005, 0.0025, 0.00125]
    result = few(lesson.spring(), dts=dts, integrators=list(orders), sweeps=[1], starts=2)
    for name, order in orders.items():
        errors = [by(result, integrator=name, dt=dt).error for dt in (0.005, 0.0025)]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.12)
        assert result.orders[name] == pytest.approx(order, abs=0.12)


def test_a_constant_force_is_held_exactly():
    options = {"ctrl": np.full((1, 1), 1.5), "starts": 1, "integrators": ["semi-implicit", "rk4"]}
    result = few(pushed(), sweeps=[1], **options)
    # v-first is off by a dt t / 2 with a = 3 m/s².
    row = by(result, integrator="semi-implicit", dt=0.01, sweeps=1)
    assert row.largest.max() == pytest.approx(3.0 * 0.01 / 2, rel=1e-6)
    assert by(result, integrator="rk4", dt=0.01, sweeps=1).error < 1e-9


def test_cheaper_settings_that_take_longer_here_say_how_work_is_counted():
    result = few(lesson.spring(), dts=[0.02, 0.01], integrators=["semi-implicit"], starts=1)
    coarse = min(result.rows, key=lambda row: row.cost)
    for here, told in ((0.5, False), (1.5, True)):
        result.times = {result.shipped.change: 100.0, coarse.change: 100.0 * here}
        said = result._priced_beside(coarse)
        assert f"{here:.2f}× as measured here" in said
        assert ("work is counted along the shipped motion" in said) == told


def test_controls_are_the_same_for_every_step():
    seen = {}

    def control(time, sim):
        seen.setdefault(sim.settings.dt, set()).add(round(time, 9))
        return [np.sin(5 * time)]

    few(pushed(), control=control, control_dt=0.05, starts=1, dts=[0.01, 0.005])
    times = list(seen.values())
    assert len(times[0]) == 20 and all(other == times[0] for other in times)


def test_an_array_and_a_function_of_time_are_the_same_motion():
    values = np.sin(np.arange(20) * 0.25)[:, None]
    options = {"control_dt": 0.05, "starts": 1, "integrators": ["semi-implicit"]}
    a = few(pushed(), ctrl=values, **options)
    b = few(pushed(), control=lambda t, sim: values[round(t / 0.05)], **options)
    for one, other in zip(a.rows, b.rows, strict=True):
        assert one.error == pytest.approx(other.error, rel=1e-9)


def test_failures_stay_with_their_reason():
    # Explicit Euler grows tenfold a step here, 400 times.
    scene = lesson.spring(k=1e10, dt=1e-4, integrator="rk4")
    options = {"dts": [1e-4, 1e-5], "integrators": ["explicit", "rk4"], "starts": 1}
    result = few(scene, horizon=0.04, sweeps=[1], **options)
    bad = by(result, integrator="explicit", dt=1e-4)
    assert "start 0:" in bad.failure and bad in result.failures
    assert bad.error == np.inf and bad not in result.front
    record = result.table[result.rows.index(bad)]
    assert record["error"] is None and record["failure"]
    assert "failed" in result.text(full=True)


def test_the_reference_is_ten_times_better_than_the_table():
    result = few(lesson.drop(), starts=2, integrators=["semi-implicit"], sweeps=[1])
    least = min(row.error for row in result.rows)
    assert 10 * result.reference.error <= least * (1 + 1e-9)
    # At the table's finest step v-first is wrong by g dt t / 2 before the impact.
    assert 1e-5 < least < 1e-3


def test_without_effort_the_truth_is_less_sure_and_no_error_is_below_it():
    result = few(lesson.drop(), starts=2, integrators=["rk4"], effort=0.0)
    assert all(row.error >= row.unsure.max() for row in result.rows)
    assert (
        result.reference.error > few(lesson.drop(), starts=2, integrators=["rk4"]).reference.error
    )


def test_errors_do_not_depend_on_threads_and_seed_decides():
    options = {"starts": 2, "integrators": ["semi-implicit"], "dts": [0.002, 0.001], "horizon": 0.2}
    one = few(lesson.stack(), **options)
    two = few(lesson.stack(), **(options | {"threads": 2}))
    other = few(lesson.stack(), seed=1, **options)
    assert [r.error for r in one.rows] == [r.error for r in two.rows]
    assert [r.error for r in one.rows] != [r.error for r in other.rows]


def test_best_is_the_cheapest_that_is_good_enough():
    result = few(lesson.spring(), starts=1)
    good = [r for r in result.rows if result.error(r) <= 1e-3]
    assert result.best(1e-3) == min(good, key=lambda r: r.cost).settings
    assert isinstance(result.best(), sc.Settings)
    with pytest.raises(ValueError, match="the smallest in this trade"):
        result.best(1e-30)


def test_json_holds_the_table():
    result = few(lesson.spring(), starts=1, horizon=0.4)
    data = json.loads(result.to_json())
    assert len(data["rows"]) == len(result.rows)
    assert data["reference"]["error"] == result.reference.error
    assert data["rows"][0]["error"] == result.table[0]["error"]
    assert sc.Settings(**data["settings"]) == result.shipped.settings
    assert sum(row["shipped"] for row in data["rows"]) == 1
    assert data["units"]["error"] == "m" and len(data["sentences"]) >= 2


def test_a_trade_is_named_by_what_it_is_of_and_pickles():
    result = sc.trade("lesson:spring", starts=1, horizon=0.08, precisions=["f64"], progress=False)
    assert "spring" in repr(result) and result.name == "spring"
    copy = pickle.loads(pickle.dumps(result))
    assert copy.to_json() == result.to_json()
    with pytest.raises(FileNotFoundError, match="no such file"):
        sc.trade("no_such.xml")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"horizon": 0.0}, "horizon"),
        ({"horizon": float("nan")}, "horizon"),
        ({"horizon": "1 foot"}, "horizon = '1 foot': must be a finite number of seconds"),
        ({"control_dt": 1e3}, "control_dt = 1000: must be at most the horizon"),
        ({"starts": 0}, "starts = 0: must be a whole number >= 1"),
        ({"starts": 1.5}, "starts = 1.5: must be a whole number >= 1"),
        ({"seed": -1}, "seed = -1: must be a whole number >= 0"),
        ({"threads": 0}, "threads = 0: must be a whole number >= 1"),
        ({"threads": "2"}, "threads = '2': must be a whole number >= 1"),
        ({"integrators": "rk4"}, "integrators = 'rk4': must be a list"),
        ({"dts": 0.01}, "dts = 0.01: must be a list"),
        ({"dts": [0.0]}, "dts"),
        ({"dts": [0.003], "control_dt": 0.01}, "must divide"),
        ({"control_dt": 0.015}, "must divide"),
        ({"key": "stat"}, 'no key is named "stat"'),
        ({"ctrl": [[1.0, 2.0]]}, r"ctrl has shape \(1, 2\)"),
        ({"ctrl": [[1.0]], "control": lambda t, s: [0.0]}, "both given"),
        ({"solvers": ["newton"]}, "pgs"),
        ({"integrators": ["rk5"]}, "rk5"),
        ({"search": "frugal", "dts": [0.01]}, "must be 'grid' or None where dts is given"),
        ({"search": "clever"}, "search = 'clever'"),
        ({"by": "price"}, "by = 'price'"),
        ({"accuracies": [-1.0]}, "accuracies"),
        *(
            ({"budget": budget}, "budget")
            for budget in ("20 us", "-1us/s", 0, "0x", "1.2.3us/s", float("nan"), [1])
        ),
        *(
            ({"error": error}, r"error = .*: must be a length > 0")
            for error in ("1 foot", 0, -1.0, "", "1mm/s", float("inf"), [1], "-1mm")
        ),
    ],
)
def test_bad_arguments_are_refused(options, message):
    scene = pushed(law="lesson")
    with pytest.raises(ValueError, match=message):
        few(scene, **options)


def test_nothing_to_move_is_an_error():
    scene = sc.Scene()
    scene.add_geom("world", "plane", name="floor")
    with pytest.raises(ValueError, match=r"nothing .* can move|joint"):
        few(scene)


def test_the_picture_is_drawn(tmp_path, ball):
    figure = ball.plot(tmp_path / "trade.png")
    assert (tmp_path / "trade.png").read_bytes().startswith(b"\x89PNG")
    axes = figure.axes[0]
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert "ball" in axes.get_title(loc="left")


def test_a_run_that_is_nowhere_near_is_a_failure_with_its_reason():
    # Explicit Euler on a stiff spring: finite, and further away than any scene is large.
    scene = lesson.spring(k=1e6, dt=1e-3, integrator="rk4")
    result = few(scene, dts=[1e-3, 1e-4], integrators=["explicit"], starts=2, horizon=0.1)
    bad = by(result, integrator="explicit", dt=1e-3, sweeps=1)
    assert "m from where it began, beyond the bound" in bad.failure and bad in result.rows
    assert not result.shipped.failure


def test_the_default_horizon_is_a_whole_number_of_samples():
    # Four steps of 20 ms do not divide a second: 0.96 s are traded; if requested, with a remark.
    assert default_horizon(0.08) == pytest.approx(0.96)


def test_an_error_beyond_all_numbers_is_an_answer_and_no_exception():
    traded = sc.trade(sc.lesson.spring(), horizon=0.1, error=1e308, progress=False)
    assert traded.recommended.bound < 1e308


def test_a_recommendation_keeps_to_the_error_and_says_what_less_would_cost(ball):
    row = ball.recommended
    assert row.bound <= 0.9e-4 and row.settings == ball.best() == ball.best(1e-4)
    assert ball.proof.starts == 8 and ball.proof.missed == 0
    # Cheaper settings that were run from the same starts are worse.
    cheaper = [r for r in ball.rows if r.starts == row.starts and r.cost < row.cost]
    assert all(r.failure or r.bound > 0.9e-4 for r in cheaper)
    better = ball.next_better()
    assert better.error <= row.error / 2 and better.cost >= row.cost
    answer, proof, refused, half, *_ = ball.sentences
    assert answer.startswith("Recommended for an error of at most 100 µm: ")
    # 0 of 8: a share p of misses passes with (1 - p)^8, which is 5 % at 31.2 %.
    assert proof.startswith("None of 8 held-out starts missed it (")
    assert proof.endswith("with 95 % confidence at most 32 % of starts do.")
    assert refused.startswith("Cheaper settings that exceed 100 µm: ")
    assert half.startswith("Half that error or less comes at ")


# Scenes with contacts, in which choices fail on starts that join.
REFUSING = {
    "ball": (sc.loads(BALL), {"error": 1e-4, "starts": 4, "further": 8, "horizon": 0.32}),
    "sphere_box": (sc.loads(ZOO["sphere_box"].text), {"error": 1e-3, "further": 8, "effort": 1e9}),
    "drop": (lesson.drop(), {"error": 1e-3, "starts": 2, "further": 4}),
    "half_cheetah": ("gymnasium:half_cheetah", {"error": "10mm", "effort": 3e10}),
}


@pytest.mark.parametrize("name", REFUSING)
def test_no_row_is_better_than_in_any_start_that_it_ran_from(name, monkeypatch):
    """half_cheetah: 2.5 ms had 7.3 mm "on the frontier"; from a tenth start it has 26 mm."""
    least, score = {}, Study.score

    def kept(study, change, tracks, truth):
        trial = score(study, change, tracks, truth)
        for start, error, unsure in zip(trial.starts, trial.errors, trial.unsure, strict=True):
            known = least.setdefault(change, {})
            known[start] = max(known.get(start, 0.0), float(error - unsure))
        return trial

    monkeypatch.setattr(Study, "score", kept)
    scene, options = REFUSING[name]
    result = sc.trade(scene, by="flops", progress=False, **options)
    rows, search_starts = {row.change: row for row in result.rows}, set(result.reference.starts)
    for change, known in least.items():
        row, asked = rows[change], result.asked
        assert row.error > asked or max(known.values()) <= asked
        assert all(row.error >= known[s] * (1 - 1e-9) for s in search_starts & set(known))
        assert search_starts & set(known) <= set(row.starts)
        assert result.partial(row) == (not search_starts <= set(row.starts))
    for best in result.front:
        assert not any(r.error < best.error and r.cost < best.cost for r in result.rows)
        assert not result.partial(best)
    cheaper = {row.change for row in result.rows if row.cost < result.chosen.cost}
    assert {row.change for row in result.refused} == {c for c in cheaper if rows[c].error > asked}
    consistent(result)


def consistent(result):
    """Text, JSON, page and plot have the same errors, frontier and choice."""
    data, text = result.to_dict(), result.text(width=1000, full=True)
    front = {row.change for row in result.front}
    for row, record in zip(result.rows, data["rows"], strict=True):
        assert record["error"] == (None if row.failure else row.error)
        assert record["pareto"] == (row.change in front)
        assert record["missed"] == result.missed(row) and record["starts"] == len(row.starts)
    cells = result.tables(full=True)[0]
    for row, cell in zip(result.rows, cells, strict=True):
        mark = "≥ " * result.partial(row)
        assert cell["error"] == ("failed" if row.failure else f"{mark}{compact(row.error)}")
        assert ("*" in cell[""]) == (row.change in front)
    assert f"{metres(result.chosen.error)}" in text
    page = result.to_html()
    assert all(cell["error"] in page for cell in cells)
    drawn = [tuple(line.get_data()) for line in result.plot().axes[0].lines]
    points = {(float(x[0]), float(y[0])) for x, y in drawn if len(x) == 1}
    assert {(row.cost, row.error) for row in result.rows if row.error < result.size} <= points
    line = next((x, y) for x, y in drawn if len(x) == len(result.front))
    assert [*zip(*line, strict=True)] == [(row.cost, row.error) for row in result.front]


def test_a_proof_of_starts_of_which_none_is_known_proves_nothing(ball):
    trial = replace(ball.proof.trial, unsure=np.full(8, 1.0))
    proof = Proof.of(trial, ball.proof.error)
    assert (proof.missed, proof.unclear, proof.share) == (0, 8, 1.0)
    assert proof.words.startswith(
        "It is not validated: the converged motion from 8 held-out starts"
    )


def test_untouched_starts_from_which_nothing_is_told_end_the_test(ball, monkeypatch):
    """The effort is spent after 16 of 32; before, the 16 others counted as misses."""
    first = replace(ball.proof.trial, unsure=np.zeros(8))
    parts = iter([first, first, replace(first, unsure=np.full(8, 1.0))])
    monkeypatch.setattr(search, "by_eight", lambda *_: parts)
    study = SimpleNamespace(effort=1.0, fresh=range)
    proof = search.proven(study, first.change, ball.proof.error, 32)
    assert (proof.starts, proof.unclear) == (16, 0)


@pytest.mark.parametrize(("spent", "allowed"), [(0.1, 0.5), (0.72, 0.92), (0.95, 1.0)])
def test_the_search_has_its_share_whatever_the_converged_motion_took(spent, allowed):
    """A humanoid's took 0.72 of the effort: nothing but the shipped settings was tried."""
    study = SimpleNamespace(effort=1.0, spent=spent)
    search.Search.allow(SimpleNamespace(study=study), 0.5, since=0.3)
    assert study.allowed == pytest.approx(allowed)


@pytest.mark.parametrize("fixed", [False, True])
def test_under_a_deadline_steps_within_an_accuracy_begin_one_start_after_the_other(fixed):
    """From others they took 11 s where the first took 0.1 s, and no answer was left."""
    study = SimpleNamespace(price=lambda *_: 1.0, lasts=lambda cost: cost)
    own = SimpleNamespace(study=study, way=SimpleNamespace(fixed=fixed), at=lambda rung: rung)
    own._first, own._growing = lambda *_: 1, lambda rung: iter([rung])
    assert Converging._in_time(own, 8, 1.0)
    with deadline.Deadline(9.0).opened():
        assert Converging._in_time(own, 8, 1.0) is fixed


def test_what_ran_for_the_converged_motion_is_an_answer_where_nothing_else_holds():
    scene = sc.loads(ZOO["sphere_box"].text)
    result = sc.trade(scene, error=1e-3, starts=4, further=0, effort=1e5, **COUNTED)
    row = result.recommended
    assert result.ended and result.shipped.error > 1e-3 >= row.error
    assert row.change != result.reference.change and len(row.starts) == 4
    assert row.error >= result.reference.error
    # If the user names the settings to try, no others are an answer.
    euler = few(scene, error=1e-5, starts=4, dts=[0.004], integrators=["euler"], effort=1e5)
    assert euler.recommended is None and {r.settings.integrator for r in euler.rows} == {"euler"}


def test_a_motion_that_is_exact_asks_for_no_accuracy_below_the_least():
    """A rotor without load: half of an error of 3e-15 m was the tolerance of adaptive steps."""
    rotor = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="j"/>
      <geom size=".1"/></body></worldbody><actuator><motor joint="j"/></actuator></mujoco>"""
    options = {"ctrl": [[0.0], [0.1]], "control_dt": 0.05, "further": 0, "progress": False}
    found = sc.trade(sc.loads(rotor), error=1e-3, **options)
    assert found.recommended.error < 1e-12


def test_the_untouched_starts_are_those_of_no_choice(ball):
    """The third set has other states than the search and the second set, and is as large."""
    starts = ball.proof.trial.starts
    others = [row for row in ball.rows if row.change != ball.recommended.change]
    assert len(starts) == 8 and not set(starts) & {s for row in others for s in row.starts}
    # Four of the search, eight of the second set.
    assert min(starts) == 12


def test_recommended_steps_can_be_written_down(ball):
    """The shipped step times or divided by a whole number; divisors of a control period."""
    ratio = 0.004 / ball.recommended.dt
    whole = max(ratio, 1 / ratio)
    assert whole == pytest.approx(round(whole), rel=1e-9)
    held = sc.trade(
        pushed(dt=0.01),
        ctrl=[[1.0], [0.0]],
        control_dt=0.05,
        error=1e-2,
        starts=2,
        further=2,
        progress=False,
        by="flops",
        horizon=1.0,
    )
    pieces = 0.05 / held.recommended.dt
    assert pieces == pytest.approx(round(pieces), rel=1e-9)


def test_the_same_seed_finds_the_same_by_threads_and_by_an_executor(ball):
    options = COUNTED | {"error": 1e-4, "starts": 4, "further": 8, "threads": 2}
    assert sc.trade(sc.loads(BALL), **options).to_json() == ball.to_json()
    with ThreadPoolExecutor(2) as pool:
        again = sc.trade(sc.loads(BALL), executor=pool, **options)
    assert again.to_json() == ball.to_json()


def test_a_budget_buys_the_least_error_it_can():
    scene = lesson.spring()
    result = sc.trade(scene, budget="2kflop/step", starts=2, by="flops", progress=False)
    row = result.recommended
    assert result.budget == pytest.approx(2000 / scene.settings.dt)
    affordable = [r for r in result.rows if not r.failure and r.work <= result.budget]
    assert row.work <= result.budget and row.error == min(r.error for r in affordable)
    assert result.best() == row.settings
    assert result.sentences[0].startswith("Recommended for a cost of at most 200 kflop per ")


def test_what_cannot_be_verified_is_said():
    result = sc.trade(lesson.drop(), error=1e-12, starts=2, further=2, effort=1e5, **COUNTED)
    assert result.recommended is None
    known = "1 pm cannot be verified: the uncertainty of the converged motion is "
    assert result.sentences[0].startswith(known) and result.reference.error > 1e-12
    # It names an error that can be verified instead, and the settings for it.
    assert result.verified >= result.reference.error
    if result.nearest is not None:
        said = f"Recommended for an error of at most {metres(result.verified)}: "
        assert result.sentences[1].startswith(said)
        assert result.error(result.nearest) <= result.verified
    assert result.to_dict()["recommended"] is None
    with pytest.raises(ValueError, match="the smallest in this trade"):
        result.best()


@pytest.mark.parametrize("lack", ["starts", "proof", "error", ""])
def test_a_choice_that_lacks_starts_or_validation_is_preliminary(ball, lack):
    """An <option> to paste is printed only for a request that is met."""
    result = copy.copy(ball)
    result.engine, result.beside = "mujoco", None
    assert result.chosen.change.settings
    if lack == "starts":
        result.chosen = result.chosen.part(result.chosen.starts[:2])
        result.proof = None
    elif lack == "proof":
        result.proof = None
    elif lack == "error":
        result.target = result.chosen.error / 2
    answer = list(result._answer())
    assert answer[0].startswith("Best so far" if lack in ("starts", "proof") else "Recommended")
    pasted = any(sentence.startswith("In the file: <option") for sentence in answer)
    assert pasted == (lack in ("proof", ""))


def test_an_error_that_the_choice_exceeds_is_not_said_to_be_kept(ball):
    worse, lost = copy.copy(ball), copy.copy(ball)
    worse.chosen = max((row for row in ball.rows if not row.failure), key=lambda row: row.error)
    assert worse.chosen.error > 1e-4
    assert next(worse._answer()).startswith("Recommended for an error of at most 100 µm from 0 of ")
    worse.rows = [row for row in ball.rows if row.error > 1e-4]
    assert next(worse._answer()).startswith("No setting tried has an error of at most 100 µm in")
    # A truth that became finer since shows it: settings that hold are chosen (a G1 on a board).
    study = SimpleNamespace(schedule=ball.schedule, lasts=lambda starts: 1.0)
    finer = SimpleNamespace(truth=ball.reference, study=study, moved=1.0, ended=False)
    finer.trials, finer.whole = {row.change: row for row in ball.rows}, ball.whole
    finer.row = lambda change, error: finer.trials[change]
    worse.take(finer)
    assert worse.chosen.error <= 1e-4 and worse.chosen.cost <= ball.chosen.cost
    # If time ended the search, settings that ran from some of the starts are an answer.
    some = {row.change: row.part((0,)) for row in ball.whole if row.error <= 1e-4}
    finer.trials, worse.chosen = {ball.shipped.change: ball.shipped} | some, None
    finer.whole = [ball.shipped]
    worse.take(finer)
    assert worse.chosen.starts == (0,) and ball.shipped.error > 1e-4
    lost.unsure, lost.proof, lost.chosen = np.inf, None, ball.chosen.part((0,))
    assert "held-out starts, and may miss the error from others." in " ".join(lost._answer())
    said = "100 µm cannot be verified: from some start no run converges."
    assert next(lost._answer()).startswith(said) and compact(np.inf) == "inf"


def test_what_finer_runs_of_the_search_have_shown_to_be_unknown_is_said(ball):
    """A robot that falls: uncertainty 309 µm at the start of the search, 1.3 mm at its end."""
    found, surer = copy.copy(ball), copy.copy(ball)
    found.reference, surer.unsure = replace(ball.reference, unsure=np.full(8, 1.3e-3)), 2e-4
    assert "cannot be verified: the uncertainty of the converged motion is 1.3 mm" in next(
        found._answer()
    )
    assert "cannot be verified: the uncertainty of the converged motion was 200 µm" in next(
        surer._answer()
    )
    # The data from other starts suffice for the choice.
    found.reference = replace(ball.reference, unsure=np.array([1e-6] * 7 + [1.3e-3]))
    assert "100 µm cannot be verified from 1 of 8 starts: the unc" in next(found._answer())


def test_why_settings_that_seem_better_are_not_chosen_is_said(ball):
    said = "Cheaper settings within the error are above 90 µm, or were not tested on other starts."
    cheaper = [row for row in ball.whole if row.cost < ball.chosen.cost]
    within = [row for row in cheaper if row.error <= 1e-4]
    assert (said in ball.tables(True)[0].legend) == bool(within)
    assert all(row.error > 0.9e-4 for row in within)
    other = copy.copy(ball)
    cost = 2 * max(row.cost for row in ball.rows)
    other.chosen = replace(ball.chosen, cost=cost)
    assert said in other.tables(True)[0].legend


def test_a_start_from_which_no_run_converges_has_no_error_in_kilometres(ball):
    found, far = copy.copy(ball), np.array([0.01] * 7 + [np.inf])
    found.chosen = found.proof = None
    found.shipped = replace(ball.shipped, starts=range(8), errors=far, unsure=far, largest=far)
    found.rows = [found.shipped]
    found.reference = replace(ball.reference, unsure=far)
    said = " ".join(found.text().split())
    assert "from start 7 no run converges" in said and "10 mm in the median" in said
    assert "from some start no run converges" in said and "inf km" not in said


def test_an_answer_counts_errors_only_as_long_as_motions_can_be_predicted():
    """A double pendulum from high up: the first sentence has the time."""
    scene = sc.Scene(gravity=(0, 0, -G), name="double pendulum")
    upper = scene.add_body("upper", mass=1.0, ipos=(0, 0, -1), inertia=(1e-9, 1e-9, 1e-9))
    lower = scene.add_body("lower", upper, pos=(0, 0, -1), mass=1.0, ipos=(0, 0, -1))
    lower.inertia = upper.inertia
    for body in (upper, lower):
        scene.add_joint(body, "hinge", axis=(0, 1, 0))
    scene.add_key(qpos=[3.0, 0.1])
    scene.options = {"dt": 0.01, "integrator": "rk4"}
    options = {"dts": [0.005, 0.01], "integrators": ["rk4"], "starts": 2, "by": "flops"}
    result = sc.trade(scene, horizon=12.0, progress=False, **options)
    assert result.predictable < 12.0
    assert result.sentences[0].startswith("Errors count only while the motion can be predicted: ")
    assert "over what can be predicted" in " ".join(result.sentences)


def test_failures_are_rows_with_a_reason():
    scene = lesson.spring(k=1e6, dt=1e-3, integrator="rk4")
    result = sc.trade(scene, error=1e-3, starts=1, further=2, **(COUNTED | {"horizon": 0.096}))
    assert all(row.failure and row.error == np.inf for row in result.failures)
    assert result.recommended.settings.integrator == "rk4"


def test_a_recommendation_is_written_back_to_the_file(ball):
    fast = sc.loads(BALL).with_settings(ball.best(error=1e-4))
    again = sc.loads(fast.to_mjcf())
    assert again.settings == ball.best()


def test_ctrl_c_ends_it():
    def stop(label, done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sc.trade(lesson.drop(), starts=1, horizon=0.096, progress=stop, search="grid")


def test_a_printed_table_has_every_row_that_the_answer_names(ball):
    named = [ball.shipped, *ball.named]
    assert len(named) >= 2
    printed = ball.tables(full=False)[0].records
    cells = [(record["dt"], record["integrator"], record["error"]) for record in printed]
    for row in named:
        mine = ball.rows[[one.change for one in ball.rows].index(row.change)]
        assert (f"{row.dt * 1e3:.4g}", row.settings.integrator, compact(mine.error)) in cells


FALLING = """<mujoco model="ball"><option timestep=".002"/><worldbody>
 <geom type="plane" size="5 5 .1"/>
 <body name="ball" pos="0 0 .2"><freejoint/><geom size=".1" mass="1"/></body>
 </worldbody></mujoco>"""
LANDS = {"horizon": 0.3, "starts": 2, "further": 2, "progress": False, "by": "flops"}


def test_a_ball_that_lands_is_cheapest_within_an_accuracy():
    """No step of a fixed length is as accurate at the cost, counted in operations."""
    trade = sc.trade(sc.loads(FALLING), error="0.2mm", **LANDS)
    chosen = trade.recommended
    assert chosen.settings.accuracy is not None and trade.error(chosen) <= 2e-4
    fixed = [r for r in trade.rows if r.settings.accuracy is None and r.bound <= 2e-4]
    assert all(row.work > chosen.work for row in fixed)
    assert f"accuracy {metres(chosen.settings.accuracy)}" in str(trade)


def test_what_a_model_ships_may_keep_an_accuracy():
    model = sc.loads(FALLING).compile().with_settings(accuracy="1mm", dt=0.02)
    trade = sc.trade(model, error="1mm", **LANDS)
    assert trade.shipped.settings == model.settings
    assert trade.error(trade.shipped) < 1e-3


def test_where_steps_keep_none_no_such_row_is_tried():
    """Under a law that a step of a fixed length defines."""
    model = sc.loads(FALLING).compile().with_settings(law="rigid", solver="pgs")
    trade = sc.trade(model, error="1mm", **LANDS)
    assert all(row.settings.accuracy is None for row in trade.rows)


def test_accuracies_are_an_axis():
    trade = sc.trade(
        sc.loads(FALLING),
        dts=[0.002],
        accuracies=["10mm", 1e-3, "0.1%"],
        solvers=["newton"],
        integrators=["euler"],
        **LANDS,
    )
    kept = {row.settings.accuracy for row in trade.rows if row.settings.accuracy is not None}
    assert len(kept) == 3 and 0.01 / trade.horizon == pytest.approx(max(kept))


def test_mujoco_beside_computes_the_same_physics():
    result = sc.trade(
        "gymnasium:reacher", error="1mm", mujoco=True, starts=2, further=0, progress=False
    )
    other = result.beside
    assert '<option timestep="' in other.text() or other.chosen.change.words == "as shipped"
    assert result.parted <= result.reference.error + other.reference.error
    assert other.shipped.settings.dt == result.shipped.settings.dt
    assert any("MuJoCo computes the same physics" in said for said in result.sentences)
    assert other.chosen.error <= 1e-3
    assert {row.settings.integrator for row in other.rows} <= {
        *("euler", "rk4", "implicit", "implicitfast")
    }


FLEX = """<mujoco><option timestep="0.001"/><worldbody><geom type="plane" size="2 2 .1"/>
<flexcomp name="jelly" type="grid" count="3 3 3" spacing=".1 .1 .1" pos="0 0 .5" radius=".01"
mass="1" dim="3"><elasticity young="1e4" poisson=".2" damping=".01"/>
<contact selfcollide="none"/></flexcomp></worldbody></mujoco>"""


def test_a_file_that_stepcore_refuses_is_traded_by_mujoco(tmp_path, capsys):
    from stepcore.cli import main

    path = tmp_path / "jelly.xml"
    path.write_text(FLEX)
    quick = ["--error", "5mm", "--horizon", "0.1", "--starts", "2", "--further", "2"]
    assert main(["trade", str(path), "--engine", "mujoco", *quick]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Recommended for an error of at most 5 mm" in said
    assert f"in MuJoCo {mujoco.__version__} alone" in said
    assert main(["trade", str(path), *quick]) != 0


def test_mujoco_cannot_be_beside_itself_nor_run_other_laws():
    with pytest.raises(ValueError, match="mujoco = True: must be False"):
        sc.trade("gymnasium:reacher", engine="mujoco", mujoco=True)
    with pytest.raises(ValueError, match="engine = 'bullet': must be one of 'stepcore', 'mujoco'"):
        sc.trade("gymnasium:reacher", engine="bullet")
    with pytest.raises(ValueError, match="law = 'lesson': MuJoCo has solref alone"):
        sc.trade(lesson.drop(), engine="mujoco")


def test_servos_that_a_motion_needs_are_made_once_for_all_its_parts(monkeypatch):
    arm = """<mujoco><worldbody><body><joint name="hip" axis="0 1 0"/>
      <geom type="capsule" size=".03" fromto="0 0 0 0 0 -.5"/></body></worldbody>
      <actuator><motor joint="hip"/></actuator></mujoco>"""
    study = Study(sc.loads(arm).compile(), Motion(kind="move", horizon=0.1, starts=4))
    made, of = [], Change.of
    monkeypatch.setattr(Change, "of", lambda *given: made.append(given) or of(*given))
    for k in range(4):
        study.run([Change(), Change(dt=0.001)], starts=[k])
    assert len([change for change, _ in made if change.servos]) == 1
