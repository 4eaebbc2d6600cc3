"""How well the truth of a trade is known: orders, closed forms, and the rule without either."""

import decimal
from dataclasses import replace

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.engine.start import Start
from stepcore.experiment.closed_form import closed, expm
from stepcore.experiment.converged import known, observed, shown
from stepcore.experiment.errors import Errors
from stepcore.experiment.run import Run
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import Schedule

PI = decimal.Decimal("3.14159265358979323846264338327950288419716939937510582097494459")


def trade(scene, **options):
    chosen = {"threads": 1, "progress": False, "starts": 1, "precisions": ["f64"]}
    return sc.trade(scene, **(chosen | options))


def apart(*values):
    """Halvings that moved the motion by so much, in every measure."""
    return [Errors(value, value, value, value, 0, 0, 0, 0, each=(value,)) for value in values]


def test_an_order_is_shown_by_three_halvings_within_a_fifth():
    assert observed([8.0, 4.0, 1.0]) == [1.0, 2.0]
    for order in (1, 2, 4):
        for p in (0.81 * order, order, 1.19 * order):
            assert shown([1.0, 2**-p, 2 ** (-2 * p)], floor=0.0) == order
        for p in (0.79 * order, 1.21 * order):
            assert shown([1.0, 2**-p, 2 ** (-2 * p)], floor=0.0) in (None, 1, 2, 4)
            assert shown([1.0, 2**-p, 2 ** (-2 * p)], floor=0.0) != order
    assert shown([1.0, 0.25], floor=0.0) is None
    assert shown([1.0, 2**-3.0, 2**-6.0], floor=0.0) is None
    # Shown, then lost; shown, then bettered; shown, then at rounding.
    assert shown([1.0, 0.25, 0.0625, 0.06], floor=0.0) is None
    assert shown([1.0, 0.25, 0.0625, 0.005], floor=0.0) == 2
    assert shown([1.0, 0.25, 0.0625, 0.06], floor=0.1) is None
    assert shown([1.0, 0.25, 0.0625, 0.06], floor=0.062) == 2


def test_without_an_order_the_error_is_twice_the_distance_of_two_integrators():
    rival = apart(5e-3)[0]
    sure = known(apart(4e-3, 1e-3, 2.5e-4), 0.0, rival, "euler")
    assert sure.error == pytest.approx(2.5e-4 / 3) and sure.orders["high"] == 2
    sure = known(apart(4e-3, 3e-3, 2.5e-4), 0.0, rival, "euler")
    assert sure.error == sure.high == 1e-2 and sure.orders["high"] is None
    assert sure.bases["high"] == "twice the distance to euler"
    # Two integrators that happen to agree know no more than the last halving told.
    sure = known(apart(4e-3, 3e-3, 2.5e-4), 0.0, apart(1e-9)[0], "euler")
    assert sure.largest == 2.5e-4
    assert known(apart(4e-3, 3e-3), 0.0, None, "").angle == 6e-3


def test_no_sample_is_further_off_than_all_of_them_together():
    halvings = apart(4e-3, 1e-3, 2.5e-4)
    halvings[1] = replace(halvings[1], position_max=3.9e-3)
    sure = known(halvings, 0.0, apart(5e-3)[0], "euler")
    assert sure.largest == 1e-2 and sure.orders["largest"] is None
    sure = known(halvings, 0.0, apart(5e-3)[0], "euler", count=100)
    assert sure.largest == pytest.approx(10 * 2.5e-4 / 3) and sure.orders["largest"] == 2


def test_the_matrix_exponential():
    turn = np.array([[0.0, 30.0], [-30.0, 0.0]])
    c, s = np.cos(30.0), np.sin(30.0)
    assert expm(turn) == pytest.approx(np.array([[c, s], [-s, c]]), abs=1e-13)
    assert expm(np.zeros((3, 3))).tolist() == np.eye(3).tolist()
    assert expm(np.array([[0.0, 5.0], [0.0, 0.0]])).tolist() == [[1.0, 5.0], [0.0, 1.0]]
    rng = np.random.default_rng(0)
    some = rng.normal(size=(6, 6))
    values, vectors = np.linalg.eigh(some + some.T)
    wanted = vectors @ np.diag(np.exp(values)) @ vectors.T
    assert expm(some + some.T) == pytest.approx(wanted, rel=1e-11)
    # A spring of 1e10 and mass 1, turned by 3 rad: balanced, nothing is lost to the units.
    spring = expm(np.array([[0.0, 1.0], [-1e10, 0.0]]) * 3e-5)
    assert spring[0] == pytest.approx([np.cos(3.0), np.sin(3.0) / 1e5], rel=1e-14)
    assert expm(some) @ expm(-some) == pytest.approx(np.eye(6), abs=1e-11)


