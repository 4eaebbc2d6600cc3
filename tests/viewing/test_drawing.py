"""What is drawn: shapes where the engine has them, colours and visual geoms of the file."""

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.viewing.drawing import GROUND, corners, drawing_of, quat_of
from stepcore.viewing.surfaces import of_hfield

MODEL = """
<mujoco><asset>
<texture name="wood" builtin="checker" rgb1="1 0 0" rgb2="0 0 1" type="2d" width="8" height="8"/>
<material name="gold" rgba="1 0.8 0.1 1"/> <material name="wooden" texture="wood"/>
<mesh name="shell" vertex="0 0 0 1 0 0 0 1 0 0 0 1" face="0 2 1 0 1 3 0 3 2 1 2 3" {shell}/>
</asset><default><default class="gold"><geom material="gold"/></default></default>
<worldbody><geom type="plane" size="2 2 .1"/>
<body name="arm" pos="0 0 1" euler="0 90 0"><joint name="j"/>
  <geom name="own" size=".1" material="gold" rgba="0 1 0 1"/>
  <geom name="classed" class="gold" type="box" size=".1 .2 .3" pos=".5 0 0"/>
  <geom name="wooden" size=".1" material="wooden" group="3"/>
  <geom name="clear" size=".3" rgba="1 1 1 0" contype="0" conaffinity="0" mass="0"/>
  <geom name="seen" type="mesh" mesh="shell" rgba=".2 .3 .4 1" pos="0 1 0" contype="0"
    conaffinity="0" mass="0"/>
</body></worldbody></mujoco>"""


def drawn(text, **values):
    scene = sc.loads(text.replace("{shell}", ""), **values)
    sim = sc.Sim(scene)
    return scene, sim, drawing_of(sim.model, sim)


def test_colours_are_those_of_the_file():
    _, _, drawing = drawn(MODEL)
    colours = {shape.name: shape.rgba for shape in drawing.shapes}
    assert colours["own"] == (0, 1, 0, 1)
    assert colours["classed"] == (1, 0.8, 0.1, 1)
    assert colours["wooden"] == (0.5, 0, 0.5, 1)
    assert colours[""] == GROUND
    assert "clear" not in colours
    assert [shape.name for shape in drawing.shapes if not shape.shown] == ["wooden"]


def test_a_body_with_hidden_geoms_alone_shows_them():
    text = MODEL.replace(
        "</body></worldbody>",
        '<body><geom name="paw" size=".1" group="3"/></body></body></worldbody>',
    )
    _, _, drawing = drawn(text)
    assert {shape.name for shape in drawing.shapes if not shape.shown} == {"wooden"}


def test_what_only_draws_is_drawn_and_not_in_the_physics():
    scene, sim, drawing = drawn(MODEL)
    assert "seen" not in sim.model.geom_names
    shell = next(shape for shape in drawing.shapes if shape.name == "seen")
    assert shell.rgba == (0.2, 0.3, 0.4, 1) and drawing.bodies[shell.body] == "arm"
    assert shell.pos == (0, 1, 0) and len(shell.surface[1]) == 4
    assert scene.meshes == [] and any("only draws" in line for line in scene.ignored)


def test_a_scene_that_was_changed_keeps_its_shapes():
    scene = sc.loads(MODEL.replace("{shell}", ""))
    scene.add_body("new", pos=(0, 0, 3), mass=1.0, inertia=(1, 1, 1))
    sim = sc.Sim(scene)
    names = {shape.name for shape in drawing_of(sim.model, sim).shapes}
    assert {"own", "classed"} <= names and "seen" not in names


def test_a_missing_file_of_what_only_draws_is_a_note(tmp_path):
    text = MODEL.replace(
        'vertex="0 0 0 1 0 0 0 1 0 0 0 1" face="0 2 1 0 1 3 0 3 2 1 2 3" {shell}', 'file="no.stl"'
    )
    scene = sc.loads(text, base=tmp_path)
    sim = sc.Sim(scene)
    drawing = drawing_of(sim.model, sim)
    assert len(drawing.notes) == 1 and "no.stl" in drawing.notes[0]
    assert "seen" not in {shape.name for shape in drawing.shapes}


def test_shapes_stand_where_the_engine_has_their_geoms():
    """Corners of a box by the drawing, and by the geom's own pose."""
    _, sim, drawing = drawn(MODEL)
    sim.qpos[:] = 0.7
    box = next(shape for shape in drawing.shapes if shape.name == "classed")
    here = corners(box) @ sim.xmat[box.body].T + sim.xpos[box.body]
    index = sim.model.geom_names.index("classed")
    own = (here - sim.geom_xpos[index]) @ sim.geom_xmat[index]
    assert np.abs(own) == pytest.approx(np.tile([0.1, 0.2, 0.3], (8, 1)), abs=1e-12)


def test_fused_bodies_keep_what_they_show():
    text = MODEL.replace("<asset>", '<compiler fusestatic="true"/><asset>', 1)
    text = text.replace(
        "</body></worldbody>",
        '<body pos="0 0 2" name="cap"><geom name="cap" '
        'type="mesh" mesh="shell" contype="0" conaffinity="0" mass="0"/></body>'
        "</body></worldbody>",
    )
    _, _, drawing = drawn(text)
    assert drawing.bodies == ("world", "arm")
    cap = next(shape for shape in drawing.shapes if shape.name == "cap")
    assert cap.body == 1 and cap.pos == pytest.approx((0, 0, 2))


@pytest.mark.parametrize("kind", ["sphere", "capsule", "cylinder", "ellipsoid", "box"])
def test_triangles_of_primitives_close_their_volume(kind):
    """By the divergence theorem, which a triangle turned inside out would break."""
    scene = sc.Scene()
    body = scene.add_body()
    scene.add_joint(body, "free")
    scene.add_geom(body, kind, (0.3, 0.4, 0.5), density=1.0)
    sim = sc.Sim(scene)
    shape = drawing_of(sim.model, sim).shapes[0]
    vertices, faces = shape.triangles(1.0)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    assert volume == pytest.approx(float(sim.model.body_mass[1]), rel=0.03)


def test_a_height_field_is_drawn_where_it_is():
    """The first row is at the largest y; the highest point is size[2] high."""
    field = sc.HField(size=(1, 2, 0.5, 0.1), elevation=[[0, 0, 4], [0, 0, 0]])
    vertices, _ = of_hfield(field)
    top = vertices[np.argmax(vertices[:, 2])]
    assert top.tolist() == [1.0, 2.0, 0.5]


def test_quaternions_of_matrices():
    rng = np.random.default_rng(0)
    for _ in range(50):
        matrix = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        matrix *= np.sign(np.linalg.det(matrix))
        w, x, y, z = quat_of(matrix)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        again = np.eye(3) + 2 * w * cross + 2 * cross @ cross
        assert again == pytest.approx(matrix, abs=1e-12)


def test_the_weight_is_that_of_what_moves():
    sim = sc.Sim(lesson.stack())
    drawing = drawing_of(sim.model, sim)
    assert drawing.weight == pytest.approx(9.81 * sim.model.body_mass[1:].sum())
