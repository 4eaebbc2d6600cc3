"""`Batch.param`: worlds of one batch with masses, friction, gains of their own.

The law: a world of a batch computes the bits of a `Sim` of the model that the scene makes with the
world's values, whoever its neighbours are.
"""

import copy
import pickle
import re

import numpy as np
import pytest
from covering import every_pair
from hypothesis import given, settings
from hypothesis import strategies as st

import stepcore as sc
from stepcore.engine.parameters import ModelVariation, own_value
from stepcore.scene.records import Variation
from stepcore.scene.value_paths import changed_scene

ARM = """<mujoco><option gravity="0 0 -9.81"/><worldbody>
<geom name="floor" type="plane" size="5 5 1" friction="0.8"/>
<body name="upper" pos="0 0 0.5">
<joint name="shoulder" axis="0 1 0" range="-1 1" limited="true" damping="0.1"/>
<geom name="rod" type="capsule" fromto="0 0 0 0.4 0 0" size="0.04"/>
<body name="lower" pos="0.4 0 0">
<joint name="elbow" axis="0 1 0" armature="0.01" stiffness="1"/>
<geom name="hand" type="sphere" pos="0.3 0 0" size="0.05"/></body></body>
<body name="box" pos="1 0 0.1"><freejoint/><geom name="box" type="box" size="0.1 0.1 0.1"/></body>
</worldbody><actuator><position name="servo" joint="elbow" kp="5"/></actuator></mujoco>"""

# Everything of a scene that a trainer varies, with values that differ by world.
VARIED = {
    "geom/box/friction": lambda u: 0.2 + u,
    "body/upper/mass": lambda u: 1 + u,
    "geom/hand/mass": lambda u: 0.5 + u,
    "joint/shoulder/damping": lambda u: 0.1 + u,
    "joint/elbow/armature": lambda u: 0.01 + 0.1 * u,
    "joint/elbow/stiffness": lambda u: 1 + 5 * u,
    "joint/shoulder/range": lambda u: np.stack([-0.5 - u, 0.5 + u], axis=-1),
    "joint/elbow/frictionloss": lambda u: 0.3 * u,
    "actuator/servo/kp": lambda u: 5 + 20 * u,
    "gravity": lambda u: np.stack([0 * u, 0.3 * u, -5 - 5 * u], axis=-1),
    "geom/floor/solref": lambda u: np.stack([0.02 + 0.02 * u, 1 + 0 * u], axis=-1),
    "body/lower/pos": lambda u: np.stack([0.4 + 0.1 * u, 0 * u, 0 * u], axis=-1),
}


def model(**fields):
    return sc.loads(ARM).compile().with_settings(**fields)


def started(batch):
    n = len(batch)
    batch.qvel[:, 0] = np.linspace(-3, 3, n)
    batch.qvel[:, 2] = np.linspace(1, 4, n)
    batch.ctrl[:, 0] = np.linspace(-1, 1, n)
    return batch


def alone(batch, world, values):
    sim = sc.Sim(batch.model.with_values(values))
    sim.qpos, sim.qvel, sim.ctrl = batch.qpos[world], batch.qvel[world], batch.ctrl[world]
    return sim


def rows(columns, world):
    return {path: column[world].tolist() for path, column in columns.items()}


def same(batch, sims, worlds=None):
    for world, sim in zip(worlds or range(len(batch)), sims, strict=True):
        assert np.array_equal(batch.qpos[world], sim.qpos), world
        assert np.array_equal(batch.qvel[world], sim.qvel), world


@every_pair(solver=["pgs", "newton"], path=VARIED)
def test_a_world_is_a_sim_of_its_own_model(path, solver):
    batch = started(sc.Batch(model(solver=solver), 5, threads=2))
    columns = {path: VARIED[path](np.array([0.0, 0.9, 0.3, 0.9, 0.6]))}
    batch.param[path] = columns[path]
    sims = [alone(batch, world, rows(columns, world)) for world in range(5)]
    batch.step(60)
    for sim in sims:
        sim.step(60)
    same(batch, sims)
    assert not np.array_equal(batch.qpos[0], batch.qpos[1])


