"""MuJoCo as the engine of a Study: the same physics, messages and failures; more files."""

import pickle

import mujoco
import numpy as np
import pytest
from menagerie import PANDA, needed

import stepcore as sc
from stepcore import lesson
from stepcore.engine.norm import distances, rms
from stepcore.experiment.change import Change
from stepcore.experiment.motion import Motion
from stepcore.experiment.mujoco_engine import MuJoCo
from stepcore.experiment.price import computing_time
from stepcore.experiment.study import Study
from stepcore.loading import find_asset

ARM = """<mujoco><option timestep="0.005" integrator="implicitfast"/><worldbody>
<body name="arm" pos="0 0 1"><joint name="hip" axis="0 1 0" damping="0.1"/>
<geom name="rod" type="capsule" fromto="0 0 0 0.4 0 0" size="0.03" mass="1"/></body></worldbody>
<actuator><position name="servo" joint="hip" kp="20" kv="1" ctrlrange="-1 1"/></actuator>
</mujoco>"""
# A flex with stiffness falls on a driven paddle: stepcore has no flex.
JELLY = """<mujoco><option timestep="0.001"/><worldbody><geom type="plane" size="2 2 .1"/>
<body name="paddle" pos="0 0 .3"><joint name="lift" type="slide" axis="0 0 1" damping="1"/>
<geom type="box" size=".2 .2 .02" mass="1"/></body>
<flexcomp name="jelly" type="grid" count="3 3 3" spacing=".1 .1 .1" pos="0 0 .5" radius=".01"
mass="1" dim="3"><elasticity young="1e4" poisson=".2" damping=".01"/>
<contact selfcollide="none"/></flexcomp></worldbody>
<actuator><position name="push" joint="lift" kp="200" kv="20" ctrlrange="-.1 .1"/></actuator>
</mujoco>"""
TORUS = """<mujoco><extension><plugin plugin="mujoco.sdf.torus"><instance name="torus">
<config key="radius1" value="0.35"/><config key="radius2" value="0.15"/></instance></plugin>
</extension><asset><mesh name="torus"><plugin instance="torus"/></mesh></asset>
<worldbody><geom type="plane" size="5 5 .1" euler="0 10 0"/><body pos="0 0 .6"><freejoint/>
<geom type="sdf" mesh="torus"><plugin instance="torus"/></geom></body></worldbody></mujoco>"""


ROBOTS = ["gymnasium:half_cheetah", "gymnasium:hopper", "gymnasium:reacher"]


@pytest.mark.parametrize("source", [*ROBOTS, pytest.param(str(PANDA), marks=needed)])
def test_both_engines_converge_to_the_same_motion(source):
    ours, theirs = Study(source, starts=2), Study(source, starts=2, engine="mujoco")
    assert theirs.engine.refusal == ""
    assert theirs.engine.matter.moving == ours.engine.matter.moving
    np.testing.assert_allclose(theirs.engine.matter.gyration, ours.engine.matter.gyration, 1e-12)
    a, b = (study.truth(1e-3) for study in (ours, theirs))
    far = rms(distances(a.tracks, b.tracks, ours.engine.matter), a.scored & b.scored)
    assert (far <= a.unsure + b.unsure).all()


