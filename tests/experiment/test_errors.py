"""Each error of a trade against what is known of it: momentum, joints, friction, models."""

import dataclasses
import math

import numpy as np
import pytest
from small import by

import stepcore as sc
from stepcore import lesson
from stepcore.experiment.friction import Friction
from stepcore.measure.trade.rows import Further

G = 9.81


def trade(scene, **options):
    chosen = {"threads": 1, "progress": False, "starts": 1, "precisions": ["f64"], "by": "flops"}
    return sc.trade(scene, **(chosen | options))


def two_balls(gravity=(0, 0, -1.0), floor=False):
    """Free balls that meet in flight, off centre, with friction."""
    scene = sc.Scene(gravity=gravity, name="two balls")
    for name, at in (("one", (-0.15, 0, 0)), ("two", (0.15, 0.05, 0))):
        ball = scene.add_body(name, pos=at)
        scene.add_joint(ball, "free")
        scene.add_geom(ball, "sphere", 0.1, mass=2.0)
    if floor:
        scene.add_geom("world", "plane", pos=(0, 0, -0.15))
    scene.add_key(
        qpos=[-0.15, 0, 0, 1, 0, 0, 0, 0.15, 0.05, 0, 1, 0, 0, 0],
        qvel=[1, 0, 0, 0, 0, 3, -1, 0, 0, 0, 2, 0],
    )
    scene.options = {"dt": 0.005, "integrator": "semi-implicit"}
    return scene


def test_forces_between_bodies_give_no_momentum():
    result = trade(two_balls(), horizon=0.4, dts=[0.005], integrators=["semi-implicit"])
    e = result.shipped.errors
    assert max(path.overlap for path in result.reference.runs) > 0
    # Contact forces act on both at one point: to rounding of 4 kg at 1 m/s.
    assert e.momentum < 1e-13 and e.angular_momentum < 1e-13
    # What stands still takes momentum that is not known.
    floor = trade(two_balls(floor=True), horizon=0.7, dts=[0.005], integrators=["semi-implicit"])
    assert floor.shipped.errors.momentum is None
    assert floor.table[0]["angular_momentum"] is None


def test_a_tumbling_body_loses_angular_momentum_at_first_order():
    scene = sc.Scene(gravity=(0, 0, 0))
    scene.add_body("plate", mass=1.0, inertia=(0.1, 0.2, 0.3))
    scene.add_joint("plate", "free")
    scene.add_key(qvel=[1, 0, 0, 1.0, 2.0, 3.0])
    scene.options = {"dt": 0.01, "integrator": "semi-implicit"}
    result = trade(scene, dts=[0.01, 0.005], integrators=["semi-implicit"], horizon=0.4)
    lost = [by(result, dt=dt).errors.angular_momentum for dt in (0.01, 0.005)]
    # A step turns the body and then its momentum: I a = -ω × I ω, explicitly, is wrong by
    # dt |ω × (I ω × …)| / 2 a second; here its order is asked for, and its size by running.
    assert lost[0] / lost[1] == pytest.approx(2, rel=0.05)
    sim = sc.Sim(scene, dt=0.01)
    sim.reset(key=0)
    begin, most = sim.momentum.angular, 0.0
    for _ in range(40):
        sim.step()
        most = max(most, float(np.linalg.norm(sim.momentum.angular - begin)))
    # About the centre, which moves from the origin along its momentum: the same.
    assert lost[0] == pytest.approx(most, rel=1e-9)
    # Motors inside the body are no outside force; a damper on the free joint is one.
    scene.joints[0].damping = 0.1
    options = {"dts": [0.01], "integrators": ["semi-implicit"], "horizon": 0.1}
    assert trade(scene, **options).shipped.errors.momentum is None


