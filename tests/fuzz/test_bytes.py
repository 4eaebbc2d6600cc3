"""Files whose bytes were changed: each is a model, or is refused in a sentence that names the file.

The readers of meshes, pictures, height fields, URDF and MJCF, and what is compiled of what they
read. Many more changes: `pytest -m long tests/fuzz/test_bytes.py`.
"""

from __future__ import annotations

import contextlib
import math
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from png_writer import SIGNATURE, chunk, grey

import stepcore as sc

CORNERS = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1))
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 4), (1, 4, 3), (2, 3, 4))
MESH = """<mujoco><asset><mesh name="m" file="{0}"/></asset><worldbody>
<geom type="plane" size="1 1 1"/><body pos="0 0 .1"><freejoint/><geom type="mesh" mesh="m"/></body>
</worldbody></mujoco>"""
FIELD = """<mujoco><asset><hfield name="h" file="{0}" size="1 1 .2 .1"/></asset><worldbody>
<geom type="hfield" hfield="h"/><body pos="0 0 .3"><freejoint/><geom size=".1"/></body></worldbody>
</mujoco>"""
MJCF = """<?xml version="1.0"?>
<mujoco model="m"><compiler angle="radian"/><option timestep=".002"/><default><geom size=".1"/>
<default class="a"><joint damping="1"/></default></default><worldbody>
<geom type="plane" size="1 1 1"/><body name="b" pos="0 0 1" childclass="a">
<joint name="j" range="-1 1"/><geom fromto="0 0 0 1 0 0" type="capsule" size=".1"/>
<site name="s"/></body></worldbody><tendon><fixed name="t"><joint joint="j" coef="1"/></fixed>
<spatial name="u"><site site="s"/><site site="s"/></spatial></tendon>
<actuator><motor joint="j" gear="2"/></actuator><sensor><jointpos joint="j"/></sensor>
<keyframe><key qpos=".1"/></keyframe></mujoco>"""
URDF = """<?xml version="1.0"?>
<robot name="r"><link name="a"/><link name="b"><inertial><origin xyz="0 0 .1" rpy="0 0 1"/>
<mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial><collision>
<origin xyz="0 0 0"/><geometry><cylinder radius=".1" length="1"/></geometry></collision></link>
<link name="c"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>
</inertial></link><joint name="j" type="revolute"><parent link="a"/><child link="b"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="3" velocity="1"/></joint><joint name="k"
type="prismatic"><parent link="b"/><child link="c"/><mimic joint="j" multiplier="2"/>
<limit effort="1" velocity="1"/></joint></robot>"""


def binary_stl() -> bytes:
    body = b"".join(
        struct.pack("<12fH", 0, 0, 1, *(x for k in face for x in CORNERS[k]), 0) for face in FACES
    )
    return b"\0" * 80 + struct.pack("<I", len(FACES)) + body


def text_stl() -> bytes:
    lines = ["solid s"]
    for face in FACES:
        lines += ["facet normal 0 0 1", "outer loop"]
        lines += ["vertex " + " ".join(map(str, CORNERS[k])) for k in face]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid s"]).encode()


def obj() -> bytes:
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + ["vt 0 0", "vn 0 0 1", "o part", "usemtl m"]
    lines += [f"f {a + 1}/1/1 {b + 1}/1/1 {c - 5}" for a, b, c in FACES]
    return "\n".join([*lines, "f 1 2 5 3", "# the end"]).encode()


def msh() -> bytes:
    numbers = [float(x) for corner in CORNERS for x in corner]
    head = struct.pack("<4i", len(CORNERS), 0, 0, len(FACES))
    body = struct.pack(f"<{len(numbers)}f", *numbers)
    return head + body + struct.pack(f"<{3 * len(FACES)}i", *(k for face in FACES for k in face))


def hfield() -> bytes:
    return struct.pack("<2i12f", 3, 4, *(math.sin(k) for k in range(12)))


