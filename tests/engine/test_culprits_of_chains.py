"""Whom a post-mortem names where a chain flies apart within a few steps."""

import itertools

import numpy as np
import pytest

import stepcore as sc

SOFT = 'stiffness="2" damping=".02"'


def chain(seed, at, stiffness, servo):
    """Random links with soft joints; joint `at` has a spring or a servo of another stiffness."""
    rng = np.random.default_rng(seed)
    bodies, end = "", 0.0
    for i in range(5):
        own = SOFT if i != at else "" if servo else f'stiffness="{stiffness}"'
        axis, kind = rng.choice(["1 0 0", "0 1 0", "0 0 1"]), rng.choice(["hinge", "slide"])
        length, mass = rng.uniform(0.1, 0.5), 10 ** rng.uniform(-1, 0.7)
        bodies += f"""<body pos="{end} 0 0"><joint name="j{i}" type="{kind}" axis="{axis}" {own}/>
        <geom type="capsule" size=".03" fromto="0 0 0 {length} 0 0" mass="{mass}" contype="0"/>"""
        end = length
    motor = f'<position name="servo" joint="j{at}" kp="{stiffness}"/>' if servo else ""
    return sc.loads(f"""<mujoco><worldbody>{bodies}{"</body>" * 5}</worldbody>
    <actuator>{motor}</actuator></mujoco>""")


@pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")
@pytest.mark.parametrize("integrator", ["euler", "semi-implicit", "implicitfast", "rk4"])
@pytest.mark.parametrize("servo", [False, True], ids=["spring", "servo"])
def test_what_is_too_stiff_is_named_however_quickly_it_ends(servo, integrator):
    """1.4 to 5 times beyond 2/ω: energies reach 1e40 in ten steps, where they round to less than
    none, and what is flung down has fallen far."""
    dt, names = 0.01, []
    for seed, at, times in itertools.product(range(4), (1, 2, 3), (1.4, 3, 5)):
        start = sc.Sim(chain(seed, at, 1.0, servo))
        inertia = 1 / np.linalg.inv(start.mass_matrix())[at, at]
        scene = chain(seed, at, inertia * (2 * times / dt) ** 2, servo)
        sim = sc.Sim(scene, dt=dt, integrator=integrator, ledger=True)
        sim.qvel[:] = 0.5
        try:
            sim.step(1500)
        except sc.SimulationError as error:
            names.append((error.element, "servo `servo`" if servo else f"spring of joint `j{at}`"))
    assert len(names) > 20
    assert [pair for pair in names if pair[0] != pair[1]] == []
