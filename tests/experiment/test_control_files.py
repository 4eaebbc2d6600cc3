"""Logs of other tools as controls: Parquet, and MCAP in JSON and of ROS 2."""

import json
import struct
import sys
import types

import numpy as np
import pandas
import pytest
from mcap.writer import Writer

import stepcore as sc
from stepcore.cli import main
from stepcore.experiment.control_table import control_table

CARTS = """<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody>
<body name="a"><joint name="x" type="slide"/><geom size="0.1" mass="2"/></body>
<body name="b" pos="0 0 5"><joint name="y" type="slide"/><geom size="0.1" mass="4"/></body>
</worldbody><actuator><motor name="a" joint="x"/><motor name="b" joint="y"/></actuator></mujoco>"""
TIMES = 0.025 * np.arange(8)
FORCES = np.random.default_rng(0).normal(size=(8, 2))


JOINT_STATE = b"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""


def write_mcap(path, topics, kind="sensor_msgs/msg/JointState", times=TIMES, text=JOINT_STATE):
    """topics: the messages of each topic, one per time; in JSON, or as bytes of another format."""
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        for topic, messages in topics.items():
            plain = isinstance(messages[0], bytes)
            schema = writer.register_schema(
                kind, *(("ros2msg", text) if plain else ("jsonschema", b"{}"))
            )
            channel = writer.register_channel(topic, "cdr" if plain else "json", schema)
            for time, message in zip(times, messages, strict=False):
                at = 1700000000000000000 + round(1e9 * time)
                data = message if plain else json.dumps(message).encode()
                writer.add_message(channel, log_time=at, publish_time=at, data=data)
        writer.finish()
    return path


BY_NAME = [{"y": v, "x": u, "stamp": "now"} for u, v in FORCES]
JOINTS = [{"name": ["x", "y"], "position": [0, 0], "effort": [u, v]} for u, v in FORCES]
LISTS = [{"data": [u, v]} for u, v in FORCES]


@pytest.mark.parametrize(
    ("topics", "words"),
    [
        ({"/drive": BY_NAME}, ""),
        ({"/other": JOINTS, "/drive": BY_NAME}, ":/drive"),
        ({"/drive": JOINTS}, ":/drive.effort"),
        ({"/drive": LISTS}, ":/drive.data"),
    ],
)
def test_messages_are_rows_at_their_times(tmp_path, topics, words):
    path = write_mcap(tmp_path / "log.mcap", topics)
    np.testing.assert_allclose(sc.Log(f"{path}{words}").times, TIMES, atol=1e-9)
    model = sc.loads(CARTS).compile()
    run = sc.run(model, horizon=0.2, ctrl=f"{path}{words}")
    speeds = FORCES.sum(axis=0) * 0.025 / (2, 4)
    assert run.sim.qvel == pytest.approx(speeds, abs=1e-8)
    file = tmp_path / "carts.xml"
    file.write_text(CARTS)
    assert main(["run", str(file), "--horizon", "0.2", "--ctrl", f"{path}{words}"]) == 0


def test_a_log_of_stepcore_plays_the_run_again(tmp_path):
    pytest.importorskip("mcap.writer")
    pytest.importorskip("trimesh")
    sim = sc.Sim(sc.loads(CARTS))
    run = sim.run(0.2, lambda time, sim: [np.sin(9 * time), time], record=("qpos", "ctrl"))
    run.save_mcap(tmp_path / "run.mcap")
    again = sc.run(sc.loads(CARTS), horizon=0.2, ctrl=tmp_path / "run.mcap")
    np.testing.assert_allclose(again.sim.qpos, run.qpos[-1], rtol=0, atol=1e-14)


def in_cdr(message, order="<"):
    """A JointState of ROS 2 in CDR, byte by byte: stamp, frame, names, three lists of numbers."""
    data = bytearray()

    def put(code, *values):
        data.extend(b"\0" * (-len(data) % struct.calcsize(code)) * bool(values))
        data.extend(struct.pack(f"{order}{len(values)}{code}", *values))

    def text(word):
        put("I", len(word) + 1)
        data.extend(word.encode() + b"\0")

    put("I", 1_700_000_000, 5)
    text("base_link")
    put("I", len(message["name"]))
    for name in message["name"]:
        text(name)
    for state in ("position", "velocity", "effort"):
        put("I", len(message.get(state, ())))
        put("d", *message.get(state, ()))
    return bytes([0, order == "<", 0, 0]) + bytes(data)


@pytest.mark.parametrize("order", ["<", ">"])
def test_joint_states_of_ros_are_decoded(tmp_path, order):
    messages = [in_cdr(message, order) for message in JOINTS]
    path = write_mcap(tmp_path / "log.mcap", {"/joint_states": messages})
    log = sc.Log(path)
    assert (
        np.transpose([log.columns["x.effort"], log.columns["y.effort"]]).tolist() == FORCES.tolist()
    )
    assert "x.position" in log.columns and "x.velocity" not in log.columns
    run = sc.run(sc.loads(CARTS), horizon=0.2, ctrl=f"{path}:/joint_states.effort")
    assert run.sim.qvel == pytest.approx(FORCES.sum(axis=0) * 0.025 / (2, 4), abs=1e-8)


