"""Values of a model from logs: hidden ones found again, in logs of ours and of MuJoCo."""

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson

pytest.importorskip("scipy")

ARM = """<mujoco><option timestep="0.002" integrator="Euler"/><worldbody>
 <body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0" damping="{damping}"
  armature=".01"/><geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass="1"/>
 <body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0" damping=".05"
  frictionloss="{loss}"/><geom name="rod" type="capsule" size=".03" fromto="0 0 0 .3 0 0"
  mass="{mass}"/></body></body></worldbody>
 <actuator><position name="a" joint="shoulder" kp="{kp}" kv="2"/><motor joint="elbow"/></actuator>
 </mujoco>"""
TRUE = {"damping": 0.3, "loss": 0.04, "mass": 0.7, "kp": 60.0}
GUESS = {"damping": 0.1, "loss": 0.1, "mass": 0.4, "kp": 30.0}
RANGES = {
    "joint/shoulder/damping": (0.01, 2.0),
    "joint/elbow/frictionloss": (0.001, 0.5),
    "body/fore/mass": (0.1, 3.0),
    "actuator/a/kp": (5.0, 200.0),
}
HIDDEN = dict(zip(RANGES, (0.3, 0.04, 0.7, 60.0), strict=True))


def controls(steps):
    time = np.arange(steps) * 0.002
    return np.stack([0.8 * np.sin(4 * time), 0.4 * np.sign(np.sin(7 * time))], axis=1)


def mujoco_log(steps=600, every=5):
    """The states that MuJoCo steps through, read every 10 ms."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(ARM.format(**TRUE))
    data, ctrl = mujoco.MjData(model), controls(steps)
    rows = {"time": [], "qpos": [], "qvel": [], "ctrl": []}
    for step in range(steps):
        if step % every == 0:
            data.ctrl[:] = ctrl[step]
            for key, value in (("time", data.time), ("qpos", data.qpos), ("qvel", data.qvel)):
                rows[key].append(np.copy(value))
            rows["ctrl"].append(np.copy(data.ctrl))
        mujoco.mj_step(model, data)
    return {key: np.array(value) for key, value in rows.items()}


def guess():
    return sc.loads(ARM.format(**GUESS)).compile()


def test_hidden_values_of_a_log_that_mujoco_made():
    found = sc.identify(guess(), mujoco_log(), RANGES)
    assert found.values == pytest.approx(HIDDEN, rel=1e-6)
    assert found.alike == [] and found.unknown == []
    assert max(found.residuals.values()) < 1e-6 < min(found.before.values())
    # What the step leaves out is told: it is more than the residual.
    assert found.integration["qpos[elbow]"] > found.residuals["qpos[elbow]"]
    assert "take shorter steps" in str(found).replace("\n", " ")
    assert found.model.with_values({}).scene.joint("shoulder").damping == pytest.approx(0.3)


def test_noise_gaps_and_velocities_that_were_not_measured():
    log, rng = mujoco_log(), np.random.default_rng(0)
    del log["qvel"]
    log["qpos"] += rng.normal(0, 1e-3, log["qpos"].shape)
    log["qpos"][20:40, 1] = np.nan
    found = sc.identify(guess(), log, RANGES)
    for path, value in HIDDEN.items():
        low, high = found.intervals[path]
        middle, half = (low + high) / 2, (high - low) / 2
        # 95 % intervals, half as wide again, because there are four.
        assert abs(middle - value) <= 1.5 * half, path
        assert half < 0.5 * value
    assert set(found.residuals) == {"qpos[shoulder]", "qpos[elbow]"}
    for residual in found.residuals.values():
        assert residual == pytest.approx(1e-3, rel=0.3)


def test_what_cannot_be_told_apart_is_named():
    """Of a spring alone, the mass and the stiffness have one frequency."""
    model = lesson.spring().compile().with_settings(dt=0.005, integrator="semi-implicit")
    sim = sc.Sim(model)
    sim.reset("start")
    log = sim.run(0.5)
    mass = model.body_names[1]
    found = sc.identify(
        model, log, {"joint/spring/stiffness": (20, 500), f"body/{mass}/mass": (0.1, 10)}
    )
    assert [set(paths) for paths in found.alike] == [set(found.values)]
    assert "cannot tell apart" in str(found)


def test_files_and_trajectories_are_logs(tmp_path):
    true = guess().with_values(HIDDEN)
    run = sc.Sim(true).run(0.4, control=controls(200), record=("qpos", "qvel", "ctrl"))
    run.save(tmp_path / "run.csv")
    run.save(tmp_path / "run.npz")
    wanted = {"joint/shoulder/damping": RANGES["joint/shoulder/damping"]}
    others = {key: HIDDEN[key] for key in HIDDEN if key not in wanted}
    model = guess().with_values(others)
    for log in (run, tmp_path / "run.csv", str(tmp_path / "run.npz"), [run, run]):
        found = sc.identify(model, log, wanted)
        assert found.values["joint/shoulder/damping"] == pytest.approx(0.3, rel=1e-4)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"parameters": {}}, "parameters = {}: must be a dict of paths and ranges"),
        ({"parameters": {"joint/elbow/damping": 3}}, r"must be a range \(low, high\)"),
        ({"parameters": {"joint/elbow/damping": (1, 2)}}, "must be a range around 0.05"),
        ({"parameters": {"joint/elbo/damping": (1, 2)}}, 'no joint is named "elbo"'),
        ({"parameters": {"geom/rod/friction": (0.1, 2)}}, "name one, as geom/rod/friction"),
        ({"logs": []}, "logs: must be at least one"),
        ({"logs": {"qpos": [1.0]}}, r"logs\[0\]: must be a Trajectory, a DataFrame"),
        ({"logs": {"time": [0.0, 0.1], "qpos": np.zeros((2, 2))}}, "ctrl is missing"),
        ({"logs": {"time": [0.1, 0.0], "qpos": np.zeros((2, 2))}}, "increasing"),
        (
            {"logs": {"time": [0, 0.1], "qpos": np.zeros((2, 3)), "ctrl": np.zeros((2, 2))}},
            r"qpos has shape \(2, 3\): must be \(2, 2\)",
        ),
        (
            {"logs": {"time": [0, 1], "qpos": np.full((2, 2), np.nan), "ctrl": np.zeros((2, 2))}},
            "the first row of qpos must be whole",
        ),
    ],
)
def test_what_does_not_fit_is_told(change, message):
    given = {"logs": {"time": [0.0, 0.1], "qpos": np.zeros((2, 2)), "ctrl": np.zeros((2, 2))}}
    given |= {"parameters": {"joint/elbow/damping": (0.01, 1)}} | change
    with pytest.raises(ValueError, match=message):
        sc.identify(guess(), **given)
