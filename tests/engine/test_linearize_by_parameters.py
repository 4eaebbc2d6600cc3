"""∂step/∂p against differences of whole steps, each of a model compiled anew."""

import numpy as np
import pytest
from covering import every_pair

import stepcore as sc
from stepcore.engine.parameters import named_columns, own_value, split_entry

# Of the first derivative, to the eighth power of the distance (Fornberg 1988).
WEIGHTS = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
EXACT = {"solver": "newton", "tolerance": 1e-14, "sweeps": 200}
ARM = """<mujoco><option timestep="0.005" integrator="{integrator}"/><worldbody>
 <geom name="floor" type="plane" size="3 3 .1" friction=".6"/>
 <body name="arm" pos="0 0 .3"><joint name="shoulder" axis="0 1 0" stiffness="5" damping=".2"
  armature=".01" frictionloss=".1"/><geom name="upper" type="capsule" size=".03"
  fromto="0 0 0 .3 0 0"/>
 <body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0" damping=".1" range="-60 60"/>
  <geom name="lower" type="capsule" size=".03" fromto="0 0 0 .1 .02 -.3" mass=".4"/></body></body>
 <body name="box" pos=".6 .4 .099"><freejoint/><geom name="crate" type="box" size=".1 .12 .1"
  mass="2" solimp=".9 .95 .002 .2 2"/></body></worldbody>
 <tendon><fixed name="cord" stiffness="3" damping=".2" springlength=".1">
  <joint joint="shoulder" coef="1"/><joint joint="elbow" coef="-.5"/></fixed></tendon>
 <actuator><position name="servo" joint="elbow" kp="30" kv="1"/></actuator></mujoco>"""
PATHS = (
    *("body/arm/mass", "body/fore/mass", "joint/shoulder/stiffness", "joint/shoulder/damping"),
    *("joint/shoulder/armature", "joint/shoulder/frictionloss", "joint/elbow/damping"),
    *("geom/upper/size", "geom/crate/size[1]", "geom/floor/friction[0]", "geom/crate/solref[0]"),
    *(
        "geom/crate/solimp[0]",
        "geom/crate/solimp[1]",
        "geom/crate/solimp[2]",
        "geom/crate/solimp[3]",
    ),
    *("tendon/cord/stiffness", "tendon/cord/damping", "actuator/servo/kp", "gravity[2]"),
)


def moving(model):
    sim = sc.Sim(model, **EXACT)
    sim.qvel[:] = np.random.default_rng(0).normal(0, 0.3, model.nv)
    sim.qpos[0], sim.ctrl[0] = 0.2, 0.5
    return sim


def tangent(model, start, end):
    """The state after a step, in the coordinates of A."""
    dq = []
    for joint in range(len(model.jnt_type)):
        q = model.jnt_qposadr[joint]
        if model.jnt_type[joint] == "free":
            dq += list(end.qpos[q : q + 3])
            w, v = end.qpos[q + 3], end.qpos[q + 4 : q + 7]
            w0, v0 = start.qpos[q + 3], start.qpos[q + 4 : q + 7]
            dq += list(2 * (w0 * v - w * v0 - np.cross(v0, v)))
        else:
            dq.append(end.qpos[q])
    return np.concatenate([dq, end.qvel, end.act])


def differences(model, path, entry, value, make):
    """The stencil on steps; distances much larger than those of the models inside."""
    apart, base = abs(value) * 1e-3, make(model)
    base.step()

    def at(k):
        own = value + k * apart
        if entry is not None:
            name = path.split("/")
            whole = model.scene.gravity if path == "gravity" else None
            if whole is None:
                whole = getattr(getattr(model.scene, name[0])(name[1]), name[2])
            whole = list(whole)
            whole[entry] = own
            own = whole
        sim = make(model.with_values({path: own}))
        sim.step()
        return tangent(model, base, sim)

    return sum(w * (at(k) - at(-k)) for k, w in WEIGHTS.items()) / apart


def assert_columns(found, model, make):
    """Each column of P is the difference of steps of models with other values."""
    for column, label in zip(found.P.T, found.parameters, strict=True):
        path, entry = split_entry(label)
        value = own_value(model, path)
        value = float(value if entry is None else value[entry])
        true = differences(model, path, entry, value, make)
        assert np.abs(column - true).max() <= 1e-7 * max(np.abs(true).max(), 1e-6), label


@pytest.mark.parametrize("integrator", ("Euler", "implicitfast", "RK4", "discrete"))
def test_every_kind_of_parameter(integrator):
    """Contacts, friction, limits, tendons, servos, inertia that follows of a size."""
    text = ARM.format(integrator=integrator if integrator != "discrete" else "Euler")
    model = sc.loads(text).compile()
    if integrator == "discrete":
        model = model.with_settings(integrator="discrete")
    sim = moving(model)
    found = sim.linearize(PATHS)
    plain = sim.linearize()
    assert np.array_equal(found.A, plain.A) and np.array_equal(found.B, plain.B)
    assert found.P.shape == (2 * model.nv, len(found.parameters))
    assert_columns(found, model, moving)


