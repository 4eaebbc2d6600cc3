"""`sweep(batch=True)`: the points of a grid as worlds of a batch, with the bits of single Sims."""

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.measure import sweep as sweep_module

SLIDING = """<mujoco><worldbody><geom name="floor" type="plane" size="5 5 1"/>
<body pos="0 0 0.1"><freejoint/><geom name="box" type="box" size="0.1 0.1 0.1"/></body>
</worldbody></mujoco>"""
GRID = {
    "geom/box/friction": np.linspace(0.2, 1.5, 7).tolist(),
    "dt": [0.002, 0.004],
    "gravity": [(0.0, 0.0, -9.81), (0.0, 0.0, -1.62)],
}


def slide(world):
    """The place to which a pushed box comes: in one world, or in all."""
    world.qvel[..., 0] = 2.0
    world.step(40)
    return {"way": np.array(world.qpos[..., 0]), "speed": np.array(world.qvel[..., 0])}


def test_a_batch_has_the_numbers_of_single_sims():
    model = sc.loads(SLIDING).compile()
    alone = sc.sweep(model, GRID, slide, threads=1)
    together = sc.sweep(model, GRID, slide, batch=True, threads=2)
    assert together.columns == alone.columns
    assert together.records == alone.records
    assert len(together) == 28


@pytest.mark.parametrize("pool", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_an_executor_gets_batches_of_some_points_each(monkeypatch, pool):
    model = sc.loads(SLIDING).compile()
    here = sc.sweep(model, GRID, slide, batch=True)
    monkeypatch.setattr(sweep_module, "MAX_POINTS", 3)
    with pool(2) as executor:
        there = sc.sweep(model, GRID, slide, batch=True, executor=executor)
    assert there.records == here.records


def pulled(world):
    world.qpos[..., 0] = 0.1
    world.step(200)
    return np.array(world.qpos[..., 0])


def test_points_that_fail_keep_their_rows():
    model = lesson.spring().compile()
    grid = {"body/mass/mass": [1.0, -2.0, 1e-9, 4.0]}
    how = {"integrator": ["semi-implicit"], "dt": [0.01]}
    alone = sc.sweep(model, grid | how, pulled, threads=1)
    together = sc.sweep(model, grid | how, pulled, batch=True)
    for one, other in zip(alone, together, strict=True):
        assert one.get("value") == other.get("value")
        assert (one.get("failure") is None) == (other.get("failure") is None)
    assert "mass" in together[1]["failure"]
    assert "diverged" in together[2]["failure"]


def test_what_cannot_be_measured_together_is_said():
    model = lesson.spring().compile()
    with pytest.raises(ValueError, match=r"batch = True: must be False"):
        sc.sweep(lambda dt: model, {"dt": [0.1]}, pulled, batch=True)
    with pytest.raises(TypeError, match=r'"value" has shape \(\).*2 worlds'):
        sc.sweep(model, {"dt": [0.1]} | {"joint/spring/stiffness": [1, 2]}, len, batch=True)
    with pytest.raises(ValueError, match="no value"):
        sc.sweep(model, {"joint/spring/stifness": [1, 2]}, pulled, batch=True)
