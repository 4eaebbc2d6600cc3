"""Plots: what each shows: what is on its axes and in which units, how many series, which names."""

import itertools
import math

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from measured import RESULTS

import stepcore as sc
from stepcore import lesson
from stepcore.report.plot.style import log_ticks, new_figure, write_beside

FALLING = """<mujoco><worldbody><body name="b"><freejoint name="root"/><geom size=".1"/>
<body><joint name="knee"/><geom size=".1" pos="0 0 1"/></body></body></worldbody></mujoco>"""


@pytest.fixture
def results():
    return lambda kind: RESULTS[kind]()


def labels(axes):
    return axes.get_xlabel(), axes.get_ylabel()


def names(figure):
    """The entries of the figure's legends."""
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def ticks(axes):
    return [text.get_text() for text in axes.get_yticklabels()]


@pytest.mark.parametrize("kind", RESULTS)
def test_every_result_draws_its_name_and_its_axes(results, tmp_path, kind):
    result = results(kind)
    figure = result.plot(tmp_path / "plot.svg")
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    titles += [figure.get_suptitle()]
    assert any(title.startswith((result.name, result.title)) for title in titles)
    assert all(any(labels(axes)) for axes in figure.axes if axes.get_visible())
    assert "<svg" in (tmp_path / "plot.svg").read_text(encoding="utf-8")
    assert kind == result.kind


def test_a_trade_shows_error_against_cost(results):
    trade = results("trade")
    figure = trade.plot()
    (axes,) = figure.axes
    assert labels(axes) == (
        "floating-point operations per simulated second",
        "RMS position error of the worst start [m]",
    )
    assert axes.get_xscale() == axes.get_yscale() == "log"
    points = {tuple(map(float, line.get_xydata()[0])) for line in axes.lines}
    ran = [row for row in trade.rows if not row.failure]
    assert len(ran) >= 4
    assert {(float(row.cost), float(row.error)) for row in ran} <= points
    assert {"rk4", "semi-implicit", "pgs", "best for its cost"} <= set(names(figure))
    texts = [text.get_text() for text in axes.texts]
    # The shipped integrator is named: two of them can lie on one another.
    assert any(text.startswith("as shipped\nsemi-implicit, pgs,\ndt ") for text in texts)
    assert any(text.startswith("recommended\nrk4") for text in texts)
    # The target's line lies within the axes; its text in the legend covers nothing.
    assert "target 1 mm" in names(figure)
    low, high = axes.get_ylim()
    assert low < trade.target < high


def test_an_ablation_shows_a_bar_for_each_feature(results):
    ablation = results("ablation")
    figure = ablation.plot()
    work, error = figure.axes
    assert work.get_xlabel() == "work saved [% of operations]"
    assert error.get_xlabel() == "RMS position error added [m]"
    assert error.get_xscale() == "log"
    features = [row for row in ablation.rows if not row.trial.failure]
    assert len(ticks(work)) == len(features) + 1
    assert {row.removal.label[:45] for row in features} == {name[:45] for name in ticks(work)[1:]}
    assert sorted(names(figure)) == sorted(
        ["not needed within 1 mm", "kept", "the smallest model", "tolerance 1 mm"]
    )
    widths = sorted(bar.get_width() for bar in work.patches)
    saved = sorted(100 * ablation.saved(row) for row in [ablation.best, *features])
    assert widths == pytest.approx([share for share in saved if share > 0])


def test_a_convergence_shows_error_against_work(results):
    convergence = results("convergence")
    (axes,) = convergence.plot().axes
    assert labels(axes)[1] == "RMS position error [m]"
    steps, sweeps = axes.lines[:2]
    assert sorted(steps.get_xdata()) == sorted(trial.work for trial in convergence.dts)
    assert len(sweeps.get_xdata()) == 1 + len(convergence.sweeps)


def test_a_predictability_shows_a_line_for_each_start(results):
    found = results("predictability")
    figure = found.plot()
    (axes,) = figure.axes
    assert labels(axes) == ("time [s]", "growth of a perturbation")
    assert axes.get_yscale() == "log" and axes.get_xlim() == (0, found.horizon)
    starts = [line for line in axes.lines if len(line.get_xdata()) > 2]
    assert len(starts) == 3
    assert starts[0].get_ydata()[1:] == pytest.approx(found.growth.factor[0])
    unpredictable = "not predictable\nabove 1000"
    assert names(figure) == ["start 0, the keyframe", "other starts", unpredictable]
    # No text lies over a line.
    assert not axes.texts


def test_a_stability_map_shows_a_panel_for_each_setting(results):
    found = results("stability")
    figure = found.plot()
    assert [axes.get_title(loc="left").split("\n")[0] for axes in figure.axes] == [
        panel.label for panel in found.panels
    ]
    assert figure.axes[0].get_ylabel() == "dt [s]"
    assert all(axes.get_xlabel() == found.path for axes in figure.axes)
    assert names(figure) == ["accurate", "inaccurate", "exploded"]
    for axes, panel in zip(figure.axes, found.panels, strict=True):
        (mesh,) = axes.collections
        shown = mesh.get_array().reshape(2, 2).T.ravel()
        states = ["accurate", "inaccurate", "exploded"]
        assert [states[int(code)] for code in shown] == [cell.state for cell in panel.cells]
        # By theory, white under black.
        assert len(axes.lines) == 2


def test_a_plan_shows_the_cost_of_each_entry(results):
    plan = results("plan")
    figure = plan.plot()
    (axes,) = figure.axes
    assert axes.get_xlabel() == "floating-point operations per step"
    costs = {entry.name: entry.flops for entry in plan.used if entry.flops is not None}
    assert set(ticks(axes)) == set(costs)
    drawn = [bar.get_width() for bar in axes.patches]
    assert drawn == pytest.approx([cost for cost in costs.values() if cost > 0])
    assert set(names(figure)) <= {"place", "detect", "solve", "commit"} and names(figure)
    timed = sc.plan(lesson.drop(), time=True).plot()
    assert timed.axes[0].get_xlabel() == "time per step [µs]"


