"""What `compile` refuses about elements of a file is said with file and line."""

import copy
import pickle

import pytest

import stepcore as sc
from stepcore.mjcf.nodes import MJCFError

LINES = """<mujoco><worldbody>
<geom name="floor" type="plane" size="0 0 1"/>
<body name="leg" pos="0 0 1">
<freejoint/>
<geom type="{}" size=".1 .1 .1" {}/>
</body>
{}
</worldbody></mujoco>"""


def refused(kind="sphere", more="", after=""):
    with pytest.raises(MJCFError) as caught:
        sc.loads(LINES.format(kind, more, after), name="robot.xml").compile()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_every_kind_of_refusal_has_its_line():
    assert refused(more='mass="0"').startswith("robot.xml:3: body 'leg' mass = 0")
    twice = "<body name='arm'><joint/>\n<joint/>\n<geom size='.1'/></body>"
    assert refused(after=twice).startswith("robot.xml:7: joint 1 of body 'arm'")


def test_a_place_survives_copies_and_later_edits():
    scene = sc.loads(LINES.format("sphere", "", ""), name="robot.xml")
    for twin in (copy.deepcopy(scene), pickle.loads(pickle.dumps(scene))):
        assert twin.geoms[1].place == "robot.xml:5"
        twin.joints[0].range = (0, 1)
        with pytest.raises(ValueError, match=r"^robot.xml:4: joint 0 of body 'leg': range"):
            twin.compile()
    with pytest.raises(AttributeError):
        scene.geoms[1].place = "elsewhere"


def test_a_scene_without_a_file_names_bodies():
    scene = sc.Scene()
    box = scene.add_body("box", pos=(0, 0, 1))
    scene.add_joint(box, "free")
    scene.add_geom(box, "box", (0.1, 0.1, 0.1), mass=0)
    with pytest.raises(ValueError, match=r"^body 'box' mass = 0"):
        scene.compile()
    # A name that holds a quote is left as it is.
    scene.bodies[1].name = "it's"
    with pytest.raises(ValueError, match=r"^body 'it's' mass = 0"):
        scene.compile()


def test_an_element_without_a_name_is_called_by_its_index_and_body():
    """Alike, whether the scene's check or the engine refuses it, with a file and without."""
    scene = sc.Scene()
    scene.add_geom("world", "plane", (1, 1, 1))
    for _ in range(2):
        body = scene.add_body()
        scene.add_joint(body, "slide")
        scene.add_geom(body, "sphere", 0.1)
    scene.joints[1].type = "free"
    scene.add_joint(scene.bodies[2], "hinge")
    with pytest.raises(ValueError, match=r"^body 2: its joints have more than 6 dofs"):
        scene.compile()
    scene.joints.pop()
    scene.geoms[2].type = "mesh"
    with pytest.raises(ValueError, match=r"^geom 2 of body 2: a geom of type mesh needs a mesh"):
        scene.compile()
    assert refused("box", after="<geom type='sphere' size='0'/>").startswith(
        "robot.xml:7: geom 1 of the world: size = (0.0, 0.0, 0.0)"
    )


def test_an_empty_range_is_noted():
    body = '<body><joint range="1 -1"/><geom size="1"/></body>'
    scene = sc.loads(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    assert scene.notes == ["<string>:1: range = 1 -1 is empty: no limit"]
