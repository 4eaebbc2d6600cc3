"""`Sim.linearize`: against central differences of the real step, and against closed forms."""

import math
import re

import mujoco
import numpy as np
import peers
import pytest
import tangents
from small import ball, pendulum, unstable
from zoo import ZOO

import stepcore as sc
from stepcore import Sim

INTEGRATORS = (
    *("explicit", "semi-implicit", "euler", "implicitfast"),
    *("implicit", "discrete", "midpoint", "rk4"),
)
SWEPT = {"solver": "pgs", "sweeps": 6, "tolerance": 0.0}
TO_ROUNDING = {"solver": "pgs", "sweeps": 3000, "tolerance": 1e-13}
NUMERICS = [
    *({"integrator": name} for name in INTEGRATORS if name not in ("implicit", "discrete")),
    {"cone": "elliptic"},
    {"integrator": "rk4", "cone": "elliptic"},
    {"cone": "elliptic", **SWEPT},
    SWEPT,
    TO_ROUNDING,
    {"cone": "elliptic", **TO_ROUNDING},
    {"acceleration": "momentum", **TO_ROUNDING},
    {"law": "lesson", "softness": 1e-3, **SWEPT},
    {"law": "relaxed", "softness": 1e-3, "cone": "elliptic", **SWEPT},
    {"law": "penalty", "penalty_stiffness": 3e3, "solver": "pgs"},
    {"integrator": "implicit"},
    {"integrator": "discrete"},
    {"integrator": "discrete", "cone": "elliptic", **TO_ROUNDING},
]
SCENES = (
    "ball_joints",
    "free_limb",
    "motors",
    "friction_loss",
    "limits",
    "ball_limit",
    "connect",
    "plane_capsule",
    "sphere_sphere",
    "sphere_box",
    "capsule_capsule",
    "plane_cylinder",
    "plane_box",
    "capsule_box",
    "box_box",
    "condim_4",
    "condim_6",
    "all_together",
)


def error(sim, sizes=(1e-6, 2e-7)):
    """Largest difference from central differences, beside the largest derivative (or 1).

    The better of two sizes: within reach of a wide difference a law may switch.
    """
    step = sim.linearize()
    got, errors = np.hstack([step.A, step.B]), []
    for h in sizes:
        wanted = tangents.differences(sim, h)
        errors.append(abs(got - wanted).max() / max(1.0, abs(wanted).max()))
        if errors[-1] < 1e-7:
            break
    return min(errors)


@pytest.mark.parametrize("name", SCENES)
def test_smooth_steps_equal_central_differences(name):
    """Every kind of step, in motion: differences of the real step, of fourth order."""
    model, rng = sc.loads(ZOO[name].text).compile(), np.random.default_rng(0)
    tried = 0
    for numerics in NUMERICS:
        sim = Sim(model, **numerics)
        sim.qvel[:] = 0.3 * ZOO[name].speed * rng.normal(size=model.nv)
        sim.ctrl[:] = 0.2
        try:
            sim.step(25)
        except (sc.SimulationError, ValueError) as refused:
            # A penalty beyond its own dt, a midpoint that does not close: no step to differentiate.
            assert re.search("diverged|zero softness", str(refused))
            continue
        assert error(sim) < 1e-6, numerics
        tried += 1
    assert tried >= len(NUMERICS) - 2


@pytest.mark.parametrize("name", ["half_cheetah", "ant"])
def test_models_that_people_know(name):
    """Robots on the ground, after a second of random controls."""
    model = sc.load(f"gymnasium:{name}").compile()
    for numerics in ({}, {"cone": "elliptic"}, {"integrator": "implicitfast"}, TO_ROUNDING):
        sim, rng = Sim(model, **numerics), np.random.default_rng(1)
        for _ in range(40):
            sim.ctrl[:] = 0.5 * rng.uniform(-1, 1, model.nu)
            sim.step(5)
        while not len(sim.contacts):
            sim.step()
        assert error(sim) < 1e-6


