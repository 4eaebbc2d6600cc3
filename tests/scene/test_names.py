"""Elements by name: found at once in scenes of thousands, whatever is done to the lists."""

import copy
import pickle
import sys

import pytest

import stepcore as sc


class Counted(str):
    """A name that counts how often it is compared."""

    compared = 0
    __hash__ = str.__hash__

    def __eq__(self, other: object) -> bool:
        Counted.compared += 1
        return str.__eq__(self, other)


def built(count: int, kind: type = str) -> sc.Scene:
    scene = sc.Scene()
    for i in range(count):
        name = kind(f"ball{i}")
        scene.add_body(name, pos=(i, 0, 0))
        scene.add_joint(name, "free", name=name)
        scene.add_geom(name, "sphere", 0.1, name=name)
    return scene


def test_names_are_compared_a_few_times_an_element() -> None:
    counts = []
    for count in (50, 500):
        Counted.compared = 0
        built(count, Counted).compile()
        counts.append(Counted.compared / count)
    assert counts[1] <= counts[0] + 1 and counts[1] < 30


def test_compiling_takes_as_many_calls_an_element_in_a_large_scene() -> None:
    def calls(count: int) -> int:
        seen = 0

        def note(frame: object, event: str, argument: object) -> None:
            nonlocal seen
            seen += event in ("call", "c_call")

        scene = built(count)
        sys.setprofile(note)
        try:
            sc.Sim(scene.compile())
        finally:
            sys.setprofile(None)
        return seen

    calls(100)  # Imports what is needed.
    few, some, many = calls(100), calls(200), calls(400)
    assert many - some <= 2.2 * (some - few)


def test_an_element_is_found_by_its_new_name() -> None:
    scene = built(3)
    ball = scene.body("ball1")
    ball.name = "other"
    assert scene.body("other") is ball
    with pytest.raises(ValueError, match='no body is named "ball1"'):
        scene.body("ball1")
    again = scene.add_body("ball1")
    assert scene.body("ball1") is again and scene.body(ball) is ball
    with pytest.raises(ValueError, match="used twice"):
        scene.add_body("other")


def test_lists_may_be_changed_by_hand() -> None:
    scene = built(4)
    gone = scene.geoms.pop()
    with pytest.raises(ValueError, match="no geom is named"):
        scene.geom("ball3")
    with pytest.raises(ValueError, match="is not a geom of this scene"):
        scene.geom(gone)
    scene.add_geom("ball3", "sphere", 0.2, name="ball3")
    assert scene.geom("ball3").size[0] == 0.2
    scene.geoms = [scene.geoms[3], *scene.geoms[:3]]
    assert scene.geom("ball2") is scene.geoms[3] and scene.geom("ball3") is scene.geoms[0]
    scene.geoms[0], scene.geoms[1] = scene.geoms[1], scene.geoms[0]
    assert scene.geom("ball3") is scene.geoms[1] and scene.geom("ball0") is scene.geoms[0]
    other = built(1).geoms[0]
    other.name, other.body = "put", scene.body("ball0")
    scene.geoms[2] = other
    assert scene.geom("put") is other
    with pytest.raises(ValueError, match="no geom is named"):
        scene.geom("ball1")
    scene.geoms.append(other)
    with pytest.raises(ValueError, match="used twice"):
        scene.compile()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_a_copy_finds_its_own_elements(copied) -> None:
    scene = built(3)
    other = copied(scene)
    assert other == scene
    for kind in ("body", "joint", "geom"):
        own = getattr(other, kind)("ball2")
        assert own is not getattr(scene, kind)("ball2") and own.name == "ball2"
    assert other.geom("ball1").body is other.body("ball1")
    other.body("ball1").pos = (0, 0, 5)
    other.add_body("more")
    assert scene.body("ball1").pos == (1, 0, 0)
    with pytest.raises(ValueError, match="no body"):
        scene.body("more")


def test_what_is_no_name_is_said_to_be_none() -> None:
    scene = built(2)
    for wrong in (3, None, ["ball1"], {}, ""):
        with pytest.raises(ValueError, match="body"):
            scene.body(wrong)
