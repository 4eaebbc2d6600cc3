"""The examples of control reach what they are for."""

import importlib.util
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


def example(name):
    if not EXAMPLES.is_dir():
        pytest.skip("no examples beside the tests")
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_lqr_holds_the_pole():
    pytest.importorskip("scipy")
    pytest.importorskip("gymnasium")
    assert example("lqr").main() < 0.05


def test_sampling_mpc_swings_the_pole_up():
    assert example("mppi").main() > 0.5
