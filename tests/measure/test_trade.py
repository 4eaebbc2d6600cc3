"""The trade's figures against closed forms, and its book-keeping. No time is judged here."""

import dataclasses
import json
import pickle

import numpy as np
import pytest
from small import by

import stepcore as sc
from stepcore import lesson
from stepcore.experiment.schedule import default_horizon
from stepcore.measure.trade.rows import Frontier
from stepcore.measure.trade.words import about_reference

G = 9.81


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


def test_free_fall_is_wrong_by_half_g_dt_t():
    result = few(falling(), integrators=["semi-implicit"], starts=3, horizon=1.0)
    assert result.reference.error < 1e-12
    for row in result.rows:
        e, dt = row.errors, row.settings.dt
        assert e.position_max == pytest.approx(G * dt / 2, rel=1e-9)
        # Samples every dt_max: the root mean square of t over them.
        times = np.arange(1, 26) * 0.04
        rms = G * dt / 2 * np.sqrt(np.mean(times**2))
        assert e.position == pytest.approx(rms, rel=1e-9)
        assert e.gained == pytest.approx(0, abs=1e-10)
        # It falls too far by as much as the weight did too much work: m g (g dt t / 2).
        assert e.lost == pytest.approx(2.0 * G * G * dt / 2, rel=1e-9)
        assert e.angle_max < 1e-12 and e.overlap == 0 and e.residual == 0


def test_the_orders_of_the_integrators_on_a_spring():
    orders = {"semi-implicit": 1, "explicit": 1, "midpoint": 2, "rk4": 4}
    dts = [0.01, 0.005, 0.0025, 0.00125]
    result = few(lesson.spring(), dts=dts, integrators=list(orders), starts=2)
    for name, order in orders.items():
        errors = [by(result, integrator=name, dt=dt).errors.position for dt in (0.005, 0.0025)]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.12)
        assert result.orders[name] == pytest.approx(order, abs=0.12)
    assert any("choice of solver has no effect" in note for note in result.notes)


def test_the_work_of_a_motor_is_not_gained_energy():
    # A constant force is held exactly: v = a t, so E - W = -a² dt t / 2 under v-first.
    options = {"ctrl": np.full((1, 1), 1.5), "starts": 1, "integrators": ["semi-implicit", "rk4"]}
    result = few(pushed(), **options)
    row = by(result, integrator="semi-implicit", dt=0.01)
    assert row.errors.lost == pytest.approx(3.0**2 * 0.01 / 2, rel=1e-9)
    assert row.errors.gained < 1e-12
    exact = by(result, integrator="rk4", dt=0.01).errors
    assert exact.position_max < 1e-12 and exact.gained < 1e-12 and exact.lost < 1e-12


def test_what_a_damper_takes_is_not_lost_energy():
    result = few(pushed(damping=2.0), ctrl=[[1.0]], starts=1, integrators=["rk4"])
    lost = [by(result, integrator="rk4", dt=dt).errors for dt in (0.01, 0.005)]
    dissipated = 0.5  # about; the balance is far below and falls with dt²
    assert max(lost[0].lost, lost[0].gained) < 1e-3 * dissipated
    ratio = max(lost[0].lost, lost[0].gained) / max(lost[1].lost, lost[1].gained)
    assert ratio == pytest.approx(4, rel=0.2)


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
    # The first has a closed form; what a function will ask for cannot be known beforehand.
    assert a.reference.exact is not None and b.reference.exact is None
    for one, other in zip(a.rows, b.rows, strict=True):
        assert one.errors.position == pytest.approx(other.errors.position, rel=1e-9)


def test_failures_stay_with_their_reason():
    # Explicit Euler grows tenfold a step here, 400 times.
    scene = lesson.spring(k=1e10, dt=1e-4, integrator="rk4")
    options = {"dts": [1e-4, 1e-5], "integrators": ["explicit", "rk4"], "starts": 1}
    result = few(scene, horizon=0.04, **options)
    bad = by(result, integrator="explicit", dt=1e-4)
    assert "start 0: diverged" in bad.failure and "spring" in bad.failure
    assert bad.errors is None and np.isnan(bad.cost) and not bad.best
    assert len(result.table) == 4
    (said,) = (note for note in result.notes if " settings fail: " in note)
    assert said.count("(start 0: diverged") == 1
    assert "explicit, pgs at dt 10 µs to 100 µs" in said
    record = result.table[result.rows.index(bad)]
    assert record["cost"] is None and record["position"] is None and record["failure"]


def test_the_reference_is_ten_times_better_than_the_table():
    result = few(lesson.drop(), starts=2, integrators=["semi-implicit"])
    reference = result.reference
    least = min(row.errors.high for row in result.rows)
    assert 10 * reference.high <= least
    assert not any("the reference error is" in note for note in result.notes)
    assert reference.settings.dt < min(row.settings.dt for row in result.rows)
    assert reference.settings.softness == result.shipped.settings.softness
    # At the table's finest step v-first is wrong by g dt t / 2 before the impact.
    assert 1e-5 < least < 1e-3


