"""Elements are data: (kind, index, part) in rows, contacts and errors; names are made of them."""

from __future__ import annotations

import numpy as np
import pytest

import stepcore as sc

SCENE = """<mujoco><option timestep="0.002"/><worldbody>
<geom name="floor" type="plane" size="5 5 1"/>
<body name="arm" pos="0 0 0.15"><joint name="lift" type="slide" axis="0 0 1" range="-1 0.01"
  frictionloss="0.2" stiffness="30" damping="2" limited="true"/>
 <geom name="bar" type="capsule" fromto="-0.3 0 0 0.3 0 0" size="0.1" mass="1"/></body>
<body name="free" pos="2 0 0.09"><freejoint/><geom name="ball" size="0.1" mass="2"/></body>
</worldbody><equality><connect name="tie" body1="free" body2="arm" anchor="-1 0 0"/></equality>
<actuator><motor name="push" joint="lift"/><position name="hold" joint="lift" kp="5"/></actuator>
</mujoco>"""


@pytest.fixture
def sim() -> sc.Sim:
    sim = sc.Sim(sc.loads(SCENE).compile())
    sim.qpos[0] = 0.02
    sim.ctrl[:] = [1.0, 0.5]
    sim.forward()
    return sim


def test_rows_and_contacts_carry_their_elements(sim):
    rows, model = sim.rows, sim.model
    assert {"connect", "friction loss", "limit", "contact"} == set(rows["kind"].tolist())
    for row in rows:
        element = (str(row["kind"]), int(row["index"]), int(row["part"]))
        assert model.element_name(*element) == row["name"]
    (limit,) = rows[rows["kind"] == "limit"]
    assert (limit["index"], limit["part"]) == (0, 1)
    assert set(rows["part"][rows["kind"] == "connect"]) == {-1}
    for contact in sim.contacts:
        pair = model._core.pairs()[contact["index"]]
        assert pair == (contact["geom1"], contact["geom2"]) and contact["kind"] == "contact"


def test_every_kind_has_a_name(sim):
    model = sim.model
    names = {
        ("joint", 0): "joint `lift`",
        ("spring", 0): "spring of joint `lift`",
        ("damper", 0): "damper of joint `lift`",
        ("friction loss", 0): "friction loss of joint `lift`",
        ("limit", 0): "limit of joint `lift`",
        ("actuator", 0): "motor `push`",
        ("actuator", 1): "servo `hold`",
        ("connect", 0): "connect `tie`",
        ("xfrc_applied", 2): "force applied to body `free`",
        ("gravity", 0): "gravity",
        ("joint", 1): "joint 1 of body `free`",
    }
    assert {element: model.element_name(*element) for element in names} == names
    pairs = model._core.pairs()
    one, two = (model.geom_names[geom] for geom in pairs[0])
    assert model.element_name("contact", 0, 1) == f"contact `{one}`/`{two}`"


def test_what_is_no_element_is_refused(sim):
    name = sim.model.element_name
    with pytest.raises(ValueError, match=r"kind = 'sprin': no such kind; nearest: spin, spring"):
        name("sprin", 0)
    with pytest.raises(ValueError, match=r"index = 2: must be below 2"):
        name("joint", 2)
    with pytest.raises(ValueError, match=r"part = -2"):
        name("limit", 0, -2)


def test_an_error_of_the_compiler_says_where_it_names_what():
    from stepcore import _core

    scene = sc.loads(SCENE).to_dict()
    scene["geoms"][1]["size"][0] = -1.0
    with pytest.raises(ValueError) as caught:
        _core.compile(scene)
    ((start, end, kind, index),) = caught.value.mentions
    assert str(caught.value)[start:end] == "geom 'bar'" and (kind, index) == ("geom", 1)


def test_an_error_of_a_run_carries_the_element_that_it_names():
    scene = sc.loads(SCENE)
    scene.joints[0].stiffness = 1e9
    # Rows at speeds without meaning give and take as much as the spring that drives them there.
    scene.equalities.clear()
    sim = sc.Sim(scene.compile(), integrator="explicit", dt=0.01)
    sim.qpos[0] = -0.5
    with pytest.raises(sc.SimulationError) as caught:
        sim.step(500)
    error = caught.value
    assert error.element_id == ("spring", 0, -1)
    assert error.element == sim.model.element_name(*error.element_id)
    assert list(error.shares) == [sim.model.element_name(*element) for element in error.share_ids]