@pytest.mark.parametrize("integrator", ["euler", "rk4", "implicit", "implicitfast"])
@pytest.mark.parametrize("name", ["half_cheetah", "humanoid"])
def test_a_run_is_that_of_mujoco_step_by_step(name, integrator):
    study = Study(f"gymnasium:{name}", Motion(horizon=0.2, starts=2), engine="mujoco")
    tracks = study.engine.follow(
        Change(integrator=integrator, solver="pgs", sweeps=7), study.schedule, [1]
    )
    model = mujoco.MjModel.from_xml_path(str(find_asset("gymnasium", name)))
    model.opt.integrator = ("euler", "rk4", "implicit", "implicitfast").index(integrator)
    model.opt.solver, model.opt.iterations = mujoco.mjtSolver.mjSOL_PGS, 7
    data, begin, dt = mujoco.MjData(model), study.schedule.starts[1], model.opt.timestep
    data.qpos[:], data.qvel[:] = begin.qpos, begin.qvel
    rows, hold = study.schedule.rows([1], dt)
    every = study.schedule.every * study.schedule.steps(dt)
    for step in range(every * len(study.schedule.times)):
        data.ctrl[:] = rows[0, min(step // hold, rows.shape[1] - 1)]
        mujoco.mj_step(model, data)
        if (step + 1) % every == 0:
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            places = data.xipos[study.engine.matter.moving]
            np.testing.assert_allclose(tracks.com[0, step // every], places, rtol=0, atol=1e-12)


def test_a_control_function_gets_mujocos_state():
    seen = []

    def control(time, sim):
        seen.append((time, float(sim.qpos[0]), sim.body("arm").xquat[2]))
        return [0.5 * np.cos(time)]

    study = Study(ARM, Motion(horizon=0.1, control=control, starts=1), engine="mujoco")
    called = study.engine.follow(Change(), study.schedule, [0])
    assert [time for time, *_ in seen[:3]] == pytest.approx([0.0, 0.005, 0.01])
    assert all(np.isclose(np.sin(angle / 2), turn) for _, angle, turn in seen)
    assert seen[0][1] != seen[-1][1]
    rows = np.array([[0.5 * np.cos(time)] for time, *_ in seen])
    table = Study(ARM, Motion(horizon=0.1, ctrl=rows, starts=1), engine="mujoco")
    played = table.engine.follow(Change(), table.schedule, [0])
    np.testing.assert_array_equal(called.com, played.com)


@pytest.mark.parametrize("source", [JELLY, TORUS], ids=["flex", "sdf"])
def test_a_file_that_stepcore_refuses_has_a_truth_and_errors(source):
    study = Study(source, Motion(horizon=0.1, starts=2), engine="mujoco")
    assert "is not built yet" in study.engine.refusal
    with pytest.raises(ValueError, match="stepcore cannot load this scene"):
        _ = study.model
    shipped, half = study.run([Change(), Change(dt=study.engine.dt / 2)], error=1e-2)
    truth = study.truth(1e-2)
    assert truth.error <= 1e-3
    assert not half.failure
    assert half.error <= shipped.error or shipped.error < 2 * truth.error
    assert half.work > shipped.work > 0
    fresh = study.fresh(2)
    assert study.run([Change()], fresh)[0].starts == fresh


def test_a_flex_starts_unstrained():
    study = Study(JELLY, Motion(starts=3), engine="mujoco")
    for start in study.schedule.starts[1:]:
        moved = (start.qpos - study.schedule.starts[0].qpos)[1:].reshape(-1, 3)
        np.testing.assert_allclose(moved, np.tile(moved[0], (27, 1)), atol=1e-15)
        assert moved[0].any()


def test_controls_of_a_file_that_stepcore_refuses():
    rows = {"lift": [0.1, 0.0], "time": [0.0, 0.05]}
    study = Study(JELLY, Motion(horizon=0.1, ctrl=rows, starts=1), engine="mujoco")
    assert study.schedule.rows([0], 0.001)[0].ravel()[[0, -1]].tolist() == [0.1, 0.0]
    drive = Study(JELLY, Motion(kind="hold"), engine="mujoco").schedule.drive
    assert drive == "actuators are held at the keyframe's controls"
    with pytest.raises(ValueError, match='no actuator is named "lfit"; nearest: "lift"'):
        Study(JELLY, Motion(ctrl={"lfit": 0.1}), engine="mujoco")
    with pytest.raises(ValueError, match=r"control: .*give rows of controls"):
        Study(JELLY, Motion(control=lambda time, sim: [0.0]), engine="mujoco")


def test_a_run_that_diverges_fails_and_is_not_begun_again():
    study = Study(JELLY, Motion(horizon=1.0, starts=1), engine="mujoco")
    (trial,) = study.run([Change(dt=study.schedule.period)], error=1e-2)
    assert "not finite at 0." in trial.failure
    assert np.isnan(trial.tracks.com[0, -1]).all()


def test_what_mujoco_does_not_have_is_a_failure_that_says_so():
    study = Study(ARM, Motion(horizon=0.1, starts=1), engine="mujoco")
    for change, why in (
        (Change(integrator="semi-implicit"), "integrator = 'semi-implicit'"),
        (Change(accuracy=1e-3), "accuracy = 0.001: MuJoCo has no such setting"),
        (Change({"geom/rod/mass": 2.0}), "geom/rod/mass: MuJoCo's engine changes"),
        (Change(without=("coriolis",)), "MuJoCo has no flag for it"),
    ):
        assert why in study.engine.follow(change, study.schedule, [0]).failure
        assert study.engine.work(change, study.schedule) == np.inf


@pytest.mark.parametrize(
    "change",
    [
        Change({"joint/hip/damping": 2.0}),
        Change({"actuator/servo/kp": 5.0, "actuator/servo/kv": 3.0}),
        Change({"joint/hip/armature": 0.5, "joint/hip/stiffness": 4.0}),
        Change({"gravity": (0.0, 1.0, -3.0)}),
        Change(without=("gravity",)),
        Change(without=("damper",)),
        Change(without=("actuation",)),
    ],
    ids=str,
)
def test_a_change_of_the_model_is_the_same_in_both_engines(change):
    ours, theirs = (
        Study(scene_of(ARM), Motion(horizon=0.4, starts=2), engine=name)
        for name in ("stepcore", "mujoco")
    )
    both = change.also(Change(integrator="rk4", dt=0.001))
    a, b = (study.engine.follow(both, study.schedule, [0, 1]) for study in (ours, theirs))
    (whole,) = theirs.tracks([Change(integrator="rk4", dt=0.001)], [0, 1])
    np.testing.assert_allclose(a.com, b.com, rtol=0, atol=1e-12)
    assert np.abs(b.com - whole.com).max() > 1e-6


def scene_of(text):
    from stepcore import loads

    return loads(text)


def test_sources_and_pickles():
    path = find_asset("gymnasium", "hopper")
    model = mujoco.MjModel.from_xml_path(str(path))
    tracks = []
    for source in (path, "gymnasium:hopper", model, scene_of(path.read_text()).compile()):
        study = Study(source, Motion(horizon=0.1, starts=1), engine="mujoco")
        engine = pickle.loads(pickle.dumps(study.engine))
        tracks.append(engine.follow(Change(), study.schedule, [0]))
    for other in tracks[1:]:
        np.testing.assert_allclose(other.com, tracks[0].com, rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match="law = 'relaxed': MuJoCo has solref alone"):
        MuJoCo(lesson.stack())
    with pytest.raises(ValueError, match="engine = 'bullet'"):
        Study(ARM, engine="bullet")


def test_settings_are_those_of_the_scene_and_are_said_as_option():
    scene = scene_of(ARM).with_settings(dt=0.002, solver="pgs", sweeps=7, cone="elliptic")
    settings = MuJoCo(scene.compile()).shipped
    own = (settings.dt, settings.solver, settings.sweeps, settings.cone)
    assert own == (0.002, "pgs", 7, "elliptic")
    change = Change(dt=0.01, integrator="rk4", solver="cg", sweeps=30, cost_tolerance=1e-6)
    text = (
        '<option timestep="0.01" integrator="RK4" iterations="30" solver="CG" tolerance="1e-06"/>'
    )
    assert sorted(change.mjcf[:-2].split()) == sorted(text[:-2].split())
    assert MuJoCo(ARM).settings(change).as_dict()["solver"] == "cg"


def test_the_estimated_cost_ranks_methods():
    """An evaluation is one stage: rk4 makes four; few sweeps of PGS are cheaper than many."""
    study = Study("gymnasium:humanoid", Motion(horizon=0.2, starts=1), engine="mujoco")
    engine, schedule = study.engine, study.schedule
    work = {
        name: engine.work(Change(integrator=name), schedule)
        for name in ("euler", "rk4", "implicit", "implicitfast")
    }
    assert 3 < work["rk4"] / work["euler"] < 4
    assert work["euler"] <= work["implicitfast"] < work["implicit"] < work["rk4"]
    few, many = (engine.work(Change(solver="pgs", sweeps=n), schedule) for n in (2, 100))
    assert few < many
    coarse = engine.work(Change(dt=2 * engine.dt), schedule)
    assert coarse == pytest.approx(engine.work(Change(), schedule) / 2)
    # About 10 µs a step.
    assert 2 < computing_time(work["euler"], engine.shipped) * engine.dt < 50


def test_a_refusal_of_mujocos_names_the_file_and_the_version(tmp_path):
    file = tmp_path / "new.xml"
    file.write_text('<mujoco><worldbody><geom size="1" newattribute="1"/></worldbody></mujoco>')
    text = f"new.xml: MuJoCo {mujoco.__version__} refuses it: .*newattribute"
    with pytest.raises(ValueError, match=text):
        sc.trade(file, engine="mujoco", progress=False)


def test_a_file_that_stepcore_refuses_can_be_predicted():
    result = sc.predict(JELLY, engine="mujoco", horizon=0.3, starts=2, progress=False)
    assert result.time > 0 and result.integrator in ("rk4", "implicitfast", "discrete")
    assert result.ran.endswith(f"in MuJoCo {mujoco.__version__} alone")


def test_a_file_that_stepcore_refuses_has_sweeps_and_steps():
    result = sc.converge(JELLY, engine="mujoco", horizon=0.3, starts=1, progress=False)
    assert result.verdict == "solved"
    errors = [trial.error for trial in result.dts]
    assert errors == sorted(errors, reverse=True)


def test_a_map_of_a_file_that_stepcore_refuses():
    grid = {"path": "joint/lift/damping", "values": [1.0, 4.0], "dts": [5e-4, 1e-3]}
    result = sc.stability_map(JELLY, **grid, engine="mujoco", horizon=0.2, progress=False)
    assert [cell.state for cell in result.panels[0].cells] == ["accurate"] * 4
    assert result.panels[0].boundary is None
    with pytest.raises(ValueError, match="must be given"):
        sc.stability_map(JELLY, path=grid["path"], engine="mujoco", progress=False)