def test_a_reference_that_is_not_ten_times_better_is_noted():
    result = few(lesson.drop(), starts=2, integrators=["rk4"], effort=0.0)
    assert 10 * result.reference.high > min(row.errors.high for row in result.rows)
    assert any("the reference error is" in note for note in result.notes)
    assert all(result.error(row) >= result.reference.high for row in result.rows)


def test_errors_do_not_depend_on_threads_and_seed_decides():
    options = {"starts": 2, "integrators": ["semi-implicit"], "dts": [0.002, 0.001], "horizon": 0.2}
    options["effort"] = 1e5
    one = few(lesson.stack(), **options)
    two = few(lesson.stack(), **(options | {"threads": 2}))
    other = few(lesson.stack(), seed=1, **options)
    assert [r.errors for r in one.rows] == [r.errors for r in two.rows]
    assert [r.row_updates for r in one.rows] == [r.row_updates for r in two.rows]
    assert [r.errors for r in one.rows] != [r.errors for r in other.rows]


def test_best_is_the_cheapest_that_is_good_enough():
    result = few(lesson.spring(), starts=1)
    good = [r for r in result.rows if result.error(r) <= 1e-3]
    assert result.best(1e-3) == min(good, key=lambda r: r.cost).settings
    assert isinstance(result.best(), sc.Settings)
    with pytest.raises(ValueError, match="the smallest in this trade"):
        result.best(1e-30)
    # Nobody is credited with an error below the reference's own.
    assert all(result.error(row) >= result.reference.error for row in result.rows)


def test_json_holds_the_table():
    result = few(lesson.spring(), starts=1, horizon=0.4)
    data = json.loads(result.to_json())
    assert len(data["rows"]) == len(result.rows)
    assert data["reference"]["error"] == result.reference.error
    assert data["rows"][0]["position"] == result.table[0]["position"]
    assert sc.Settings(**data["settings"]) == result.shipped.settings
    assert sum(row["shipped"] for row in data["rows"]) == 1
    assert data["units"]["position"] == "m" and len(data["sentences"]) >= 2


def test_a_trade_is_named_by_what_it_is_of_and_pickles():
    result = sc.trade("lesson:spring", starts=1, horizon=0.08, precisions=["f64"], progress=False)
    assert "spring" in repr(result) and result.name == "spring"
    copy = pickle.loads(pickle.dumps(result))
    assert copy.to_json() == result.to_json()
    with pytest.raises(FileNotFoundError, match="no such file"):
        sc.trade("no_such.xml")


def test_the_sentences_name_the_shipped_settings():
    shipped, half, *_ = few(lesson.spring(), starts=1, horizon=0.4).sentences
    what = (
        "As shipped (semi-implicit, pgs 1 sweep, dt 10 ms) the RMS position error over 400 ms is "
    )
    assert shipped.startswith(what)
    assert half.startswith("Half that error or less comes at ")


def test_newton_has_no_sweeps_and_single_rows_need_one():
    scene = lesson.drop()
    scene.options = {"dt": 0.002, "integrator": "euler", "solver": "newton"}
    result = sc.trade(scene, starts=1, horizon=0.4, dts=[0.002], threads=1, progress=False)
    kinds = {(r.settings.solver, r.settings.sweeps) for r in result.rows}
    assert kinds == {("newton", 100), ("pgs", 1)}
    assert {r.settings.precision for r in result.rows} == {"f64", "f32"}


def test_refsafe_is_said_to_soften():
    scene = lesson.drop()
    scene.options = {"dt": 0.008, "integrator": "euler", "solver": "newton"}
    result = few(scene, starts=1, horizon=0.4, dts=[0.008, 0.016], integrators=["euler"])
    marks = {row.settings.dt: row.clamped for row in result.rows}
    assert marks == {0.008: False, 0.016: True}
    assert any("refsafe" in note for note in result.notes)
    # Before the ball lands there is nothing to soften.
    above = few(scene, starts=1, horizon=0.08, dts=[0.008, 0.016], integrators=["euler"])
    assert not any(row.clamped for row in above.rows)
    assert not any("refsafe" in note for note in above.notes)


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


def test_the_picture_is_drawn(tmp_path):
    result = few(lesson.spring(), starts=1, horizon=0.4)
    figure = result.plot(tmp_path / "trade.png")
    assert (tmp_path / "trade.png").read_bytes().startswith(b"\x89PNG")
    axes = figure.axes[0]
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert "spring" in axes.get_title(loc="left")


