"""The frugal search and its recommendation: against brute force, unseen starts and MuJoCo.

Costs are counted operations: what is found is the same on every machine.
"""

import dataclasses
import json
import re
import sys
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from trade_cases import CASES, Judge, best

import stepcore as sc
from stepcore import lesson
from stepcore.measure.trade.methods import digits
from stepcore.measure.trade.recommend import HardestStarts
from stepcore.measure.trade.rows import Frontier, Further, TradeRow
from stepcore.measure.trade.words import Words, failed
from stepcore.report.units import compact, metres

BALL = """<mujoco model="ball"><option timestep="0.004"/><worldbody>
<geom type="plane" size="5 5 .1"/><body pos="0 0 .16"><joint type="slide" axis="0 0 1"/>
<geom size=".1" mass="1"/></body></worldbody></mujoco>"""
COUNTED = {"by": "flops", "progress": False, "horizon": 0.32, "threads": 1}


@pytest.fixture(scope="module")
def ball():
    return sc.trade(sc.loads(BALL), error=1e-4, starts=4, further=8, **COUNTED)


def check(name):
    """The recommendation holds on unseen starts, and costs what the best by brute force does.

    Both are held to the error on 24 starts.
    """
    case = next(case for case in CASES if case.name == name)
    options = {"error": case.error, "horizon": case.horizon, "by": "flops", "progress": False}
    result = sc.trade(case.make(), **options)
    row = result.recommended
    assert row is not None and row.further.held == row.further.starts == 32
    finest = min(result.reference.settings.dt, row.settings.dt / 8)
    judge = Judge(case, 24, 987, finest)
    wrong = [judge.wrong(row.settings, k) for k in range(24)]
    assert np.mean(np.array(wrong) <= case.error) >= 0.9, wrong
    rows = max(path.rows for path in result.reference.runs)
    cheapest = best(judge, case.error, rows)
    assert cheapest is not None
    assert judge.price(row.settings) <= 1.3 * cheapest[1], (row.settings, cheapest)


@pytest.mark.parametrize("name", ["stiff spring"])
def test_a_recommendation_holds_and_is_within_a_third_of_the_best(name):
    check(name)


# Where a recommendation is known to fall short on these 24 starts, and why. Everything is counted,
# so the long run finds the same every time.
SHORT = {
    "slider, pyramid": "costs 1.64 times the best by brute force",
    "servo arm": "costs 1.39 times the best by brute force: harder starts, margin, round step",
}


def known(name):
    """The name of a case; where it is known to fall short, an xfail that must fail."""
    short = pytest.mark.xfail(strict=True, raises=AssertionError, reason=SHORT.get(name))
    return pytest.param(name, marks=[short] if name in SHORT else [])


@pytest.mark.long
@pytest.mark.parametrize("name", [known(case.name) for case in CASES])
def test_every_recommendation_holds_and_is_within_a_third_of_the_best(name):
    check(name)


def test_it_keeps_to_the_error_and_says_what_less_would_cost(ball):
    row = ball.recommended
    assert ball.error(row) <= 1e-4 and row.settings == ball.best() == ball.best(1e-4)
    assert row.further.starts == row.further.held == 8
    # What is cheaper and was run from all starts is worse, or a little cheaper and not as round.
    cheaper = [r for r in ball.rows if r.errors and r.flops < row.flops]
    good = [r for r in cheaper if ball.error(r) <= 0.9e-4]
    assert all(1.15 * r.flops >= row.flops and digits(r.settings.dt) > 3 for r in good)
    better = ball.next_better()
    searched = ball.frontier.searched
    assert searched(better) <= searched(row) / 2 and better.flops >= row.flops
    answer, *rest = ball.sentences
    assert answer.startswith("Recommended for an error of at most 100 µm: ")
    # 12 starts passed: of 13 alike the next is the worst once.
    share = "92.3 % of other starts are expected to stay within it."
    assert answer.endswith(f"Confirmed on 8 further starts; {share}")
    (next_better,) = [said for said in rest if "alf " in said[:90]]
    there = ball.error(row) > searched(row)
    begins = f"In the {ball.starts} starts of the search its error is "
    assert next_better.startswith(begins if there else "Half that error or less comes at ")


