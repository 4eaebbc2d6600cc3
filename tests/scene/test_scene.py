"""A scene by hand: what it takes, what it refuses, and the plain data it becomes."""

import copy
import math
import pickle

import numpy as np
import pytest

from stepcore import Settings
from stepcore.scene.scene import Scene

NAN = math.nan


def ball_on_floor() -> Scene:
    scene = Scene(name="drop")
    body = scene.add_body("ball", pos=(0, 0, 1))
    scene.add_joint(body, "free", name="root")
    scene.add_geom(body, "sphere", 0.1, name="ball", mass=1.0)
    scene.add_geom("world", "plane", name="floor")
    return scene


def chain() -> Scene:
    """Two arms of two links, added breadth first, so that the engine's order differs."""
    scene = Scene()
    for name in "ab":
        scene.add_body(name, mass=1, inertia=(1, 1, 1))
    for name in "ab":
        scene.add_body(name + "2", parent=name, pos=(1, 0, 0), mass=1, inertia=(1, 1, 1))
    for name in ("b2", "a", "b", "a2"):
        scene.add_joint(name, name="j_" + name, axis=(0, 2, 0), ref=0.5)
        scene.add_geom(name, "capsule", (0.1, 0.5), name="g_" + name)
        scene.add_site(name, name="s_" + name)
    scene.add_actuator("j_b2", name="motor", gear=3, ctrlrange=(-1, 1))
    scene.add_equality("connect", "a2", "b2", (1, 0, 0), solref=(0.05, 1))
    scene.exclude("a", "b2")
    return scene


def test_an_empty_scene_is_the_world() -> None:
    plain = Scene().to_dict()
    assert [body["name"] for body in plain["bodies"]] == ["world"]
    assert plain["gravity"] == [0, 0, -9.81]
    assert plain["mass_rules"] == {
        "from_geoms": None,
        "group_range": [0, 5],
        "bound_mass": 0.0,
        "bound_inertia": 0.0,
        "balance_inertia": False,
        "total_mass": -1.0,
        "fit_aabb": False,
    }
    assert set(plain["features"].values()) == {True}


def test_fields_have_the_engines_names() -> None:
    plain = ball_on_floor().to_dict()
    assert set(plain) == {
        *("name", "gravity", "magnetic", "bodies", "joints", "geoms", "sites"),
        *("sensors", "actuators", "equalities"),
        *(
            "meshes",
            "hfields",
            "keys",
            "excludes",
            "pairs",
            "contact_override",
            "mass_rules",
            "features",
            "density",
            "viscosity",
            "wind",
            "tendons",
        ),
    }
    assert set(plain["joints"][0]) == {
        *("name", "body", "kind", "pos", "axis", "range", "margin", "reference", "springref"),
        *("stiffness", "damping", "armature", "frictionloss", "limit", "friction"),
        *("springdamper", "actuatorgravcomp", "actuatorfrcrange"),
    }
    assert set(plain["geoms"][0]) == {
        *("name", "body", "kind", "size", "pos", "quat", "mass", "density", "shell_inertia"),
        *("group", "contype", "conaffinity", "condim", "priority", "friction", "margin", "gap"),
        *("solmix", "soft", "mesh", "fitscale", "hfield", "fluidshape", "fluidcoef"),
        *("hidden", "surfacevel", "adhesion"),
    }
    assert plain["geoms"][0]["soft"] == {
        "solref": [0.02, 1.0],
        "solimp": [0.9, 0.95, 0.001, 0.5, 2.0],
    }
    # The floor was added last but hangs on the world, which comes first.
    assert [geom["name"] for geom in plain["geoms"]] == ["floor", "ball"]


