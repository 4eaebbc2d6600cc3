"""`diagnose`: cures by bisection on the real step, names, and a warning that never fails a load."""

import math
import warnings

import pytest
import stiff

import stepcore as sc
from stepcore.engine.linear_maps import INTEGRATORS
from stepcore.measure.diagnosis.oscillator import oscillator_dt
from stepcore.measure.diagnosis.stiffness_warning import stiffness


def diagnosed(scene, **options):
    options = {"horizon": 0.1, "threads": 1, "progress": False} | options
    return sc.diagnose(scene, **options)


def series(count, k, mass=1.0, **options):
    """Equal masses in a row, an equal spring between neighbours: the last is free.

    The fastest mode is ω = 2 √(k/m) cos(π / (4 n + 2)), √2 times that of a spring alone.
    """
    scene = sc.Scene(gravity=(0, 0, 0), name="series").with_settings(**options)
    parent = scene.world
    for i in range(count):
        parent = scene.add_body(f"mass{i}", parent=parent, pos=(1, 0, 0))
        scene.add_joint(parent, "slide", name=f"h{i}", axis=(1, 0, 0), stiffness=k)
        scene.add_geom(parent, "sphere", 0.1, mass=mass, **stiff.INERT)
    return scene


# --- the warning at load ------------------------------------------------------------------------


def test_the_load_warning_uses_the_whole_step():
    """Law: twenty springs in series limit dt to 2/ω, 1/√2 of what one alone does. At 1.2 times
    that the step explodes; a spring alone would have a margin of 1.18."""
    limit = 1 / (math.sqrt(1e4) * math.cos(math.pi / 82))
    text = stiffness(series(20, 1e4, dt=1.2 * limit, integrator="semi-implicit"))
    assert text.startswith("dt 12 ms explodes under semi-implicit") and "limits dt to 10 ms" in text
    assert not stiffness(series(20, 1e4, dt=0.49 * limit, integrator="semi-implicit"))


def test_the_load_warning_says_nothing_of_what_it_does_not_linearise():
    assert stiffness(series(20, 1e8, dt=0.01))
    assert not stiffness(series(41, 1e8, dt=0.01))


HUGE = (
    'stiffness="1e308"',
    'damping="1e154"',
    'damping="1e308"',
    'stiffness="1" armature="1e154"',
    'stiffness="1" damping="1" armature="1e308"',
    'stiffness="1e-308" damping="1e-308"',
    'frictionloss="1e308" solreffriction="-1e300 -1e300"',
    'range="-1 1" limited="true" solreflimit="-1e300 -1e300"',
    'range="-1 1" limited="true" solreflimit="1e-200 1e-200" stiffness="1"',
)


@pytest.mark.parametrize("integrator", ["Euler", "RK4", "implicitfast"])
@pytest.mark.parametrize("attributes", HUGE)
def test_a_warning_never_fails_a_load(integrator, attributes):
    text = f"""<mujoco><option integrator="{integrator}"><flag refsafe="disable"/></option>
    <worldbody><body><joint name="k" type="slide" {attributes}/><geom size=".1" mass="1"/></body>
    </worldbody></mujoco>"""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", sc.StiffnessWarning)
        assert sc.loads(text).joints[0].name == "k"


def test_a_limit_too_short_to_ask_for_is_not_printed():
    """Law: k = 1e20 on 1 kg has ω = 1e10 and a limit of 0.2 ns: no step of use comes near."""
    text = stiffness(stiff.slider(1e20, dt=0.01, integrator="euler"))
    assert "every step tried unstable, down to 1 µs" in text and " ns" not in text
    d = diagnosed(stiff.slider(1e20, dt=0.01, integrator="euler"))
    assert d.limit() == 0.0 and d.stiffest() == "spring of joint `slide`"
    assert "every step tried unstable, down to 1 µs" in d.sentences[0]
    assert " ns" not in d.text(full=True)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_closed_forms_keep_their_range(integrator):
    """Law: limits scale as 1/rate, from the largest number to the smallest."""
    assert oscillator_dt(1e308, 1e308, 0.0, integrator) >= 0.0
    assert oscillator_dt(1e-308, 1e-308, 1e-308, integrator) == math.inf
    here = oscillator_dt(1e3, 2e2, 0.0, integrator)
    assert oscillator_dt(1e63, 2e62, 0.0, integrator) == pytest.approx(1e-60 * here, rel=1e-2)