def test_the_next_better_is_better_than_what_was_found():
    """The longest step tried of rk4 is ten times better than asked for: a half of that is told."""
    scene = sc.Scene(gravity=(0.0, 0.0, 0.0))
    scene.settings = sc.Settings(dt=0.002, integrator="semi-implicit")
    ball = scene.add_body("ball")
    scene.add_joint(ball, "slide", axis=(1.0, 0.0, 0.0), stiffness=100.0)
    scene.add_geom(ball, "sphere", 0.1, mass=1.0)
    scene.add_key(qpos=[0.3])
    options = {"error": 1e-3, "by": "flops", "starts": 2, "further": 0, "progress": False}
    result = sc.trade(scene, horizon=1.0, **options)
    best, better = result.recommended, result.next_better()
    assert best.settings.integrator == "rk4" and result.error(best) < 2e-4
    # Fourth order: twice the work, a sixteenth of the error.
    assert better.settings.integrator == "rk4"
    assert better.flops == pytest.approx(2 * best.flops, rel=0.02)
    assert 12 < result.error(best) / result.error(better) < 20


def test_half_of_an_error_is_compared_in_the_same_starts(ball):
    """A row that ran from the search's starts alone does not halve what further starts showed."""
    row = ball.recommended
    harder = dataclasses.replace(row.further, high=10 * row.errors.high)
    frontier = ball.frontier.updated(dataclasses.replace(row, further=harder))
    (worse,) = [r for r in frontier.rows if r.settings == row.settings]
    assert frontier.error(worse) == 10 * row.errors.high
    assert frontier.halving(worse).settings == ball.next_better().settings


def test_the_same_seed_finds_the_same_by_threads_and_by_an_executor(ball):
    options = COUNTED | {"error": 1e-4, "starts": 4, "further": 8, "threads": 2}
    assert sc.trade(sc.loads(BALL), **options).to_json() == ball.to_json()
    with ThreadPoolExecutor(2) as pool:
        again = sc.trade(sc.loads(BALL), executor=pool, **options)
    assert again.to_json() == ball.to_json()


def test_it_is_frugal(ball):
    data = json.loads(ball.to_json())
    assert data["asked"] == {"error": 1e-4, "budget": None, "by": "flops"}
    assert data["recommended"]["dt"] == ball.best().dt
    # Most of what was tried was dropped after a few of the twelve starts, though the search is made
    # again on the hardest eight.
    assert len(ball.rows) < ball.screened / 2 and ball.runs < 6 * ball.screened
    assert all(record["cost"] is None and record["flops"] for record in data["rows"])


def test_a_budget_buys_the_least_error_it_can():
    scene = lesson.spring()
    result = sc.trade(scene, budget="2kflop/step", starts=2, further=4, by="flops", progress=False)
    row = result.recommended
    assert result.budget == pytest.approx(2000 / scene.settings.dt)
    assert row.flops <= result.budget and row.further.starts == 4
    affordable = [r for r in result.rows if r.errors and r.flops <= result.budget]
    assert result.error(row) == min(result.error(r) for r in affordable)
    assert result.best() == row.settings
    assert result.sentences[0].startswith(
        "Recommended for at most 200 kflop per simulated second: "
    )
    assert result.sentences[0].endswith("This includes 4 further starts.")


