"""Random models of drives, delays and what else `random_drives` writes are MuJoCo's.

Law: at two random states both engines agree to 1e-8 of the largest number of each quantity, and to
1e-6 in a run of fifteen steps under changing controls; to 1e-5 of a model with meshes, whose
vertices MuJoCo keeps in single precision.
"""

from __future__ import annotations

from pathlib import Path
from random import Random

import mujoco
import numpy as np
import peers
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_drives import DrivesMaker
from test_random_models import REFUSED_BY_BOTH, REFUSED_HERE, ROUNDING, draw, nothing_moves_a_row

import stepcore as sc

# Motions beyond this are about to explode, and what differs by rounding grows in them.
FAST = 100.0
BAD = (*REFUSED_BY_BOTH, "is repeated", "actuator armature", "lengthrange")


def compare(seed: int, folder: Path) -> None:
    maker = DrivesMaker(Random(seed))
    text = maker.model()
    for name, content in maker.files().items():
        (folder / name).write_text(content)
    path = folder / "model.xml"
    path.write_text(text)
    try:
        model = peers.strict(mujoco.MjModel.from_xml_path(str(path)))
    except ValueError as error:
        with pytest.raises(ValueError):
            sc.load(path).compile()
        assert any(reason in str(error) for reason in BAD), error
        return
    if ((model.tendon_invweight0 > 0) & (model.tendon_invweight0 < ROUNDING)).any():
        return
    try:
        sim = sc.Sim(sc.load(path), **peers.EXACT)
    except ValueError as error:
        assert any(reason in str(error) for reason in REFUSED_HERE), error
        return
    agree_at_states(seed, sim, model, 1e-5 if "<mesh" in text else 1e-8)
    if "<mesh" not in text:
        agree_in_a_run(seed, sim, model)


def agree_at_states(seed: int, sim: sc.Sim, model: mujoco.MjModel, limit: float) -> None:
    data, rng, worst = mujoco.MjData(model), np.random.default_rng(seed), peers.Worst()
    for index in range(2):
        state = draw(model, rng)
        sim.time = 0.0
        if not nothing_moves_a_row(model, data, state):
            peers.note_forward(worst, index, sim, model, data, state)
            peers.note_step(worst, index, sim, model, data, state)
    # The axes of a mesh are its roundings where two principal moments are nearly equal.
    limits = dict.fromkeys(peers.PLACED | peers.SOLVED | peers.STEPPED, limit)
    worst.check(limits | ({"geom_xmat": 2.0} if limit > 1e-7 else {}), f"seed {seed}")


def agree_in_a_run(seed: int, sim: sc.Sim, model: mujoco.MjModel) -> None:
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    sim.reset()
    data.qvel[:] = sim.qvel[:] = 0.3 * rng.normal(size=model.nv)
    for step in range(15):
        data.ctrl[:] = sim.ctrl[:] = rng.normal(size=model.nu)
        mujoco.mj_step(model, data)
        try:
            sim.step()
        except sc.SimulationError:
            return
        if not max(np.abs(data.qvel).max(), np.abs(data.qpos).max()) < FAST:
            return
        for name in ("qpos", "qvel", "act"):
            apart = peers.apart(getattr(sim, name), getattr(data, name))
            assert apart < 1e-6, f"seed {seed}: {name} {apart:.1e} in step {step}"


def test_all_that_is_drawn_is_there():
    """The kinds of elements that these models add."""
    text = "".join(DrivesMaker(Random(seed)).model() for seed in range(200))
    for word in ("<pid", "<dcmotor", "<muscle", "<orientation", "delay=", "adhesion=", "<attach"):
        assert word in text, word
    for word in (
        "surfacevel",
        "actuatorgravcomp",
        "<replicate",
        "<mesh",
        "<insidesite",
        "<exclude",
    ):
        assert word in text, word
    assert '<pair geom1="floor"' in text and "lugre" in text and "<key " in text


@pytest.mark.filterwarnings("ignore::UserWarning")
@settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.integers(0, 2**32))
def test_a_random_drive_is_mujocos(tmp_path: Path, seed: int) -> None:
    compare(seed, tmp_path)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::UserWarning")
@settings(
    max_examples=1000,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.integers(0, 2**32))
def test_many_random_drives_are_mujocos(tmp_path: Path, seed: int) -> None:
    compare(seed, tmp_path)
