"""gymnasium's own checker, its warnings as errors."""

import subprocess
import sys
import warnings

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env

import stepcore.gymnasium
from stepcore.gymnasium.tasks import TASKS


def check(env, skip_render_check=False):
    with warnings.catch_warnings():
        # The spaces are those of gymnasium's own tasks, of which it says the same.
        warnings.filterwarnings("ignore", ".*recommend using a symmetric and normalized space")
        warnings.filterwarnings("ignore", ".*A Box observation space m.*infinit?y")
        check_env(env, skip_render_check=skip_render_check)


@pytest.mark.parametrize("name", TASKS)
def test_gymnasiums_checker_finds_nothing(name):
    # Of every task the same code draws.
    check(gymnasium.make(f"stepcore/{name}-v0").unwrapped, skip_render_check=name != "Hopper")


def test_gymnasiums_checker_finds_nothing_in_an_environment_of_ones_own():
    env = stepcore.gymnasium.Env(
        CART,
        reward=lambda now: -abs(now.qpos[..., 0]),
        reset=lambda model, rng: (rng.normal(size=model.nq), rng.normal(size=model.nv)),
    )
    with pytest.warns(UserWarning, match="does not have a spec|having a spec"):
        check(env)


CART = stepcore.loads(
    """<mujoco><worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"/>
    <geom size="0.1" mass="1"/></body></worldbody>
    <actuator><motor joint="x" ctrlrange="-1 1"/></actuator></mujoco>"""
)


def test_without_gymnasium_it_says_what_to_install():
    code = "import sys; sys.modules['gymnasium'] = None; import stepcore.gymnasium"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.stderr.splitlines()[-1] == (
        "ImportError: stepcore.gymnasium needs gymnasium: "
        "pip install '.[gymnasium]' in a clone of stepcore"
    )