def test_limits_are_passed_as_deep_as_the_law_says():
    # Under the lesson's law a weight at rest is s m g dt²/β deep, on a limit as on a floor.
    scene = sc.Scene(gravity=(0, 0, -G))
    scene.add_body("weight", mass=3.0, inertia=(1, 1, 1))
    scene.add_joint("weight", "slide", axis=(0, 0, 1), range=(0.0, 1.0))
    depth = 0.5 * 3.0 * G * 0.01**2 / 0.2
    scene.add_key(qpos=[-depth])
    scene.options = {"dt": 0.01, "integrator": "semi-implicit", "solver": "pgs", "sweeps": 1}
    scene.options |= {"law": "lesson", "softness": 0.5, "beta": 0.2, "warm_start": False}
    result = trade(scene, dts=[0.01], integrators=["semi-implicit"], horizon=0.4)
    e = result.shipped.errors
    assert e.limit == pytest.approx(depth, rel=1e-9) and e.joint is None and e.overlap == 0


def test_a_connection_hangs_open_by_what_its_softness_lets_it():
    # A weight on a connection: at rest a = 0, so k d r = -R f; MuJoCo's r at its own R and k.
    scene = sc.Scene(gravity=(0, 0, -G))
    scene.add_body("weight", pos=(0, 0, -1), mass=3.0, inertia=(1, 1, 1))
    scene.add_joint("weight", "slide", axis=(0, 0, 1))
    scene.add_equality("connect", "world", "weight", anchor=(0, 0, 0))
    scene.options = {"dt": 0.005, "integrator": "euler"}
    sim = sc.Sim(scene)
    sim.step(2000)
    result = trade(scene, dts=[0.005], integrators=["euler"], horizon=0.4)
    # It starts closed and sags without overshoot; after 0.4 s it hangs as it does after 10 s.
    assert result.shipped.errors.joint == pytest.approx(abs(float(sim.qpos[0])), rel=1e-3)
    assert result.shipped.errors.limit is None


def slider(angle, push=0.0, slopes=(1.0, 0.0), **options):
    """A ball that cannot roll, on a floor; it slides at 2 m/s, at an angle, or is pushed."""
    scene = sc.Scene(gravity=(slopes[1], 0, -G), name="slider")
    scene.add_geom("world", "plane", friction=0.5)
    body = scene.add_body("block", pos=(0, 0, 0.1))
    for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1)):
        scene.add_joint(body, "slide", axis=axis)
    scene.add_geom(body, "sphere", 0.1, mass=1.0, friction=0.5)
    speed = 0.0 if push else 2.0
    scene.add_key(qvel=[speed * math.cos(angle), speed * math.sin(angle), 0])
    scene.options = {"dt": 0.002, "integrator": "semi-implicit", "solver": "pgs", "sweeps": 50}
    scene.options |= {"law": "lesson", "cone": "pyramidal"} | options
    return scene


@pytest.mark.parametrize("degrees", [0, 25, 45, 65])
def test_the_anisotropy_of_the_box_by_turning_the_slide(degrees):
    # |f_x|, |f_y| <= μ n, both at their bounds: the force points along the diagonal, whatever the
    # slip, unless that is along an axis. Both speeds fall by μ g t, which turns the slip away.
    angle, slowed = math.radians(degrees), 0.5 * G * 0.08
    options = {"dts": [0.002], "integrators": ["semi-implicit"], "horizon": 0.08}
    found = trade(slider(angle), **options).shipped.errors.anisotropy
    last = math.atan2(2 * math.sin(angle) - slowed, 2 * math.cos(angle) - slowed)
    wanted = abs(math.pi / 4 - last) if degrees else 0.0
    assert found == pytest.approx(wanted, abs=1e-3)
    found = trade(slider(angle, cone="elliptic"), **options).shipped.errors.anisotropy
    assert found == pytest.approx(0.0, abs=1e-6)
    assert trade(lesson.spring(), horizon=0.1, dts=[0.01]).shipped.errors.anisotropy is None