@pytest.mark.parametrize("name", ("hopper", "half_cheetah", "ant"))
def test_robots_on_the_ground(name):
    gymnasium = pytest.importorskip("gymnasium")
    assert gymnasium
    model = sc.load(f"gymnasium:{name}").compile().with_settings(integrator="euler")

    def settled(model):
        sim = sc.Sim(model, **EXACT)
        sim.step(120)
        # The same state whatever the model.
        sim.qpos[:], sim.qvel[:] = state
        sim.ctrl[:] = 0.3
        return sim

    first = sc.Sim(model, **EXACT)
    first.step(120)
    state = np.array(first.qpos), np.array(first.qvel)
    sim = settled(model)
    bodies = [f"body/{body}/mass" for body in model.body_names[1:3]]
    found = sim.linearize([*bodies, "gravity[2]"])
    assert_columns(found, model, settled)


def test_muscles_whose_force_and_range_follow_from_inertia():
    """The scale of a force changes with an armature: derivatives, and bits by world."""
    model = sc.loads("""<mujoco><option timestep="0.002"/><worldbody>
    <body><joint name="hip" axis="0 1 0" range="-40 60" damping=".3" armature=".01"/>
    <geom type="capsule" size=".03" fromto="0 0 0 0 0 -.3" mass="1"/>
    <site name="low" pos=".03 0 -.1"/></body><site name="high" pos=".05 0 .1"/></worldbody>
    <tendon><spatial name="cord"><site site="high"/><site site="low"/></spatial></tendon>
    <actuator><muscle name="pull" tendon="cord" scale="300"/></actuator></mujoco>""").compile()

    def pulled(model):
        sim = sc.Sim(model)
        sim.qpos[0], sim.qvel[0], sim.act[0], sim.ctrl[0] = 0.2, 0.3, 0.4, 0.9
        return sim

    path = "joint/hip/armature"
    found = pulled(model).linearize([path]).P[:, 0]
    expected = differences(model, path, None, 0.01, pulled)
    np.testing.assert_allclose(found, expected, atol=1e-7 * abs(expected).max())
    assert abs(expected).max() > 0.1
    batch = sc.Batch(model, 5)
    batch.param[path] = np.linspace(0.005, 0.02, 5)
    for name in ("qpos", "qvel", "act", "ctrl"):
        getattr(batch, name)[:] = getattr(pulled(model), name)
    batch.step(20)
    for world in range(5):
        sim = pulled(batch.model_of(world))
        sim.step(20)
        assert np.array_equal(sim.qpos, batch.qpos[world])


def test_all_joints_are_those_that_turn_or_slide():
    free = '<body pos="3 0 0"><joint name="base" type="free"/><geom size=".1"/></body></worldbody>'
    text = ARM.format(integrator="Euler").replace("</worldbody>", free)
    found = named_columns(sc.loads(text).compile(), ["joint/*/damping", "joint/b*/damping"])
    joints = ["shoulder", "elbow", "base"]
    assert [column.label for column in found] == [f"joint/{joint}/damping" for joint in joints]


def test_patterns_and_labels():
    model = sc.loads(ARM.format(integrator="Euler")).compile()
    found = moving(model).linearize(["joint/*/damping", "geom/floor/friction"])
    assert found.parameters == (
        "joint/shoulder/damping",
        "joint/elbow/damping",
        "geom/floor/friction[0]",
        "geom/floor/friction[1]",
        "geom/floor/friction[2]",
    )
    assert found.to_dict()["parameters"] == list(found.parameters)
    assert "5 parameters" in repr(found)


@pytest.mark.parametrize(
    "path, message",
    [
        ("joint/sholder/damping", 'no joint is named "sholder".*shoulder'),
        ("joint/shoulder/dampin", 'a joint has no value "dampin".*damping'),
        ("joint/elbow/stiffness", r"joint/elbow/stiffness = 0: must be finite and not zero"),
        ("geom/floor/friction[3]", r"geom/floor/friction has 3 entries, and no \[3\]"),
        ("body/arm/mass[0]", "is a number and has no entry"),
        ("geom/crate/solimp[4]", r"geom/crate/solimp\[4\]: must be one that steps read as a"),
        ("body/a*z/mass", 'no body is named "a.z"'),
        ("body/arm/pos[2]", r"body/arm/pos\[2\]|"),
        (3, "parameters = 3: must be paths of values"),
    ],
)
def test_what_is_no_parameter(path, message):
    sim = moving(sc.loads(ARM.format(integrator="Euler")).compile())
    if path == "body/arm/pos[2]":
        assert sim.linearize([path]).P.shape[1] == 1
        return
    with pytest.raises(ValueError, match=message):
        sim.linearize([path] if isinstance(path, str) else path)


def test_an_impedance_that_steps_clamp_is_no_parameter():
    model = sc.loads(ARM.format(integrator="Euler")).compile()
    model = model.with_values({"geom/crate/solimp": [0.9, 1.0, 0.002, 0.4, 2]})
    with pytest.raises(ValueError, match=r"solimp\[1\] = 1: must be between 0.00011 and 0.99989"):
        moving(model).linearize(["geom/crate/solimp[1]"])


