"""A network from a file as a control function, with substitutes for the packages that read it."""

import contextlib
import pickle
import sys
import types

import numpy as np
import pytest

import stepcore as sc
from stepcore.cli import main
from stepcore.experiment.motion import Motion

CARTS = """<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody>
<body name="a"><joint name="x" type="slide" damping="1"/><geom size="0.1" mass="2"/></body>
<body name="b" pos="0 0 5"><joint name="y" type="slide"/><geom size="0.1" mass="4"/></body>
</worldbody><actuator><motor name="a" joint="x"/><motor name="b" joint="y"/></actuator>
<keyframe><key qpos="0.1 -0.2"/></keyframe></mujoco>"""
GAINS = np.array([[-9.0, 0.5, -2.0, 0.0], [1.0, -7.0, 0.0, -3.0]], np.float32)


def feedback(time, sim):
    return GAINS @ np.concatenate([sim.qpos, sim.qvel]).astype(np.float32)


class Session:
    """onnxruntime.InferenceSession of the network GAINS, for rows of `width` numbers."""

    width, inputs, made = 4, 1, 0

    def __init__(self, path, options, providers):
        assert options.intra_op_num_threads == 1 and providers == ["CPUExecutionProvider"]
        type(self).made += 1

    def get_inputs(self):
        entry = types.SimpleNamespace(name="obs", shape=["batch", self.width])
        return [entry] * self.inputs

    def run(self, outputs, given):
        assert outputs is None and given["obs"].dtype == np.float32
        return [given["obs"] @ GAINS.T]


class Tensor(np.ndarray):
    def numpy(self):
        return np.asarray(self)


@pytest.fixture
def networks(monkeypatch, tmp_path):
    """Substitutes for both packages, and the paths of a file for each."""
    options = type("SessionOptions", (), {})
    runtime = types.SimpleNamespace(SessionOptions=options, InferenceSession=Session)
    module = types.SimpleNamespace(eval=lambda: lambda row: ((row @ GAINS.T).view(Tensor), None))
    torch = types.SimpleNamespace(
        jit=types.SimpleNamespace(load=lambda path, map_location: module),
        inference_mode=contextlib.nullcontext,
        from_numpy=lambda array: array,
    )
    monkeypatch.setitem(sys.modules, "onnxruntime", runtime)
    monkeypatch.setitem(sys.modules, "torch", torch)
    monkeypatch.setattr(Session, "made", 0)
    for name in ("net.onnx", "net.pt"):
        (tmp_path / name).touch()
    (tmp_path / "carts.xml").write_text(CARTS)
    return tmp_path


@pytest.mark.parametrize("name", ["net.onnx", "net.pt"])
def test_a_network_controls_as_the_function_that_it_is(networks, name):
    scene = sc.loads(CARTS)
    mine = sc.run(scene, horizon=0.5, control=feedback, control_dt=0.02)
    run = sc.run(scene, horizon=0.5, control=sc.policy(networks / name), control_dt=0.02)
    np.testing.assert_allclose(run.sim.qpos, mine.sim.qpos, rtol=1e-6)
    assert f"driven by the control function `{name}`, sampled every 20 ms" in run.ran


def test_a_measurement_reads_the_network_once_and_its_result_pickles(networks):
    net = sc.policy(networks / "net.onnx")
    motion = Motion(horizon=0.1, control=net, control_dt=0.02)
    sc.converge(sc.loads(CARTS), motion, threads=2, progress=False)
    assert Session.made == 1
    again = pickle.loads(pickle.dumps(motion)).control
    assert again.path == net.path and repr(again) == f"policy({net.path!r})"


def test_observations_and_actions_are_the_user_s(networks, monkeypatch):
    monkeypatch.setattr(Session, "width", 5)
    net = sc.policy(networks / "net.onnx")
    with pytest.raises(ValueError, match=r"expects 5 inputs, not 4: observe=FUNCTION"):
        sc.run(sc.loads(CARTS), control=net)
    monkeypatch.setattr(Session, "width", 4)
    net = sc.policy(
        networks / "net.onnx",
        observe=lambda time, sim: [*sim.qpos, *(2 * sim.qvel)],
        act=lambda action, sim: np.clip(action, -1, 1),
    )
    sim = sc.Sim(sc.loads(CARTS))
    sim.qvel = [0.5, 0.25]
    expected = np.clip(GAINS @ [0, 0, 1.0, 0.5], -1, 1)
    assert net(0.0, sim) == pytest.approx(expected, rel=1e-6)


def test_what_is_no_policy_is_refused(networks, monkeypatch):
    with pytest.raises(ValueError, match=r"must end in \.onnx, \.pt, \.pth, \.ts"):
        sc.policy("net.txt")
    monkeypatch.setattr(Session, "inputs", 2)
    with pytest.raises(ValueError, match=r"has 2 inputs \(obs, obs\); write a control function"):
        sc.run(sc.loads(CARTS), control=sc.policy(networks / "net.onnx"))


@pytest.mark.parametrize(("name", "package"), [("net.onnx", "onnxruntime"), ("net.pt", "torch")])
def test_a_missing_package_and_a_missing_file_are_named(
    networks, monkeypatch, capsys, name, package
):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"needs {package}: pip install"):
        sc.run(sc.loads(CARTS), control=sc.policy(networks / name))
    file = str(networks / "carts.xml")
    assert main(["run", file, "--control", str(networks / name)]) == 2
    assert f"needs {package}: pip install" in capsys.readouterr().err
    assert main(["run", file, "--control", f"no-{name}"]) == 2
    assert f"no-{name}: no such file" in capsys.readouterr().err


def test_the_command_line_takes_a_network_and_hands_it_on(networks, capsys, monkeypatch):
    monkeypatch.chdir(networks)
    given = ["--control", "net.onnx", "--control-dt", "20ms", "--horizon", "100ms"]
    assert main(["check", "carts.xml", *given, "--threads", "1"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    words = "--horizon 0.1 --control net.onnx --control-dt 0.02"
    assert f"stepcore predict carts.xml {words}" in said
