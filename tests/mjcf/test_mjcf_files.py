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
    monkeypatch.setattr(files, "LARGEST_FILE", len(BODY) - 1)
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
    import mujoco

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
    import mujoco

    text = SERVO.format(angle, limited)
    scene = sc.loads(text)
    theirs = mujoco.MjModel.from_xml_string(text).actuator_ctrlrange[0]
    assert scene.actuators[0].ctrlrange == pytest.approx(theirs, rel=1e-15)
    assert bool(scene.notes) == ((angle, limited) == ("degree", "false"))


def scene_of(asset):
    """A text whose fourth line names a file."""
    kind = "hfield" if asset.startswith("<hfield") else "mesh"
    geom = f'<geom type="{kind}" {kind}="a" mass="1"/>'
    return f"<mujoco>\n<worldbody>{geom}</worldbody>\n<asset>\n{asset}\n</asset></mujoco>"


KINDS = {
    "mesh": '<mesh name="a" content_type="model/stl" file="{}"/>',
    "hfield": '<hfield name="a" size="1 1 1 1" file="{}"/>',
    "image": '<hfield name="a" size="1 1 1 1" content_type="image/png" file="{}"/>',
}


@pytest.mark.parametrize("kind", KINDS)
def test_an_asset_that_cannot_be_read_is_an_error_of_its_line(kind, tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "denied").write_bytes(b"1")
    opened = os.open

    def refusing(name, *rest):
        if str(name).endswith("denied"):
            raise PermissionError(13, "Permission denied")
        return opened(name, *rest)

    monkeypatch.setattr(os, "open", refusing)
    cases = {
        "pipe": "not a regular file",
        "/dev/zero": "not a regular file",
        "folder": "is a folder",
        "empty": "not a whole",
        "denied": "cannot be read: Permission denied",
        "b" * 3000: "cannot be read: File name too long",
        # Files of the system: of no size, whatever they would give, or wait to give.
        "/proc/self/mem": "not a whole",
        "/proc/kmsg": "not a whole|cannot be read",
        "/proc/self/status": "not a whole",
    }
    for name, says in cases.items():
        if name.startswith("/proc") and not os.path.exists(name):
            continue
        with pytest.raises(sc.MJCFError, match=rf"^<string>:4: .*({says})") as caught:
            sc.loads(scene_of(KINDS[kind].format(name)), base=tmp_path)
        assert len(str(caught.value)) < 1000
    with pytest.raises(FileNotFoundError, match=r"^<string>:4: .*gone: no such file"):
        sc.loads(scene_of(KINDS[kind].format("gone")), base=tmp_path)


@pytest.mark.parametrize("what", ["include", "model"])
def test_a_folder_or_a_file_that_is_denied_has_the_line_that_names_it(what, tmp_path):
    texts = {
        "include": '<mujoco>\n<include file="{}"/></mujoco>',
        "model": '<mujoco><asset>\n<model name="m" file="{}"/></asset>'
        '<worldbody><attach model="m" prefix="a"/></worldbody></mujoco>',
    }
    (tmp_path / "folder").mkdir()
    for name in ("folder", "/proc/self/mem"):
        with pytest.raises(sc.MJCFError, match=r":(2|1): "):
            sc.loads(texts[what].format(name), base=tmp_path)
    with pytest.raises(sc.MJCFError, match=r"^<string>:2: .*is a folder"):
        sc.loads(texts[what].format("folder"), base=tmp_path)


def test_a_file_that_grows_is_read_as_far_as_it_said(tmp_path, monkeypatch):
    path = tmp_path / "m.xml"
    path.write_text(BODY + "<")
    status = os.fstat

    class Shorter:
        def __init__(self, whole):
            self.st_mode, self.st_size = whole.st_mode, whole.st_size - 1
            self.st_dev, self.st_ino = whole.st_dev, whole.st_ino

    monkeypatch.setattr(os, "fstat", lambda number: Shorter(status(number)))
    assert files.contents(path, "a model") == BODY.encode()


def test_pointers_of_git_lfs_are_told(tmp_path):
    """A clone without Git LFS has them in place of meshes."""
    (tmp_path / "arm.stl").write_text(
        "version https://git-lfs.github.com/spec/v1\noid sha256:9ba0e5a4dc95\nsize 6884\n"
    )
    text = """<mujoco><asset><mesh file="arm.stl"/></asset><worldbody><geom type="mesh" mesh="arm"/>
</worldbody></mujoco>"""
    with pytest.raises(sc.MJCFError, match=r"arm\.stl: is a pointer of Git LFS.*git lfs pull"):
        sc.loads(text, base=tmp_path)


LONG = "n" * 6000


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('<mujoco><worldbody><geom type="mesh" mesh="{}"/></worldbody></mujoco>', "no such mesh"),
        ('<mujoco><worldbody><geom class="{}" size="1"/></worldbody></mujoco>', "class"),
        ('<mujoco><worldbody><geom type="{}"/></worldbody></mujoco>', "must be one of"),
        ('<mujoco><include file="{}"/></mujoco>', "too long"),
        ('<mujoco><sensor><jointpos joint="{}"/></sensor></mujoco>', "no joint|no such joint"),
        ('<mujoco><worldbody><body name="{0}"/><body name="{0}"/></worldbody></mujoco>', "twice"),
        ('<robot name="r"><link name="{}"/><link name="b"/></robot>', "both have no parent"),
    ],
)
@pytest.mark.parametrize("name", [LONG, "two words " * 600])
def test_a_long_name_leaves_room_for_what_is_wrong(text, says, name, tmp_path):
    with pytest.raises(sc.MJCFError, match=says) as caught:
        sc.loads(text.format(name), base=tmp_path)
    assert len(str(caught.value)) < 1100


def test_many_errors_with_long_names_are_a_message_that_can_be_read():
    geoms = "".join(f'<geom mesh="{i}{LONG}" type="mesh"/>' for i in range(100))
    with pytest.raises(sc.MJCFError) as caught:
        sc.loads(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>", name=LONG)
    lines = str(caught.value).split("\n")
    assert len(lines) == 21
    assert max(map(len, lines)) <= 600
    assert "no such mesh" in lines[0]


def test_a_missing_file_of_a_long_name_is_a_short_message(tmp_path):
    path = "/".join(["n" * 200] * 15)
    with pytest.raises(FileNotFoundError, match=r"no such file$") as caught:
        sc.loads(f'<mujoco><include file="{path}"/></mujoco>', base=tmp_path, name=LONG)
    assert len(str(caught.value)) < 1000


def test_a_length_that_diverges_is_an_error_of_the_muscle():
    text = """<mujoco><worldbody>
    <body><body pos="-0.2875 0.2990 0.1862"><body><site name="one"/></body></body><body>
      <joint name="j" axis="0.4452 0.2213 0.9821"/><joint type="slide"/>
      <geom size="0.1204"/><site name="two"/></body></body></worldbody>
    <equality><connect site1="two" site2="one"/></equality>
    <actuator>
      <muscle joint="j"/>
    </actuator></mujoco>"""
    says = r"<string>:7: actuator 0: its range of lengths was not found: the motion diverged"
    with pytest.raises(ValueError, match=says):
        sc.loads(text).compile()
