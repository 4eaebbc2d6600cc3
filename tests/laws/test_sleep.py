"""Sleep: who rests makes no rows, and wakes exactly when touched."""

import copy

import numpy as np
import pytest

import stepcore as sc

HALF, RADIUS = 0.1, 0.05
ON = {"sleep": True, "sleep_time": 0.1}
# Under laws on velocities a body at rest is at rest; under solref and penalty it creeps there.
LAWS = {
    "newton": {},
    "pgs": {"solver": "pgs", "sweeps": 100},
    "elliptic": {"cone": "elliptic", "stiction": True, "integrator": "implicitfast"},
    "rigid": {"law": "rigid", "solver": "pgs", "integrator": "semi-implicit", "sweeps": 200},
    "lesson": {"law": "lesson", "solver": "pgs", "integrator": "semi-implicit", "sweeps": 200},
    "penalty": {
        "law": "penalty",
        "integrator": "semi-implicit",
        "dt": 5e-4,
        "penalty_stiffness": 1e4,
        "penalty_damping_ratio": 0.5,
    },
}


def scene(boxes=2, extra=""):
    """A tower of boxes on a plane, a box beside it, and a ball far above the tower."""
    free = "".join(
        f'<body name="box{k}" pos="0 0 {(2 * k + 1) * HALF}"><freejoint/>'
        f'<geom name="box{k}" type="box" size="{HALF} {HALF} {HALF}" mass="1"/></body>'
        for k in range(boxes)
    )
    return f"""<mujoco><option timestep=".002"/><worldbody><geom name="floor" type="plane"
      size="5 5 1"/>{free}
      <body name="beside" pos="1 0 {HALF}"><freejoint/><geom type="box" size="{HALF} {HALF} {HALF}"
        mass="1"/></body>
      <body name="ball" pos="0 0 {2 * boxes * HALF + 20}"><freejoint/><geom name="ball"
        size="{RADIUS}" mass=".3"/></body>{extra}</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def model():
    return sc.loads(scene()).compile()


def dofs(sim, body):
    return slice(*(6 * (sim.model.body_names.index(body) - 1) + k for k in (0, 6)))


def asleep(sim):
    return {
        name for name, is_asleep in zip(sim.model.body_names, sim.asleep, strict=True) if is_asleep
    }


TOWER = {"box0", "box1"}


def slept(model, law="newton"):
    """A world whose boxes sleep while the ball falls."""
    sim = sc.Sim(model, **LAWS[law], **ON)
    for _ in range(3000):
        sim.step()
        if asleep(sim) == TOWER | {"beside"}:
            return sim
    raise AssertionError(f"asleep: {asleep(sim)}")


def above(sim, gap, speed):
    """Puts the ball so far above the tower, with a speed downward."""
    z = sim.qpos[7 + 2] + HALF + RADIUS + gap
    at = 7 * (sim.model.body_names.index("ball") - 1)
    sim.qpos[at : at + 7] = [sim.qpos[7], sim.qpos[8], z, 1, 0, 0, 0]
    sim.qvel[dofs(sim, "ball")] = [0, 0, -speed, 0, 0, 0]


@pytest.mark.parametrize("law", LAWS)
def test_what_rests_sleeps_and_costs_no_rows(model, law):
    sim = slept(model, law)
    before, updates = sim.qpos.copy(), sim.row_updates
    sim.step(20)
    for box in ("box0", "box1", "beside"):
        at = 7 * (sim.model.body_names.index(box) - 1)
        assert np.array_equal(sim.qpos[at : at + 7], before[at : at + 7])
        assert not sim.qvel[dofs(sim, box)].any() and not sim.qacc[dofs(sim, box)].any()
    assert sim.row_updates == updates and len(sim.rows) == 0 and len(sim.contacts) == 0


@pytest.mark.parametrize("law", LAWS)
def test_until_someone_sleeps_every_bit_is_the_same(model, law):
    sim, other = sc.Sim(model, **LAWS[law], **ON), sc.Sim(model, **LAWS[law])
    steps = 0
    while not sim.asleep.any():
        assert np.array_equal(sim.qpos, other.qpos) and np.array_equal(sim.qvel, other.qvel)
        sim.step()
        other.step()
        steps += 1
    assert steps * sim.settings.dt >= ON["sleep_time"] - 1e-9


@pytest.mark.parametrize("law", LAWS)
def test_a_ball_wakes_the_tower_in_the_step_in_which_it_touches(model, law):
    sim = slept(model, law)
    above(sim, 0.011, 1.0)
    awake = sc.Sim(model, **LAWS[law])
    for _ in range(60):
        awake.restore(sim.state())
        awake.step()
        touches = any("ball" in str(names) for names in touching(awake))
        sim.step()
        assert asleep(sim) == ({"beside"} if touches else TOWER | {"beside"})
        if touches:
            break
    assert touches
    # The tower and the ball: as if it had never slept.
    for body in (*TOWER, "ball"):
        assert np.array_equal(sim.qvel[dofs(sim, body)], awake.qvel[dofs(awake, body)])


def touching(sim):
    """Names of what has rows, or under `penalty` pushes."""
    contacts = [(str(c["name1"]), str(c["name2"])) for c in sim.contacts if c["dist"] < 0]
    return contacts if sim.settings.law == "penalty" else [str(row["name"]) for row in sim.rows]


WAYS = {
    "qfrc": lambda sim: sim.qfrc_applied.__setitem__(6 + 2, 1e-6),
    "xfrc": lambda sim: sim.xfrc_applied.__setitem__((1, 2), 1e-6),
    "qvel": lambda sim: sim.qvel.__setitem__(6 + 2, 1e-9),
    "qpos": lambda sim: sim.qpos.__setitem__(7 + 2, sim.qpos[7 + 2] + 1e-12),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("law", ["newton", "pgs", "rigid"])
def test_writing_wakes_the_island_and_no_other(model, law, way):
    sim = slept(model, law)
    before = sim.state()
    WAYS[way](sim)
    awake = sc.Sim(model, **LAWS[law])
    awake.restore(sim.state())
    sim.forward()
    assert asleep(sim) == TOWER | {"beside"}
    sim.step()
    awake.step()
    assert asleep(sim) == {"beside"}
    for body in TOWER:
        assert np.array_equal(sim.qvel[dofs(sim, body)], awake.qvel[dofs(awake, body)])
    sim.restore(before)
    sim.step()
    assert asleep(sim) == TOWER | {"beside"}


def test_what_stood_on_a_support_falls_when_it_is_taken_away(model):
    sim = slept(model)
    sim.qpos[1] += 3.0
    sim.step(50)
    assert sim.qvel[6 + 2] == pytest.approx(-9.81 * 0.1, rel=0.02)


@pytest.mark.parametrize("copied", [lambda sim: copy.deepcopy(sim), None])
@pytest.mark.parametrize("law", ["newton", "elliptic", "rigid"])
def test_a_snapshot_of_a_sleeping_world_continues_bit_for_bit(model, law, copied):
    sim = slept(model, law)
    above(sim, 0.05, 1.0)
    sim.step(5)
    other = copied(sim) if copied else sc.Sim(model, **LAWS[law], **ON)
    if not copied:
        other.step(3)
        other.restore(sim.state())
    seen = []
    for _ in range(20):
        seen.append(asleep(sim))
        assert np.array_equal(sim.asleep, other.asleep)
        sim.step(10)
        other.step(10)
        assert np.array_equal(sim.qpos, other.qpos) and np.array_equal(sim.qvel, other.qvel)
    assert seen[0] == TOWER | {"beside"} and {"beside"} in seen
    assert sim.state() == other.state()


def test_a_heap_sleeps_by_its_islands():
    """100 balls on a floor, 10 cm between them: 5050 pairs that could meet."""
    balls = "".join(
        f'<body name="b{k}" pos="{0.2 * (k % 10)} {0.2 * (k // 10)} {RADIUS}"><freejoint/>'
        f'<geom size="{RADIUS}"/></body>'
        for k in range(100)
    )
    text = f"""<mujoco><worldbody><geom type="plane" size="5 5 1" condim="6"
      friction="1 .01 .01"/>{balls}</worldbody></mujoco>"""
    model = sc.loads(text).compile()
    assert model.is_heap
    sim = sc.Sim(model, **ON)
    sim.step(300)
    assert sim.asleep.sum() == 100
    updates = sim.row_updates
    sim.step(10)
    assert sim.row_updates == updates
    sim.qvel[0] = 1.0
    sim.step(20)
    assert asleep(sim) == set(model.body_names[2:])
    # Ball 1 is touched where 10 cm are gone, and ball 2 not yet.
    while sim.qpos[0] < 0.1:
        sim.step()
    sim.step()
    assert asleep(sim) == set(model.body_names[3:])


def test_an_actuator_keeps_its_tree_awake_and_a_joint_at_its_limit_sleeps():
    text = """<mujoco><worldbody>
      <body><joint name="a" axis="0 1 0" range="-10 10" frictionloss=".01"/>
        <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/></body>
      <body pos="0 1 0"><joint name="b" axis="0 1 0" range="-10 10" frictionloss=".01"/>
        <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/></body></worldbody>
      <actuator><motor joint="b"/></actuator></mujoco>"""
    sim = sc.Sim(sc.loads(text).compile(), **ON)
    sim.step(1500)
    assert sim.asleep.tolist() == [False, True, False]
    assert sim.rows["name"].tolist() == ["friction loss of joint `b`", "limit of joint `b`"]


def test_many_worlds_sleep_one_by_one(model):
    batch = sc.Batch(model, 9, **ON)
    sim = sc.Sim(model, **ON)
    batch.step(400)
    sim.step(400)
    assert sim.asleep.any()
    assert all(np.array_equal(qpos, sim.qpos) for qpos in batch.qpos)
    assert batch.asleep.dtype == bool
    assert all(np.array_equal(asleep, sim.asleep) for asleep in batch.asleep)
    batch.xfrc_applied[4, np.flatnonzero(sim.asleep)[0], 2] = 1e-3
    batch.step(1)
    assert batch.asleep[3].any() and batch.asleep[4].sum() < batch.asleep[3].sum()
    assert not sc.Batch(model, 3).asleep.any()


@pytest.mark.parametrize("integrator", ["midpoint", "rk4"])
def test_what_cannot_sleep_is_refused(model, integrator):
    with pytest.raises(ValueError, match=f"integrator = '{integrator}' with sleep"):
        sc.Sim(model, sleep=True, integrator=integrator)
    with pytest.raises(ValueError, match="sleep_time = -1"):
        sc.Sim(model, sleep=True, sleep_time=-1)


def test_a_derivative_is_that_of_the_step_awake(model):
    sim = slept(model)
    awake = sc.Sim(model)
    awake.restore(sim.state())
    assert np.array_equal(sim.linearize().A, awake.linearize().A)