def test_what_is_held_creeps_as_its_softness_says():
    # solref's friction: 0 = a = -b v - R f for a held row, so v = -R f / b, with b of solref.
    options = {"law": "solref", "solver": "newton", "integrator": "euler", "cone": "elliptic"}
    scene = slider(0.0, push=1.0, slopes=(1.0, 1.0), **options)
    result = trade(scene, dts=[0.002], integrators=["euler"], horizon=0.4)
    sim = sc.Sim(scene)
    sim.step(2000)
    rows = sim.rows
    b, creeping = 2 / (0.95 * 0.02), abs(float(sim.qvel[0]))
    held = [row for row in rows if row["kind"] == "contact"][1:]
    force = np.hypot(*(row["force"] for row in held))
    assert force == pytest.approx(1.0, rel=1e-3)
    assert creeping == pytest.approx(held[0]["regulariser"] * force / b, rel=0.02)
    # The fastest of the run is while the contact settles, which may be faster.
    assert creeping * 0.99 <= result.shipped.errors.creep < 3 * creeping
    # Under the lesson's law friction rows have no softness.
    scene = slider(0.0, push=1.0, slopes=(1.0, 1.0), cone="elliptic")
    result = trade(scene, dts=[0.002], integrators=["semi-implicit"], horizon=0.2)
    assert result.shipped.errors.creep < 1e-12
    # Of a block that stays there is no error to halve.
    assert result.error(result.shipped) == 0
    assert "No setting tried halves that error." in " ".join(result.text().split())


def test_errors_are_relative_to_the_size_of_the_scene():
    result = trade(lesson.spring(), horizon=0.4)
    e = result.shipped.errors
    # Nothing has a length but the motion cos(10 t), seen every 40 ms.
    assert result.size == pytest.approx(math.cos(0.4) - math.cos(3.2), rel=1e-9)
    assert e.relative == pytest.approx(e.position / result.size, rel=1e-12)
    assert e.relative_max == pytest.approx(e.position_max / result.size, rel=1e-12)


def test_no_rms_is_above_the_largest_error_nor_on_further_starts():
    """A wheel that turns on the spot: its centre is exact, and all of the error is rotation."""
    scene = sc.Scene(gravity=(0, 0, 0))
    wheel = scene.add_body("wheel", mass=1.0, inertia=(0.01, 0.01, 0.01))
    scene.add_joint(wheel, "hinge", stiffness=1.0)
    scene.add_key(qpos=[1.0])
    scene.options = {"dt": 0.01, "integrator": "semi-implicit"}
    result = trade(scene, horizon=0.4, error=1e-3, by="flops", further=4)
    tested = [row for row in result.rows if row.errors and row.further]
    assert tested and tested[0].errors.angle_max > 0
    for row in result.rows:
        assert result.frontier.largest(row) >= result.frontier.searched(row) > 0
        assert row.errors.position_max >= row.errors.high
    # All that is printed of rows is of the same starts, whichever ran from further ones too.
    row = dataclasses.replace(tested[0], further=Further(4, 4, 0.5))
    trade_ = dataclasses.replace(result, frontier=result.frontier.updated(row))
    assert trade_.error(row) == 0.5 and trade_.tables(True)[0].records == (
        result.tables(True)[0].records
    )


def test_a_contact_that_is_about_to_overflow_is_looked_at_in_silence():
    """A run that diverges is finite until its last step: 1e308 m/s times 10 m is not."""
    scene = sc.loads(
        '<mujoco><worldbody><geom type="plane" size="5 5 .1"/><body pos="0 0 9.99"><freejoint/>'
        '<geom size="10" mass="1"/></body></worldbody></mujoco>'
    )
    model = scene.compile()
    sim = sc.Sim(model)
    sim.forward()
    contacts = sim.contacts
    sim.qvel = [0.0, 0.0, 0.0, 1e307, 1e308, 0.0]
    (slip,) = Friction(model, [1]).slips(sim, contacts).values()
    assert not np.isfinite(slip.speed)
