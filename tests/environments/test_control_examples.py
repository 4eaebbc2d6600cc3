"""The examples of control reach what they are for."""

import importlib.util
from pathlib import Path

import pytest
from menagerie import SO101, needed

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


def test_ilqr_stands_the_hopper_up():
    """Its torso is at 1.25 m when its leg is straight."""
    pytest.importorskip("gymnasium")
    low, lean = example("ilqr").main()
    assert low > 1.15
    assert lean < 0.05


@needed
def test_the_arm_reaches_each_target():
    farthest = example("reach").main([str(SO101)])
    assert farthest < 0.005


def test_reaching_says_what_model_it_needs(tmp_path, capsys):
    with pytest.raises(SystemExit):
        example("reach").main([str(tmp_path / "so101.xml")])
    assert "so101.xml" in capsys.readouterr().err
