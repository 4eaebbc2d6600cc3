"""Machine code of a step has the bits of the stages, in every lane."""

from __future__ import annotations

import numpy as np
import pytest
import zoo

import stepcore as sc
from stepcore import lesson

WORLDS, STEPS = 21, 24
WAYS = {
    "newton": {"solver": "newton"},
    "newton rk4": {"solver": "newton", "integrator": "rk4"},
    "sweeps": {"solver": "pgs", "sweeps": 6, "tolerance": 0.0, "integrator": "implicitfast"},
    "sweeps without start": {
        "solver": "pgs",
        "sweeps": 4,
        "tolerance": 0.0,
        "warm_start": False,
        "cone": "elliptic",
    },
}
SMALL = {
    "spring": lesson.spring(damping=0.1),
    "drop": lesson.drop(),
    "stack": lesson.stack(3),
}


def batch(monkeypatch, when, model, precision, **how):
    """Worlds at different poses and speeds, with code before the first step, or none."""
    monkeypatch.setenv("STEPCORE_COMPILE", when)
    made = sc.Batch(model, WORLDS, lanes=True, precision=precision, threads=1, **how)
    rng = np.random.default_rng(5)
    made.qvel[:] = rng.integers(-64, 65, made.qvel.shape) / 64
    made.ctrl[:] = rng.integers(-64, 65, made.ctrl.shape) / 64
    return made


def same(one, other):
    for name in ("qpos", "qvel", "act", "qacc"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("precision", ["f64", "f32"])
@pytest.mark.parametrize("name", sorted(zoo.ZOO))
def test_code_has_the_bits_of_the_stages(monkeypatch, name, precision, way):
    model = sc.loads(zoo.ZOO[name].text).compile()
    refused, made = set(), []
    for when in ("now", "0"):
        try:
            made.append(batch(monkeypatch, when, model, precision, **WAYS[way]))
        except ValueError as error:
            refused.add(str(error))
    if refused:
        assert len(refused) == 1 and not made
        return
    for steps in (1, STEPS, 3):
        failures = []
        for own in made:
            try:
                own.step(steps)
            except sc.SimulationError as error:
                failures.append(str(error))
        same(*made)
        assert len(set(failures)) <= 1
        assert len(failures) in (0, 2)
        if failures:
            return


@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_rollouts_and_resets_do_too(monkeypatch, name, precision):
    model = SMALL[name].compile()
    made = [batch(monkeypatch, when, model, precision) for when in ("now", "0")]
    ends = [own.rollout(np.zeros((WORLDS, 30, model.nu))).qpos for own in made]
    assert np.array_equal(*ends)
    same(*made)
    for own in made:
        own.reset(worlds=[3, 4])
        own.step(5)
        own.qpos[7] += 0.01
        own.step(5)
    same(*made)


def test_one_world_does_too():
    model = lesson.drop().compile()
    one, other = sc.Sim(model), sc.Sim(model)
    one.step(200)
    for _ in range(200):
        other.step(1)
    assert one.state() == other.state()
    assert (one.row_updates, one.most_rows) == (other.row_updates, other.most_rows)


def test_a_plan_says_what_code_there_is():
    plan = sc.plan(lesson.spring())
    assert plan.code.operations < 20
    assert any("qvel[0]" in line for line in plan.code.lines)
    assert "as machine code" in str(plan)


PENDULUM = """<mujoco><option solver="PGS" tolerance="0" iterations="6"/><worldbody>
<geom name="floor" type="plane" size="3 3 1"/><body name="a" pos="0 0 .3">
<joint name="j" axis="0 1 0" damping="0.1" stiffness="2" range="-60 60"/>
<geom name="g" type="capsule" fromto="0 0 0 .3 0 0" size=".05" mass="1"/></body></worldbody>
<actuator><motor name="m" joint="j" gear="2"/></actuator></mujoco>"""


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_values_that_differ_by_world_are_read_by_code(monkeypatch, precision):
    model = sc.loads(PENDULUM).compile().with_settings(acceleration="none", tolerance=0.0)
    made = [batch(monkeypatch, when, model, precision) for when in ("now", "0")]
    spread = np.linspace(0.5, 2.0, WORLDS)
    for own in made:
        own.param["body/a/mass"] = spread
        own.param["joint/j/damping"] = 0.1 * spread
        own.param["geom/floor/friction"] = np.stack([spread, 0.01 * spread, 0 * spread + 1e-4], 1)
    for steps in (1, STEPS):
        for own in made:
            own.step(steps)
        same(*made)
    assert len(np.unique(made[0].qpos[:, 0])) == WORLDS
    # Others later: code of the models before is not theirs.
    for own in made:
        own.param["body/a/mass"] = spread[::-1]
        own.step(STEPS)
    same(*made)


# What the stages do between two parts of the code.

MEETING = """<mujoco><option timestep="0.004"/><worldbody><geom type="plane" size="5 5 .1"/>
  <body name="left" pos="-.5 0 .1"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/></body>
  <body name="right" pos=".5 0 .12"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/></body>
  <body pos="0 .6 .5"><joint type="hinge" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .3 0 0"
    size=".04"/><body pos=".3 0 0"><joint type="hinge" axis="0 1 0"/>
    <geom type="cylinder" fromto="0 0 0 .2 0 0" size=".03"/></body></body>
  {more}</worldbody></mujoco>"""


def crowd():
    """More contacts than code has rows for: links of a chain over the floor."""
    link = """<body pos="{x} 0 0"><joint type="hinge" axis=".1 1 0" damping=".01"/>
      <geom type="capsule" fromto="0 0 0 .12 0 0" size=".03"/>"""
    links = [link.format(x=0.13 if k else -1) for k in range(10)]
    return MEETING.format(more=f'<body pos="0 -1 .2">{"".join(links)}{"</body>" * 11}')


@pytest.mark.parametrize("precision", ["f64", "f32"])
@pytest.mark.parametrize("text", [MEETING.format(more=""), crowd()], ids=["few", "crowd"])
@pytest.mark.parametrize("solver", [{"solver": "newton"}, {"solver": "pgs"}], ids=str)
def test_pairs_that_the_stages_test(monkeypatch, text, precision, solver):
    """Boxes that slide together, in some worlds and not in others."""
    model = sc.loads(text).compile()
    assert sc.plan(sc.loads(text).with_settings(precision=precision, **solver)).code
    made = []
    for when in ("now", "0"):
        monkeypatch.setenv("STEPCORE_COMPILE", when)
        own = sc.Batch(model, WORLDS, lanes=True, precision=precision, threads=1, **solver)
        own.qvel[:, 0] = np.linspace(0, 3, WORLDS)
        own.qvel[:, 6] = -np.linspace(0, 3, WORLDS)
        made.append(own)
    for _ in range(8):
        for own in made:
            own.step(20)
        same(*made)
    assert made[0].qvel[-1, 0] < 0.9 * 3, "they met"


def test_code_that_comes_while_worlds_step(monkeypatch):
    """Groups go by code or by the stages, whichever takes less time: nobody sees it."""
    made = []
    for when in ("", "0"):
        monkeypatch.setenv("STEPCORE_COMPILE", when)
        made.append(sc.Batch("gymnasium:hopper", 64, lanes=True, threads=2))
    rng = np.random.default_rng(0)
    for _ in range(200):
        control = rng.uniform(-1, 1, made[0].ctrl.shape)
        for own in made:
            own.ctrl[:] = control
            own.step(20)
    same(*made)