# The file whose bytes change, and the model that names it, if that is another.
FILES: dict[str, tuple[bytes, str]] = {
    "binary.stl": (binary_stl(), MESH),
    "text.stl": (text_stl(), MESH),
    "part.obj": (obj(), MESH),
    "part.msh": (msh(), MESH),
    "heights.bin": (hfield(), FIELD),
    "heights.png": (grey(np.arange(30).reshape(5, 6) * 8, filters=(0, 1, 2, 3, 4)), FIELD),
    "model.xml": (MJCF.encode(), ""),
    "robot.urdf": (URDF.encode(), ""),
}
# What a reader may mistake for something else.
PIECES = (
    *(b"", b"\0", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x00\x00\xc0\x7f", b"\n", b" " * 40),
    *(b"nan", b"-inf", b"1e400", b"-1", b"999999999999", b"/", b"\\\n", b'"', b"<!--", b"]]>"),
    *(b"&lt;", b"\xef\xbb\xbf", b"\xc2\x9b", b"\x1b[2J", b"IDAT", b"IEND", b"solid", b"endsolid"),
    *(b"vertex", b"f 1 2 3\n", b"<geom/>", b"</body>", b'class="a"', b'xyz="0 0"', b"0x10"),
)
changes = st.lists(
    st.tuples(
        st.floats(0, 1),
        st.sampled_from(("put", "cut", "flip", "copy", "end")),
        st.one_of(st.sampled_from(PIECES), st.binary(max_size=8)),
        st.integers(0, 60),
    ),
    min_size=1,
    max_size=4,
)


def changed(data: bytes, edits: list[tuple[float, str, bytes, int]]) -> bytes:
    for place, kind, piece, length in edits:
        at = int(place * len(data))
        if kind == "put":
            data = data[:at] + piece + data[at + len(piece) :]
        elif kind == "cut":
            data = data[:at] + data[at + length :]
        elif kind == "flip" and data:
            at = min(at, len(data) - 1)
            data = data[:at] + bytes([data[at] ^ (1 << length % 8)]) + data[at + 1 :]
        elif kind == "copy":
            data = data[:at] + data[at : at + length] * 2 + piece + data[at + length :]
        elif kind == "end":
            data = data[:at]
    return data


def sealed(data: bytes) -> bytes:
    """A PNG file with the checksums that its chunks should have."""
    made, rest = SIGNATURE, data[len(SIGNATURE) :]
    while len(rest) >= 12:
        length = min(struct.unpack(">I", rest[:4])[0], len(rest) - 12)
        made += rest[:4] + chunk(rest[4:8], rest[8 : 8 + length])[4:]
        rest = rest[12 + length :]
    return made + rest


def check(folder: Path, name: str, edits: list[tuple[float, str, bytes, int]]) -> bool:
    """Loads and steps, or is refused in a sentence that names the file; whether it loads."""
    data, around = FILES[name]
    path = folder / name
    damaged = changed(data, edits)
    path.write_bytes(sealed(damaged) if name.endswith(".png") and len(edits) > 1 else damaged)
    if around:
        path = folder / f"{name}.xml"
        path.write_text(around.format(name))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            sim = sc.Sim(sc.load(path))
        except ValueError as error:
            assert path.name in str(error) or name in str(error), str(error)
            assert len(str(error)) < 1500 and "internal error" not in str(error)
            assert not any(unicode_control(letter) for letter in str(error)), repr(str(error))
            return False
        except FileNotFoundError as error:
            # The name of a file was what was changed.
            assert not around and "file" in str(error)
            return False
    if sim.model.nv < 100:
        with contextlib.suppress(sc.SimulationError):
            sim.step(2)
    return True


def unicode_control(letter: str) -> bool:
    return letter != "\n" and (ord(letter) < 32 or 127 <= ord(letter) < 160)


@pytest.mark.parametrize("name", FILES)
def test_the_file_itself_is_a_model(tmp_path, name):
    check(tmp_path, name, [(1.0, "put", b"", 0)])
    around = FILES[name][1]
    assert sc.load(tmp_path / (f"{name}.xml" if around else name)).compile().nv


@pytest.mark.parametrize("name", FILES)
def test_some_changes_are_harmless_and_some_are_not(tmp_path, name):
    """Either outcome is among these: what is tried gets past the first check of a reader."""
    edits = [(k / 40, kind, b"9", 1) for k in range(40) for kind in ("put", "flip", "cut")]
    loads = [check(tmp_path, name, [edit] * (1 + name.endswith(".png"))) for edit in edits]
    assert 5 < sum(loads) < len(loads) - 5


quiet = [HealthCheck.function_scoped_fixture]


@pytest.mark.parametrize("name", FILES)
@settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=quiet)
@given(edits=changes)
def test_changed_bytes(tmp_path, name, edits):
    check(tmp_path, name, edits)


@pytest.mark.long
@pytest.mark.parametrize("name", FILES)
@settings(max_examples=5000, deadline=None, suppress_health_check=quiet)
@given(edits=changes)
def test_many_changed_bytes(tmp_path, name, edits):
    check(tmp_path, name, edits)
