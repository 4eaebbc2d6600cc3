"""Which files the reader opens: regular ones of a bounded size, and it tells of those outside."""

import os

import pytest

import stepcore as sc
from stepcore import files

BODY = '<mujoco><worldbody><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
INERTIA = """<mujoco><compiler balanceinertia="{0}"/><worldbody><body><freejoint/>
<inertial pos="0 0 0" mass="1" fullinertia="{1}"/></body></worldbody></mujoco>"""
SERVO = """<mujoco><compiler angle="{0}"/><worldbody><body>
<joint name="j" limited="{1}" range="-1 2"/><geom size=".1"/></body></worldbody>
<actuator><position joint="j" inheritrange="1"/></actuator></mujoco>"""


@pytest.fixture
def include(tmp_path):
    """Loads a model that includes a file of this name."""

    def load(name):
        main = tmp_path / "model" / "main.xml"
        main.parent.mkdir(exist_ok=True)
        main.write_text(f'<mujoco><include file="{name}"/></mujoco>')
        return sc.load(main)

    return load


@pytest.mark.parametrize("read", [sc.load, sc.replay])
def test_a_device_and_a_pipe_are_not_opened(read, tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in ("/dev/zero", pipe):
        with pytest.raises(ValueError, match="not a regular file"):
            read(path)


def test_an_include_of_a_device_or_a_pipe_is_not_opened(include, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name in ("/dev/zero", "../pipe"):
        with pytest.raises((ValueError, OSError), match="not a regular file"):
            include(name)


def test_a_file_beyond_the_limit_is_refused(monkeypatch, tmp_path):
    path = tmp_path / "large.xml"
    path.write_text(BODY)
    assert sc.load(path).bodies
    monkeypatch.setattr(files, "LARGEST", len(BODY) - 1)
    with pytest.raises(ValueError, match="MiB"):
        sc.load(path)


def test_an_include_with_an_over_long_name_is_an_error_of_the_file(include):
    with pytest.raises(sc.MJCFError, match="cannot be read: File name too long"):
        include("b" * 100_000)


def test_an_include_outside_the_folder_is_read_and_told(include, tmp_path):
    (tmp_path / "outside.xml").write_text(BODY)
    scene = include("../outside.xml")
    assert len(scene.bodies) == 2
    assert any("outside the folder of the main file" in note for note in scene.notes)
    (tmp_path / "model" / "inside.xml").write_text(BODY)
    assert not include("inside.xml").notes


@pytest.mark.parametrize("balance", ["true", "false"])
@pytest.mark.parametrize("full", ["1 1 1 2 0 0", "1 1 1 1 0 0", "1 1 1 .9 0 0", "1 1 1 .3 .2 .1"])
def test_an_inertia_is_refused_where_mujoco_refuses_it(full, balance):
    mujoco = pytest.importorskip("mujoco")
    text = INERTIA.format(balance, full)
    try:
        theirs = mujoco.MjModel.from_xml_string(text)
    except ValueError:
        with pytest.raises(ValueError, match="principal moments"):
            sc.loads(text).compile()
    else:
        assert sc.loads(text).compile().nv == theirs.nv


@pytest.mark.parametrize("limited", ["true", "false", "auto"])
@pytest.mark.parametrize("angle", ["degree", "radian"])
def test_an_inherited_range_is_mujocos_also_where_the_joint_is_not_limited(angle, limited):
    mujoco = pytest.importorskip("mujoco")
    text = SERVO.format(angle, limited)
    scene = sc.loads(text)
    theirs = mujoco.MjModel.from_xml_string(text).actuator_ctrlrange[0]
    assert scene.actuators[0].ctrlrange == pytest.approx(theirs, rel=1e-15)
    assert bool(scene.notes) == ((angle, limited) == ("degree", "false"))