def test_bodies_become_depth_first_and_indices_follow() -> None:
    plain = chain().to_dict()
    assert [body["name"] for body in plain["bodies"]] == ["world", "a", "a2", "b", "b2"]
    assert [body["parent"] for body in plain["bodies"]] == [0, 0, 1, 0, 3]
    assert [joint["name"] for joint in plain["joints"]] == ["j_a", "j_a2", "j_b", "j_b2"]
    assert [joint["body"] for joint in plain["joints"]] == [1, 2, 3, 4]
    assert [geom["name"] for geom in plain["geoms"]] == ["g_a", "g_a2", "g_b", "g_b2"]
    assert [site["name"] for site in plain["sites"]] == ["s_a", "s_a2", "s_b", "s_b2"]
    assert plain["joints"][0]["axis"] == [0, 1, 0]
    assert plain["actuators"] == [
        {
            "name": "motor",
            "target": {"joint": 3},
            "gear": [3, 0, 0, 0, 0, 0],
            "ctrlrange": [-1, 1],
            "actrange": None,
            "forcerange": None,
            "gain": [1, 0, 0],
            "bias": [0, 0, 0],
            "muscle_gain": None,
            "muscle_bias": None,
            "dampratio": 0,
            "controller": None,
            "orientation": None,
            "feeds": None,
            "input": "pos",
            "dynamics": "none",
            "dynprm": [1, 0, 0],
            "actearly": False,
            "lengthrange": [0, 0],
            "delay": 0,
            "nsample": 0,
            "interp": "zoh",
            "damping": [0, 0, 0],
            "armature": 0,
            "enabled": True,
        }
    ]
    assert (plain["equalities"][0]["first"], plain["equalities"][0]["second"]) == (2, 4)
    assert plain["equalities"][0]["soft"]["solref"] == [0.05, 1]
    assert plain["excludes"] == [[1, 4]]


def test_several_joints_of_a_body_keep_their_order() -> None:
    scene = Scene()
    scene.add_body("a", mass=1, inertia=(1, 1, 1))
    for name in "zyx":
        scene.add_joint("a", "slide", name=name)
    assert [joint["name"] for joint in scene.to_dict()["joints"]] == ["z", "y", "x"]


def test_numpy_values_are_taken() -> None:
    scene = ball_on_floor()
    scene.body("ball").pos = np.array([1, 2, 3], dtype=np.float32)
    scene.geom("ball").size = np.float64(0.5)
    scene.geom("ball").condim = np.int64(1)
    scene.geom("ball").shellinertia = np.bool_(True)
    geom = scene.to_dict()["geoms"][1]
    assert scene.body("ball").pos == (1, 2, 3)
    assert (geom["size"], geom["condim"], geom["shell_inertia"]) == ([0.5, 0, 0], 1, True)
    with pytest.raises(ValueError, match="finite numbers"):
        scene.body("ball").pos = np.zeros((3, 1))


def test_fromto_is_a_size_and_a_pose() -> None:
    scene = Scene()
    geom = scene.add_geom("world", "capsule", 0.1, fromto=(0, 0, 1, 0, 0, 3))
    assert geom.size == (0.1, 1.0, 0.0)
    assert geom.pos == (0, 0, 2)
    with pytest.raises(ValueError, match="fromto is for"):
        scene.add_geom("world", "sphere", 0.1, fromto=(0, 0, 1, 0, 0, 3))
    with pytest.raises(ValueError, match="too close"):
        scene.add_geom("world", "capsule", 0.1, fromto=(0, 0, 1, 0, 0, 1))
    assert len(scene.geoms) == 1


@pytest.mark.parametrize(
    ("element", "field", "value", "says"),
    [
        ("geom", "friction", (-1, 0, 0), ">= 0"),
        ("geom", "size", (0.1, NAN), "1 to 3 finite numbers"),
        ("geom", "pos", (0, 0), "3 finite numbers"),
        ("geom", "pos", "0 0 0", "3 finite numbers"),
        ("geom", "quat", (0, 0, 0, 0), "not all zero"),
        ("geom", "mass", -1, ">= 0"),
        ("geom", "mass", math.inf, "finite"),
        ("geom", "condim", 2, "one of 1, 3, 4, 6"),
        ("geom", "type", "spere", '"sphere"'),
        ("geom", "contype", -1, "whole number from 0 to 4294967295"),
        ("geom", "contype", 1.5, "whole number"),
        ("geom", "solref", (-100, 1), "both > 0"),
        ("geom", "solimp", (0.9, 0.95, 0.001, 0.5, 2, 1), "1 to 5 finite numbers"),
        ("geom", "shellinertia", 1, "True or False"),
        ("geom", "name", 3, "a string"),
        ("joint", "range", (1, -1), "the first smaller"),
        ("joint", "axis", (0, 0, 0), "not all zero"),
        ("joint", "damping", "1", "a finite number"),
        ("joint", "armature", -0.1, ">= 0"),
        ("joint", "frictionloss", NAN, ">= 0"),
        ("joint", "stiffness", None, "a finite number"),
        ("joint", "body", "torso", "a Body"),
        ("body", "pos", (0, 0, NAN), "3 finite numbers"),
        ("body", "mass", True, "a finite number"),
        ("body", "inertia", (1, 1, -1), ">= 0"),
        ("body", "inertia", (1, 1), "3 or 6"),
    ],
)
def test_a_bad_value_names_element_field_value_and_limit(
    element: str, field: str, value: object, says: str
) -> None:
    scene = ball_on_floor()
    name = "root" if element == "joint" else "ball"
    target = getattr(scene, element)(name)
    before = getattr(target, field)
    with pytest.raises(ValueError) as caught:
        setattr(target, field, value)
    text = str(caught.value)
    assert text.startswith(f'{element} "{name}": {field} = ')
    assert says in text
    assert "\n" not in text
    assert getattr(target, field) == before


