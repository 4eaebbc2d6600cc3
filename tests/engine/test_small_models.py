"""Small models: calls of many steps and worlds of batches have the bits of single steps."""

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson

SCENES = {
    "spring": lesson.spring(damping=0.1),
    "drop": lesson.drop(),
    "stack": lesson.stack(5),
    "spring f32": lesson.spring(precision="f32"),
    "drop f32": lesson.drop(precision="f32"),
}
PENDULUM = """<mujoco><option integrator="implicitfast"/><worldbody><body pos="0 0 1">
<joint name="a" axis="0 1 0" damping="0.01"/><geom size="0.05" pos="0.3 0 0"/>
<body pos="0.3 0 0"><joint name="b" axis="1 0 0" stiffness="2"/><geom size="0.04" pos="0 0 -0.2"/>
</body></body></worldbody></mujoco>"""


def scene(name):
    if name == "pendulum":
        pendulum = sc.loads(PENDULUM)
        pendulum.add_key("start", qpos=[0.4, -0.3])
        return pendulum
    return SCENES[name]


@pytest.mark.parametrize("name", [*SCENES, "pendulum"])
def test_calls_of_many_steps_are_single_steps(name):
    model = scene(name).compile()
    one, other = sc.Sim(model), sc.Sim(model)
    for sim in (one, other):
        sim.reset(key="start")
        sim.qvel[:] = 0.3
    for n in (7, 64, 300):
        one.step(n)
        for _ in range(n):
            other.step(1)
        assert one.state() == other.state()
        assert np.array_equal(one.qacc, other.qacc)
        assert (one.row_updates, one.most_rows) == (other.row_updates, other.most_rows)
        for sim in (one, other):
            sim.qfrc_applied[0] = 0.5 if n == 7 else 0.0


@pytest.mark.parametrize("name", [*SCENES, "pendulum"])
@pytest.mark.parametrize("lanes", ["auto", True, False])
def test_worlds_of_a_batch_are_single_worlds(name, lanes):
    model, n = scene(name).compile(), 21
    batch = sc.Batch(model, n, threads=2, lanes=lanes)
    spread = np.linspace(0.0, 0.4, n)[:, None]
    batch.qpos[:] = np.asarray(scene(name).key("start").qpos) + spread
    sims = [sc.Sim(model) for _ in range(n)]
    for sim, qpos in zip(sims, batch.qpos.copy(), strict=True):
        sim.qpos[:] = qpos
    for steps in (1, 2, 90):
        batch.step(steps)
        for _ in range(steps):
            for sim in sims:
                sim.step(1)
        for name_ in ("qpos", "qvel", "qacc", "residual"):
            alone = np.array([getattr(sim, name_) for sim in sims])
            assert np.array_equal(getattr(batch, name_), alone), name_


def test_whoever_leaves_the_finite_numbers_says_so_as_before():
    model = lesson.spring(k=1e9).compile()  # far too stiff for its step
    one, other = sc.Sim(model), sc.Sim(model)
    errors = []
    for sim, portions in ((one, [400]), (other, [1] * 400)):
        sim.reset(key="start")
        with pytest.raises(sc.SimulationError) as raised:
            for n in portions:
                sim.step(n)
        errors.append(raised.value)
    assert [str(error) for error in errors[:1]] == [str(error) for error in errors[1:]]
    assert one.time == other.time
    assert one.state() == other.state()
    batch = sc.Batch(model, 20)
    batch.qpos[:, 0] = np.linspace(0.5, 1.0, 20)
    with pytest.raises(sc.SimulationError):
        batch.step(400)