def test_forces_of_a_kind_at_many_states_are_those_of_a_step(sim):
    model = sim.model
    rng = np.random.default_rng(2)
    qpos = sim.qpos + 0.01 * rng.normal(size=(2, 3, model.nq))
    qvel, ctrl = rng.normal(size=(2, 3, model.nv)), rng.normal(size=(2, 3, model.nu))
    act = np.zeros((2, 3, model.na))
    forces = {
        kind: model.element_force(kind, ctrl, act, qpos, qvel)
        for kind in ("spring", "damper", "actuator")
    }
    for at in np.ndindex(2, 3):
        sim.qpos, sim.qvel, sim.ctrl = qpos[at], qvel[at], ctrl[at]
        sim.forward()
        assert sim.passive == pytest.approx(forces["spring"][at] + forces["damper"][at])
        driven = (sim.actuator_force[:, None] * model.actuator_gear[:, :1]).sum()
        assert forces["actuator"][at] == pytest.approx([driven] + [0.0] * 6)
    with pytest.raises(ValueError, match="'limit': must be 'spring', 'damper' or 'actuator'"):
        model.element_force("limit", ctrl, act, qpos, qvel)


def test_a_model_that_cannot_move_has_no_forces():
    scene = sc.Scene()
    scene.add_geom(scene.add_body("shelf"), "box", (1, 1, 1))
    model, none = scene.compile(), np.zeros((3, 0))
    for kind in ("spring", "damper", "actuator"):
        assert model.element_force(kind, none, none, none, none).shape == (3, 0)


def test_a_penalty_contact_tells_its_force():
    """k·overlap at rest, along the normal, although it has no row."""
    scene = sc.Scene()
    scene.add_geom("world", "plane")
    ball = scene.add_body(pos=(0, 0, 0.099))
    scene.add_joint(ball, "free")
    scene.add_geom(ball, "sphere", 0.1, mass=1.0)
    sim = sc.Sim(scene.compile(), law="penalty", penalty_stiffness=2e4, solver="pgs")
    sim.forward()
    (contact,) = sim.contacts
    assert contact["force"] == pytest.approx([0, 0, 2e4 * 0.001]) and len(sim.rows) == 0


NAMELESS = """
<mujoco><worldbody><geom type="plane" size="1 1 1"/><site/>
<body name="arm"><joint/><geom size=".1"/><site/>
<body name="hand"><joint axis="0 1 0"/><geom size=".1" pos=".5 0 0"/></body></body></worldbody>
<tendon><fixed><joint joint="elbow" coef="1"/></fixed></tendon>
<equality><connect body1="hand" anchor="0 0 0"/></equality>
<actuator><motor joint="elbow"/><position tendon="rope"/></actuator></mujoco>"""


def test_what_has_no_name_is_called_by_what_it_belongs_to():
    text = NAMELESS.replace("<joint axis", '<joint name="elbow" axis')
    model = sc.loads(text.replace("<fixed>", '<fixed name="rope">')).compile()
    names = {
        ("geom", 0): "geom 0 of the world",
        ("geom", 2): "geom 2 of body `hand`",
        ("site", 1): "site 1 of body `arm`",
        ("joint", 0): "joint 0 of body `arm`",
        ("spring", 0): "spring of joint 0 of body `arm`",
        ("joint", 1): "joint `elbow`",
        ("connect", 0): "connect 0 of body `hand` and the world",
        ("actuator", 0): "motor 0 at joint `elbow`",
        ("actuator", 1): "servo 1 at tendon `rope`",
    }
    assert {element: model.element_name(*element) for element in names} == names
    assert model.called("actuator") == ("motor 0 at joint `elbow`", "servo 1 at tendon `rope`")
    assert model.called("body") == ("world", "arm", "hand")