def test_a_bad_argument_adds_nothing() -> None:
    scene = ball_on_floor()
    for add in (
        lambda: scene.add_body("b", pos=(NAN, 0, 0)),
        lambda: scene.add_body("b", inertia=(1, 1, 1)),
        lambda: scene.add_body("ball"),
        lambda: scene.add_joint("ball", "hing"),
        lambda: scene.add_geom("ball", "box", (1, 1, 1, 1)),
        lambda: scene.add_site("ball", pos=None),
        lambda: scene.add_actuator("root", gear=(1, 2, 3, 4, 5, 6, 7)),
        lambda: scene.add_equality("glue", "ball"),
        lambda: scene.add_key("k", qpos="0 0"),
        lambda: scene.exclude("ball", "balls"),
        lambda: setattr(scene, "gravity", (0, 0, math.inf)),
    ):
        with pytest.raises(ValueError):
            add()
    assert scene == ball_on_floor()


def test_an_unknown_name_lists_the_nearest() -> None:
    scene = chain()
    with pytest.raises(ValueError, match='no body is named "b3"; nearest: "b", "b2"'):
        scene.add_geom("b3")
    with pytest.raises(ValueError, match='nearest: "j_b2"'):
        scene.joint("jb2")
    for add in (scene.add_joint, scene.add_geom, scene.add_site):
        with pytest.raises(ValueError, match="body = None: must be a Body"):
            add(None)
    with pytest.raises(ValueError, match="must be a name or a Body"):
        scene.body(3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="not a body of this scene"):
        scene.body(Scene().world)
    with pytest.raises(ValueError, match='no field "dampng"; nearest: "damping"'):
        scene.add_joint("a", dampng=1)
    with pytest.raises(AttributeError, match='no field "frction"; nearest: "friction"'):
        scene.geom("g_a").frction = 1  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda s: s.add_geom("ball", "plane"), "cannot move"),
        (lambda s: s.add_geom("ball", "box", (1, 1)), "3 half sizes > 0 for a box"),
        (lambda s: s.add_joint("ball", "slide"), "more than 6 dofs"),
        (lambda s: s.add_joint("world", "slide"), "the world cannot move"),
        (lambda s: setattr(s.world, "pos", (0, 0, 1)), "the world cannot move"),
        (lambda s: setattr(s.joint("root"), "range", (0, 1)), "None for a free joint"),
        (lambda s: s.add_key("k", qpos=(1, 2)), "7 numbers, not 2"),
        (lambda s: s.add_key("k", ctrl=(1,)), "0 numbers, not 1"),
        (lambda s: s.add_equality("connect", "ball", "ball"), "to itself"),
        (lambda s: setattr(s.body("ball"), "parent", s.body("ball")), "not connected"),
        (lambda s: s.bodies.remove(s.body("ball")), "not in this scene"),
        (lambda s: setattr(s.geom("floor"), "name", "ball"), "used twice"),
        (lambda s: setattr(s.body("ball"), "ipos", (1, 0, 0)), "mass = None"),
    ],
)
def test_what_only_the_whole_scene_shows(change, says) -> None:
    scene = ball_on_floor()
    change(scene)
    with pytest.raises(ValueError, match=says):
        scene.to_dict()