# Worlds of a register whose every value differs, on models with boxes, meshes, tendons and ranges.
SPREAD = np.linspace(0.05, 0.95, 20)
TETRA = "0 0 0 .2 0 0 0 .2 0 0 0 .2"
HEAPED = f"""<mujoco><asset><mesh name="m" vertex="{TETRA}"/></asset><worldbody>
<geom name="floor" type="plane" size="5 5 1"/>
<body name="a" pos="0 0 .15"><freejoint/><geom name="a" type="box" size=".1 .15 .1"/></body>
<body name="b" pos=".1 0 .4"><freejoint/><geom name="b" type="mesh" mesh="m"/></body>
<body name="c" pos=".5 0 .3"><joint name="c" axis="0 1 0" damping=".1" range="-40 40"/>
<geom name="c" type="capsule" fromto="0 0 0 .3 0 0" size=".04"/>
<geom name="d" type="cylinder" pos=".3 0 0" size=".05 .06"/></body></worldbody>
<tendon><fixed name="t" stiffness="3" damping=".2"><joint joint="c" coef="1"/></fixed></tendon>
<actuator><position name="p" joint="c" kp="20" kv="1" forcerange="-5 5"/></actuator></mujoco>"""
HEAPED_VALUES = {
    "geom/a/size": lambda u: np.stack([0.08 + 0.04 * u, 0.1 + 0.1 * u, 0.1 + 0 * u], axis=-1),
    "geom/c/size": lambda u: np.stack([0.03 + 0.02 * u, 0.15 + 0 * u, 0 * u], axis=-1),
    "geom/b/friction": lambda u: np.stack([0.3 + u, 0.005 + 0 * u, 1e-4 + 0 * u], axis=-1),
    "geom/b/mass": lambda u: 0.5 + u,
    "body/a/mass": lambda u: 2 + u,
    "actuator/p/kp": lambda u: 10 + 10 * u,
    "joint/c/range": lambda u: np.stack([-0.2 - u, 0.2 + u], axis=-1),
    "gravity": lambda u: np.stack([0.1 + u, u - 0.5, -5 - 5 * u], axis=-1),
}


@every_pair(
    **{"text, varied": [(ARM, VARIED), (HEAPED, HEAPED_VALUES)]},
    fields=[{"solver": "newton"}, {"solver": "pgs", "sweeps": 8}, {"cone": "elliptic"}],
    integrator=["euler", "implicitfast", "rk4"],
    precision=["f64", "f32"],
)
def test_worlds_of_distinct_values_share_lanes(text, varied, fields, integrator, precision):
    base = sc.loads(text).compile()
    base = base.with_settings(integrator=integrator, precision=precision, **fields)
    batch = started(sc.Batch(base, len(SPREAD), lanes=True))
    columns = {path: values(SPREAD) for path, values in varied.items()}
    batch.param.update(columns)
    assert batch.in_lanes == sc.Batch(base, 2, lanes=True).in_lanes
    sims = [alone(batch, world, rows(columns, world)) for world in range(len(SPREAD))]
    batch.step(40)
    for sim in sims:
        sim.step(40)
    same(batch, sims)


def test_only_worlds_of_new_values_are_compiled_and_made_anew(monkeypatch):
    compiled = []
    own = ModelVariation.compiled
    monkeypatch.setattr(
        ModelVariation, "compiled", lambda self, data: compiled.append(1) or own(self, data)
    )
    batch = started(sc.Batch(model(), 20, lanes=True))
    column = 0.5 + SPREAD
    batch.param["body/upper/mass"] = column
    assert len(compiled) == 20
    sims = [alone(batch, w, {"body/upper/mass": column[w]}) for w in range(20)]
    batch.step(30)
    batch.param["body/upper/mass"][[7]] = 2.5
    assert len(compiled) == 21
    assert batch.param["body/upper/mass"][7] == 2.5 and column[7] != 2.5
    batch.step(30)
    for sim in sims:
        sim.step(60)
    others = [world for world in range(20) if world != 7]
    same(batch, [sims[world] for world in others], others)
    assert not np.array_equal(batch.qpos[7], sims[7].qpos)


def test_rows_of_an_array_are_assigned_in_place():
    batch = sc.Batch(model(), 4)
    own = batch.param["geom/floor/friction"]
    own[2, 0] = 0.25
    batch.param["joint/elbow/armature"][:2] = [0.1, 0.2]
    assert np.array_equal(batch.param["geom/floor/friction"], own)
    assert batch.param["joint/elbow/armature"].tolist() == [0.1, 0.2, 0.01, 0.01]
    view = batch.param["joint/elbow/armature"][1:]
    view[0] = 7.0
    doubled = batch.param["joint/elbow/armature"] * 2
    doubled[0] = 5.0
    assert batch.param["joint/elbow/armature"].tolist() == [0.1, 0.2, 0.01, 0.01]
    with pytest.raises(ValueError, match=r"world 3.*armature = -1"):
        batch.param["joint/elbow/armature"][3] = -1.0
    assert batch.param["joint/elbow/armature"].tolist() == [0.1, 0.2, 0.01, 0.01]