def spring(integrator, k=30.0, d=0.0, dt=0.05):
    scene = sc.Scene(gravity=(0, 0, 0)).with_settings(dt=dt, integrator=integrator)
    cart = scene.add_body("cart")
    scene.add_joint(cart, "slide", name="rail", stiffness=k, damping=d)
    scene.add_geom(cart, "sphere", 0.1, mass=2.0)
    sim = Sim(scene)
    sim.qpos[0], sim.qvel[0] = 0.3, -0.2
    return sim


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_spring_and_damper(integrator):
    """m q̈ = −k q − d q̇: each integrator's own formula, to rounding."""
    m, k, d, h = 2.0, 30.0, 1.5, 0.05
    rate = np.array([[0, 1], [-k / m, -d / m]])
    one = np.eye(2)
    # First the velocity, then the position by it.
    late = np.array([[1, h], [0, 1]])
    kick = np.array([[1, 0], [-h * k / m, 1 - h * d / m]])
    implicit = np.array([[1, 0], [-h * k / (m + h * d), m / (m + h * d)]])
    z = h * rate
    wanted = {
        "explicit": one + z,
        "semi-implicit": late @ kick,
        "euler": late @ implicit,
        "implicitfast": late @ implicit,
        "implicit": late @ implicit,
        "discrete": late @ np.array([[1, 0], np.array([-h * k, m]) / (m + h * d + h * h * k)]),
        "midpoint": np.linalg.solve(one - z / 2, one + z / 2),
        "rk4": one + z @ (one + z @ (one / 2 + z @ (one / 6 + z / 24))),
    }[integrator]
    step = spring(integrator, k, d, h).linearize()
    assert abs(step.A - wanted).max() < 1e-14
    assert step.B.shape == (2, 0)
    radius = max(abs(np.linalg.eigvals(wanted)))
    assert step.spectral_radius == pytest.approx(radius, rel=1e-12)


def test_pendulums_hang_and_stand():
    """Semi-implicit: det A = 1 without damping; upright one mode grows as √(mgl/I) says."""
    scene = sc.Scene().with_settings(dt=1e-3, integrator="semi-implicit")
    rod = scene.add_body("rod")
    scene.add_joint(rod, "hinge", name="pivot", axis=(0, 1, 0))
    scene.add_geom(rod, "capsule", 0.02, fromto=(0, 0, 0, 0, 0, -1), mass=1.0)
    sim = Sim(scene)
    inertia = float(sim.mass_matrix()[0, 0])
    for angle, sign in ((0.0, -1.0), (math.pi, 1.0)):
        sim.qpos[0] = angle
        step = sim.linearize()
        stiffness = sign * 9.81 * 0.5 / inertia
        assert abs(step.A[1, 0] - 1e-3 * stiffness) < 1e-14
        assert abs(np.linalg.det(step.A) - 1) < 1e-14
    assert math.log(step.spectral_radius) / 1e-3 == pytest.approx(math.sqrt(stiffness), rel=1e-3)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_free_body_at_rest_turns_with_its_velocity(integrator):
    """Where no axis of rotation exists, ∂(turn)/∂(angular velocity) is still dt."""
    scene = sc.Scene(gravity=(0, 0, 0)).with_settings(dt=0.01, integrator=integrator)
    plate = scene.add_body("plate", quat=(0.5, -0.5, 0.1, 0.7))
    scene.add_joint(plate, "free")
    scene.add_geom(plate, "box", (0.3, 0.2, 0.01), mass=1.0)
    sim = Sim(scene)
    wanted = np.eye(12)
    wanted[:6, 6:] = 0.01 * np.eye(6)
    for speed in (0.0, 1e-320, 1e-160, 1e-100, 1e-50, 1e-12):
        sim.qvel[3:] = speed
        assert abs(sim.linearize().A - wanted).max() < 1e-11
    # A quaternion that is not of unit length turns as its unit quaternion does.
    sim.qvel[:] = 0
    sim.qpos[3:] *= 3.0
    assert abs(sim.linearize().A - wanted).max() < 1e-12


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_rotation_springs_at_rest(integrator):
    """A ball spring at its rest pose: I ω̇ = −k θ about each axis."""
    scene = sc.Scene(gravity=(0, 0, 0)).with_settings(dt=0.01, integrator=integrator)
    bob = scene.add_body("bob")
    scene.add_joint(bob, "ball", name="hip", stiffness=4.0)
    scene.add_geom(bob, "box", (0.1, 0.1, 0.1), mass=3.0)
    step = Sim(scene).linearize()
    inertia = 3.0 * 2 * 0.1**2 / 3
    wanted = -0.01 * 4.0 / inertia
    share = {
        "discrete": 1 / (1 - 0.01 * wanted),
        "midpoint": 1 / (1 - 0.25 * 0.01 * wanted),
        "rk4": 1 + 0.01 * wanted / 6,
    }
    got = step.A[3:, :3]
    assert abs(got - wanted * share.get(integrator, 1.0) * np.eye(3)).max() < 1e-12
    assert step.labels == ("hip turn x", "hip turn y", "hip turn z")


