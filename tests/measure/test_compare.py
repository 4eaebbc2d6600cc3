"""compare: planted differences are named and ranked as by swaps made by hand."""

import json
import math

import numpy as np
import pytest

import stepcore as sc
from stepcore.cli import main
from stepcore.engine.norm import Matter, distances, rms
from stepcore.experiment import Change, Study
from stepcore.measure.comparison.events import first_difference

SHORT = {"horizon": 0.4, "starts": 2, "progress": False, "threads": 1}
ARM = """<mujoco model="arm"><option timestep="{dt}"/><worldbody>{bodies}</worldbody>
<actuator>{actuators}</actuator></mujoco>"""
LEFT = """<body name="left" pos="0 .2 1"><joint name="l" axis="0 1 0" damping="{damping}"/>
<geom name="l" type="capsule" size=".03" fromto="0 0 0 0 0 -.4"/>
<body name="tip" pos="0 0 -.4"><joint name="t" axis="0 1 0" damping=".02"/>
<geom name="t" type="capsule" size=".02" fromto="0 0 0 .2 0 0"/>{extra}</body></body>"""
RIGHT = """<body name="right" pos="0 -.2 1"><joint name="r" axis="0 1 0" damping=".1"/>
<geom name="r" type="capsule" size=".03" fromto="0 0 0 0 0 -.3"/></body>"""
SERVO = '<position name="l" joint="l" kp="{kp}" kv=".2"/>'
GENERAL = """<general name="l" joint="l" gainprm="{kp}" biastype="affine" biasprm="0 -{kp} -.2"/>"""
MOTORS = (
    '<position name="t" joint="t" kp="2" kv=".05"/><position name="r" joint="r" kp="4" kv=".1"/>'
)
PLANTED = {
    "joint/l/damping": 0.3,
    "joint/t/armature": 0.02,
    "actuator/r/kp": 4.4,
    "body/tip/mass": 0.27,
}


def arm(dt=0.002, damping=0.1, kp=5, extra="", servo=SERVO, reverse=False):
    bodies = [LEFT.format(damping=damping, extra=extra), RIGHT][:: -1 if reverse else 1]
    actuators = [servo.format(kp=kp), MOTORS][:: -1 if reverse else 1]
    text = ARM.format(dt=dt, bodies="".join(bodies), actuators="".join(actuators))
    return sc.loads(text).compile()


@pytest.fixture(scope="module")
def planted():
    a = arm()
    return sc.compare(a, a.with_values(PLANTED).with_settings(dt=0.02), **SHORT)


def test_planted_differences_are_named(planted):
    assert {one.path for one in planted.differences} == {*PLANTED, "dt"}
    assert not planted.others and not planted.rounding
    assert planted.unexplained == 0.0
    assert planted.uncertainty < 0.1 * planted.converged


def test_effects_are_those_of_swaps_made_by_hand(planted):
    """Each value alone, in runs of 0.1 ms by another integrator."""
    exact = {"integrator": "implicitfast", "dt": 1e-4}
    study = Study(arm(), horizon=SHORT["horizon"], starts=SHORT["starts"])
    before, *after = study.tracks(
        [Change(**exact), *(Change({path: value}, **exact) for path, value in PLANTED.items())],
        study.starts,
    )
    matter = Matter.of(arm())
    by_hand = {
        path: rms(distances(before, tracks, matter)).max()
        for path, tracks in zip(PLANTED, after, strict=True)
    }
    effects = {row.difference.path: row.alone for row in planted.models.rows}
    assert sorted(effects, key=effects.get) == sorted(by_hand, key=by_hand.get)
    for path, far in by_hand.items():
        assert effects[path] == pytest.approx(far, rel=0.1, abs=planted.uncertainty)


def test_the_smallest_set_explains_the_distance(planted):
    part = planted.models
    assert part.left <= part.within
    assert 0 < len(part.needed) < len(PLANTED)
    kept = {row.alone for row in part.rows if row.needed}
    assert min(kept) > max(row.alone for row in part.rows if not row.needed)
    assert planted.change.of(arm()).settings.dt == 0.02