@settings(deadline=None, max_examples=12)
@given(
    paths=st.sets(st.sampled_from(sorted(VARIED)), min_size=1),
    drawn=st.lists(st.sampled_from([0.0, 0.25, 0.5, 1.0]), min_size=1, max_size=24),
    lanes=st.booleans(),
    threads=st.integers(1, 3),
    precision=st.sampled_from(["f64", "f32"]),
    integrator=st.sampled_from(["implicitfast", "discrete", "rk4"]),
)
def test_any_mixture_has_the_bits_of_its_sims(paths, drawn, lanes, threads, precision, integrator):
    n, u = len(drawn), np.array(drawn)
    base = model(precision=precision, integrator=integrator)
    batch = started(sc.Batch(base, n, threads=threads, lanes=lanes))
    columns = {path: VARIED[path](u) for path in sorted(paths)}
    batch.param.update(columns)
    sims = [alone(batch, world, rows(columns, world)) for world in range(n)]
    batch.step(20)
    reset = list(range(0, n, 3))
    batch.reset(worlds=reset)
    batch.step(10)
    for world, sim in enumerate(sims):
        sim.step(20)
        if world in reset:
            sim.reset()
        sim.step(10)
    same(batch, sims)


@pytest.mark.parametrize("path", VARIED)
def test_only_what_a_value_touches_is_made_anew_and_the_scene_is_the_same(path):
    base = model()
    variation = Variation(base.scene, [path], base.masses())
    for u in (0.0, 0.4, 0.8, 0.4):
        values = {path: VARIED[path](np.array([u]))[0].tolist()}
        assert variation.data(values) == changed_scene(base.scene, values, base.masses()).to_dict()


def test_what_is_read_is_that_of_the_world():
    batch = started(sc.Batch(model(), 3, threads=2))
    columns = {"body/upper/mass": np.array([1.0, 2.0, 3.0])}
    batch.param["body/upper/mass"] = columns["body/upper/mass"]
    sims = [alone(batch, world, rows(columns, world)) for world in range(3)]
    batch.step(5)
    for world, sim in enumerate(sims):
        sim.step(5)
        for name in ("xpos", "cinert", "bias", "constraint_force", "actuator_force", "cfrc_ext"):
            assert np.array_equal(getattr(batch, name)[world], getattr(sim, name)), name
        assert np.allclose(batch.mass_matrix()[world], sim.mass_matrix(), rtol=0, atol=1e-15)
        assert np.array_equal(batch.energy[world], list(sim.energy)[:2])
        assert batch.contacts[world].tolist() == sim.contacts.tolist()
        assert batch.rows[world].tolist() == sim.rows.tolist()
        assert np.array_equal(batch.inverse()[world], sim.inverse())
    assert batch.model_of(2).body_mass[1] == 3.0


def test_changing_parameters_on_the_way_keeps_states_and_impulses():
    batch = started(sc.Batch(model(), 4))
    batch.step(40)
    states, time = batch.state(), batch.time
    frictions = np.array([0.1, 0.2, 0.3, 0.4])
    batch.param["geom/box/friction"] = frictions
    assert batch.time == time
    sims = []
    for world, friction in enumerate(frictions.tolist()):
        sim = sc.Sim(batch.model.with_values({"geom/box/friction": friction}))
        sim.restore(states[world])
        sim.step(20)
        sims.append(sim)
    batch.step(20)
    same(batch, sims)


def test_assigning_reading_and_going_back():
    batch, other = started(sc.Batch(model(), 3)), started(sc.Batch(model(), 3))
    assert batch.param["geom/floor/friction"].shape == (3, 3)
    assert batch.param["body/upper/mass"].shape == (3,)
    assert len(batch.param) == 0
    batch.param["geom/floor/friction"] = 0.3
    assert batch.param["geom/floor/friction"].tolist() == [0.3] * 3
    assert list(batch.param) == ["geom/floor/friction"]
    assert "geom/floor/friction" in repr(batch.param)
    del batch.param["geom/floor/friction"]
    batch.param.clear()
    batch.step(30)
    other.step(30)
    assert np.array_equal(batch.qpos, other.qpos)


