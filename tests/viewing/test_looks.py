"""How a file says that its scene looks: colours, textures and visual geoms."""

import os
import struct
import zlib

import numpy as np
import pytest

import stepcore as sc
from stepcore.mjcf.appearance import GREY
from stepcore.viewing.drawing import drawing_of

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
ARM = f"""
<robot name="arm">
<material name="blue"><color rgba="0 0 1 1"/></material>
<link name="base">{INERTIAL}
  <visual name="seen"><origin xyz="1 2 3"/><geometry><box size="2 4 6"/></geometry>
    <material name="red"><color rgba="1 0 0 0.5"/></material></visual>
  <collision name="seen"><geometry><sphere radius="1"/></geometry></collision></link>
<link name="upper">{INERTIAL}
  <visual><geometry><mesh filename="package://none/none.dae"/></geometry></visual>
  <visual><geometry><cylinder radius=".1" length="2"/></geometry>
    <material name="blue"/></visual></link>
<link name="tool">{INERTIAL}
  <collision><geometry><sphere radius=".3"/></geometry></collision></link>
<joint name="one" type="continuous"><parent link="base"/><child link="upper"/></joint>
<joint name="two" type="continuous"><parent link="upper"/><child link="tool"/></joint>
</robot>"""


def drawn(text, **values):
    scene = sc.loads(text, **values)
    sim = sc.Sim(scene)
    return sim, drawing_of(sim.model, sim)


def test_a_file_of_which_something_is_left_out_keeps_its_colours():
    colour = '<mujoco><worldbody><body><joint name="j"/><geom size=".1" rgba="1 0 0 1"/></body>'
    text = f'{colour}</worldbody><sensor><jointpos joint="j"/></sensor></mujoco>'
    _, drawing = drawn(text, without=["sensor"])
    assert drawing.shapes[0].rgba == (1, 0, 0, 1)
    assert not drawing.notes


def test_a_urdf_gets_a_colour_for_each_body_and_its_visuals_are_not_read():
    sim, drawing = drawn(ARM)
    assert sim.model.ngeom == len(drawing.shapes) == 2
    colours = {shape.body: shape.rgba for shape in drawing.shapes if shape.shown}
    assert len(set(colours.values())) == len(colours) == 2
    assert GREY not in colours.values()
    assert any("<visual>" in line for line in sim.model.scene.ignored)


TEXTURED = """
<mujoco><compiler texturedir="images"/><asset>
<texture name="board" builtin="checker" type="2d" width="8" height="8" rgb1="1 1 1" rgb2="0 0 0"/>
<texture type="2d" file="wood.png"/>
<material name="floor" texture="board" rgba="1 0.5 1 1"/>
<material name="wood" rgba="1 1 0.5 1"><layer texture="wood" role="rgb"/></material>
</asset><worldbody>
<geom name="floor" type="plane" size="1 1 1" material="floor"/>
<body name="arm"><joint/><geom name="arm" size=".1" material="wood"/>
<geom name="own" size=".1" pos="1 0 0" material="wood" rgba="0.5 1 1 1"/></body>
</worldbody></mujoco>"""


@pytest.fixture
def images(tmp_path):
    from PIL import Image

    (tmp_path / "images").mkdir()
    wood = np.zeros((4, 4, 3), np.uint8)
    # The mean is half of red, a quarter of green.
    wood[:2, :, 0], wood[0, :, 1] = 255, 255
    Image.fromarray(wood).save(tmp_path / "images" / "wood.png")
    return tmp_path


def test_a_texture_gives_its_mean_colour(images):
    _, drawing = drawn(TEXTURED, base=images)
    colours = {shape.name: shape.rgba for shape in drawing.shapes}
    assert colours["floor"] == (0.5, 0.25, 0.5, 1)
    assert colours["arm"] == pytest.approx((0.5, 0.25, 0, 1), abs=0.005)
    # The colour of a geom stands for its material's, under the same texture.
    assert colours["own"] == pytest.approx((0.25, 0.25, 0, 1), abs=0.005)
    assert drawing.notes == []


def test_the_squares_of_a_plane_stay_calm(images):
    _, drawing = drawn(TEXTURED, base=images)
    floor = next(shape for shape in drawing.shapes if shape.name == "floor")
    one, other = (np.array(rgba) for rgba in floor.checks)
    assert (one + other) / 2 == pytest.approx(floor.rgba)
    assert np.abs(one - other).max() == pytest.approx(2 * 0.07)


def test_an_image_that_is_not_there_is_a_note(tmp_path):
    _, drawing = drawn(TEXTURED, base=tmp_path)
    assert len(drawing.notes) == 1 and "wood.png" in drawing.notes[0]


ODD = """<mujoco><asset>
<texture name="t" type="2d" builtin="checker" width="8" height="8" {texture}/>
<material name="odd" {material} texture="t"/><material name="red" rgba="1 0 0 1"/></asset>
<worldbody><body><joint/><geom name="red" size=".1" mass="1" material="red"/>
<geom name="odd" size=".1" pos="1 0 0" material="odd"/>
<geom name="seen" type="box" size=".1 .1 .1" contype="0" conaffinity="0" mass="0"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(
    "odd",
    [
        'material rgba="1 0"',
        'material rgba="1 0 0 1 1"',
        'texture rgb1="1 0"',
        'texture rgb2="x"',
    ],
)
def test_what_mujoco_refuses_costs_a_note_and_no_other_colour(odd):
    """The other material and the geoms that only draw stay."""
    import mujoco

    tag, attribute = odd.split(" ", 1)
    text = ODD.format(**dict.fromkeys(("material", "texture"), "") | {tag: attribute})
    with pytest.raises(ValueError):
        mujoco.MjModel.from_xml_string(text)
    _, drawing = drawn(text)
    (note,) = drawing.notes
    assert f"<{tag}>" in note and attribute.split("=")[0] in note
    shapes = {shape.name: shape for shape in drawing.shapes}
    assert set(shapes) == {"red", "odd", "seen"} and shapes["red"].rgba == (1, 0, 0, 1)


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def head(width, height):
    return b"\x89PNG\r\n\x1a\n" + chunk(
        b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    )


ONE_IMAGE = """<mujoco><asset><texture name="t" type="2d" file="t.png"/>
<material name="m" texture="t"/></asset><worldbody>
<geom size=".3" material="m"/><body><joint/><geom size=".1"/></body></worldbody></mujoco>"""
END = chunk(b"IDAT", zlib.compress(b"", 9)) + chunk(b"IEND", b"")
IMAGES = [head(n, n) + END for n in (30_000, 12_000, 2**31 - 1)] + [
    b"",
    b"\x89PNG\r\n\x1a\n",
    b"GIF89a",
]


@pytest.mark.parametrize("image", IMAGES, ids=range(len(IMAGES)))
def test_an_image_that_is_none_or_too_large_is_drawn_grey_with_a_note(tmp_path, image):
    (tmp_path / "t.png").write_bytes(image)
    sim, drawing = drawn(ONE_IMAGE, base=tmp_path)
    assert drawing.shapes[0].rgba == (0.8, 0.8, 0.8, 1.0)
    assert any("t.png" in note and "not a whole image" in note for note in drawing.notes)
    sim.run(0.01).save_html(tmp_path / "run.html")


def test_a_texture_that_is_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "t.png")
    _, drawing = drawn(ONE_IMAGE, base=tmp_path)
    assert any("is not a regular file" in note for note in drawing.notes)
