"""`Quantity`: series and scalars against plain loops, in both engines; its errors and refusals."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import stepcore as sc
from stepcore.experiment import Change, Quantity, Study
from stepcore.report import units

ARM = """<mujoco model="arm"><option timestep=".004" integrator="implicitfast"/>
<worldbody><geom name="floor" type="plane" size="2 2 .1"/>
<body name="upper" pos="0 0 .5"><joint name="shoulder" axis="0 1 0" damping=".2"/>
<geom name="link" type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass="1"/>
<body name="lower" pos=".3 0 0"><joint name="elbow" axis="0 1 0" damping=".1"/>
<geom name="hand" type="capsule" size=".02" fromto="0 0 0 .25 0 0" mass=".5"/>
<site name="tip" pos=".25 0 .01"/></body></body>
<body name="ball" pos="-.5 0 .06"><freejoint name="root"/>
<geom name="ball" size=".05" mass=".3"/></body>
<body name="post" pos="1 0 0"><geom name="post" size=".1"/><site name="still"/></body></worldbody>
<tendon><fixed name="sum"><joint joint="shoulder" coef="1"/><joint joint="elbow" coef="2"/></fixed>
</tendon>
<actuator><position name="servo" joint="elbow" kp="20" kv="1"/></actuator>
<sensor><framepos name="place" objtype="site" objname="tip"/><jointvel joint="elbow" name="rate"/>
</sensor></mujoco>"""
FIELDS = {"horizon": 0.2, "starts": 2, "kind": "sines"}


def ball_force(sim):
    rows = [row for row in sim.contacts if {row["name1"], row["name2"]} == {"ball", "floor"}]
    return sum(abs(row["force"] @ row["normal"]) for row in rows)


def com_z(sim):
    ipos = sim.model.body_ipos[:, :, None]
    places = sim.xpos + (sim.xmat @ ipos)[..., 0]
    moving = sim.model.body_mass * (np.arange(sim.model.nbody) != sim.model.index("body", "post"))
    return moving @ places[:, 2] / moving.sum()


SERIES = {
    "joint/elbow": lambda sim: sim.joint("elbow").qpos[0],
    "joint/shoulder/velocity": lambda sim: sim.joint("shoulder").qvel[0],
    "site/tip/z": lambda sim: sim.site("tip").xpos[2],
    "geom/hand/x": lambda sim: sim.geom("hand").xpos[0],
    "body/lower/x": lambda sim: sim.body("lower").xpos[0],
    "com/z": com_z,
    "energy": lambda sim: sim.energy.total,
    "actuator/servo/force": lambda sim: sim.actuator("servo").force,
    "tendon/sum": lambda sim: sim.tendon("sum").length,
    "sensor/rate": lambda sim: sim.sensor("rate").data[0],
    "contact/ball/floor": ball_force,
}


def study_of(quantity, tmp_path=None, engine="stepcore", **fields):
    source = sc.loads(ARM)
    if tmp_path is not None:
        source = tmp_path / "arm.xml"
        source.write_text(ARM)
    return Study(source, engine=engine, quantity=quantity, **{**FIELDS, **fields})


def loop(study, start, reading):
    """The readings at the samples of a motion that is stepped by hand."""
    model = study.schedule.driven_model(study.model)
    sim = sc.Sim(model)
    study.schedule.starts[start].put(sim)
    rows, hold = study.schedule.rows([start], model.settings.dt)
    readings, every = [], study.schedule.every * study.schedule.steps(model.settings.dt)
    for step in range(study.schedule.periods * study.schedule.steps(model.settings.dt)):
        if rows is not None:
            sim.ctrl[:] = rows[0, min(step // hold, rows.shape[1] - 1)]
        sim.step()
        if (step + 1) % every == 0:
            readings.append(reading(sim))
    return np.array(readings)


@pytest.mark.parametrize("name", SERIES)
def test_a_series_is_what_a_plain_loop_reads(name):
    study = study_of(name)
    (tracks,) = study.tracks([Change()], [1])
    (column,) = study.measure.columns
    expected = loop(study, 1, SERIES[name])
    assert column.values(tracks)[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("name", [*SERIES, "body/ball", "site/tip", "max(contact/ball)"])
def test_both_engines_measure_the_same_error(name, tmp_path):
    errors, unsure = [], 0.0
    for engine in ("stepcore", "mujoco"):
        trial = study_of(name, tmp_path, engine, starts=1).run(Change(dt="8ms"))
        errors.append(trial.errors)
        unsure += trial.unsure.max()
    assert errors[0] == pytest.approx(errors[1], rel=0.02, abs=unsure + 1e-9)


def test_a_pose_counts_rotations_as_arcs():
    study = study_of("body/lower")
    (tracks,) = study.tracks([Change()], [0])
    turned = pickle.loads(pickle.dumps(tracks))
    turned.quat[:] = [np.cos(0.05), np.sin(0.05), 0, 0]
    tracks.quat[:] = [1, 0, 0, 0]
    place = study.engine.matter.moving.index(study.model.index("body", "lower"))
    gyration = study.engine.matter.gyration[place]
    assert study.measure.apart(tracks, turned) == pytest.approx(0.1 * gyration, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("max", np.max),
        ("min", np.min),
        ("mean", np.mean),
        ("range", np.ptp),
        ("final", lambda series: series[-1]),
        ("integral", lambda series: 0.016 * series.sum()),
    ],
)
def test_a_scalar_is_the_number_of_the_series(name, number):
    study = study_of(f"{name}(joint/elbow)")
    assert study.schedule.every == 1 and study.schedule.period == pytest.approx(0.016)
    tracks = study.tracks([Change(), Change(dt="8ms")], [0])
    series = [study.measure.columns[0].values(each)[0] for each in tracks]
    assert study.measure.error(*tracks)[0] == pytest.approx(
        abs(number(series[0]) - number(series[1])), rel=1e-12
    )


def test_a_pattern_is_the_rms_over_its_elements():
    whole, parts = (study_of(name) for name in ("joint/*", "joint/elbow"))
    assert [column.name for column in whole.measure.columns] == ["joint/shoulder", "joint/elbow"]
    far = whole.measure.apart(*whole.tracks([Change(), Change(dt="8ms")], [0]))
    single = parts.measure.apart(*parts.tracks([Change(), Change(dt="8ms")], [0]))
    assert np.array_equal(far[..., 1:], single)


def test_motion_is_the_default_bit_for_bit():
    trials = [study_of(quantity).run(Change(dt="8ms")) for quantity in (None, "motion")]
    assert np.array_equal(trials[0].errors, trials[1].errors)
    assert trials[0].measure.unit == "m" and trials[0].work == trials[1].work


def test_the_recommendation_holds_from_new_starts():
    result = sc.trade(sc.loads(ARM), quantity="site/tip/z", error="0.1mm", by="flops", **FIELDS)
    assert result.recommended is not None and result.measure.unit == "m"
    check = study_of("site/tip/z", seed=99, starts=8)
    change = result.recommended.change
    finest = Change(integrator="rk4", solver="newton", sweeps=200, dt=result.shipped.dt / 64)
    runs = check.tracks([change, finest], check.starts)
    assert check.measure.error(*runs).max() <= 1.1e-4


def test_errors_in_the_unit_of_the_quantity():
    study = study_of("joint/elbow")
    assert study.error_of("run", "0.5deg") == pytest.approx(np.radians(0.5))
    assert study.error_of("run", "1%") == pytest.approx(0.01 * study.scale)
    assert study_of("contact/ball").error_of("run", "2N") == 2.0
    assert units.amount_in(0.25, "N·m") == "250 mN·m"
    trial = study.run(Change(dt="8ms"), error="1%")
    assert trial.words(trial.error).endswith("rad")


def test_ablate_and_converge_measure_the_quantity():
    scene = sc.loads(ARM)
    result = sc.ablate(scene, quantity="joint/elbow", horizon=0.2, starts=2, further=0)
    assert result.units["added"] == "rad" and result.tolerance > 0
    ball = [row for row in result.rows if row.removal.kind == "gravity"]
    assert all(row.trial.error > 0 for row in ball)
    data = sc.converge(scene, quantity="joint/elbow", horizon=0.2, starts=1).to_dict()
    assert data["units"]["error"] == "rad"


@pytest.mark.parametrize(
    ("quantity", "words"),
    [
        ("site/tipp", 'nearest: "tip"'),
        ("joint/elbo/velocity", 'nearest: "elbow"'),
        ("speed", "is no series"),
        ("mox(joint/elbow)", 'nearest: "max"'),
        ("max(motion)", "name an element"),
        ("max(site/tip)", "site/tip/x"),
        ("joint/root", "name its body"),
        ("site/still", "does not move"),
        ("actuator/servo", "actuator/servo/force"),
        ("sensor/*", "m and no unit"),
        ("contact/ball/flor", "no geom or body"),
        (7, "quantity"),
    ],
)
def test_a_wrong_quantity_is_refused(quantity, words):
    with pytest.raises(ValueError, match=words):
        study_of(quantity)


def test_wrong_errors_are_refused_before_anything_runs():
    study = study_of("contact/ball")
    for wrong in ("1mm", "-1N", 0, "1"):
        if wrong == "1":
            assert study.error_of("run", wrong) == 1.0
            continue
        with pytest.raises(ValueError, match="error"):
            study.run(Change(dt="8ms"), error=wrong)
    assert study.runs == 0


def test_a_constant_quantity_is_refused():
    with pytest.raises(ValueError, match="constant"):
        study_of("contact/hand/link").run(Change(dt="8ms"))


def test_results_and_quantities_can_be_pickled():
    quantity = pickle.loads(pickle.dumps(Quantity("max(joint/elbow)")))
    assert quantity == Quantity("max(joint/elbow)") and quantity.is_scalar
    result = sc.trade(sc.loads(ARM), quantity=quantity, dts=[0.004, 0.008], by="flops", **FIELDS)
    again = pickle.loads(pickle.dumps(result))
    assert str(again) == str(result)