@pytest.mark.parametrize("solver", ["newton", "pgs"])
@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_resting_contact_is_a_spring(solver, cone):
    """A ball at rest, though the warm start leaves the solver nothing to do: its contact's
    stiffness and damping are those of solref, a_ref = −b v − K d r, whatever the mass."""
    numerics = {"solver": solver, "cone": cone, "sweeps": 1000, "tolerance": 1e-15}
    sim = Sim(ball(dt=1e-3, integrator="semi-implicit", **numerics))
    sim.step(3000)
    step = sim.linearize()
    assert error(sim) < 1e-6
    # The friction of a heavy ball at rest holds it: no slip, no spin that rolls on.
    assert step.A[6 + 2, 2] < 0 and abs(step.spectral_radius - 1) < 0.05


def test_controls_and_clamps():
    """B is dt M⁻¹ gear, and nothing beyond the control range; one side at its end."""
    sim = Sim(pendulum(dt=0.01, integrator="semi-implicit"))
    minv = np.linalg.inv(sim.mass_matrix())
    step = sim.linearize()
    assert abs(step.B[2:, 0] - 0.01 * 2.0 * minv[:, 1]).max() < 1e-14
    assert step.controls == ("motor",) and step.labels == ("shoulder", "elbow")
    sim.ctrl[0] = 1.5
    assert not sim.linearize().B.any()


def test_nothing_moves_and_precision_is_double():
    """The state's bytes are the same before and after; an f32 world gives f64's derivatives."""
    double = Sim(pendulum())
    double.qvel[:] = 0.3, -0.4
    double.step(50)
    before, work = double.state(), double.row_updates
    step = double.linearize()
    assert double.state() == before and double.row_updates == work
    single = Sim(pendulum(precision="f32"))
    single.qpos[:], single.qvel[:], single.ctrl[:] = double.qpos, double.qvel, double.ctrl
    assert abs(single.linearize().A - step.A).max() < 1e-4
    assert not step.A.flags.writeable


def test_growth_of_an_unstable_step():
    """ω² dt² = 100 under semi-implicit: the larger root of μ² − (2 − 100) μ + 1 = 0."""
    radius = Sim(unstable()).linearize().spectral_radius
    assert radius == pytest.approx(49 + math.sqrt(49**2 - 1), rel=1e-9)


def test_refusals_and_printing():
    sim = Sim(pendulum())
    sim.qvel[0] = np.nan
    with pytest.raises(ValueError, match=r"qvel\[0\]"):
        sim.linearize()
    sim.qvel[0] = 1e300
    with pytest.raises(sc.SimulationError, match="diverged in step 0") as found:
        sim.linearize()
    assert "joint" in found.value.element
    sim.qvel[0] = 0.0
    step = sim.linearize()
    assert repr(step).startswith("<Linearization: 2 dofs, 1 controls; a step of 0.002 s; spectral")
    assert step.to_dict()["labels"] == ["shoulder", "elbow"]


@pytest.mark.parametrize("law", ["rigid", "lesson"])
def test_one_sided_where_friction_just_holds(law):
    """A motor pushes with exactly the friction loss: more would slip, less would stick."""
    scene = sc.Scene().with_settings(dt=0.01, integrator="semi-implicit", law=law, solver="pgs")
    cart = scene.add_body("cart")
    scene.add_joint(cart, "slide", name="rail", axis=(1, 0, 0), frictionloss=0.5)
    scene.add_geom(cart, "sphere", 0.1, mass=2.0)
    scene.add_actuator("rail", name="motor")
    sim = Sim(scene)
    for push in (0.4, 0.6):
        sim.ctrl[0] = push
        step = sim.linearize()
        assert step.degenerate == () and "one-sided" not in repr(step)
        assert step.B[1, 0] == pytest.approx(0.0 if push < 0.5 else 0.005, abs=1e-15)
    sim.ctrl[0] = 0.5
    step = sim.linearize()
    assert step.degenerate_ids == (("friction loss", 0, 0),)
    assert step.degenerate == ("friction loss of joint `rail`",)
    assert repr(step).endswith("; one-sided at: friction loss of joint `rail`>")
    assert step.to_dict()["degenerate"] == list(step.degenerate)
    # One side's: it slips, or it sticks.
    assert min(abs(step.B[1, 0] - side) for side in (0.0, 0.005)) < 1e-15