def test_nothing_within_reach_is_said():
    result = sc.trade(lesson.drop(), error=1e-12, starts=1, further=2, effort=1e4, **COUNTED)
    assert result.recommended is None
    # The reference is not known to a picometre either, and that is what the answer says.
    known = "1 pm cannot be verified: the reference is good to "
    assert result.sentences[0].startswith(known) and result.reference.high > 1e-12
    # It says what can be verified instead, and the settings for that.
    least, verified = min(map(result.error, result.rows)), result.verified
    assert result.reference.high <= least <= 0.9 * verified < 1.1 * least
    said = f"Recommended for an error of at most {metres(verified)}, which can be verified: "
    assert result.sentences[1].startswith(said)
    assert result.error(result.nearest) <= verified and result.nearest.further.starts == 2
    assert result.to_dict()["nearest"] and result.to_dict()["recommended"] is None
    with pytest.raises(ValueError, match="the smallest in this trade"):
        result.best()
    # The target's line is that of the error that was verified, and lies within the axes.
    axes = result.plot().axes[0]
    assert axes.get_ylim()[0] < verified < axes.get_ylim()[1]


def test_settings_that_the_reference_cannot_rank_are_a_tie(ball):
    """In the worst start all three are below the reference's error; in start 0 it can tell."""
    rows = []
    for k, (here, there) in enumerate(((1e-5, 1e-4), (3e-6, 4e-4), (2e-5, 2e-4))):
        settings = ball.settings.replace(dt=1e-3 / (k + 1))
        errors = dataclasses.replace(ball.shipped.errors, each=(here, there))
        rows.append(TradeRow(settings, errors, cost=1.0 + k, row_updates=0, flops=1.0 + k))
    rows[0] = dataclasses.replace(rows[0], shipped=True)
    known = dataclasses.replace(ball.reference.known, high=1e-3, each=(1e-6, 1e-3))
    reference = dataclasses.replace(ball.reference, known=known, exact=None)
    frontier = Frontier.of(rows, 1e-3, 1e-2, "flops")
    words = Words(frontier, reference, 1e-4, None, None, None, None, 1.0)
    said = list(words.answer())
    assert said[0].startswith("100 µm cannot be verified: the reference is good to 1 mm")
    assert said[1].startswith("In the 1 of 2 starts whose reference is good enough, ")
    assert "dt 1 ms keeps to it, for 1 flop" in said[1]
    assert said[2].startswith("3 settings are as accurate as the reference can tell, the cheapest")
    assert said[3].startswith("In the 1 of 2 starts whose reference is ten times as good, the most")
    assert "dt 500 µs, with an error of 3 µm." in said[3]
    assert not any("most accurate one is" in line for line in said[:3])


def test_failures_are_rows_with_a_reason():
    scene = lesson.spring(k=1e6, dt=1e-3, integrator="rk4")
    result = sc.trade(scene, error=1e-3, starts=1, further=2, **(COUNTED | {"horizon": 0.096}))
    assert result.failures and all(row.failure and row.errors is None for row in result.failures)
    assert {row.settings.integrator for row in result.failures} >= {"explicit"}
    assert result.recommended.settings.integrator == "rk4"


def test_a_recommendation_is_written_back_to_the_file(ball):
    fast = sc.loads(BALL).with_settings(ball.best(error=1e-4))
    again = sc.loads(fast.to_mjcf())
    assert again.settings == ball.best()


def test_mujoco_runs_the_same_motion():
    result = sc.trade(sc.loads(BALL), mujoco=True, starts=2, **(COUNTED | {"by": "time"}))
    check = result.mujoco[0].check
    assert check.agrees and check.apart < 1e-5
    # Where both engines have the same settings they are equally wrong.
    for point in result.mujoco:
        for row in result.rows:
            s = row.settings
            same = (s.dt, s.integrator, s.solver) == (point.dt, point.integrator, point.solver)
            if same and s == result.shipped.settings.replace(dt=s.dt, integrator=s.integrator):
                assert point.error == pytest.approx(row.errors.high, rel=1e-3)
    assert {p.integrator for p in result.mujoco} == {"euler", "rk4", "implicitfast"}
    assert all(p.cost > 0 for p in result.mujoco)
    assert any("computes the same physics" in sentence for sentence in result.sentences)
    assert len(json.loads(result.to_json())["mujoco"]) == len(result.mujoco)


