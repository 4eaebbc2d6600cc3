"""Position, velocity and general servos: against MuJoCo, closed forms and the numpy reference."""

import itertools

import mujoco
import numpy as np
import oracle
import peers
import pytest
import zoo
from covering import every_pair

import stepcore as sc

ARM = zoo.ZOO["servo_arm"].text


def servo(stiffness=1.0, mass=1.0, ratio=0.0, gear=1.0, **fields):
    """One mass on a slide, drawn to the control by a position servo; no gravity.

    The servo's frequency is gear × √(stiffness / mass), its damping ratio is exact in kv.
    """
    scene = sc.Scene(gravity=(0, 0, 0))
    body = scene.add_body("mass", mass=mass, inertia=(1, 1, 1))
    scene.add_joint(body, "slide", name="rail", axis=(1, 0, 0))
    kv = 2 * ratio * np.sqrt(stiffness * mass) / abs(gear)
    scene.add_actuator("rail", "position", name="servo", kp=stiffness, kv=kv, gear=gear, **fields)
    return scene


@pytest.mark.parametrize("integrator", peers.INTEGRATORS)
def test_an_arm_at_200_states(integrator):
    """Forces, accelerations and one step of a six-joint arm are MuJoCo's to 1e-9.

    A third of the forces that have bounds are at them, where `implicitfast` has no damping
    from the servo; the bounds are met from both sides.
    """
    theirs = peers.strict(mujoco.MjModel.from_xml_string(ARM), integrator=integrator)
    sim = sc.Sim(sc.loads(ARM).compile(), **peers.EXACT, integrator=integrator)
    data = mujoco.MjData(theirs)
    worst = peers.Worst()
    at_bound = []
    limited = theirs.actuator_forcelimited.astype(bool)
    low, high = theirs.actuator_forcerange[limited].T
    for index, state in enumerate(peers.fall_states(theirs, 200, 11, 0.3, 2.0)):
        peers.note_forward(worst, index, sim, theirs, data, state)
        force = data.actuator_force[limited]
        at_bound.append([(force <= low).any(), (force >= high).any(), (force > low).any()])
        peers.note_step(worst, index, sim, theirs, data, state)
    assert np.all(np.mean(at_bound, axis=0) > 0.1)
    worst.check(peers.PLACED | peers.SOLVED | peers.STEPPED, integrator)


