"""Joint springs and dampers of several coefficients: MuJoCo's polynomials, and our own readings."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import stepcore as sc

STIFFNESS, DAMPING = (2.0, 3.0, 5.0), (0.7, 1.1, 1.3)
INTEGRATORS = {"euler": "Euler", "implicitfast": "implicitfast", "rk4": "RK4"}
TURN = np.array([np.cos(0.35), *np.sin(0.35) * np.array([1.0, 2.0, 2.0]) / 3.0])


def text(*joints: str, integrator: str = "Euler") -> str:
    """One body a joint, each on the last; a free joint stands alone."""
    law = 'stiffness="2 3 5" damping="0.7 1.1 1.3"'
    inside = ""
    for n, kind in reversed(list(enumerate(joints))):
        inside = (
            f'<body pos="0.1 0.2 0.3"><joint name="j{n}" type="{kind}" {law}/>'
            f'<geom type="box" size="0.1 0.2 0.3" pos="0.05 0 0.1" mass="1.5"/>{inside}</body>'
        )
    return (
        f'<mujoco><option timestep="0.005" integrator="{integrator}"><flag energy="enable" '
        f'contact="disable"/></option><worldbody>{inside}</worldbody></mujoco>'
    )


def pair(*joints: str, integrator: str = "euler") -> tuple[sc.Sim, mujoco.MjModel, mujoco.MjData]:
    source = text(*joints, integrator=INTEGRATORS[integrator])
    model = mujoco.MjModel.from_xml_string(source)
    data = mujoco.MjData(model)
    at = 0
    for kind in joints:
        if kind == "free":
            data.qpos[at : at + 7] += [0.1, -0.2, 0.3, 0, 0, 0, 0]
            at += 3
        if kind in ("ball", "free"):
            data.qpos[at : at + 4] = TURN
        else:
            data.qpos[at] = 0.3 * (-1) ** at
        at += {"ball": 4, "free": 4}.get(kind, 1)
    data.qvel[:] = np.linspace(-0.9, 0.8, model.nv)
    sim = sc.Sim(sc.loads(source).compile(), dt=0.005, integrator=integrator)
    sim.qpos, sim.qvel = data.qpos, data.qvel
    return sim, model, data


CHAIN = ("hinge", "slide", "ball")


@pytest.mark.parametrize("joints", [("hinge",), ("slide",), ("ball",), ("free",), CHAIN])
def test_forces_and_energy_are_mujocos(joints):
    """Springs, dampers and the energy of springs, to 1e-12 of their size."""
    sim, model, data = pair(*joints)
    mujoco.mj_forward(model, data)
    assert sim.passive == pytest.approx(data.qfrc_passive, rel=1e-12, abs=1e-12)
    assert sim.energy.potential == pytest.approx(data.energy[0], rel=1e-12)
    assert sim.energy.kinetic == pytest.approx(data.energy[1], rel=1e-12)


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("joints", [("hinge",), ("slide",), ("ball",), CHAIN])
def test_a_step_is_mujocos(joints, integrator):
    """A step of every integrator that both have, and so the slopes that the implicit ones take."""
    sim, model, data = pair(*joints, integrator=integrator)
    for _ in range(20):
        sim.step(1)
        mujoco.mj_step(model, data)
        assert sim.qvel == pytest.approx(data.qvel, rel=1e-12, abs=1e-12)
        assert sim.qpos == pytest.approx(data.qpos, rel=1e-12, abs=1e-12)


def test_the_slope_of_a_damper_is_its_derivative():
    """v⁺ = v + dt f/(M + dt (a + 2 b|v| + 3 c v²)) under `euler`, to 1e-12."""
    sim, _, data = pair("slide")
    mass, v = float(sim.mass_matrix()[0, 0]), float(data.qvel[0])
    a, b, c = DAMPING
    sim.forward()
    force = mass * float(sim.qacc[0])
    slope = a + 2 * b * abs(v) + 3 * c * v * v
    sim.step(1)
    assert sim.qvel[0] == pytest.approx(v + 0.005 * force / (mass + 0.005 * slope), rel=1e-12)


def test_the_reference_in_numpy_agrees():
    from oracle import Sim as Reference

    for joints in (("hinge",), ("slide",), ("ball",), ("free",)):
        _, _, data = pair(*joints)
        scene = sc.loads(text(*joints))
        yardstick = Reference(scene, integrator="semi-implicit", dt=0.005)
        yardstick.qpos[:], yardstick.qvel[:] = data.qpos, data.qvel
        twin = sc.Sim(scene.compile(), integrator="semi-implicit", dt=0.005)
        twin.qpos, twin.qvel = data.qpos, data.qvel
        twin.step(1)
        yardstick.step()
        assert twin.qvel == pytest.approx(yardstick.qvel, rel=1e-11, abs=1e-11)


@pytest.mark.parametrize("integrator", ["euler", "implicitfast", "midpoint", "rk4"])
def test_the_ledger_knows_them(integrator):
    """What elements feed in is the change of energy, to rounding. Dampers only take, but those that
    an integrator takes by their slope at the start of the step: these do what the line says.
    """
    sim, _, _ = pair(*CHAIN)
    sim = _twin(sim, integrator)
    name = sim.model.element_name
    for _ in range(30):
        before, v0 = sum(sim.energy), sim.qvel.copy()
        gains = dict(sim._core.taped_step()[2])
        assert sum(gains.values()) == pytest.approx(sum(sim.energy) - before, abs=1e-12)
        dampers = [gain for element, gain in gains.items() if element[0] == "damper"]
        assert len(dampers) == 3
        if integrator in ("euler", "implicitfast"):
            assert dampers == pytest.approx(_by_slope(sim, v0), abs=1e-12)
        else:
            assert max(dampers) < 0
    assert {name(*element) for element in gains} >= {f"spring of joint `j{n}`" for n in range(3)}


def _by_slope(sim, v0):
    """Work of each joint's damper in a step from v0, its force on the line through that at v0."""
    v1, found = sim.qvel, []
    for joint, first in zip(sim.model.scene.joints, sim.model.jnt_dofadr, strict=True):
        dofs = slice(int(first), int(first) + (3 if joint.type == "ball" else 1))
        old, new = v0[dofs], v1[dofs]
        b, c = joint.dampingpoly
        force = -(joint.damping + b * np.abs(old) + c * old**2) * old
        slope = joint.damping + 2 * b * np.abs(old) + 3 * c * old**2
        mean = (old + new) / 2
        found.append(float(((force - slope * (new - old)) * mean).sum() * sim.settings.dt))
    return found