def test_richardsons_estimate_is_the_reference_s_error_where_that_is_known():
    # x = cos 10 t: the closed form is the truth, and the converged run's error is known twice.
    result = trade(lesson.spring(), horizon=0.96, dts=[0.02, 0.01])
    reference = result.reference
    wanted = np.cos(10 * np.arange(1, 49) * 0.02)
    assert reference.runs[0].com[:, 0, 0] == pytest.approx(wanted, abs=1e-12)
    assert reference.basis == "closed form" and reference.error < 1e-12
    assert reference.known.orders["error"] == 4
    assert reference.exact.check == pytest.approx(reference.known.error, rel=0.2)
    assert reference.orders["rk4"] == pytest.approx([4, 4], abs=0.05)
    assert result.to_dict()["reference"]["closed_form"] == reference.exact.check
    assert "closed form" in str(result)


@pytest.mark.parametrize("stiffness", [1e2, 1.7e4, 1.3e6, 1.1e8, 1.9e10])
@pytest.mark.parametrize("period", [0.001, 1.0])
def test_the_closed_form_states_its_own_error_also_after_thousands_of_oscillations(
    stiffness, period
):
    # x = 0.1 cos ωt, whose phase is reduced exactly by decimals of 60 digits.
    scene = sc.Scene(gravity=(0, 0, 0))
    mass = 1.3
    scene.add_body("mass", mass=mass, inertia=(1, 1, 1))
    scene.add_joint("mass", "slide", axis=(1, 0, 0), stiffness=stiffness)
    model, count = scene.compile(), 300 if period < 1 else 20
    begin = Start(np.array([0.1]), np.array([0.0]))
    exact = closed(Runner(model, Schedule(period, count, 1, (begin,), None, None, ())), [Run()])
    with decimal.localcontext(prec=60):
        rate = (decimal.Decimal(stiffness) / decimal.Decimal(mass)).sqrt()
        turn = [float(rate * decimal.Decimal(period) * k % (2 * PI)) for k in range(1, count + 1)]
    true = np.abs(exact.runs[0].com[-count:, 0, 0] - 0.1 * np.cos(turn)).max()
    assert true <= exact.error <= 500 * true + 1e-13


def pair(damping=0.7):
    """Two carts on a line, tied to the world and to each other by springs and dampers."""
    scene = sc.Scene(gravity=(0, 0, 0), name="pair")
    scene.add_body("one", mass=2.0, inertia=(1, 1, 1))
    scene.add_joint("one", "slide", axis=(1, 0, 0), stiffness=30.0, damping=damping)
    scene.add_body("two", "one", mass=1.0, inertia=(1, 1, 1))
    joint = scene.add_joint("two", "slide", axis=(1, 0, 0), stiffness=50.0)
    scene.add_actuator(joint, name="motor", gear=[3.0], ctrlrange=(-1, 1))
    scene.add_key(qpos=[0.3, -0.2], qvel=[0.0, 1.0])
    scene.options = {"dt": 0.01, "integrator": "semi-implicit"}
    return scene


def test_the_closed_form_of_coupled_carts_under_steps_of_control():
    controls = [[1.0], [-5.0], [0.5], [0.0]]  # the second is clamped
    result = trade(pair(), ctrl=controls, control_dt=0.1, horizon=0.4, integrators=["rk4"])
    # M q'' = -D q' - K q + B u in joint coordinates; eigenvectors of the first-order system.
    inverse = np.linalg.inv([[3.0, 1.0], [1.0, 1.0]])
    slopes = np.block(
        [
            [np.zeros((2, 2)), np.eye(2)],
            [-inverse @ np.diag([30.0, 50.0]), -inverse @ np.diag([0.7, 0])],
        ]
    )
    values, vectors = np.linalg.eig(slopes)
    state = np.array([0.3, -0.2, 0.0, 1.0])
    for k, u in enumerate([1.0, -1.0, 0.5, 0.0]):
        rest = -np.linalg.solve(slopes, np.concatenate([[0, 0], inverse @ [0, 3.0 * u]]))
        grow = np.diag(np.exp(values * 0.1))
        state = rest + (vectors @ grow @ np.linalg.solve(vectors, state - rest)).real
        com = result.reference.runs[0].com[k, :, 0]
        assert com == pytest.approx([state[0], state[0] + state[1]], abs=1e-13)
    assert result.reference.exact.check < 1e-9