def test_rollout_and_pickle_with_parameters():
    base = model()
    controls = np.random.default_rng(1).normal(size=(6, 15, base.nu))
    batch = sc.Batch(base, 6, threads=2)
    batch.param["actuator/servo/kp"] = [1.0, 2.0, 1.0, 2.0, 3.0, 4.0]
    other = pickle.loads(pickle.dumps(batch))
    played = batch.rollout(controls)
    for step in range(15):
        other.ctrl[:] = controls[:, step]
        other.step()
        assert np.array_equal(played.qpos[:, step], other.qpos)
    assert other.param["actuator/servo/kp"].tolist() == [1.0, 2.0, 1.0, 2.0, 3.0, 4.0]
    assert np.array_equal(copy.deepcopy(batch).qpos, batch.qpos)


def test_a_reset_world_stands_where_its_own_model_begins():
    batch = sc.Batch(model(), 3)
    batch.param["body/box/pos"] = [[1, 0, 0.1], [2, 0, 0.3], [3, 0, 0.5]]
    batch.reset(worlds=[0, 2])
    assert batch.qpos[:, 2].tolist() == [1, 1, 3]
    batch.reset()
    assert batch.qpos[:, 2].tolist() == [1, 2, 3]


@pytest.mark.parametrize("on_failure", ["stop", "go on"])
def test_the_world_that_fails_is_named_and_the_others_keep_their_bits(on_failure):
    batch = started(sc.Batch(model(integrator="explicit"), 6, on_failure=on_failure, dt=0.01))
    stiffness = np.array([1.0, 2.0, 1.0, 1e7, 2.0, 1.0])
    batch.param["joint/elbow/stiffness"] = stiffness
    batch.qpos[:, 1] = 0.2
    sims = [alone(batch, w, {"joint/elbow/stiffness": k}) for w, k in enumerate(stiffness)]
    with pytest.raises(sc.SimulationError) as failed:
        sims[3].step(400)
    if on_failure == "stop":
        with pytest.raises(sc.SimulationError, match="in world 3") as error:
            batch.step(400)
        assert error.value.step == failed.value.step
        assert error.value.replay.run().same
    else:
        batch.step(400)
        assert list(batch.failures) == [3]
        assert batch.failures[3].replay.run().same
    for world in (0, 1, 2, 4, 5):
        sims[world].step(400 if on_failure == "go on" else failed.value.step)
    same(batch, sims)


@pytest.mark.parametrize(
    ("path", "values", "says"),
    [
        ("geom/box/friction", [0.1, -1.0], ["world 1", "box", "friction", "-1"]),
        ("geom/box/friktion", [0.1, 0.2], ["friktion", '"friction"']),
        ("geom/bax/friction", [0.1, 0.2], ["bax", '"box"']),
        ("geom/box/friction", [0.1, 0.2, 0.3], ["shape (3,)", "(2,)", "(2, 3)"]),
        ("geom/box/friction", [0.1, np.nan], ["[1]", "finite"]),
        ("geom/box/friction", "much", ["friction", "must be"]),
        ("joint/elbow/type", [0.1, 0.2], ["type"]),
        ("body/upper/mass", [1.0, 0.0], ["world 1", "mass", "0"]),
    ],
)
def test_bad_values_are_named_and_change_nothing(path, values, says):
    batch = sc.Batch(model(), 2)
    batch.param["gravity"] = [[0, 0, -1], [0, 0, -2]]
    with pytest.raises(ValueError) as error:
        batch.param[path] = values
    for words in says:
        assert words in str(error.value)
    assert list(batch.param) == ["gravity"]
    other = sc.Batch(model(), 2)
    other.param["gravity"] = [[0, 0, -1], [0, 0, -2]]
    batch.step(20)
    other.step(20)
    assert np.array_equal(batch.qpos, other.qpos)