@pytest.mark.parametrize("reverse", [False, True])
def test_equal_models_have_no_difference(reverse):
    result = sc.compare(arm(), arm(reverse=reverse), **SHORT)
    assert (result.differences, result.others, result.distance) == ([], [], 0.0)


def test_states_and_controls_are_mapped_by_name():
    result = sc.compare(arm(), arm(damping=0.3, reverse=True), **SHORT)
    assert [one.path for one in result.needed] == ["joint/l/damping"]
    assert result.unexplained < 1e-9 < result.distance


def test_constant_controls():
    """The converged motion has adaptive steps."""
    controls = {"ctrl": {"l": 0.5}, "horizon": 0.5, "progress": False}
    result = sc.compare(arm(), arm(damping=0.3, reverse=True), **controls)
    assert [one.path for one in result.needed] == ["joint/l/damping"]
    assert result.models.error < 0.5 * result.models.within


def test_differences_by_rounding_are_counted():
    result = sc.compare(arm(), arm(damping=0.1 * (1 + 1e-8)), **SHORT)
    assert (result.differences, result.rounding) == ([], 1)


@pytest.mark.parametrize(("kp", "paths"), [(5, []), (7, ["actuator/l/kp"])])
def test_a_gain_is_one_difference_in_every_notation(kp, paths):
    for a, b in ((SERVO, GENERAL), (GENERAL, SERVO), (GENERAL, GENERAL)):
        result = sc.compare(arm(servo=a), arm(kp=kp, servo=b), **SHORT)
        assert [one.path for one in result.differences] == paths
        assert result.unexplained == pytest.approx(0.0, abs=1e-12)


def test_an_element_of_one_model_is_listed_and_its_effect_is_unexplained():
    extra = '<geom name="load" pos=".1 0 0" size=".04"/>'
    result = sc.compare(arm(), arm(extra=extra), **SHORT)
    assert any('"load" is only in B' in said.replace("'", '"') for said in result.others)
    assert result.unexplained == result.distance > 1e-3


def test_another_shape_is_one_difference():
    box = '<geom name="load" type="box" pos=".1 0 0" size=".04 .03 .02"/>'
    ball = '<geom name="load" pos=".1 0 0" size=".05"/>'
    result = sc.compare(arm(extra=box), arm(extra=ball), **SHORT)
    assert [one.path for one in result.differences] == ["geom/load (type, size)"]
    assert result.unexplained < 1e-9 < result.distance


def test_equal_changes_of_several_elements_are_one_entry_of_the_answer():
    a = arm()
    b = a.with_values({f"joint/{name}/frictionloss": 0.2 for name in "lr"})
    assert "frictionloss of 2 joints (0 → 0.2)." in sc.compare(a, b, **SHORT).sentences[0]


def test_a_joint_without_counterpart_stops_the_comparison():
    joint = '<body name="z"><joint name="z"/><geom size=".1"/></body>'
    result = sc.compare(arm(), arm(extra=joint), **SHORT)
    assert len(result.unmapped) == 1 and "z" in result.unmapped[0]
    assert math.isnan(result.distance) and not result.rows
    assert "z" in result.text()


def test_a_run_that_fails_is_reported():
    a = arm()
    result = sc.compare(a, a.with_values({"actuator/l/kp": 1e9}), **SHORT)
    assert result.failures[0] == "" and "start 0" in result.failures[1]
    assert result.needed == [] and math.isinf(result.rows[0].alone)
    assert "failed" in result.text()


def test_a_given_distance_counts_as_equal():
    result = sc.compare(arm(), arm(damping=0.3), within="1m", **SHORT)
    assert result.needed == [] and result.models.needed == []


def test_bad_input():
    with pytest.raises(ValueError, match="within = -1"):
        sc.compare(arm(), arm(), within=-1)
    with pytest.raises(ValueError, match=r"dt = 0\.0033 s: must divide"):
        sc.compare(arm(), arm(dt=0.0033), control_dt=0.01, **SHORT)
    with pytest.raises(ValueError, match="no joint"):
        sc.compare(arm(), sc.loads("<mujoco/>"))