@pytest.mark.parametrize("name", ["half_cheetah", "hopper", "walker2d"])
@pytest.mark.parametrize("integrator", ["euler", "implicitfast", "implicit"])
def test_mujoco_differences_its_own_step_to_the_same(name, integrator):
    """A and B of `mjd_transitionFD`, which has the same coordinates, on the ground: to what
    central differences of size 1e-6 can tell."""
    theirs = peers.strict(mujoco.MjModel.from_xml_path(peers.gym_path(name)), integrator=integrator)
    sim = Sim(sc.load(f"gymnasium:{name}"), integrator=integrator, tolerance=0.0)
    rng = np.random.default_rng(3)
    for _ in range(30):
        sim.ctrl[:] = 0.4 * rng.uniform(-1, 1, theirs.nu)
        sim.step(5)
    while not len(sim.contacts):
        sim.step()
    data = mujoco.MjData(theirs)
    data.qpos[:], data.qvel[:], data.ctrl[:] = sim.qpos, sim.qvel, sim.ctrl
    mujoco.mj_forward(theirs, data)
    A, B = np.zeros((2 * theirs.nv, 2 * theirs.nv)), np.zeros((2 * theirs.nv, theirs.nu))
    mujoco.mjd_transitionFD(theirs, data, 1e-6, True, A, B, None, None)
    step = sim.linearize()
    assert abs(step.A - A).max() < 1e-6 * abs(A).max()
    assert abs(step.B - B).max() < 1e-6 * abs(B).max()


def test_a_joint_without_a_name_is_called_as_in_a_trajectory():
    scene = sc.loads("""<mujoco><worldbody><body name="arm"><joint/><joint name="own" axis="1 0 0"/>
      <geom size=".1" mass="1"/></body></worldbody></mujoco>""")
    sim = sc.Sim(scene)
    (axis,) = sim.run(0.01, record=("qvel",)).axes("qvel")
    assert sim.linearize().labels == axis.entries == ("joint 0 of body `arm`", "own")


ROUND = '<joint name="a" type="slide"/><geom size=".1" mass="1"/>'
AT_REST = {
    "joint": ('<joint name="a" type="slide" stiffness="100"/><geom size=".1" mass="1"/>', ""),
    "fixed": (ROUND, '<fixed stiffness="100"><joint joint="a" coef="1"/></fixed>'),
    "spatial": (
        f'{ROUND}<site name="s"/>',
        '<spatial stiffness="100"><site site="o"/><site site="s"/></spatial>',
    ),
}


@pytest.mark.parametrize("kind", AT_REST)
def test_a_spring_at_its_rest_length_has_its_stiffness(kind):
    """There every spring begins whose file says nothing else; once a tendon's had none."""
    body, tendon = AT_REST[kind]
    scene = sc.loads(f"""<mujoco><worldbody><site name="o" pos="0 0 -1"/><body>{body}</body>
      </worldbody><tendon>{tendon}</tendon></mujoco>""")
    sim = sc.Sim(scene, integrator="semi-implicit")
    assert sim.linearize().A[1, 0] == pytest.approx(-100 * 0.002, rel=1e-12)
    (acts,) = (a for name, a in sim.element_slopes().items() if "spring" in str(name))
    assert np.asarray(acts.stiffness).max() == pytest.approx(100, rel=1e-12)


@pytest.mark.parametrize("act", [0.0, 0.3, 1.0])
def test_a_muscle_that_is_as_active_as_it_is_asked_has_one_sides_slope(act):
    """Its time constant is another when it relaxes; at 0 and 1 its control is at a bound."""
    text = """<mujoco><worldbody><body><joint name="j" type="slide" axis="0 0 1"/>
    <geom size=".1"/></body></worldbody><actuator><muscle name="m" joint="j" lengthrange="-1 1"/>
    </actuator></mujoco>"""
    sim = Sim(sc.loads(text))
    sim.act[0] = sim.ctrl[0] = act
    slope, sides = sim.linearize().B[-1, 0], []
    for change in (1e-7, -1e-7):
        other = sim.copy()
        other.ctrl[0] += change
        other.step()
        sides.append((other.act[0] - act) / change)
    assert min(abs(slope - side) for side in sides) < 1e-6
