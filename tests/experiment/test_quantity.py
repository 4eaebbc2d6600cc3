"""`Quantity`: series and scalars against plain loops, in both engines; its errors and refusals."""

from __future__ import annotations

import pickle

import mujoco
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
INTEGRATORS = {
    "euler": "mjINT_EULER",
    "implicit": "mjINT_IMPLICIT",
    "implicitfast": "mjINT_IMPLICITFAST",
    "rk4": "mjINT_RK4",
}
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


SLASHES = """<mujoco><option timestep=".004"/><worldbody>
<geom name="arena/floor" type="plane" size="1 1 .1"/>
<body name="walker/leg" pos="0 0 .04"><freejoint name="walker/root"/>
<geom name="walker/leg/foot" size=".05" mass="1"/><site name="walker/leg/x" pos="0 0 .05"/></body>
<body name="arm/x" pos="1 0 .5"><joint name="arm/x/velocity" axis="0 1 0"/>
<geom name="arm/link" type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass="1"/></body>
</worldbody><actuator><motor name="arm/force" joint="arm/x/velocity" gear="2"
ctrlrange="-1 1"/></actuator></mujoco>
"""
PUBLIC = {
    "gymnasium:half_cheetah": (
        "body/bfoot",
        "joint/fthigh/velocity",
        "range(joint/bshin)",
        "com/x",
    ),
    "dm_control:walker": ("body/left_foot/z", "joint/right_knee", "actuator/left_hip/force"),
    "slashes": (
        *("site/walker/leg/x", "site/walker/leg/x/z", "body/arm/x", "body/arm/x/x"),
        *("joint/arm/x/velocity", "joint/arm/x/velocity/velocity", "actuator/arm/force/force"),
        *("contact/walker/leg/foot/arena/floor", "contact/walker/leg/arena/floor"),
    ),
}


@pytest.mark.parametrize(
    ("source", "name"), [(source, name) for source, names in PUBLIC.items() for name in names]
)
def test_engines_agree_on_public_models_and_names_with_slashes(source, name, tmp_path):
    """Both engines run a motion with converged steps, and have the same series or number."""
    if source == "slashes":
        source = tmp_path / "slashes.xml"
        source.write_text(SLASHES)
    apart, tracks = [], []
    for engine in ("stepcore", "mujoco"):
        study = Study(
            str(source), engine=engine, quantity=name, horizon=0.1, starts=1, kind="sines"
        )
        coarse, fine = study.tracks([Change(dt=study.engine.dt / n) for n in (8, 16)], [0])
        apart.append(float(study.measure.error(coarse, fine)[0]))
        tracks.append(fine)
    far = float(study.measure.error(*tracks)[0])
    assert far <= 4 * max(apart) + 1e-3 * study.scale


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


def test_a_recommendation_in_mujoco_holds_in_a_plain_loop(tmp_path):
    """The error of a recommendation for the tip, from loops over `mujoco.mj_step` alone."""
    file, tips = tmp_path / "arm.xml", []
    file.write_text(ARM.replace('pos="-.5 0 .06"', 'pos="-.5 0 9"'))
    fall = {"quantity": "site/tip/z", "horizon": 0.4, "starts": 1, "kind": "fall", "by": "flops"}
    result = sc.trade(str(file), error="0.3mm", engine="mujoco", further=0, **fall)
    chosen = result.recommended.settings
    for integrator, dt in ((str(chosen.integrator), chosen.dt), ("rk4", 0.00025)):
        model = mujoco.MjModel.from_xml_path(str(file))
        model.opt.timestep = dt
        model.opt.integrator = getattr(mujoco.mjtIntegrator, INTEGRATORS[integrator])
        data, heights = mujoco.MjData(model), []
        every = round(0.016 / dt)
        for step in range(round(0.4 / dt)):
            mujoco.mj_step(model, data)
            if (step + 1) % every == 0:
                mujoco.mj_forward(model, data)
                heights.append(data.site("tip").xpos[2])
        tips.append(np.array(heights))
    error = float(np.sqrt(np.mean((tips[0] - tips[1]) ** 2)))
    assert error <= 3e-4 and error == pytest.approx(result.recommended.error, rel=0.1, abs=2e-5)


def test_errors_in_the_unit_of_the_quantity():
    study = study_of("joint/elbow")
    assert study.error_of("run", "0.5deg") == pytest.approx(np.radians(0.5))
    assert study.error_of("run", "1%") == pytest.approx(0.01 * study.scale)
    assert study_of("contact/ball").error_of("run", "2N") == 2.0
    assert units.amount_in(0.25, "N·m") == "250 mN·m"
    trial = study.run(Change(dt="8ms"), error="1%")
    assert trial.words(trial.error).endswith("rad")


BOTH = ["site/tip", "actuator/servo/force"]


def test_errors_of_several_quantities_are_those_of_each():
    trial = study_of(BOTH).run(Change(dt="8ms"), error=["1mm", 0.02])
    singles = [study_of(name).run(Change(dt="8ms")) for name in BOTH]
    for name, single in zip(BOTH, singles, strict=True):
        assert trial.named[name] == pytest.approx(single.error, rel=0.01)
    assert trial.error == pytest.approx(max(trial.named["site/tip"] / 1e-3, 0), rel=1e-9)
    assert trial.record()["site/tip"] == trial.named["site/tip"]