def test_data_text_and_plot(planted):
    data = json.loads(planted.to_json())
    assert {row["difference"] for row in data["rows"]} == {*PLANTED, "dt"}
    assert data["needed"] == [one.path for one in planted.needed]
    assert data["mjcf"] == planted.mjcf and 'timestep="0.02"' in planted.mjcf
    assert planted.mjcf in planted.text(width=200)
    assert np.isfinite([row.removed for row in planted.rows]).all()
    assert len(planted.plot().axes[0].patches) >= len(planted.rows)


def test_the_command(tmp_path, capsys):
    for name, model in (("a", arm()), ("b", arm(damping=0.3)), ("c", arm(extra="<joint/>"))):
        model.scene.save(tmp_path / f"{name}.xml")
    a, b, c = (str(tmp_path / f"{name}.xml") for name in "abc")
    short = ["--horizon", "0.2", "--starts", "2"]
    assert main(["compare", a, b, *short, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["needed"] == ["joint/l/damping"]
    assert main(["compare", a, c, *short]) == 3
    assert main(["compare", a, str(tmp_path / "d.xml")]) == 2


def test_engines_make_the_same_motion():
    result = sc.compare(sc.load("gymnasium:half_cheetah"), other_engine="mujoco", **SHORT)
    assert result.same and result.engine.startswith("MuJoCo") and not result.rows


def test_engines_that_differ_are_judged_by_their_converged_motions(tmp_path):
    """MuJoCo's file has half of the stiffness: shorter steps do not make the engines agree."""
    soft = tmp_path / "soft.xml"
    soft.write_text(TEXT_OF_SPRING.replace("50", "25"))
    result = sc.compare(sc.loads(TEXT_OF_SPRING), soft, other_engine="mujoco", **SHORT)
    assert result.needed[0].path == "joint/s/stiffness"
    assert result.unexplained < 1e-3 * result.distance
    assert result.converged > 10 * result.uncertainty


TEXT_OF_SPRING = """<mujoco><worldbody><body>
<joint name="s" type="slide" axis="1 0 0" stiffness="50" springref=".1"/>
<geom size=".1" mass="1"/></body></worldbody></mujoco>"""


def test_settings_of_the_other_model():
    scene = sc.load("gymnasium:hopper")
    result = sc.compare(scene, settings={"dt": 0.004}, **SHORT)
    assert [one.path for one in result.needed] == ["dt"] and 0 < result.separated < 0.4
    with pytest.raises(ValueError, match="other: must be a second model"):
        sc.compare(scene, **SHORT)


DROP = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/><body pos="0 0 {z}">
<freejoint/><geom name="ball" size=".1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("engine", ["stepcore", "mujoco"])
def test_first_event_is_named_with_its_times(tmp_path, engine):
    """A falls 4 cm, B 5 cm: the contact begins after √(2h/g)."""
    files = [tmp_path / name for name in ("a.xml", "b.xml")]
    for file, z in zip(files, (0.14, 0.15), strict=True):
        file.write_text(DROP.format(z=z))
    schedules, engines = [], []
    for file, name in zip(files, ("stepcore", engine), strict=True):
        study = Study(file, "hold", engine=name, horizon=0.3)
        schedules.append(study.schedule)
        engines.append(study.engine)
    event = first_difference(tuple(engines), tuple(schedules), 0)
    assert event.name == "contact `ball`/`floor`"
    assert event.a == pytest.approx(math.sqrt(2 * 0.04 / 9.81), abs=0.003)
    assert event.b == pytest.approx(math.sqrt(2 * 0.05 / 9.81), abs=0.003)
    assert "begins in A, " in str(event)


def test_compare_of_one_file_on_the_command_line(capsys):
    args = ["compare", "lesson:spring", "--set", "dt=5ms", "--horizon", "0.2", "--starts", "1"]
    assert main([*args, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["needed"] == ["dt"]
    assert main(["compare", "lesson:spring", "--set", "dtt=5ms"]) == 2
    assert 'nearest: "dt"' in capsys.readouterr().err