def test_without_mujoco_the_way_out_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match="pip install mujoco"):
        sc.trade(sc.loads(BALL), mujoco=True)


def test_a_law_that_mujoco_does_not_have_is_refused():
    with pytest.raises(ValueError, match="law is 'lesson', which MuJoCo does not have"):
        sc.trade(lesson.drop(), mujoco=True)


def test_ctrl_c_ends_it():
    def stop(label, done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sc.trade(lesson.drop(), error=1e-3, starts=1, horizon=0.096, progress=stop)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("20 us", "budget = '20 us': must be > 0, with its unit: \"20us/step\""),
        ("-1us/s", "budget"),
        (0, "budget = 0"),
        ("0x", "budget"),
        ("1.2.3us/s", "budget"),
        (float("nan"), "budget"),
        ([1], "budget"),
    ],
)
def test_a_budget_that_is_none_is_refused(value, words):
    with pytest.raises(ValueError, match=words):
        sc.trade(lesson.drop(), budget=value)


@pytest.mark.parametrize("value", ["1 foot", 0, -1.0, "", "1mm/s", float("inf"), [1], "-1mm"])
def test_an_error_that_is_none_is_refused(value):
    with pytest.raises(ValueError, match=r"error = .*: must be a length > 0"):
        sc.trade(lesson.drop(), error=value)


def test_a_search_with_axes_is_refused():
    with pytest.raises(ValueError, match="must be 'grid' or None where dts is given"):
        sc.trade(lesson.drop(), search="frugal", dts=[0.001])
    with pytest.raises(ValueError, match="search = 'clever'"):
        sc.trade(lesson.drop(), search="clever")
    with pytest.raises(ValueError, match="by = 'price'"):
        sc.trade(lesson.drop(), by="price")


def nearly(ball, error, held):
    """The trade with a row of half the price that has this error, and holds on so many of 8."""
    row = ball.recommended
    each = (1e-5, 2e-5, 3e-5, error)
    errors = dataclasses.replace(row.errors, each=each)
    high = error if held == 8 else 2e-4
    further = Further(8, held, high)
    settings = row.settings.replace(dt=row.settings.dt * 1.01)
    cheap = dataclasses.replace(
        row, settings=settings, errors=errors, flops=row.flops / 2, further=further, shipped=False
    )
    return dataclasses.replace(ball, frontier=ball.frontier.updated(cheap))


def beside_shipped(trade, row):
    ratio = trade.frontier.price(row) / trade.frontier.price(trade.shipped)
    return f"{ratio:.2f}× the cost of the shipped settings"


def test_every_multiple_of_an_answer_is_of_the_shipped_cost(ball):
    """Law: what costs more than what is recommended has the larger multiple."""
    result = nearly(ball, 5e-5, 7)
    rows = result.recommended, result.passed_over, result.next_better()
    said = re.findall(r"[\d.]+×[^:.]*", " ".join(result.sentences))
    assert said == [beside_shipped(result, row) for row in rows]


def test_a_cheaper_setting_within_the_target_is_explained(ball):
    """At 95 µm it is within the 100 µm asked for, but not within the 90 µm that are kept to."""
    result = nearly(ball, 9.5e-5, 8)
    (said,) = [said for said in result.sentences if "but a recommendation keeps to" in said]
    assert said.startswith(f"Cheaper settings ({beside_shipped(result, result.passed_over)}: ")
    assert ") stayed within 100 µm too, with 95 µm; " in said
    assert said.endswith("keeps to 90 µm, because starts that were not run may be worse.")
    assert result.misses(result.passed_over) == (0, 12) and result.kept == pytest.approx(9e-5)
    (legend,) = result.plot().legends
    assert "cheaper, but beyond\nthe 90 µm kept to" in [t.get_text() for t in legend.get_texts()]


