"""Elements: exact slopes beside differences of forces, names of one and of several, fields."""

import numpy as np
import pytest
from zoo import HEAPS, ZOO

import stepcore as sc
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.element import INERTIAL, Element, Elements

# Of the differences.
STEP = 1e-5


def placed(entry, seed):
    """A Sim of a zoo's scene at a random state, its rows solved to rounding."""
    model = sc.Model(sc.loads(entry.text)).with_settings(
        integrator="explicit", dt=1e-3, refsafe=False, solver="newton", sweeps=200, tolerance=1e-14
    )
    rng, coordinates = np.random.default_rng(seed), Coordinates(model)
    sim = sc.Sim(model)
    sim.qpos[:] = coordinates.moved(model.qpos0, rng.uniform(-entry.spread, entry.spread, model.nv))
    sim.qvel[:] = rng.uniform(-entry.speed, entry.speed, model.nv)
    sim.ctrl[:], sim.act[:] = rng.uniform(0, 1, model.nu), rng.uniform(0, 1, model.na)
    return sim


def forces_at(sim, qpos, qvel):
    """The forces of all elements and the rows that act, at another state."""
    sim.qpos[:], sim.qvel[:] = qpos, qvel
    sim.forward()
    rows = sim.rows
    acting = list(zip(rows["name"], rows["part"], np.sign(rows["impulse"]), strict=True))
    ends = [rows["impulse"] <= rows["lo"], rows["impulse"] >= rows["hi"]]
    return sim.element_forces(), (acting, np.array(ends).tolist())


def differences(sim):
    """Minus the derivatives of forces by positions and velocities, by (kind, index).

    Central differences of two sizes, extrapolated (Richardson 1911). None where a row begins or
    ends to act within the step, and nothing is to compare.
    """
    coordinates, nv = Coordinates(sim.model), sim.model.nv
    qpos, qvel = np.array(sim.qpos), np.array(sim.qvel)
    _, here = forces_at(sim, qpos, qvel)
    matrices = {}
    for column in range(2 * nv):
        for step, weight in ((STEP, 4 / 3), (2 * STEP, -1 / 3)):
            for sign in (1, -1):
                change = sign * step * np.eye(1, nv, column % nv)[0]
                by_position = column < nv
                moved = coordinates.moved(qpos, change) if by_position else qpos
                forces, rows = forces_at(sim, moved, qvel if by_position else qvel + change)
                if rows != here:
                    return None
                for element, force in forces.items():
                    matrix = matrices.setdefault(element, np.zeros((nv, 2 * nv)))
                    matrix[:, column] -= sign * weight * force / (2 * step)
    return matrices


@pytest.mark.parametrize("name", sorted(ZOO))
def test_slopes_are_the_derivatives_of_the_forces(name):
    """Law: K = −∂f/∂q and D = −∂f/∂v of every element, to 1e-6 of the largest entry of all."""
    compared = 0
    for seed in range(1 if name in HEAPS else 4):
        sim = placed(ZOO[name], seed)
        slopes = {(e.kind, e.index): s for e, s in sim.element_slopes().items() if e.kind != "spin"}
        expected = differences(sim)
        if expected is None:
            continue
        compared += 1
        size = max(1.0, *(np.abs(matrix).max() for matrix in expected.values()))
        for element, matrix in expected.items():
            zeros = np.zeros((sim.model.nv, sim.model.nv))
            own = slopes.pop(element, None)
            pair = (zeros, zeros) if own is None else (own.stiffness, own.damping)
            assert np.hstack(pair) == pytest.approx(matrix, abs=1e-6 * size), element
        for element, own in slopes.items():
            assert np.abs(own.stiffness).max() <= 1e-6 * size, element
            assert np.abs(own.damping).max() <= 1e-6 * size, element
    assert compared