def test_a_diagnosis_shows_the_largest_stable_dt_of_each_integrator(results):
    diagnosis = results("diagnosis")
    figure = diagnosis.plot()
    (axes,) = figure.axes
    assert axes.get_xlabel() == "largest stable dt" and axes.get_xscale() == "log"
    assert ticks(axes)[0] == diagnosis.own.integrator and set(ticks(axes)) == set(diagnosis.limits)
    assert names(figure)[-1] == "no limit up to here" and names(figure)[-2].startswith("dt ")
    left = axes.get_xlim()[0]
    ends = {round(left + bar.get_width(), 9) for bar in axes.patches}
    finite = [limit.dt for limit in diagnosis.limits.values() if 0 < limit.dt < math.inf]
    assert finite and {round(dt, 9) for dt in finite} <= ends


def test_a_postmortem_shows_energy_and_what_each_element_injected(results):
    again = results("postmortem")
    figure = again.plot()
    above, below = figure.axes
    assert above.get_ylabel() == "kinetic and spring\nenergy [J]"
    assert labels(below) == ("step", "energy injected per step,\npart of that energy")
    assert names(figure)[0] == "spring of joint spring (100 % of the growth)"
    (energy,) = above.lines
    assert energy.get_ydata()[-1] == pytest.approx(math.log10(again.energy[-1]))


def test_a_run_shows_its_energies_and_its_overlap(tmp_path):
    sim = sc.Sim(lesson.drop())
    sim.reset("start")
    (alone,) = sim.run(0.1, record=("energy", "overlap")).plot().axes
    assert alone.get_ylabel() == "energy [J]", "nothing overlaps yet"
    run = sim.run(0.5, record=("energy", "overlap"))
    assert run["overlap"].max() > 0
    above, below = run.plot(tmp_path / "run.png").axes
    assert above.get_ylabel() == "energy [J]"
    assert labels(below) == ("time [s]", "deepest overlap [m]")
    assert [line.get_label() for line in above.lines] == ["kinetic", "potential", "total"]
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
    both = sim.run(0.1, record=("qpos", "energy")).plot().axes
    assert [axes.get_ylabel() for axes in both] == ["position [m]", "energy [J]"]
    free = sc.Sim(sc.loads(FALLING)).run(0.1, record=("qpos", "qvel", "residual")).plot()
    assert [axes.get_ylabel() for axes in free.axes] == [
        *("position [m]", "orientation (quaternion)", "knee\nposition [rad]"),
        *("velocity [m/s]", "velocity [rad/s]", "residual [m/s]"),
    ]
    place = free.axes[0].get_legend().get_texts()
    assert [text.get_text() for text in place] == ["root.x", "root.y", "root.z"]


def test_texts_beside_marks_cover_nothing():
    """Marks on a line and at the edge: texts lie within the axes, apart, and beside the line."""
    figure = new_figure(6.0, 4.0)
    axes = figure.add_subplot()
    (front,) = axes.plot([0, 0.5, 0.6, 1], [1, 0.5, 0.45, 0], color="black")
    axes.set(xlim=(-0.1, 1.1), ylim=(-0.3, 1.2))
    marks = [((0.0, 1.0), "first\nmark"), ((0.5, 0.5), "second"), ((0.6, 0.45), "third")]
    write_beside(axes, [*marks, ((1.0, 0.0), "the last of the marks")])
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw_without_rendering()
    boxes = [text.get_window_extent(renderer) for text in axes.texts]
    assert len(boxes) == 4
    assert all(axes.bbox.contains(*corner) for b in boxes for corner in (b.min, b.max))
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    path = front.get_path().transformed(front.get_transform())
    assert not any(path.intersects_bbox(b, filled=False) for b in boxes)


def test_no_row_of_bars_is_cut(results):
    for kind in ("ablation", "plan", "tuning"):
        axes = results(kind).plot().axes[0]
        low, high = sorted(axes.get_ylim())
        assert all(low + 0.3 < place < high - 0.3 for place in axes.get_yticks())


def test_a_page_holds_the_plot_and_the_tables(results, tmp_path):
    for kind in ("predictability", "postmortem"):
        page = results(kind).to_html(tmp_path / "page.html")
        assert "data:image/svg+xml;base64," in page and "<table" in page and "<pre" not in page
        assert (tmp_path / "page.html").read_text(encoding="utf-8") == page


@pytest.mark.parametrize(("low", "high"), [(1.1e-3, 1.4e-3), (2e-3, 9e-3), (1e-9, 1.0), (0.3, 80)])
def test_the_ticks_of_a_log_axis_do_not_collide(low, high):
    """From hardly any range to nine decades: labels are apart by more than they are wide."""
    figure = new_figure(4.0, 3.0)
    axes = figure.add_subplot()
    axes.plot([low, high], [low, high])
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    log_ticks(axes.xaxis)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    inside = [
        t for t in axes.get_xticklabels() if t.get_text() and low <= t.get_position()[0] <= high
    ]
    boxes = [text.get_window_extent() for text in inside]
    assert len(boxes) >= 2
    assert all(a.x1 < b.x0 for a, b in itertools.pairwise(boxes))
    assert not any(text.get_text() for text in axes.get_xticklabels(minor=True))


def test_a_notebook_shows_a_plot():
    figure = sc.plan(lesson.drop()).plot()
    assert figure._repr_svg_().startswith("<?xml") and "</svg>" in figure._repr_svg_()