def test_a_setting_that_misses_on_one_start_is_named_with_its_price(ball):
    result = nearly(ball, 5e-5, 7)
    (said,) = [said for said in result.sentences if "with other starts the answer" in said]
    assert said.startswith(f"Cheaper settings ({beside_shipped(result, result.passed_over)}: ")
    assert ") exceeded 100 µm on 1 of 12 starts, by up to " in said
    # Two of twelve are too many to speak of it.
    assert nearly(ball, 5e-5, 6).passed_over is None


def test_the_hardest_of_all_starts_come_first(ball):
    """A start is as hard as the worst of the tested settings found it, whichever set it is of."""
    confirm = SimpleNamespace(hardness=lambda: np.array([3e-5, 9e-5]))
    schedule = SimpleNamespace(starts=[0, 1, 2])
    cache = SimpleNamespace(experiment=SimpleNamespace(schedule=schedule))
    row = ball.recommended
    rows = [
        dataclasses.replace(row, errors=dataclasses.replace(row.errors, each=each))
        for each in ((1e-5, 8e-5, 2e-5), (4e-5, 1e-5, 1e-5))
    ]
    search = HardestStarts(cache, confirm, None, None, 1e-4)
    assert search.order(SimpleNamespace(rows=rows)).tolist() == [4, 1, 0, 3, 2]


def test_a_print_is_a_screen_and_a_failure_is_a_line(ball):
    text = ball.text(width=100)
    assert len(ball.rows) > 16 and len(text.splitlines()) < 50
    assert len(ball.text(width=100, full=True).splitlines()) > len(ball.rows)
    long = "start 0: diverged at 0.1 s: it is not finite. The cause is spring `a`. It grows."
    rows = [dataclasses.replace(ball.rows[0], failure=long, errors=None)]
    (note,) = failed(rows)
    assert note.endswith("(start 0: diverged at 0.1 s: it is not finite)")


def test_a_printed_table_has_every_row_that_the_answer_names(ball):
    for trade in (ball, dataclasses.replace(ball, target=None, chosen=None)):
        named = [row for row in (trade.recommended, trade.shipped, *trade.offered) if row]
        assert len(named) >= 2
        printed = trade.tables(full=False)[0].records
        cells = [(record["dt"], record["integrator"], record["error"]) for record in printed]
        for row in named:
            s = row.settings
            assert (
                f"{s.dt * 1e3:.4g}",
                s.integrator,
                compact(trade.frontier.searched(row)),
            ) in cells


def test_what_holds_on_nearly_all_starts_is_said_to_do_so(ball):
    row = ball.recommended
    further = Further(32, 31, 1.5e-4)
    rare = dataclasses.replace(row, further=further)
    result = dataclasses.replace(ball, frontier=ball.frontier.updated(rare), chosen=rare)
    answer = result.sentences[0]
    said = "Recommended for an error of at most 100 µm on 35 of 36 starts (no setting keeps to it"
    assert answer.startswith(said)
    assert "The RMS position error is 150 µm in the worst start" in answer
    assert answer.endswith("The error stayed within it on 31 of 32 further starts.")


def test_time_steps_that_the_reference_cannot_judge_are_not_searched_and_that_is_said():
    text = BALL.replace('timestep="0.004"', 'timestep="0.004" density="1.2"')
    dear, cheap = (
        sc.trade(sc.loads(text), starts=2, effort=effort, **COUNTED) for effort in (6e6, 0.0)
    )
    assert not [note for note in dear.notes if "was searched" in note]
    (note,) = [note for note in cheap.notes if "was searched" in note]
    shortest = 2 * cheap.reference.settings.dt
    assert note.startswith("no time step below 2 ms was searched") and shortest == 0.002
    tried = [row.settings.dt for row in cheap.rows if not row.failure]
    assert min(tried) >= shortest * (1 - 1e-9)
