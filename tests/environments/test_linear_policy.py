"""The example that learns a linear policy: its ONNX file is the policy, and it gets better."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location(
        "policy_example", ROOT / "examples/linear_policy.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_file_is_the_policy(example, tmp_path):
    gains = np.random.default_rng(0).normal(size=(300, 2))
    (tmp_path / "policy.onnx").write_bytes(example.onnx_file(gains))
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    seen = 20 * np.random.default_rng(1).normal(size=(5, 300)).astype(np.float32)
    (acted,) = session.run(None, {"observation": seen})
    expected = np.clip(np.clip(seen, -10, 10) @ gains.astype(np.float32), -1, 1)
    assert acted == pytest.approx(expected, abs=1e-4)


def test_it_learns(example, monkeypatch, tmp_path, capsys):
    file = tmp_path / "swim.onnx"
    words = ["linear_policy.py", "stepcore/Swimmer-v0", str(file), "--iterations", "8"]
    monkeypatch.setattr(sys, "argv", [*words, "--actions", "60"])
    example.main()
    first, _ = example.learn("stepcore/Swimmer-v0", 1, 60)
    assert file.exists() and np.abs(first).max() > 0
    assert float(capsys.readouterr().out.rsplit("return ", 1)[1].split()[0]) > 0