def test_the_spin_of_a_body_is_its_gyroscopic_torque():
    """Law: (I ω) × ω in the axes of a free body; no element at rest or of a ball."""
    inertia, spin = np.array([1.0, 2.0, 2.9]), np.array([3.0, -1.0, 2.0])
    text = """<mujoco><option gravity="0 0 0"/><worldbody>
      <body name="top"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 2 2.9"/></body>
      <body name="ball" pos="9 0 0"><freejoint/><geom size=".1"/></body></worldbody></mujoco>"""
    sim = sc.Sim(sc.loads(text))
    assert not sim.element_slopes()
    sim.qpos[3:7] = 0.5
    sim.qvel[3:6] = sim.qvel[9:12] = spin
    ((element, slopes),) = sim.element_slopes().items()
    assert element.name == "spin of body `top`"
    assert slopes.force[3:6] == pytest.approx(np.cross(inertia * spin, spin))
    for k, axis in enumerate(np.eye(3)):
        slope = np.cross(inertia * axis, spin) + np.cross(inertia * spin, axis)
        assert slopes.damping[3:6, 3 + k] == pytest.approx(-slope)


def test_energy_and_force_are_those_at_the_state():
    """Law: ½ k x² and −k x of a spring, m g z and −m g of the weight."""
    scene = sc.Scene(gravity=(0, 0, -10))
    arm = scene.add_body("arm")
    scene.add_joint(arm, "slide", axis=(0, 0, 1), name="lift", stiffness=50.0)
    scene.add_geom(arm, "sphere", 0.1, mass=2.0)
    sim = sc.Sim(scene)
    sim.qpos[:] = 0.2
    acts = {element.name: slopes for element, slopes in sim.element_slopes().items()}
    spring, weight = acts["spring of joint `lift`"], acts["gravity"]
    assert spring.energy == pytest.approx(1.0) and spring.force == pytest.approx([-10.0])
    assert spring.stiffness == pytest.approx(np.array([[50.0]])) and not spring.damping.any()
    assert weight.energy == pytest.approx(4.0) and weight.force == pytest.approx([-20.0])


def test_elements_are_named_together_by_what_they_are():
    """Names are formed of parts: no name is read, whatever stands in it."""
    scene = sc.Scene()
    for name in ("a of `b", "limb/knee", "x together", "d", "e", ""):
        body = scene.add_body(parent=scene.world)
        scene.add_joint(body, "slide", name=name)
        scene.add_geom(body, "sphere", 0.1)
    scene.add_actuator("d", "position", name="drive")
    model = sc.Model(scene)
    springs = Elements(Element.of(model, "spring", k) for k in range(5))
    loss, control = Element.of(model, "friction loss", 1), Element.of(model, "control", 0)
    assert Elements(springs[:1]).name == "spring of joint `a of `b`"
    assert Elements(springs[1:3]).name == "the 2 springs of joints `limb/knee`, `x together`"
    labels = "`a of `b`, `limb/knee`, `x together`, `d` and 1 more"
    assert springs.together == f"the 5 springs of joints {labels} together"
    assert Elements([springs[1], loss]).name == f"{springs[1].name}, {loss.name}"
    assert Elements([*springs, loss]).summary == "5 springs and 1 friction loss"
    assert control.name == "control of servo `drive`"
    assert Element.of(model, "limit", 5).name == "limit of joint 5 of body 6"
    assert Elements([INERTIAL]).is_plural
    assert not Elements([Element.of(model, "joint", 2)]).is_plural
    assert sorted([loss, springs[1], springs[0]]) == [loss, springs[0], springs[1]]


def test_the_fields_of_an_element_are_values_of_the_scene():
    """Law: setting a field through its path is seen in the next model's field and law."""
    scene = sc.loads("""<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/>
      <body pos="0 0 .1"><joint name="lift" type="slide" axis="0 0 1" stiffness="7" limited="true"
      range="0 1"/><geom name="ball" size=".1"/></body></worldbody>
      <actuator><pid name="drive" joint="lift" input="pos"/></actuator></mujoco>""")
    model = sc.Model(scene)

    def fields(kind, index=0):
        return {f.path: f for f in Element.of(model, kind, index).fields(model)}

    assert fields("spring")["joint/lift/stiffness"].value == 7.0
    limit = fields("limit")["joint/lift/solreflimit"]
    assert limit.value == limit.default == (0.02, 1.0)
    gain = fields("actuator")["actuator/drive/kp"]
    assert (gain.value, gain.default, gain.unit) == (1.0, 1.0, "N/m")
    assert {"geom/floor/solref", "geom/ball/solref"} < set(fields("contact"))
    assert not fields("gravity")
    model = model.with_values({gain.path: 5.0, "joint/lift/stiffness": 9.0})
    assert fields("actuator")[gain.path].value == 5.0
    assert fields("spring")["joint/lift/stiffness"].value == 9.0
