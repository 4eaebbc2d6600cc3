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

    The fastest mode is ω = 2 √(k/m) cos(π / (2 n + 1)), √2 times that of a spring alone.
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
    limit = 1 / (math.sqrt(1e4) * math.cos(math.pi / 41))
    text = stiffness(series(20, 1e4, dt=1.2 * limit, integrator="semi-implicit"))
    assert text.startswith("dt 12 ms explodes under semi-implicit: the 20 springs of joints `h0`")
    assert "limit dt to 10 ms" in text
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


# --- names --------------------------------------------------------------------------------------


def planar(kp, kv, **options):
    """Links of 0.3 m and 0.5 kg in a plane, a position servo on each hinge."""
    scene = sc.Scene(gravity=(0, 0, 0), name="planar").with_settings(**options)
    parent = scene.world
    for i, (gain, damping) in enumerate(zip(kp, kv, strict=True)):
        parent = scene.add_body(f"link{i}", parent=parent, pos=(0.3 * (i > 0), 0, 0))
        scene.add_joint(parent, "hinge", name=f"j{i}", axis=(0, 1, 0))
        ends = (0, 0, 0, 0.3, 0, 0)
        scene.add_geom(parent, "capsule", 0.03, fromto=ends, mass=0.5, **stiff.INERT)
        servo = {"type": "position", "kp": gain, "kv": damping}
        scene.add_actuator(f"j{i}", name=f"servo{i}", **servo)
    return scene


def real_limit(scene, integrator, near, steps=1000):
    """The largest stable dt of the real step [s], around the pose at rest."""
    model = scene.compile()
    return stiff.bisected(
        lambda dt: stiff.stays(model, integrator, dt, steps), near / 3, 12 * near, fine=5e-3
    )


def test_the_servo_is_named_whose_softening_raises_the_real_limit_most():
    """Law: of an arm under rk4, servo4 has the largest share in the mode, but servo3 is what limits
    dt: a tenth of its gains raises the bisected limit of the real step by 32 %, a tenth of
    servo4's by 10 %."""
    kp, kv = [3157, 14, 3039, 2743, 5915, 984], [0.25, 1.27, 1.25, 3.81, 0.9, 4.89]
    d = diagnosed(planar(kp, kv, dt=1e-3, integrator="rk4"))
    assert max(d.shares["rk4"], key=d.shares["rk4"].get) == "servo `servo4`"
    assert d.stiffest() == "servo `servo3`"
    real = real_limit(planar(kp, kv), "rk4", d.limit())
    assert d.limit() == pytest.approx(real, rel=0.05)
    rises = []
    for i in (4, 3):
        softer = [[g * (0.1 if k == i else 1) for k, g in enumerate(gains)] for gains in (kp, kv)]
        rises.append(real_limit(planar(*softer), "rk4", d.limit()) / real)
    assert rises[0] < 1.15 and rises[1] > 1.25


def test_ten_equal_springs_are_named_together():
    """Law: no spring of ten in a row limits dt by itself; all do, at ω = 2 √(k/m) cos(π/21)."""
    d = diagnosed(series(10, 1e4, dt=0.005, integrator="semi-implicit"))
    assert d.together() == [f"spring of joint `h{i}`" for i in range(10)]
    assert d.limit() == pytest.approx(1 / (100 * math.cos(math.pi / 21)), rel=2e-3)
    together = "the 10 springs of joints `h0`, `h1`, `h2`, `h3` and 6 more together"
    assert d.stiffest() == together and f"{together} (" in d.sentences[0]
    assert " limit dt to 10.1 ms" in d.sentences[0]
    # A spring that is stiffer than the others is named by itself.
    scene = series(10, 1e4, dt=0.005, integrator="semi-implicit")
    scene.joints[4].stiffness = 1e5
    assert diagnosed(scene).together() == ["spring of joint `h4`"]