def test_joints_that_cannot_stand_together() -> None:
    scene = Scene()
    scene.add_body("a", mass=1)
    scene.add_body("b", parent="a", mass=1)
    scene.add_joint("b", "ball", name="ball", range=(0, 1))
    scene.add_joint("b", "hinge", name="hinge")
    with pytest.raises(ValueError, match='joint "hinge": a ball joint must be'):
        scene.to_dict()
    scene.joints.pop()
    scene.joint("ball").range = (-1, 1)
    with pytest.raises(ValueError, match="for a ball joint"):
        scene.to_dict()
    scene.joint("ball").range = None
    scene.joint("ball").type = "free"
    with pytest.raises(ValueError, match="parent is the world"):
        scene.to_dict()


def test_keys_have_unit_quaternions() -> None:
    scene = ball_on_floor()
    scene.add_key("far", qpos=(1, 2, 3, 0, 2, 0, 0), time=2)
    scene.add_key("none")
    keys = scene.to_dict()["keys"]
    assert keys[0]["qpos"] == [1, 2, 3, 0, 1, 0, 0]
    assert (keys[0]["time"], keys[1]["qpos"], keys[1]["qvel"]) == (2, None, None)


@pytest.mark.parametrize("make", [ball_on_floor, chain])
def test_copies_are_equal_and_apart(make) -> None:
    scene = make()
    scene.options["dt"] = 0.01
    for twin in (copy.deepcopy(scene), pickle.loads(pickle.dumps(scene))):
        assert twin == scene
        assert twin.to_dict() == scene.to_dict()
        assert repr(twin) == repr(scene)
        twin.bodies[1].pos = (5, 5, 5)
        assert twin != scene
    assert scene != "scene"


def test_a_long_chain_needs_no_recursion() -> None:
    scene = Scene()
    parent = scene.world
    for i in range(3000):
        parent = scene.add_body(f"b{i}", parent=parent, mass=1)
    assert scene.to_dict()["bodies"][-1]["parent"] == 2999
    assert copy.deepcopy(scene) == scene
    assert pickle.loads(pickle.dumps(scene)) == scene


def test_with_settings_leaves_the_original() -> None:
    scene = ball_on_floor()
    faster = scene.with_settings({"dt": 0.01}, solver="pgs")
    assert faster.options == {"dt": 0.01, "solver": "pgs"}
    assert scene.options == {}
    assert faster != scene


def test_options_are_settings() -> None:
    scene = ball_on_floor().with_settings(dt=0.01)
    assert scene.settings == Settings(dt=0.01)
    scene.settings = Settings(solver="pgs")
    assert (scene.settings.solver, scene.settings.dt) == ("pgs", Settings().dt)
    assert scene.with_settings(Settings(dt=0.5)).settings == Settings(dt=0.5)
    with pytest.raises(ValueError, match="sweeps"):
        _ = scene.with_settings(sweps=1).settings
    with pytest.raises(ValueError, match=r"settings = 0\.01: must be a"):
        scene.settings = 0.01  # type: ignore[assignment]
    with pytest.raises(ValueError, match="must be a name or a Body"):
        scene.body(np.zeros(3))


def test_reprs_say_what_there_is() -> None:
    scene = chain()
    expected = "<Scene: 4 bodies, 4 joints (nq 4, nv 4), 4 geoms, 4 sites, 1 actuator, 1 equality>"
    assert repr(scene) == expected
    assert repr(scene.joint("j_a")) == (
        "Joint(name='j_a', body=<body \"a\">, axis=(0.0, 1.0, 0.0), ref=0.5)"
    )
    assert str(scene.add_geom("a")) == 'unnamed geom of body "a"'


def test_errors_name_what_has_no_name_by_its_index() -> None:
    """When it is made, when it is assigned, and in copies: as errors about the whole scene do."""
    scene = Scene()
    body = scene.add_body()
    with pytest.raises(ValueError, match=r"^joint 0 of body 1: axis = "):
        scene.add_joint(body, axis=(0, 0, 0))
    scene.add_joint(body)
    scene.add_geom(body)
    scene.add_geom(scene.add_body("arm"))
    for held in (scene, copy.deepcopy(scene), pickle.loads(pickle.dumps(scene))):
        with pytest.raises(ValueError, match=r"^joint 0 of body 1: stiffness = 'a': must be"):
            held.joints[0].stiffness = "a"  # type: ignore[assignment]
        with pytest.raises(ValueError, match=r"^geom 1 of body 'arm': size = -1: must be"):
            held.geoms[1].size = -1  # type: ignore[assignment]
        with pytest.raises(ValueError, match=r"^body 1: mass = -1: must be"):
            held.bodies[1].mass = -1