def test_a_free_ball_whose_centre_is_elsewhere_falls_and_spins():
    scene = sc.Scene(gravity=(0, 1.0, -9.81), name="ball")
    ball = scene.add_body("ball", mass=2.0, ipos=(0.1, 0.2, 0), inertia=(0.3, 0.3, 0.3))
    scene.add_joint(ball, "free")
    scene.add_key(qpos=[0, 0, 1, 0.6, 0.8, 0, 0], qvel=[1, 2, 3, 4, 5, 6])
    scene.options = {"dt": 0.01, "integrator": "semi-implicit"}
    result = trade(scene, horizon=0.4, dts=[0.01], integrators=["rk4"], starts=2)
    assert result.reference.exact is not None and result.reference.exact.check < 1e-9
    path, times = result.reference.runs[0], np.arange(1, 41)[:, None] * 0.01
    turn = np.array([[1, 0, 0], [0, -0.28, -0.96], [0, 0.96, -0.28]])
    speed = np.array([1, 2, 3]) + turn @ np.cross([4, 5, 6], [0.1, 0.2, 0])
    centre = np.array([0, 0, 1]) + turn @ [0.1, 0.2, 0]
    wanted = centre + times * speed + times**2 / 2 * [0, 1.0, -9.81]
    assert path.com[:, 0] == pytest.approx(wanted, abs=1e-13)


def swung(**joint):
    scene = sc.Scene(gravity=(0, 0, -9.81))
    scene.add_body("rod", mass=1.0, ipos=(0, 0, -1.0), inertia=(0.1, 0.1, 0.1))
    scene.add_joint("rod", "hinge", axis=(0, 1, 0), **joint)
    scene.add_key(qpos=[0.3])
    scene.options = {"dt": 0.01, "integrator": "rk4"}
    return scene


def test_no_closed_form_where_there_is_none():
    options = {"horizon": 0.2, "dts": [0.01], "integrators": ["rk4"]}
    assert trade(swung(), **options).reference.exact is None
    upright = swung()
    upright.joints[0].axis = (0, 0, 1)
    assert trade(upright, **options).reference.exact is not None
    # A limit that is met, dry friction, and a control that asks the state.
    upright.joints[0].range = (-1, 0.301)
    upright.keys[0].qvel = [1.0]
    assert trade(upright, **options).reference.exact is None
    upright.joints[0].range, upright.joints[0].frictionloss = None, 0.01
    assert trade(upright, **options).reference.exact is None


def test_the_reference_keeps_the_softness_that_the_scene_asks_for():
    scene = lesson.drop()
    scene.options = {"dt": 0.02, "integrator": "euler", "solver": "newton"}
    options = {"horizon": 0.4, "dts": [0.02], "integrators": ["euler"]}
    result = trade(scene, **options)
    assert result.shipped.clamped and not result.reference.settings.refsafe
    assert not result.reference.stiffens
    scene.options = {"law": "lesson", "dt": 0.02, "integrator": "semi-implicit", "solver": "pgs"}
    result = trade(scene, **(options | {"integrators": ["semi-implicit"]}))
    assert result.reference.stiffens
    assert any('under the law "lesson" contacts stiffen' in note for note in result.notes)
    assert not trade(lesson.spring(), horizon=0.1).reference.stiffens


def test_a_servo_has_a_closed_form_until_its_force_is_clamped():
    scene = sc.Scene(gravity=(0, 0, 0))
    scene.add_body("cart", mass=2.0, inertia=(1, 1, 1))
    joint = scene.add_joint("cart", "slide", axis=(1, 0, 0))
    scene.add_actuator(joint, type="position", kp=50.0, kv=20.0)
    scene.options = {"dt": 0.01, "integrator": "semi-implicit"}
    options = {"ctrl": [[0.5]], "dts": [0.01], "integrators": ["rk4"], "horizon": 0.4}
    result = trade(scene, **options)
    # 2 x'' + 20 x' + 50 x = 25: critically damped, 5 rad/s.
    t = np.arange(1, 41) * 0.01
    wanted = 0.5 * (1 - (1 + 5 * t) * np.exp(-5 * t))
    assert result.reference.runs[0].com[:, 0, 0] == pytest.approx(wanted, abs=1e-13)
    scene.actuators[0].forcerange = (-10.0, 10.0)
    assert trade(scene, **options).reference.exact is None


def test_what_bounces_between_two_looks_has_no_closed_form():
    # Up and down again to the floor and off it, with nothing touching at any sample.
    scene = sc.Scene(gravity=(0, 0, -10.0))
    scene.add_geom("world", "plane", condim=1)
    scene.add_body("ball", pos=(0, 0, 0.15))
    scene.add_joint("ball", "slide", axis=(0, 0, 1))
    scene.add_geom("ball", "sphere", 0.1, mass=1.0, condim=1)
    scene.options = {"dt": 0.002, "integrator": "semi-implicit", "solver": "pgs"}
    scene.options |= {"law": "rigid", "restitution": 1.0, "sweeps": 1}
    options = {"dts": [0.002], "integrators": ["semi-implicit"], "control_dt": 0.16}
    assert trade(scene, horizon=0.16, **options).reference.exact is None
    scene.body("ball").pos = (0, 0, 2.0)
    assert trade(scene, horizon=0.16, **options).reference.exact is not None