def test_linearisation_is_their_derivative():
    sim, _, _ = pair(*CHAIN, integrator="implicitfast")
    model, n = sim.model, sim.model.nv
    found = sim.linearize().A[:, n:]
    for k in range(n):
        ends = []
        for sign in (1, -1):
            twin = _twin(sim, "implicitfast")
            twin.qvel[k] += sign * 1e-6
            twin.step(1)
            ends.append(twin.qvel.copy())
        slope = (ends[0] - ends[1]) / 2e-6
        assert found[n:, k] == pytest.approx(slope, rel=1e-6, abs=1e-7)
    assert model.nv == 5


def test_a_spring_without_a_linear_part_is_seen():
    """By plan, by name in the diagnosis, and by what asks whether a joint is free."""
    scene = sc.Scene()
    body = scene.add_body()
    scene.add_geom(body, "sphere", 0.1, mass=1.0)
    scene.add_joint(body, "slide", name="rail", stiffnesspoly=(0, 1e4), dampingpoly=(0.5, 0.0))
    entries = {entry.name for entry in sc.plan(scene.compile()).entries}
    assert {"springs", "dampers"} <= entries
    sim = sc.Sim(scene.compile())
    sim.qpos[0] = 0.5
    sim.forward()
    forces = sim.element_forces()
    assert forces["spring", 0] == pytest.approx([-1e4 * 0.5**3])


def test_a_stiffening_spring_is_diagnosed_by_name():
    """3 c x² = 3e6 N/m on 1 kg limits semi-implicit Euler to 2/√(3e6)."""
    scene = sc.Scene()
    body = scene.add_body()
    scene.add_geom(body, "sphere", 0.1, mass=1.0)
    scene.add_joint(body, "slide", name="rail", axis=(1, 0, 0), stiffnesspoly=(0.0, 1e6))
    scene.add_key("stretched", qpos=[1.0])
    found = sc.diagnose(scene, key="stretched", horizon=1e-4, progress=False)
    assert found.stiffest("semi-implicit") == "spring of joint `rail`"
    (spring,) = (row for row in found.rows if row.element.kind == "spring")
    assert spring.omega == pytest.approx(np.sqrt(3e6), rel=1e-6)


def test_mjcf_is_read_and_written():
    scene = sc.loads(text(*CHAIN))
    joint = scene.joints[0]
    assert (joint.stiffness, joint.stiffnesspoly) == (2.0, (3.0, 5.0))
    assert (joint.damping, joint.dampingpoly) == (0.7, (1.1, 1.3))
    written = scene.to_mjcf()
    assert 'stiffness="2 3 5"' in written and "poly" not in written
    assert sc.loads(written).to_dict() == scene.to_dict()
    linear = sc.loads(
        '<mujoco><worldbody><body><joint stiffness="2 0 0"/><geom size="1"/></body>'
        "</worldbody></mujoco>"
    )
    assert linear.joints[0].stiffnesspoly == (0.0, 0.0) and 'stiffness="2"' in linear.to_mjcf()


def test_a_coefficient_that_is_not_finite_is_refused():
    scene = sc.loads(text("hinge"))
    with pytest.raises(ValueError, match=r"stiffnesspoly"):
        scene.joints[0].stiffnesspoly = (1.0, np.inf)


def _twin(sim: sc.Sim, integrator: str) -> sc.Sim:
    twin = sc.Sim(sim.model, dt=0.005, integrator=integrator)
    twin.qpos, twin.qvel = sim.qpos.copy(), sim.qvel.copy()
    return twin