def test_worlds_of_their_own_impedances_share_lanes():
    text = """<mujoco><option timestep=".002"/><worldbody><geom type="plane" size="1 1 1"/>
     <body pos="0 0 .15"><freejoint/><geom name="b" size=".1" mass="1" solimp=".8 .9 .003 .5 2"/>
     </body></worldbody></mujoco>"""
    model, values = sc.loads(text).compile(), np.tile([0.8, 0.9, 0.003, 0.5, 2.0], (8, 1))
    values[:, 0], values[:, 2] = np.linspace(0.6, 0.85, 8), np.linspace(0.002, 0.005, 8)
    batch = sc.Batch(model, 8, lanes=True)
    batch.param["geom/b/solimp"] = values
    batch.step(200)
    assert batch.in_lanes
    for world, row in enumerate(values):
        sim = sc.Sim(model.with_values({"geom/b/solimp": row.tolist()}))
        sim.step(200)
        assert np.array_equal(sim.qpos, batch.qpos[world])


EVERY_ACTUATOR = """<mujoco><option timestep="0.004"/><worldbody>
<geom type="plane" size="5 5 1" pos="0 0 -1"/><site name="o" pos="0 0 1"/>
<body pos="0 0 .5"><joint name="h" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/>
<site name="s" pos=".3 0 0"/><body pos=".4 0 0"><joint name="b" type="ball"/>
<geom type="box" size=".1 .2 .05" pos=".1 0 0"/></body></body>
<body name="g" pos="2 0 -.905"><freejoint/><geom size=".1"/></body></worldbody>
<tendon><spatial name="t"><site site="o"/><site site="s"/></spatial></tendon><actuator>
<motor name="motor" joint="h" gear="2" ctrlrange="-1 1" forcerange="-3 3"/>
<position name="position" joint="h" kp="5" kv=".3" timeconst=".1"/>
<velocity name="velocity" tendon="t" kv="2"/>
<intvelocity name="intvelocity" joint="h" kp="3" actrange="-1 1"/>
<damper name="damper" joint="h" kv="1" ctrlrange="0 1"/>
<cylinder name="cylinder" tendon="t" timeconst=".2" bias="1 -2 -.3"/>
<muscle name="muscle" tendon="t" lengthrange=".2 2" force="5"/>
<adhesion name="adhesion" body="g" gain="3" ctrlrange="0 1"/>
<general name="general" site="s" refsite="o" gear="1 0 0 0 0 0" gainprm="3" biastype="affine"
 biasprm="1 -3 -.2" dyntype="filterexact" dynprm=".05"/>
<pid name="pid" joint="h" input="pos vel" kp="4" kv=".2" ki="1" imax=".1" slewmax="2"
 delay=".01" nsample="4"/>
<dcmotor name="dcmotor" joint="h" nominal="12 3 20" input="pos" controller="3 1 .1"
 lugre="10 .1 .2 .3 .1" cogging=".1 7 .3" thermal="2 30 0 .004 20 25" inductance=".01"
 saturation="2"/>
<orientation name="orientation" joint="b" kp="5" kv=".3" forcerange="0 2" input="quat"/>
</actuator></mujoco>"""


def varied_values(base, actuator):
    """(path, two values) of every number of an actuator that the scene takes."""
    for field in actuator.values():
        path = f"actuator/{actuator.name}/{field}"
        try:
            own = own_value(base, path)
            values = [(own * k + 0.01 * (own != 0)).tolist() for k in (1.25, 0.8)]
            [base.with_values({path: value}) for value in values]
        except ValueError:
            continue
        if any(value != own.tolist() for value in values):
            yield path, values


@pytest.mark.parametrize(
    "name", re.findall(r'<\w+ name="(\w+)" (?:joint|tendon|body|site)="', EVERY_ACTUATOR)
)
def test_every_number_of_every_actuator_reaches_its_world(name):
    base = sc.loads(EVERY_ACTUATOR).compile()
    numbers = list(varied_values(base, base.scene.actuator(name)))
    assert numbers
    for path, values in numbers:
        variation = Variation(base.scene, [path], base.masses())
        for value in values:
            scene = changed_scene(base.scene, {path: value}, base.masses())
            assert variation.data({path: value}) == scene.to_dict(), path
        batch = sc.Batch(base, 2)
        batch.param[path] = np.array(values)
        sims = [sc.Sim(base.with_values({path: value})) for value in values]
        for world in (batch, *sims):
            world.ctrl[:], world.qvel[:] = 0.5, 0.3
            world.step(5)
        for k, sim in enumerate(sims):
            assert np.array_equal(batch.qpos[k], sim.qpos), path
            assert np.array_equal(batch.act[k], sim.act), path