def test_damping_ratios_are_mujocos():
    """2 ratio √(kp m) with m = 1 / (J M⁻¹ Jᵀ) at the initial pose, to 1e-12; in numpy too."""
    theirs = mujoco.MjModel.from_xml_string(ARM)
    scene = sc.loads(ARM)
    model = scene.compile()
    assert model.actuator_bias == pytest.approx(theirs.actuator_biasprm[:, :3], rel=1e-12)
    assert model.actuator_gain == pytest.approx(theirs.actuator_gainprm[:, 0], rel=1e-15)
    # The reference weighs only balls and boxes: the same arm with its compiled inertias.
    for i, body in enumerate(scene.bodies[1:], 1):
        inertia = model.body_inertia[i]
        body.mass, body.ipos = model.body_mass[i], model.body_ipos[i]
        body.inertia = [inertia[j] for j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    scene.geoms.clear()
    ours = np.array(oracle.Sim(scene).model.actuator_bias)
    assert ours == pytest.approx(theirs.actuator_biasprm[:, :3], rel=1e-12)


DEFAULTS = (
    *("", '<position kp="50" kv="2" gear="2"/>', '<velocity kv="7" ctrlrange="-1 1"/>'),
    *('<general gainprm="9" biastype="affine" biasprm="1 -9 -3"/>', '<motor gear="3"/>'),
    *('<position kp="20" dampratio="1" inheritrange=".9"/>', '<general gainprm="9"/>'),
)
ELEMENTS = (
    *("<position {}/>", '<position kv=".4" {}/>', "<velocity {}/>", "<general {}/>"),
    *("<motor {}/>", '<general gainprm="3" biastype="affine" biasprm="0 -3 .4" {}/>'),
)


def test_gains_are_inherited_as_mujocos():
    """Every pair of classes, one in the other, around every kind of actuator."""
    for outer, inner, element in itertools.product(DEFAULTS, DEFAULTS, ELEMENTS):
        act = element.format('joint="j" class="inner"')
        text = (
            '<mujoco><compiler angle="radian"/>'
            f'<default>{outer}<default class="inner">{inner}</default></default><worldbody><body>'
            '<joint name="j" range="-1 2"/><geom size=".1" pos=".3 0 0"/></body></worldbody>'
            f"<actuator>{act}</actuator></mujoco>"
        )
        try:
            theirs = mujoco.MjModel.from_xml_string(text)
        except ValueError:
            with pytest.raises(ValueError, match="inherit"):
                sc.loads(text)
            continue
        model = sc.loads(text).compile()
        affine = theirs.actuator_biastype[:, None] == mujoco.mjtBias.mjBIAS_AFFINE
        bias = np.where(affine, theirs.actuator_biasprm[:, :3], 0.0)
        free = np.where(theirs.actuator_ctrllimited[:, None], theirs.actuator_ctrlrange, FREE)
        assert model.actuator_gain == pytest.approx(theirs.actuator_gainprm[:, 0]), text
        assert model.actuator_bias == pytest.approx(bias, rel=1e-12), text
        assert model.actuator_ctrlrange == pytest.approx(free), text
        assert np.array_equal(model.actuator_gear, theirs.actuator_gear), text


FREE = [-np.inf, np.inf]


@pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")
@every_pair(
    **{"integrator, sign": (("implicitfast", 1), ("euler", -1), ("semi-implicit", -1))},
    ratio=(0.0, 0.1, 0.7, 1.0, 3.0),
    gear=(1.0, -3.0),
)
def test_the_largest_stable_step(integrator, sign, ratio, gear):
    """dt ω = 2√(ζ² + 1) + 2ζ with the servo's damping implicit, 2√(ζ² + 1) − 2ζ explicit.

    From the step map v⁺ = (v − dt ω² x)/(1 + 2ζω dt), x⁺ = x + dt v⁺ (or with (1 − 2ζω dt) v):
    its eigenvalue −1. A hundredth below the motion stays bounded, a hundredth above it grows.
    """
    omega = 40.0
    limit = (2 * np.sqrt(ratio**2 + 1) + sign * 2 * ratio) / omega
    scene = servo(omega**2 * 2.0 / gear**2, 2.0, ratio, gear)
    for share in (0.99, 1.01):
        sim = sc.Sim(scene.compile(), dt=share * limit, integrator=integrator)
        sim.qpos = [1e-3]
        sim.step(1500)
        grown = abs(sim.qpos[0]) / 1e-3
        assert grown < 20 if share < 1 else grown > 1e3


def test_saturated_servos_do_not_damp():
    """At the bound of its force a servo is a constant force: both rules of damping agree."""
    scene = servo(1e4, ratio=1.0, forcerange=(-2, 2))
    for sign in (1, -1):
        steps = []
        for integrator in ("implicitfast", "euler", "semi-implicit"):
            sim = sc.Sim(scene.compile(), dt=0.01, integrator=integrator)
            sim.qpos, sim.qvel = [0.1 * sign], [0.3]
            sim.step()
            steps.append(sim.qvel[0])
        assert steps == pytest.approx([0.3 - sign * 2 * 0.01] * 3, rel=1e-14)
        sim.forward()
        assert sim.actuator_force[0] == -2 * sign


def exact(t, omega, ratio, x):
    """x(t) of a damped oscillator that starts at rest."""
    beta, free = ratio * omega, omega * np.sqrt(1 - ratio**2)
    return x * np.exp(-beta * t) * (np.cos(free * t) + beta / free * np.sin(free * t))


@pytest.mark.parametrize(
    ("integrator", "order"),
    (("implicitfast", 1), ("euler", 1), ("semi-implicit", 1), ("midpoint", 2), ("rk4", 4)),
)
def test_order_on_a_damped_servo(integrator, order):
    """A servo of ω = 5/s, ζ = 0.2 against its closed form over 1 s: the integrator's order."""
    scene = servo(25.0, ratio=0.2)
    errors = []
    for steps in (512, 1024):
        sim = sc.Sim(scene.compile(), dt=1 / steps, integrator=integrator)
        sim.qpos = [1.0]
        sim.step(steps)
        errors.append(abs(sim.qpos[0] - exact(1.0, 5.0, 0.2, 1.0)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, rel=0.1)


def test_midpoint_takes_any_stiffness():
    """ω dt = 1000: midpoint still converges and keeps the servo's energy to 1e-9."""
    sim = sc.Sim(servo(1e12).compile(), dt=1e-3, integrator="midpoint")
    sim.qpos = [1.0]
    sim.step(500)
    energy = 0.5 * sim.qvel[0] ** 2 + 0.5 * 1e12 * sim.qpos[0] ** 2
    assert energy == pytest.approx(0.5e12, rel=1e-9)


@pytest.mark.parametrize("precision", ["f64", "f32"])
@pytest.mark.parametrize(("kp", "kv"), [(9953, 826), (1e4, 500), (17284, 1417), (1000, 50)])
def test_midpoint_holds_a_servo_that_has_come_to_rest(kp, kv, precision):
    """Law: it stays where load and servo balance, at every step: what is left there is rounding of
    both forces, far larger than the velocity."""
    scene = sc.Scene()
    rod = scene.add_body("rod", pos=(0, 0, 1))
    scene.add_joint(rod, "hinge", name="j", axis=(0, 1, 0))
    scene.add_geom(rod, "capsule", 0.02, fromto=(0, 0, 0, 0.3, 0, 0), mass=1.0)
    scene.add_actuator("j", "position", kp=kp, kv=kv)
    for dt in (5e-4, 2e-3, 1e-2):
        sim = sc.Sim(scene, integrator="midpoint", dt=dt, precision=precision)
        sim.step(round(6 / dt))
        balance = 9.81 * 0.15 / kp
        assert sim.qpos[0] == pytest.approx(balance, rel=1e-3 if precision == "f32" else 1e-5)


@pytest.mark.parametrize("integrator", ("explicit", "semi-implicit", "midpoint", "rk4"))
def test_rust_is_numpy(integrator):
    """A hinged arm with three servos, one at its bounds: the engine is the reference to 1e-11."""
    scene = sc.Scene()
    upper = scene.add_body("upper", pos=(0, 0, 1), mass=2, ipos=(0.2, 0, 0), inertia=(1, 2, 2.5))
    scene.add_joint(upper, "hinge", name="shoulder", axis=(0, 1, 0.3))
    lower = scene.add_body("lower", upper, pos=(0.5, 0, 0), mass=1, inertia=(0.2, 0.3, 0.3))
    scene.add_joint(lower, "hinge", name="elbow", axis=(0, 1, 0), ref=0.2)
    scene.add_joint(lower, "slide", name="reach", axis=(1, 0, 0))
    scene.add_actuator("shoulder", "position", kp=90, dampratio=0.7, gear=2)
    scene.add_actuator("elbow", "velocity", kv=2, forcerange=(-1, 1.5))
    scene.add_actuator("reach", "general", gainprm=30, biasprm=(0.5, -40, -3))
    settings = {"dt": 0.004, "integrator": integrator, "law": "lesson", "solver": "pgs"}
    ours, theirs = sc.Sim(scene.compile(), **settings), oracle.Sim(scene, **settings)
    for sim in (ours, theirs):
        sim.qpos[:], sim.qvel[:] = [0.3, -0.2, 0.1], [1.0, -2.0, 0.5]
        sim.ctrl[:] = [-0.2, 0.4, 0.1]
        sim.step(100)
    assert ours.qpos == pytest.approx(theirs.qpos, rel=1e-11)
    assert ours.qvel == pytest.approx(theirs.qvel, rel=1e-10)


def test_lanes_and_batches_have_the_same_bits():
    """Worlds whose servos are at their bounds stand beside worlds whose servos are not."""
    model = sc.loads(ARM).compile()
    for integrator in ("implicitfast", "midpoint"):
        batch = sc.Batch(model, 9, integrator=integrator)
        rng = np.random.default_rng(3)
        batch.qvel = rng.normal(size=(9, model.nv))
        batch.ctrl = rng.normal(size=(9, model.nu))
        qvel, ctrl = np.array(batch.qvel), np.array(batch.ctrl)
        batch.step(40)
        for world in range(9):
            sim = sc.Sim(model, integrator=integrator)
            sim.qvel, sim.ctrl = qvel[world], ctrl[world]
            sim.step(40)
            assert np.array_equal(sim.qpos, batch.qpos[world])


def test_what_fails_is_named():
    """A servo far beyond its limit explodes, and is the element that is blamed."""
    sim = sc.Sim(servo(1e8).compile(), dt=0.01, integrator="semi-implicit")
    sim.qpos = [1e-3]
    with pytest.raises(sc.SimulationError, match="servo `servo`"):
        sim.step(1000)


@pytest.mark.parametrize(
    ("fields", "says"),
    (
        ({"type": "motor", "kp": 1}, "kp = 1.0: must be None for type 'motor'"),
        ({"type": "velocity", "dampratio": 1}, "dampratio = 1.0: must be None"),
        ({"type": "position", "gainprm": 1}, "gainprm = 1.0: must be None"),
        ({"type": "position", "kv": -1}, "kv = -1.0: must be >= 0"),
        ({"type": "position", "kv": 1, "dampratio": 1}, "kv and dampratio are both given"),
        ({"type": "position", "kp": -1, "dampratio": 1}, "kp = -1.0: must be >= 0"),
        ({"type": "position", "kp": np.nan}, "kp = nan: must be a finite number"),
        ({"type": "general", "biasprm": (0, np.inf)}, "biasprm"),
        ({"type": "servo"}, "type = 'servo': must be one of"),
        ({"type": "position", "kd": 1}, 'no field "kd"'),
    ),
)
def test_bad_fields_are_refused(fields, says):
    scene = servo()
    with pytest.raises(ValueError, match=says):
        scene.add_actuator("rail", name="bad", **fields)
        scene.compile()


def test_values_by_path_and_copies():
    """Gains are values of the scene: they can be swept, and travel with it."""
    model = servo(2.0).compile()
    stiffer = model.with_values({"actuator/servo/kp": 8.0, "actuator/servo/kv": 0.5})
    assert stiffer.actuator_bias.tolist() == [[0.0, -8.0, -0.5]]
    assert model.actuator_gain.tolist() == [2.0]
    assert servo(2.0) == servo(2.0) != servo(3.0)


def test_saved_servos_are_the_same():
    """An arm of every kind of servo, saved as MJCF and read again by both engines."""
    scene = sc.loads(ARM)
    text = scene.to_mjcf()
    assert sc.loads(text) == scene
    theirs = mujoco.MjModel.from_xml_string(text)
    assert scene.compile().actuator_bias == pytest.approx(theirs.actuator_biasprm[:, :3], rel=1e-12)
