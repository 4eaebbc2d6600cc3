"""Fluids, gravity compensation and springdamper against MuJoCo, each also in closed form.

Law: forces, accelerations, derivatives and one step of every integrator that both have are MuJoCo's
to 1e-9 at a hundred random states.
"""

import math

import mujoco
import numpy as np
import peers
import pytest
import zoo
from fallen import falls

import stepcore as sc

SCENES = ("fluid_boxes", "fluid_ellipsoids", "gravcomp", "springdamper")


def both(name, **options):
    text = zoo.ZOO[name].text
    theirs = peers.strict(mujoco.MjModel.from_xml_string(text), **options)
    return sc.Sim(sc.loads(text), **peers.EXACT, **options), theirs


@pytest.mark.parametrize("name", SCENES)
def test_forces(name):
    sim, theirs = both(name)
    data, worst = mujoco.MjData(theirs), peers.Worst()
    for index, state in enumerate(falls(theirs, 100, 5, 0.5, 3.0)):
        peers.note_forward(worst, index, sim, theirs, data, state)
        worst.note("fluid", peers.apart(by_kind(sim, "fluid"), data.qfrc_fluid), index)
        held = by_kind(sim, "gravity compensation")
        worst.note("gravcomp", peers.apart(held, data.qfrc_gravcomp), index)
    worst.check(peers.PLACED | peers.SOLVED | {"fluid": 1e-9, "gravcomp": 1e-9}, name)


def by_kind(sim, kind):
    forces = sim.element_forces().items()
    return sum((force for (own, _), force in forces if own == kind), np.zeros(sim.model.nv))


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("integrator", peers.INTEGRATORS)
def test_steps(name, integrator):
    sim, theirs = both(name, integrator=integrator)
    data, worst = mujoco.MjData(theirs), peers.Worst()
    for index, state in enumerate(falls(theirs, 100, 6, 0.5, 3.0)):
        peers.note_step(worst, index, sim, theirs, data, state)
    worst.check(peers.STEPPED, f"{name} {integrator}")


def sphere(radius=0.1, **fields):
    scene = sc.Scene()
    body = scene.add_body("ball", **fields)
    scene.add_joint(body, "free")
    scene.add_geom(body, "sphere", radius, contype=0, conaffinity=0, fluidshape="ellipsoid")
    return scene


def test_terminal_velocity_of_a_viscous_fluid():
    """Stokes: a sphere falls at m g / (6 π μ r), and comes there as exp(−6 π μ r t/m)."""
    radius, viscosity = 0.1, 2.0
    scene = sphere(radius)
    scene.viscosity = viscosity
    sim = sc.Sim(scene, integrator="rk4", dt=0.002)
    mass = sim.model.body_mass[1]
    drag = 6 * math.pi * viscosity * radius
    sim.step(1000)
    exact = -mass * 9.81 / drag * (1 - math.exp(-drag * 2.0 / mass))
    assert sim.qvel[2] == pytest.approx(exact, rel=1e-9)


def test_terminal_velocity_of_a_thin_fluid():
    """ρ C A v² = m g, C the blunt drag and A = π r²; the slope of v to it is tanh(t g / v)."""
    radius, density = 0.1, 30.0
    scene = sphere(radius)
    scene.density = density
    sim = sc.Sim(scene, integrator="rk4", dt=0.002)
    mass = sim.model.body_mass[1]
    limit = math.sqrt(mass * 9.81 / (density * 0.5 * math.pi * radius**2))
    sim.step(500)
    assert sim.qvel[2] == pytest.approx(-limit * math.tanh(9.81 / limit), rel=1e-8)


def test_a_body_drifts_with_the_wind():
    scene = sphere()
    scene.gravity, scene.viscosity, scene.wind = (0, 0, 0), 40.0, (1, 2, 3)
    sim = sc.Sim(scene, integrator="implicitfast", dt=0.01)
    sim.step(3000)
    assert sim.qvel[:3] == pytest.approx([1, 2, 3], rel=1e-9)


def test_a_body_that_weighs_nothing_floats():
    scene = sphere(gravcomp=1.0)
    sim = sc.Sim(scene, dt=0.002)
    sim.qvel[:3] = 0.3, 0, 0
    start = sim.energy
    sim.step(1000)
    assert sim.qpos[:3] == pytest.approx([0.6, 0, 0], abs=1e-12)
    assert sum(sim.energy) == pytest.approx(sum(start), abs=1e-12)


@pytest.mark.parametrize("name", ("fluid_boxes", "fluid_ellipsoids"))
def test_slopes_are_derivatives(name):
    """The step's derivative by velocity under semi-implicit: M⁻¹ times that of the forces."""
    sim = sc.Sim(sc.loads(zoo.ZOO[name].text), integrator="semi-implicit", solver="newton")
    rng = np.random.default_rng(3)
    sim.qvel[:] = rng.normal(size=sim.model.nv)
    linear = sim.linearize()
    start = sim.qvel.copy()
    snap = sim.state()
    for k in range(sim.model.nv):
        ends = []
        for sign in (1, -1):
            sim.restore(snap)
            sim.qvel[:] = start
            sim.qvel[k] += sign * 1e-6
            sim.step(1)
            ends.append(sim.qvel.copy())
        slope = (ends[0] - ends[1]) / 2e-6
        nv = sim.model.nv
        assert linear.A[nv:, nv + k] == pytest.approx(slope, rel=1e-6, abs=1e-7)


def test_names():
    scene = sphere(gravcomp=0.5)
    scene.density = 1.0
    model = scene.compile()
    assert model.element_name("fluid", 1) == "fluid drag on body `ball`"
    assert model.element_name("gravity compensation", 1) == "gravity compensation of body `ball`"
    labels = {entry.name for entry in model.plan().entries}
    assert {"fluid drag (by body)", "gravity compensation (by body)"} <= labels


def test_what_a_scene_refuses():
    scene = sc.Scene()
    for field, value in (("density", -1.0), ("viscosity", math.inf), ("wind", (0, 0))):
        with pytest.raises(ValueError, match=field):
            setattr(scene, field, value)


@pytest.mark.parametrize("shares", [(-0.5,), (0.5,), (-0.5, 0.4), (-0.5, 0.0), (-1.0, -0.3)])
@pytest.mark.parametrize("driven", ["false", "true"])
def test_compensation_below_zero(shares, driven):
    """Law: MuJoCo's rule, by which a share below 0 counts only beside one above 0."""
    arm = """<body pos="{0} 0 0" gravcomp="{1}"><geom size=".1" pos=".3 0 0"/>
    <joint name="j{0}" axis="0 1 0" actuatorgravcomp="{2}"/></body>"""
    bodies = "".join(arm.format(k, share, driven) for k, share in enumerate(shares))
    drive = '<actuator><motor joint="j0"/></actuator>'
    text = f"<mujoco><worldbody>{bodies}</worldbody>{drive}</mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    data, sim = mujoco.MjData(model), sc.Sim(sc.loads(text))
    mujoco.mj_forward(model, data)
    sim.forward()
    assert sim.qacc == pytest.approx(data.qacc, rel=1e-12)
    assert sim.qfrc_passive == pytest.approx(data.qfrc_passive, abs=1e-12)