def test_a_run_that_is_nowhere_near_is_a_failure_with_its_reason():
    # Explicit Euler on a stiff spring: finite, and further away than any scene is large.
    scene = lesson.spring(k=1e6, dt=1e-3, integrator="rk4")
    result = few(scene, dts=[1e-3, 1e-4], integrators=["explicit"], starts=2, horizon=0.1)
    bad = by(result, integrator="explicit", dt=1e-3)
    assert "far off" in bad.failure and bad.errors is None and not bad.best
    assert bad in result.rows and "far off" in str(result)
    assert result.shipped.failure is None


def test_the_sentence_names_the_worst_start_and_what_the_others_say():
    result = few(falling(), integrators=["semi-implicit"], starts=3, horizon=0.4)
    assert " in the worst of 3 starts (start " in result.sentences[0]
    shipped = result.shipped
    # One start far worse than the others.
    errors = dataclasses.replace(shipped.errors, position_max=0.5, each=(1e-3, 1e-4, 0.2))
    shipped = dataclasses.replace(shipped, errors=errors)
    frontier = result.frontier.updated(shipped)
    result = dataclasses.replace(result, frontier=frontier)
    said = result.sentences[0]
    assert "error over 400 ms is 200 mm in the worst of 3 starts (start 2; " in said
    assert "starts differ widely: median 1 mm), for " in said
    assert said.endswith("The largest error of a body at any time is 500 mm.")
    shipped = result.shipped
    assert result.error(shipped) == 0.2
    assert result.table[result.rows.index(shipped)]["position_high"] == 0.2


def test_a_largest_error_below_the_references_is_marked():
    result = few(falling(), integrators=["semi-implicit"], starts=1, horizon=0.4)
    assert not any(row.below_max for row in result.rows)
    coarse = dataclasses.replace(result.reference.known, largest=1.0)
    reference = dataclasses.replace(result.reference, known=coarse, exact=None)
    frontier = Frontier.of(result.rows, reference.high, reference.largest, result.by)
    again = dataclasses.replace(result, frontier=frontier, reference=reference)
    assert all(row.below_max for row in again.rows) and "<1.0e0" in str(again)
    assert again.table[0]["below_max"]
    notes = about_reference(reference, again.rows, again.size)
    assert any(note.startswith("the column max is uncertain by ") for note in notes)


def test_the_default_horizon_is_a_whole_number_of_samples():
    # Four steps of 20 ms do not divide a second: 0.96 s are what is traded; asked for, a remark.
    assert default_horizon(0.08) == pytest.approx(0.96)
    result = few(falling(dt=0.02), integrators=["semi-implicit"], starts=1, horizon=1.0)
    assert any("horizon" in note for note in result.notes)


def bouncing(**options):
    """A ball that falls 5 cm onto a floor so stiff that it has left again within 2 ms."""
    scene = sc.Scene(gravity=(0, 0, -G), name="bouncing")
    scene.add_geom("world", "plane", condim=1, solref=(5e-4, 1.0))
    ball = scene.add_body("ball", pos=(0, 0, 0.1503))
    scene.add_joint(ball, "slide", axis=(0, 0, 1))
    scene.add_geom(ball, "sphere", 0.1, mass=1.0, condim=1, solref=(-1e6, -10.0))
    scene.options = {"dt": 0.002, "integrator": "euler"} | options
    return scene


def test_rows_are_counted_at_every_step():
    """The bounce, after 0.1 s, is over by the next sample: 16 ms lie between two."""
    scene = bouncing()
    for geom in scene.geoms:
        geom.solref = (-1e6, -10.0)
    options = {"dts": [0.002, 0.0005], "integrators": ["rk4"], "control_dt": 0.016, "starts": 1}
    result = few(scene, horizon=0.24, effort=1e5, **options)
    path = result.reference.runs[0]
    # No sample touches, and the ball is thrown back: gravity alone does not turn it around.
    assert not path.touching.any() and (np.diff(path.com[:, 0, 2]) > 0.01).any()
    assert path.rows == 1
    assert not any("choice of solver has no effect" in note for note in result.notes)
    assert {row.settings.solver for row in result.rows} == {"newton", "pgs"}


def test_refsafe_is_marked_where_contacts_act_between_samples_alone():
    scene = bouncing()
    for geom in scene.geoms:
        geom.solref = (5e-4, 1.0)
    options = {"dts": [0.002, 0.00025], "integrators": ["rk4"], "starts": 1, "horizon": 0.12}
    result = few(scene, effort=1e5, **options)
    assert {row.settings.dt: row.clamped for row in result.rows} == {0.002: True, 0.00025: False}
    assert any("refsafe" in note for note in result.notes)


def test_a_penalty_has_contacts_though_it_has_no_rows():
    options = {"law": "penalty", "integrator": "semi-implicit", "solver": "pgs"}
    result = few(bouncing(**options), starts=1, horizon=0.2, dts=[2e-3, 1e-3], effort=1e5)
    assert any(path.overlap for path in result.reference.runs)
    (note,) = [note for note in result.notes if "ever active" in note]
    assert note.startswith("contacts are forces under the law penalty, and no limit or other row ")
