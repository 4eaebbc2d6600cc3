"""Logs of runs, read back by the reader of MCAP."""

import json
import sys

import numpy as np
import pytest
from mcap.reader import make_reader

import stepcore as sc
from stepcore.viewing.camera import Mark
from stepcore.viewing.mcap_log import arrow as drawn_arrow
from stepcore.viewing.mcap_log import frame_names

TOPICS = {
    "/tf": "foxglove.FrameTransforms",
    "/scene": "foxglove.SceneUpdate",
    "/contacts": "foxglove.SceneUpdate",
    "/state": "stepcore.State",
    "/recorded": "stepcore.Recorded",
}
SHAPES = """<mujoco model="shapes"><asset><mesh name="tetra" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/>
</asset><worldbody><geom type="plane" size="0 0 1"/>
<body name="one" pos="0 0 .19"><freejoint/><geom type="box" size=".1 .2 .2"/>
<geom type="sphere" size=".05" pos=".3 0 .1"/></body>
<body name="one again" pos="1 0 5" quat="0 1 0 0"><freejoint/>
<geom type="ellipsoid" size=".1 .2 .3"/><geom type="cylinder" size=".1 .2"/>
<geom type="capsule" size=".1 .2"/><geom type="mesh" mesh="tetra"/></body>
<body pos="2 0 1"><joint/><geom size=".1"/></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def run():
    return sc.Sim(sc.loads(SHAPES)).run(0.5, record=("qpos", "xpos", "overlap"))


@pytest.fixture(scope="module")
def log(run, tmp_path_factory):
    """The messages by topic, each with its time [ns]; and the schemas by topic."""
    path = tmp_path_factory.mktemp("logs") / "run.mcap"
    run.save_mcap(path)
    messages, schemas = {}, {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert schema.name == TOPICS[channel.topic]
            schemas[channel.topic] = json.loads(schema.data)
            some = messages.setdefault(channel.topic, [])
            some.append((message.log_time, json.loads(message.data)))
    return messages, schemas


def fits(value, schema, where=""):
    """What of a message its schema does not describe."""
    kind = schema.get("type")
    if kind == "object":
        unknown = set(value) - set(schema["properties"])
        assert not unknown and set(value) == set(schema["properties"]), (where, unknown)
        for name, part in value.items():
            fits(part, schema["properties"][name], f"{where}.{name}")
    elif kind == "array":
        for part in value:
            fits(part, schema["items"], where)
    else:
        types = {"number": (int, float), "integer": int, "string": str, "boolean": bool}
        assert isinstance(value, types[kind]), (where, value)


def test_every_message_is_what_its_schema_says(log):
    messages, schemas = log
    assert messages.keys() == schemas.keys() == TOPICS.keys()
    for topic, some in messages.items():
        assert schemas[topic]["title"] == TOPICS[topic]
        for _, message in some:
            fits(message, schemas[topic], topic)


def test_the_poses_are_those_of_the_run(log, run):
    messages, _ = log
    for at, message in messages["/tf"]:
        step = round(at / 1e9 / 0.002)
        assert at == round(run.time[step] * 1e9)
        transforms = {one["child_frame_id"]: one for one in message["transforms"]}
        assert list(transforms) == ["one", "one again", "body 3"]
        for body, one in enumerate(transforms.values(), start=1):
            place = [one["translation"][axis] for axis in "xyz"]
            assert np.array_equal(place, run.xpos[step, body]) and one["parent_frame_id"] == "world"
            assert np.linalg.norm(list(one["rotation"].values())) == pytest.approx(1)
            stamp = one["timestamp"]
            assert stamp["sec"] * 10**9 + stamp["nsec"] == at
    assert messages["/tf"][0][1]["transforms"][1]["rotation"] == {"w": 0, "x": 1, "y": 0, "z": 0}
    assert len(messages["/tf"]) == len(messages["/state"]) == len(run.snapshots.states)


def test_the_recorded_arrays_stand_at_every_step(log, run):
    some = log[0]["/recorded"]
    assert [at for at, _ in some] == [round(time * 1e9) for time in run.time]
    for name, values in run.data.items():
        assert np.array_equal([message[name] for _, message in some], values)


def test_bodies_have_their_shapes(log):
    ((_, message),) = log[0]["/scene"]
    entities = {entity["frame_id"]: entity for entity in message["entities"]}
    assert list(entities) == ["world", "one", "one again", "body 3"]
    assert all(entity["frame_locked"] for entity in entities.values())
    (cube,) = entities["one"]["cubes"]
    assert cube["size"] == pytest.approx({"x": 0.2, "y": 0.4, "z": 0.4})
    assert entities["one"]["spheres"][0]["pose"]["position"] == pytest.approx(
        {"x": 0.3, "y": 0, "z": 0.1}
    )
    other = entities["one again"]
    assert other["spheres"][0]["size"] == pytest.approx({"x": 0.2, "y": 0.4, "z": 0.6})
    assert other["cylinders"][0]["size"] == pytest.approx({"x": 0.2, "y": 0.2, "z": 0.4})
    for triangles in other["triangles"]:
        assert max(triangles["indices"]) == len(triangles["points"]) - 1
        assert len(triangles["indices"]) % 3 == 0
    assert len(entities["world"]["triangles"]) == 1


def test_contact_forces_are_arrows_that_carry_the_weight(log, run):
    """At rest the arrows of the box add up to its share of the weight, straight up."""
    (entity,) = log[0]["/contacts"][-1][1]["entities"]
    arrows = entity["arrows"]
    assert len(arrows) == 4
    drawing = run._replayed().drawing
    length = sum(arrow["shaft_length"] + arrow["head_length"] for arrow in arrows)
    mass = run.snapshots.model.body_mass
    assert length == pytest.approx(0.35 * drawing.extent * mass[1] / mass.sum(), rel=0.1)
    for arrow in arrows:
        w, x, y, z = (arrow["pose"]["orientation"][part] for part in "wxyz")
        along = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
        assert along[2] > 0.9


@pytest.mark.parametrize("along", [(1, 0, 0), (-1, 0, 0), (0, 2, 0), (0, 0, -3), (0.3, -0.4, 0.5)])
def test_an_arrow_points_along_its_force(along):
    arrow = drawn_arrow(Mark("arrow", np.zeros(3), np.array(along, float), 0.005, (1, 0, 0)))
    w, x, y, z = (arrow["pose"]["orientation"][part] for part in "wxyz")
    pointing = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    length = arrow["shaft_length"] + arrow["head_length"]
    assert length * np.array(pointing) == pytest.approx(along, abs=1e-12)


def test_frames_have_names_of_their_own():
    assert frame_names(("world", "a", "", "world")) == ["world", "a", "body 2", "world (3)"]


def test_what_is_missing_is_named(run, monkeypatch, tmp_path):
    with pytest.raises(ValueError, match="has no snapshots"):
        sc.Trajectory(run.time, run.data).save_mcap(tmp_path / "never.mcap")
    monkeypatch.setitem(sys.modules, "mcap", None)
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(ImportError, match=r"needs mcap: pip install '\.\[mcap\]'"):
        run.save_mcap(tmp_path / "never.mcap")
    assert not (tmp_path / "never.mcap").exists()