def test_a_recommendation_satisfies_the_error_of_each_quantity():
    errors = {"site/tip": 1e-3, "actuator/servo/force": 0.01}
    result = sc.trade(
        sc.loads(ARM), quantity=[*errors], error=[*errors.values()], by="flops", **FIELDS
    )
    assert all(result.recommended.named[name] <= most for name, most in errors.items())
    assert result.units["actuator/servo/force"] == "N·m"
    refused = [row for row in result.whole if row.error > 1 and not row.failure]
    assert all(any(row.named[n] > most for n, most in errors.items()) for row in refused)
    check = study_of(None, seed=99, starts=4)
    finest = Change(integrator="rk4", solver="newton", sweeps=200, dt=result.shipped.dt / 64)
    for name, most in errors.items():
        study = study_of(name, seed=99, starts=4)
        runs = study.tracks([result.recommended.change, finest], check.starts)
        assert study.measure.error(*runs).max() <= 1.1 * most


@pytest.mark.parametrize(
    ("quantity", "error", "words"),
    [
        (BOTH, None, "need one each"),
        (BOTH, "1mm", "one for each of 2 quantities"),
        (BOTH, ["1mm", 1, 1], "has 3 values"),
        (BOTH, ["1mm", "1mm"], "N·m"),
        (["site/tip", "site/tip"], ["1mm", "1mm"], "once"),
        (["site/tip", "joint/elbo"], ["1mm", 1], "elbow"),
        ([], 1, "quantity"),
    ],
)
def test_wrong_lists_are_refused(quantity, error, words):
    with pytest.raises(ValueError, match=words):
        sc.trade(sc.loads(ARM), quantity=quantity, error=error, **FIELDS)


def test_several_quantities_without_errors_are_refused():
    with pytest.raises(ValueError, match="an error of each"):
        sc.converge(sc.loads(ARM), quantity=BOTH, horizon=0.1, starts=1)


def test_ablate_and_converge_measure_the_quantity():
    scene = sc.loads(ARM)
    result = sc.ablate(scene, quantity="joint/elbow", horizon=0.2, starts=2, further=0)
    assert result.units["added"] == "rad" and result.tolerance > 0
    ball = [row for row in result.rows if row.removal.kind == "gravity"]
    assert all(row.trial.error > 0 for row in ball)
    left_out = sc.ablate(
        scene, quantity="joint/elbow", added="0.5deg", horizon=0.2, starts=2, further=4
    )
    # The ball touches neither arm nor elbow.
    assert left_out.removed and left_out.best.error <= np.radians(0.5)
    assert left_out.smallest is not None and left_out.proof is not None
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
    axes = {"dts": [0.004, 0.008], "statistic": "worst", "by": "flops"}
    result = sc.trade(sc.loads(ARM), quantity=quantity, **axes, **FIELDS)
    again = pickle.loads(pickle.dumps(result))
    assert str(again) == str(result)


def test_predict_measures_a_series():
    """Over 0.3 s every series of the arm can be predicted, as its motion can."""
    fields = {"horizon": 0.3, "starts": 1, "kind": "sines"}
    motion = sc.predict(sc.loads(ARM), **fields)
    for name in ("site/tip", "joint/elbow"):
        result = sc.predict(sc.loads(ARM), quantity=name, **fields)
        assert result.quantity == name and result.growth.factor.shape == motion.growth.factor.shape
        assert np.isinf(result.time) and name in str(result)
    with pytest.raises(ValueError, match="one series"):
        sc.predict(sc.loads(ARM), quantity="max(joint/elbow)", **fields)


def test_growth_of_a_series_is_that_of_two_runs():
    """In a double pendulum a change of 1e-10 of the scene's size grows alike in every series."""
    fields = {"horizon": 3.0, "starts": 1, "kind": "fall"}
    swinging = sc.loads(ARM.replace('damping=".2"', "").replace('damping=".1"', ""))
    factors = [
        sc.predict(swinging, quantity=name, **fields).growth.factor[0].max()
        for name in ("joint/elbow", "site/tip")
    ]
    assert 0.03 < factors[0] / factors[1] < 30


def test_a_stability_map_of_a_quantity():
    grid = {"path": "joint/elbow/damping", "values": [0.1, 1.0], "dts": [0.002, 0.008]}
    result = sc.stability_map(sc.loads(ARM), quantity="site/tip", deviation="1mm", **grid)
    assert result.units["error"] == "m" and "site/tip" in str(result)
    motion = sc.stability_map(sc.loads(ARM), deviation="1mm", **grid)
    errors = [[cell.error for cell in each.rows] for each in (result, motion)]
    assert all(e > 0 for row in errors for e in row) and errors[0] != errors[1]
    peak = sc.stability_map(sc.loads(ARM), quantity="max(joint/elbow)", deviation="0.1deg", **grid)
    assert peak.units["error"] == "rad" and peak.deviation == pytest.approx(np.radians(0.1))