def test_a_whole_impedance_is_by_what_steps_read_as_numbers():
    model = sc.loads(ARM.format(integrator="Euler")).compile()
    assert moving(model).linearize("geom/crate/solimp").parameters == tuple(
        f"geom/crate/solimp[{entry}]" for entry in range(4)
    )
    cubic = model.with_values({"geom/crate/solimp": [0.9, 0.95, 0.002, 0.4, 3]})
    assert len(moving(cubic).linearize("geom/crate/solimp").parameters) == 5
    level = [0.9, 0.9, 0.002, 0.4, 3]
    flat = model.with_values({"geom/crate/solimp": level, "geom/floor/solimp": level})
    with pytest.raises(ValueError, match=r"solimp\[0\]: must be .*an impedance that is flat"):
        moving(flat).linearize("geom/crate/solimp")


def test_what_an_element_is_called_is_no_field():
    """A joint of a body called as a field is."""
    text = ARM.format(integrator="Euler").replace('"shoulder"', '"a/solimp"')
    by = moving(sc.loads(text).compile()).linearize(["joint/a/solimp/stiffness"])
    assert by.parameters == ("joint/a/solimp/stiffness",)


def test_what_changes_more_than_numbers_is_refused_by_name():
    sim = moving(sc.loads(ARM.format(integrator="Euler")).compile())
    with pytest.raises(ValueError, match=r"parameters: geom/crate/condim: .*must be one of"):
        sim.linearize(["geom/crate/condim"])


def test_a_heap_is_refused_by_its_reason():
    scene = sc.Scene()
    for k in range(66):
        ball = scene.add_body(f"ball{k}", pos=(k, 0, 0))
        scene.add_joint(ball, "free", name=f"free{k}")
        scene.add_geom(ball, "sphere", size=(0.1,), mass=1.0)
    sim = sc.Sim(scene)
    assert sim.model.is_heap and sim.linearize().A.shape == (792, 792)
    with pytest.raises(ValueError, match=r"2145 pairs of geoms .* until 2000 are left"):
        sim.linearize(["body/ball0/mass"])


@every_pair(condim=(3, 4, 6), speed=(0.0, 1.0), cone=("pyramidal", "elliptic"))
def test_friction_that_holds_and_that_slides(cone, speed, condim):
    """On the surface of a cone the impulse moves with μ, and so does what keeps the law."""
    text = f"""<mujoco><option timestep="0.002" cone="{cone}" integrator="Euler"/>
     <worldbody><geom name="floor" type="plane" size="3 3 .1" friction=".1 .01 .001"/>
     <body name="crate" pos="0 0 .0995"><freejoint/><geom name="crate" type="box" size=".1 .12 .1"
     mass="2" friction=".5 .02 .003" condim="{condim}"/></body></worldbody></mujoco>"""

    def make(model):
        sim = sc.Sim(model, **EXACT)
        sim.qvel[:] = speed, 0.3 * speed, 0, 0, 0, 2 * speed
        return sim

    model = sc.loads(text).compile()
    path = "geom/crate/friction"
    found = make(model).linearize([path])
    most = 0.0
    for entry, column in enumerate(found.P.T):
        value = model.scene.geom("crate").friction[entry]
        true = differences(model, path, entry, value, make)
        size = max(np.abs(true).max(), 1e-4)
        assert np.abs(column - true).max() <= 1e-6 * size, found.parameters[entry]
        most = max(most, size)
    assert most > 1e-3 or not speed


def same(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in "ABP")


def test_a_sim_that_was_linearised_before_gives_what_a_fresh_one_gives():
    """Its working space is kept: after steps, by other parameters, and where nothing changed."""
    model = sc.loads(ARM.format(integrator="implicitfast")).compile()
    sim = moving(model)
    for by, steps in ((PATHS, 0), ((), 0), (PATHS[:2], 7), (PATHS, 30), ((), 1), ((), 0)):
        if steps:
            sim.step(steps)
        fresh = moving(model)
        fresh.restore(sim.state())
        fresh.ctrl[:] = sim.ctrl
        assert same(sim.linearize(by), fresh.linearize(by)), (len(by), steps)


@pytest.mark.parametrize("alike", [True, False])
def test_worlds_are_linearised_alike_on_any_number_of_threads(alike):
    model, made = sc.loads(ARM.format(integrator="Euler")).compile(), []
    rng = np.random.default_rng(1)
    speeds, masses = rng.normal(0, 0.5, (7, model.nv)), rng.uniform(0.5, 2, 7)
    for threads in (1, 3):
        batch = sc.Batch(model, 7, threads=threads, **EXACT)
        batch.qvel[:] = speeds
        if not alike:
            batch.param["body/fore/mass"] = masses
        made.append([batch.linearize(), batch.linearize(PATHS[:3])])
    for one, three in zip(*made, strict=True):
        assert all(same(*pair) for pair in zip(one, three, strict=True))
    for world in range(7):
        sim = sc.Sim(batch.model_of(world), **EXACT)
        sim.qvel[:] = speeds[world]
        assert same(sim.linearize(), made[0][0][world])
