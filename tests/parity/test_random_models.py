"""Random models of everything that holds, pulls, drives and senses are MuJoCo's.

Law: at two random states of each model all that `peers.note_forward` compares (poses, mass matrix,
bias, passive, actuator and constraint forces, acceleration, contacts, sensors) and the step after
it agree to 1e-8 of the largest number of each; a model that MuJoCo refuses is refused here too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from random import Random

import mujoco
import numpy as np
import peers
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_model import Maker

import stepcore as sc
from stepcore.mjcf.nodes import MJCFError

# Equalities of two sites of one body have no rows in MuJoCo.
REFUSED_HERE = ("of the same body",)
REFUSED_BY_BOTH = ("mass and inertia of moving bodies", "geom wrapping not supported")
ROUNDING = 1e-20
LIMITS = dict.fromkeys((peers.PLACED | peers.SOLVED | peers.STEPPED), 1e-8)


@dataclass
class State(peers.State):
    """With the poses of mocap bodies, and which equalities are active."""

    mocap_pos: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    mocap_quat: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    eq_active: np.ndarray = field(default_factory=lambda: np.zeros(0))


def draw(model: mujoco.MjModel, rng: np.random.Generator) -> State:
    """A state some way from qpos0."""
    data = mujoco.MjData(model)
    qpos = data.qpos.copy()
    peers.nudge(model, qpos, rng, 0.4)
    quat = data.mocap_quat + 0.3 * rng.normal(size=data.mocap_quat.shape)
    pushed = np.zeros((model.nbody, 6))
    pushed[1:] = rng.normal(size=(model.nbody - 1, 6))
    return State(
        qpos,
        rng.normal(size=model.nv),
        rng.normal(size=model.nu),
        0.5 * rng.normal(size=model.nv),
        0.5 * pushed,
        rng.uniform(-0.3, 1.0, model.na),
        data.mocap_pos + 0.1 * rng.normal(size=data.mocap_pos.shape),
        quat / np.linalg.norm(quat, axis=1, keepdims=True),
        data.eq_active ^ (rng.uniform(size=model.neq) < 0.2),
    )


def differences(text: str, seed: int) -> peers.Worst | None:
    """The largest differences between the engines; None for a model that is refused."""
    try:
        model = peers.strict(mujoco.MjModel.from_xml_string(text))
    except ValueError as error:
        with pytest.raises(ValueError):
            sc.loads(text).compile()
        assert any(reason in str(error) for reason in REFUSED_BY_BOTH), error
        return None
    if ((model.tendon_invweight0 > 0) & (model.tendon_invweight0 < ROUNDING)).any():
        # Its ends move as one: MuJoCo's rows of it are roundings, with forces of any size.
        return None
    try:
        sim = sc.Sim(sc.loads(text), **peers.EXACT)
    except MJCFError as error:
        assert any(reason in str(error) for reason in REFUSED_HERE), error
        return None
    data, rng, worst = mujoco.MjData(model), np.random.default_rng(seed), peers.Worst()
    for index in range(2):
        state = draw(model, rng)
        sim.time = 0.0
        if nothing_moves_a_row(model, data, state):
            continue
        peers.note_forward(worst, index, sim, model, data, state)
        peers.note_step(worst, index, sim, model, data, state)
    return worst


def nothing_moves_a_row(model: mujoco.MjModel, data: mujoco.MjData, state: State) -> bool:
    """An equality asks for what its dofs cannot give, as a weld does of two bodies that only slide.

    MuJoCo's row has the softness 1e-15 then, and a share in the cost, some 1e21, that leaves Newton
    no digits to see by what else costs less: it stops at once, with errors of up to 1e-2.
    """
    state.to_mujoco(model, data)
    mujoco.mj_forward(model, data)
    equality = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    return bool((data.efc_diagA[equality] < ROUNDING**0.5).any())


def compare(seed: int) -> None:
    text = Maker(Random(seed)).model()
    if worst := differences(text, seed):
        worst.check(LIMITS, f"seed {seed}")


@pytest.mark.filterwarnings("ignore::UserWarning")
@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 2**32))
def test_a_random_model_is_mujocos(seed: int) -> None:
    compare(seed)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::UserWarning")
@settings(max_examples=2000, deadline=None)
@given(st.integers(0, 2**32))
def test_many_random_models_are_mujocos(seed: int) -> None:
    compare(seed)