def test_other_messages_of_ros_are_read_from_a_chosen_topic(tmp_path):
    scans = [bytes([0, 1, 0, 0]) + struct.pack("<I4xdd", 2, *row) for row in FORCES]
    kind = "std_msgs/msg/Commands"
    path = write_mcap(tmp_path / "log.mcap", {"/drive": scans}, kind, text=b"float64[] data")
    with pytest.raises(ValueError, match=r"no messages with numbers.*not read: /drive \(cdr\)"):
        sc.Log(path)
    run = sc.run(sc.loads(CARTS), horizon=0.2, ctrl=f"{path}:/drive.data")
    assert run.sim.qvel == pytest.approx(FORCES.sum(axis=0) * 0.025 / (2, 4), abs=1e-8)


@pytest.mark.parametrize("text", [b"", b"float64[", b"other/Type field", b"\xff"])
def test_a_schema_that_cannot_be_decoded_is_refused(tmp_path, text):
    states = [in_cdr(message) for message in JOINTS]
    path = write_mcap(tmp_path / "log.mcap", {"/joint_states": states}, text=text)
    with pytest.raises(ValueError, match=r"log\.mcap: "):
        sc.Log(path)


def test_the_decoder_of_ros_is_needed_for_its_messages_alone(tmp_path, monkeypatch):
    for package in ("mcap_ros2", "mcap_ros2.decoder"):
        monkeypatch.setitem(sys.modules, package, None)
    assert len(sc.Log(write_mcap(tmp_path / "log.mcap", {"/drive": BY_NAME})).times) == len(TIMES)
    states = [in_cdr(message) for message in JOINTS]
    with pytest.raises(ImportError, match=r"needs mcap_ros2: pip .*'\.\[mcap\]'"):
        sc.Log(write_mcap(tmp_path / "log.mcap", {"/joint_states": states}))


def test_a_message_that_is_cut_off_is_refused(tmp_path):
    whole = in_cdr(JOINTS[0])
    for size in range(0, len(whole), 7):
        path = write_mcap(tmp_path / "log.mcap", {"/joint_states": [whole[:size]]})
        with pytest.raises(ValueError, match=r"log\.mcap: "):
            sc.Log(path)


@pytest.mark.parametrize(
    ("topics", "said"),
    [
        ({"/a": BY_NAME, "/b": JOINTS}, "has numbers in /a, /b: choose one, as in log.mcap:/TOPIC"),
        ({"/a": [{"x": 1.0}, {"y": 1.0}]}, "not all messages of /a have the numbers of the first"),
        ({"/a": [{"text": "hello"}]}, "has no messages with numbers by name"),
    ],
)
def test_what_is_unclear_in_a_log_is_said(tmp_path, topics, said):
    with pytest.raises(ValueError, match=said):
        control_table(write_mcap(tmp_path / "log.mcap", topics))


def test_a_file_that_is_no_log_is_named(tmp_path):
    (tmp_path / "log.mcap").write_bytes(b"nonsense" * 9)
    with pytest.raises(ValueError, match=r"log\.mcap: "):
        control_table(tmp_path / "log.mcap")
    with pytest.raises(FileNotFoundError):
        control_table(tmp_path / "none.mcap")


def test_a_parquet_file_has_columns_by_name(tmp_path, monkeypatch):
    columns = {"t": list(TIMES), "y": list(FORCES[:, 1]), "x": list(FORCES[:, 0])}
    index = {"__index_level_0__": list(range(8))}
    table = types.SimpleNamespace(to_pydict=lambda: columns | index)
    reader = types.SimpleNamespace(read_table=lambda path: table)
    monkeypatch.setitem(sys.modules, "pyarrow", types.SimpleNamespace(parquet=reader))
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", reader)
    (tmp_path / "log.parquet").touch()
    run = sc.run(sc.loads(CARTS), horizon=0.2, ctrl=tmp_path / "log.parquet")
    assert run.sim.qvel == pytest.approx(FORCES.sum(axis=0) * 0.025 / (2, 4), abs=1e-12)


def test_parquet_of_pandas_is_read(tmp_path):
    frame = pandas.DataFrame({"t": TIMES, "x": FORCES[:, 0], "y": FORCES[:, 1]})
    frame.to_parquet(tmp_path / "log.parquet")
    assert control_table(tmp_path / "log.parquet").rows == pytest.approx(FORCES)
    frame.set_index("t").to_parquet(tmp_path / "index.parquet")
    assert control_table(tmp_path / "index.parquet").times == pytest.approx(TIMES)


@pytest.mark.parametrize(
    ("package", "extra"), [("pyarrow.parquet", "data"), ("mcap.reader", "mcap")]
)
def test_a_missing_package_is_named_with_its_extra(tmp_path, monkeypatch, capsys, package, extra):
    monkeypatch.setitem(sys.modules, package.partition(".")[0], None)
    monkeypatch.setitem(sys.modules, package, None)
    path = tmp_path / ("log.parquet" if extra == "data" else "log.mcap")
    path.touch()
    with pytest.raises(
        ImportError, match=rf"needs {package.partition('.')[0]}: pip .*'\.\[{extra}\]'"
    ):
        control_table(path)
    (tmp_path / "carts.xml").write_text(CARTS)
    assert main(["run", str(tmp_path / "carts.xml"), "--ctrl", str(path)]) == 2
    assert f".[{extra}]" in capsys.readouterr().err
