"""`Batch(lanes="auto")` changes between lanes and single worlds as it runs, and no bit changes."""

import numpy as np
import pytest
from covering import every_pair

import stepcore as sc

WALKER = """<mujoco><option timestep="0.004"/><worldbody><geom type="plane" size="5 5 1"/>
<body pos="0 0 0.5"><freejoint/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.06"/>
<body pos="0.3 0 0"><joint name="a" axis="0 1 0" range="-60 60"/>
<geom type="capsule" fromto="0 0 0 0.2 0 -0.3" size="0.05"/></body>
<body><joint name="b" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 -0.2 0 -0.3" size="0.05"/>
</body></body></worldbody><actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>"""


def pair(n, **fields):
    model = sc.loads(WALKER).compile()
    batches = [sc.Batch(model, n, threads=1, lanes=lanes, **fields) for lanes in ("auto", False)]
    for batch in batches:
        random = np.random.default_rng(3)
        batch.qvel[:] = random.normal(size=batch.qvel.shape)
        batch.ctrl[:] = random.normal(size=batch.ctrl.shape)
    return batches


@every_pair(portion=[1, 7, 200], precision=["f64", "f32"], solver=["pgs", "newton"])
def test_no_bit_depends_on_the_way(solver, precision, portion):
    auto, alone = pair(13, solver=solver, precision=precision)
    for _ in range(0, 200, portion):
        auto.step(portion)
        alone.step(portion)
        assert np.array_equal(auto.qpos, alone.qpos)
        assert np.array_equal(auto.qvel, alone.qvel)
        assert np.array_equal(auto.qacc, alone.qacc)
    assert np.array_equal(auto.residual, alone.residual)
    assert np.array_equal(auto.constraint_force, alone.constraint_force)
    assert np.array_equal(auto.cfrc_ext, alone.cfrc_ext)
    assert auto.state() == alone.state()
    assert auto.time == alone.time


def test_rollouts_resets_and_parameters_on_the_way():
    auto, alone = pair(9)
    controls = np.random.default_rng(5).normal(size=(9, 60, 2))
    for batch in (auto, alone):
        batch.param["joint/a/damping"] = np.repeat([0.1, 0.2, 0.3], 3)
    one, other = auto.rollout(controls), alone.rollout(controls)
    assert np.array_equal(one.qpos, other.qpos)
    for batch in (auto, alone):
        batch.reset(worlds=[1, 5])
        batch.step(37)
        del batch.param["joint/a/damping"]
        batch.step(41)
    assert np.array_equal(auto.qpos, alone.qpos)


def test_values_that_change_between_the_ways():
    auto, alone = pair(9)
    values = np.linspace(0.1, 0.5, 9)
    for k in range(70):  # Each way is taken up again after values have changed.
        values[k % 9] = 0.1 + 0.01 * k
        for batch in (auto, alone):
            batch.param["joint/a/damping"] = values
            batch.step(1 + k % 3)
        assert np.array_equal(auto.qpos, alone.qpos)


@pytest.mark.parametrize("on_failure", ["stop", "go on"])
def test_failures_are_the_same(on_failure):
    auto, alone = pair(10, on_failure=on_failure)
    for batch in (auto, alone):
        batch.step(30)
        batch.qvel[4, 3] = 1e200
        if on_failure == "stop":
            with pytest.raises(sc.SimulationError, match="world 4"):
                batch.step(100)
            batch.qvel[4, 3] = 0
        else:
            batch.step(100)
            assert list(batch.failures) == [4]
        batch.step(50)
    assert np.array_equal(auto.qpos, alone.qpos)
    assert np.array_equal(auto.residual, alone.residual)


def wild():
    """Two masses on springs: that of one gains energy until it overflows."""
    scene = sc.Scene(gravity=(0, 0, 0)).with_settings(dt=0.1, integrator="semi-implicit")
    for name, stiffness in (("calm", 1.0), ("wild", 1e4)):
        body = scene.add_body(name)
        scene.add_joint(body, "slide", name=name, stiffness=stiffness)
        scene.add_geom(body, "sphere", 0.1, mass=1.0, contype=0, conaffinity=0)
    return scene.compile()


READ = ("qpos", "qvel", "qacc", "residual", "constraint_force", "actuator_force", "cfrc_int")


def numbers(batch, name):
    """An array's bytes, or the error with which it is refused."""
    try:
        return getattr(batch, name).tobytes()
    except sc.SimulationError as error:
        return str(error)


def what_is_read(batch):
    return {name: numbers(batch, name) for name in READ} | {
        "rows": repr([table.tolist() for table in batch.rows]),
        "contacts": repr([table.tolist() for table in batch.contacts]),
        "time": batch.time,
        "energy": batch.energy.tolist(),
        "state": batch.state(),
        "failures": {world: str(error) for world, error in batch.failures.items()},
    }


@pytest.mark.filterwarnings("ignore")
@every_pair(
    on_failure=["stop", "go on"],
    scene=["wild", "walker"],
    portions=[(1,) * 60, (60,), (7, 1, 2, 50), (3, 57)],
    lanes=["auto", True],
)
def test_what_is_read_after_a_failure_tells_nothing_of_the_way(lanes, portions, scene, on_failure):
    """With the way changed at every step, and whatever the calls in which the steps are made."""
    model = wild() if scene == "wild" else sc.loads(WALKER).compile()
    found = []
    for way, calls in ((lanes, portions), (False, (60,))):
        batch = sc.Batch(model, 9, lanes=way, threads=1, on_failure=on_failure)
        if way == "auto":
            batch._core.turn_at_every_step()
        batch.qvel[:] = np.random.default_rng(3).normal(size=batch.qvel.shape)
        batch.qvel[4, -1] = 1e60
        messages = []
        for _ in range(2):  # The second time where all stand.
            for steps in calls:
                try:
                    batch.step(steps)
                except sc.SimulationError as error:
                    messages.append(str(error))
                    break
        found.append({"messages": messages, **what_is_read(batch)})
    assert [name for name in found[0] if found[0][name] != found[1][name]] == []


def test_the_words_of_lanes():
    with pytest.raises(ValueError, match="lanes = 'fast': must be one of True, False, 'auto'"):
        sc.Batch(sc.loads(WALKER), 2, lanes="fast")
