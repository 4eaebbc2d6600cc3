"""Files of meshes: the same mesh in every format; damage is refused."""

import collections
import os
import pickle
import re
import struct

import mujoco
import numpy as np
import pytest
from png_writer import grey

import stepcore as sc
from stepcore.scene import asset_files

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3.5)])
FACES = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])


def binary_stl(vertices=CORNERS, faces=FACES) -> bytes:
    data = b"solid looks like a text".ljust(80) + struct.pack("<I", len(faces))
    for face in faces:
        data += struct.pack("<12fH", 0, 0, 0, *vertices[face].ravel(), 0)
    return data


def text_stl() -> bytes:
    lines = ["solid of four faces"]
    for face in FACES:
        lines += ["facet normal 0 0 0", " outer loop"]
        lines += ["  vertex " + " ".join(map(repr, map(float, CORNERS[i]))) for i in face]
        lines += [" endloop", "endfacet"]
    return "\n".join([*lines, "endsolid of four faces", ""]).encode()


def obj() -> bytes:
    lines = ["# a comment", "mtllib nothing.mtl", "o thing"]
    lines += ["v " + " ".join(map(str, corner)) for corner in CORNERS]
    lines += ["vn 0 0 1", "vt 0 0", "s off", "f 1/1/1 3/1/1 2/1/1", "f -4//1 -3//1 -1//1"]
    return "\n".join([*lines, "f 2 3 4", "f 1 4 \\", " 3", ""]).encode()


def msh() -> bytes:
    head = struct.pack("<4i", 4, 4, 4, 4)
    places = CORNERS.astype("<f4").tobytes()
    return head + places + places + bytes(32) + FACES.astype("<i4").tobytes()


def dae(up="Z_UP") -> bytes:
    """Two geometries in half metres, one of them moved, with lines beside it."""
    shapes, nodes = "", ""
    parts = ((FACES[:2], "triangles", "", 0.0), (FACES[2:], "polylist", "<vcount>3 3</vcount>", 1))
    for faces, tag, counts, shift in parts:
        places = " ".join(str(2 * x) for x in (CORNERS - [shift, 0, 0]).ravel())
        index = " ".join(map(str, faces.ravel()))
        way = f'<input semantic="VERTEX" source="#{tag}v" offset="0"/>'
        shapes += f"""<geometry id="{tag}"><mesh><source id="{tag}p"><float_array id="{tag}f"
count="12">{places}</float_array><technique_common><accessor source="#{tag}f" count="4" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source><vertices id="{tag}v"><input semantic="POSITION"
source="#{tag}p"/></vertices><{tag} count="2">{way}{counts}<p>{index}</p></{tag}>
<lines count="1">{way}<p>0 1</p></lines></mesh></geometry>"""
        nodes += f"""<node id="{tag}n"><translate>{2 * shift} 0 0</translate>
<instance_geometry url="#{tag}"/></node>"""
    return f"""<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema"
version="1.4.1"><asset><unit name="half" meter="0.5"/><up_axis>{up}</up_axis></asset>
<library_geometries>{shapes}</library_geometries><library_visual_scenes><visual_scene id="s">{nodes}
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>
""".encode()


FORMATS = {"a.stl": binary_stl, "b.STL": text_stl, "c.obj": obj, "d.msh": msh, "e.dae": dae}


def same_surface(vertices, faces) -> None:
    """The triangles of the formats, whatever the numbers of their vertices."""

    def triangles(points, corners):
        rolled = []
        for face in corners:
            first = min(range(3), key=lambda k: tuple(points[face[k]]))
            rolled.append(tuple(tuple(points[face[(first + k) % 3]]) for k in range(3)))
        return sorted(rolled)

    assert triangles(vertices, faces) == triangles(CORNERS, FACES)


@pytest.mark.parametrize("name", FORMATS)
def test_each_format_holds_the_mesh(name, tmp_path):
    (tmp_path / name).write_bytes(FORMATS[name]())
    vertices, faces = asset_files.read_mesh(tmp_path / name)[:2]
    assert len(vertices) == 4
    same_surface(vertices, faces)
    scene = sc.Scene()
    mesh = scene.add_mesh(file=tmp_path / name)
    assert mesh.name == name[0]
    same_surface(mesh.vertices, mesh.faces)
    assert not mesh.vertices.flags.writeable


def test_the_axis_that_collada_calls_up_is_passed_over_and_its_package_is_named(
    tmp_path, monkeypatch
):
    (tmp_path / "a.dae").write_bytes(dae("Y_UP"))
    surface = asset_files.read_mesh(tmp_path / "a.dae")
    same_surface(surface.vertices, surface.faces)
    assert asset_files.notes("a.dae", surface) == [
        "a.dae: calls another axis than z up, which is passed over, as in ROS"
    ]
    monkeypatch.setattr(asset_files.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"need pycollada: pip install '\.\[dae\]'"):
        asset_files.read_mesh(tmp_path / "a.dae")


def test_faces_of_four_corners_and_none_at_all(tmp_path):
    path = tmp_path / "a.obj"
    path.write_bytes(b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    # Along the shorter diagonal, the second one where both are as long.
    assert asset_files.read_mesh(path)[1].tolist() == [[0, 1, 3], [1, 2, 3]]
    path.write_bytes(b"v 0 0 0\nv 1 0 0\nv 1 .9 0\nv -.1 1 0\nf 1 2 3 4\n")
    assert asset_files.read_mesh(path)[1].tolist() == [[0, 1, 2], [0, 2, 3]]
    path.write_bytes(b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1\n")
    assert asset_files.read_mesh(path)[1] is None
    (tmp_path / "b.msh").write_bytes(struct.pack("<4i", 4, 0, 0, 0) + bytes(48))
    assert asset_files.read_mesh(tmp_path / "b.msh")[1] is None


CUBE = (
    *((1, 3, 2), (1, 4, 3), (5, 6, 7), (5, 7, 8), (1, 2, 6), (1, 6, 5)),
    *((2, 3, 7), (2, 7, 6), (3, 4, 8), (3, 8, 7), (4, 1, 5), (4, 5, 8)),
)


def cubes(*heads: str) -> str:
    """Three cubes along x; before the faces of each stands a line."""
    text = ""
    for x in (0, 3, 7):
        corners = ((0, 0), (1, 0), (1, 1), (0, 1))
        text += "".join(f"v {x + a} {b} {z}\n" for z in (0, 1) for a, b in corners)
    for k, line in enumerate(heads):
        text += line + "".join(f"f {a + 8 * k} {b + 8 * k} {c + 8 * k}\n" for a, b, c in CUBE)
    return text


@pytest.mark.parametrize(
    "heads",
    [
        ("", "", ""),
        ("o a\n", "o b\n", "o c\n"),
        ("", "g b\n", ""),
        ("o a\n", "", "g c\n"),
        ("o nothing\no a\n", "usemtl m\n", "s 1\n"),
        ("g a\n", "g a\n", ""),
        ("g\n", "o\n", "# o b\n"),
    ],
)
def test_the_first_object_is_the_mesh_as_in_mujoco(heads, tmp_path):
    """Mass, centre and hull of a file of several objects, and the note that says so."""
    path = tmp_path / "cubes.obj"
    path.write_text(cubes(*heads))
    text = f"""<mujoco><asset><mesh name="m" file="{path}"/></asset><worldbody><body><freejoint/>
      <geom type="mesh" mesh="m" density="1"/></body></worldbody></mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(text)
    scene = sc.loads(text)
    model = scene.compile()
    count = theirs.mesh_facenum[0]
    assert len(asset_files.read_mesh(path).faces) == count
    assert model.body_mass[1] == pytest.approx(theirs.body_mass[1], rel=1e-6)
    assert model.body_ipos[1] == pytest.approx(theirs.body_ipos[1], abs=1e-6)
    assert len(model.geom_hull(0)[0]) == 8
    assert any(f"{36 - count} faces of others" in note for note in scene.notes) == (count < 36)


@pytest.mark.parametrize("seed", range(40))
def test_larger_faces_weigh_what_mujocos_do(seed, tmp_path):
    """A flat, convex face has one area, however it is split; one of four corners has MuJoCo's."""
    chance = np.random.default_rng(seed)
    count = int(chance.integers(4, 12))
    angles = np.sort(chance.uniform(0, 2 * np.pi, count))
    bent = 0.05 * (seed % 2) * chance.normal(size=count) if count == 4 else np.zeros(count)
    ring = np.stack([np.cos(angles), np.sin(angles), bent], axis=1)
    turned = ring[:: 1 if seed % 3 else -1] @ np.linalg.qr(chance.normal(size=(3, 3)))[0].T
    tetrahedron = [[0, 0, 3], [0, 0, -3], [2, 2, 2], [-2, 2, 1]]
    places = np.concatenate([turned + 0.1 * chance.normal(size=3), tetrahedron])
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*place) for place in places]
    lines.append("f " + " ".join(str(corner + 1) for corner in range(count)))
    closed = ((1, 2, 3), (1, 3, 4), (2, 4, 3), (1, 4, 2))
    lines += ["f " + " ".join(str(count + corner) for corner in face) for face in closed]
    path = tmp_path / f"{seed}.obj"
    path.write_text("\n".join(lines) + "\n")
    mesh = f'<asset><mesh name="m" file="{path}" inertia="shell"/></asset>'
    body = '<body><freejoint/><geom type="mesh" mesh="m"/></body>'
    text = f"<mujoco>{mesh}<worldbody>{body}</worldbody></mujoco>"
    theirs = mujoco.MjModel.from_xml_string(text)
    ours = sc.loads(text).compile()
    assert ours.body_mass[1] == pytest.approx(theirs.body_mass[1], rel=1e-5)
    assert ours.body_ipos[1] == pytest.approx(theirs.body_ipos[1], abs=1e-5)
    if count == 4:
        assert asset_files.read_mesh(path)[1].tolist() == theirs.mesh_face.tolist()


def head(count: int) -> bytes:
    return bytes(80) + struct.pack("<I", count)


DAMAGED = {
    "empty.stl": (b"", "has 0 bytes"),
    "gigantic.stl": (head(2**32 - 1), "take 214748364834 bytes"),
    "cut.stl": (binary_stl()[:-1], "it has 283"),
    "nan.stl": (binary_stl(CORNERS * [1, np.nan, 1]), "not a finite number"),
    "none.stl": (head(0), "no faces"),
    "text.stl": (text_stl().replace(b"endloop", b"end loop", 1), "neither a facet"),
    "words.stl": (text_stl().replace(b"3.5", b"x.5", 1), "not a number"),
    "a.obj": (obj().replace(b"v 1", b"v one"), "not a number"),
    "b.obj": (obj().replace(b"f 2 3 4", b"f 2 3 5"), "vertex 4, of 4"),
    "c.obj": (obj().replace(b"f 2 3 4", b"f 2 3 0"), "indices start at 1"),
    "e.obj": (obj().replace(b"f 2 3 4", b"f 2 -9 4"), "vertex -"),
    "f.obj": (b"v 1 2\n", "fewer than 3"),
    "a.msh": (msh()[:-4], "it has"),
    "b.msh": (struct.pack("<4i", 2**31 - 1, 0, 0, 2**31 - 1), "asks for"),
    "c.msh": (struct.pack("<4i", -4, 0, 0, 0), "its head says"),
    "d.msh": (msh()[:-4] + struct.pack("<i", 99), "vertex 99, of 4"),
    "a.ply": (b"<x/>", "ends with .stl"),
    "a.dae": (b"<x/>", "not a whole DAE file"),
    "b.dae": (dae()[:-40], "not a whole DAE file"),
    "c.dae": (dae().replace(b'url="#s"', b'url="#t"'), "no faces"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_what_is_damaged_is_refused(name, tmp_path):
    data, why = DAMAGED[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ValueError, match=why):
        asset_files.read_mesh(tmp_path / name)


def test_devices_pipes_folders_and_what_is_not_there(tmp_path):
    with pytest.raises(FileNotFoundError):
        asset_files.read_mesh(tmp_path / "a.stl")
    (tmp_path / "b.stl").mkdir()
    with pytest.raises(IsADirectoryError):
        asset_files.read_mesh(tmp_path / "b.stl")
    os.mkfifo(tmp_path / "c.stl")
    (tmp_path / "d.stl").symlink_to("/dev/zero")
    for name in ("c.stl", "d.stl"):
        with pytest.raises(ValueError, match="not a regular file"):
            asset_files.read_mesh(tmp_path / name)


@pytest.mark.parametrize("name", FORMATS)
def test_bytes_changed_at_random_are_read_or_refused(name, tmp_path):
    """Never another exception; what is read is finite, with faces between its vertices."""
    rng = np.random.default_rng(1)
    whole = FORMATS[name]()
    outcomes = collections.Counter()
    for _ in range(400):
        data = bytearray(whole)
        for _ in range(rng.integers(1, 6)):
            data[rng.integers(len(data))] = rng.integers(256)
        if rng.random() < 0.5:  # a file that still reads: another digit, or another last byte
            digits = [k for k in range(len(whole)) if whole[k] in b"0123456789"]
            data = bytearray(whole)
            data[digits[rng.integers(len(digits))] if digits else -1] = 48 + rng.integers(10)
        elif rng.random() < 0.3:
            del data[rng.integers(len(data)) :]
        (tmp_path / name).write_bytes(data)
        try:
            vertices, faces = asset_files.read_mesh(tmp_path / name)[:2]
        except ValueError as error:
            assert "\n" not in str(error)
            outcomes["refused"] += 1
            continue
        assert np.isfinite(vertices).all()
        assert faces is None or (faces.min() >= 0 and faces.max() < len(vertices))
        scene = sc.Scene()
        try:
            mesh = scene.add_mesh("m", vertices, faces)
            body = scene.add_body("b")
            scene.add_joint(body, "free")
            scene.add_geom(body, "mesh", mesh=mesh)
            model = scene.compile()
        except ValueError:
            outcomes["no solid"] += 1
            continue
        assert np.isfinite(model.body_mass).all() and (model.body_mass[1:] > 0).all()
        outcomes["compiled"] += 1
    assert outcomes["refused"] > 10 and outcomes["compiled"] > 10, outcomes


ROBOT = """<mujoco><compiler {compiler}/>
<default><mesh scale=".1 .1 .1"/>
<default class="big"><mesh scale="2 2 2" inertia="shell"/></default></default>
<asset>
  <mesh name="seen" file="not_there.stl"/>
  <mesh file="{file}"/>
  <mesh name="twice" class="big" vertex="0 0 0 1 0 0 0 1 0 0 0 1" maxhullvert="4"/>
  <hfield name="ground" nrow="2" ncol="3" size="1 1 .1 .1" elevation="0 1 2 3 4 5"/>
  <hfield name="far" file="not_there.png" size="1 1 1 1"/>
</asset>
<worldbody>
  <geom type="mesh" mesh="seen"/>
  <body><freejoint/>
    <geom name="hull" type="mesh" mesh="a"/>
    <geom type="mesh" mesh="seen" contype="0" conaffinity="0" mass="0"/>
    <geom name="fit" type="box" mesh="twice" fitscale=".5"/>
    <geom type="box" mesh="seen" contype="0" conaffinity="0" density="0"/>
  </body>
  <geom type="hfield" hfield="far" contype="0" conaffinity="0"/>
</worldbody></mujoco>"""


def robot(folder, compiler="", file="a.stl") -> sc.Scene:
    (folder / "m.xml").write_text(
        ROBOT.format(compiler=compiler, file=file).replace(
            '<geom type="mesh" mesh="seen"/>',
            '<geom type="mesh" mesh="seen" contype="0" conaffinity="0"/>',
        )
    )
    return sc.load(folder / "m.xml")


def test_only_what_moves_the_model_is_read(tmp_path):
    """Files of meshes that only draw need not even exist."""
    (tmp_path / "a.stl").write_bytes(binary_stl())
    scene = robot(tmp_path)
    assert [mesh.name for mesh in scene.meshes] == ["a", "twice"]
    assert [geom.name for geom in scene.geoms] == ["hull", "fit"]
    assert scene.meshes[0].scale == (0.1, 0.1, 0.1)
    assert (scene.meshes[1].scale, scene.meshes[1].inertia) == ((2, 2, 2), "shell")
    assert not any("files" in note for note in scene.notes), "what only draws is no news"
    listed = "\n".join(scene.ignored)
    for what in ('<mesh> "seen"', '<hfield> "far"', '<hfield> "ground"', "m.xml:12", "m.xml:19"):
        assert what in listed
    model = scene.compile()
    # The hull of a tetrahedron of volume 7/6, a tenth as large; and half a box.
    assert model.geom_type == ("mesh", "box")
    assert len(model.geom_hull("hull")[0]) == 4


def test_where_files_are_sought(tmp_path):
    for folder in ("meshes", "parts", "elsewhere"):
        (tmp_path / folder).mkdir()
    (tmp_path / "meshes" / "a.stl").write_bytes(binary_stl())
    (tmp_path / "meshes" / "parts").mkdir()
    (tmp_path / "meshes" / "parts" / "a.stl").write_bytes(binary_stl())
    assert robot(tmp_path, 'meshdir="meshes"').meshes[0].file.endswith("meshes/a.stl")
    assert robot(tmp_path, 'assetdir="meshes"', "parts/a.stl").meshes
    assert robot(tmp_path, 'meshdir="meshes" assetdir="x" strippath="true"', "nowhere/a.stl").meshes
    home = tmp_path / "elsewhere"
    for name in ("../meshes/a.stl", str(tmp_path / "meshes" / "a.stl")):
        scene = robot(home, file=name)
        assert any("outside the folder of the main file" in note for note in scene.notes)
    with pytest.raises(FileNotFoundError, match=r"m\.xml:6: .*no such file"):
        robot(tmp_path, 'meshdir="parts"')
    text = (home / "m.xml").read_text()
    assert sc.loads(text, base=home).meshes
    with pytest.raises(sc.MJCFError, match="needs loads"):
        sc.loads(ROBOT.format(compiler="", file="a.stl"))


def test_a_mesh_that_gives_mass_is_read_though_it_only_draws(tmp_path):
    text = """<mujoco><asset><mesh name="m" file="a.stl"/></asset><worldbody><body><freejoint/>
    <geom type="mesh" mesh="m" contype="0" conaffinity="0"/><geom size=".1" mass="0"/>
    </body></worldbody></mujoco>"""
    (tmp_path / "m.xml").write_text(text)
    with pytest.raises(FileNotFoundError):
        sc.load(tmp_path / "m.xml")
    (tmp_path / "a.stl").write_bytes(binary_stl())
    model = sc.load(tmp_path / "m.xml").compile()
    assert model.body_mass[1] == pytest.approx(1000 * 7 / 6, rel=1e-12)
    assert len(model.geom_hull(0)[0]) == 0


def test_round_trip_copies_and_pickles(tmp_path):
    (tmp_path / "a.stl").write_bytes(binary_stl())
    scene = robot(tmp_path)
    scene.add_geom(
        "world", "hfield", hfield=scene.add_hfield("g", [[0, 1], [2, 3]], size=(1, 1, 1, 1))
    )
    again = sc.loads(scene.to_mjcf())
    assert again == scene
    assert pickle.loads(pickle.dumps(scene)) == scene
    other = scene.with_settings(dt=0.001)
    assert other.meshes[0] is not scene.meshes[0]
    assert other.meshes[0].vertices is scene.meshes[0].vertices
    other.meshes[0].scale = (0.1, 0.1, 0.2)
    assert other != scene
    loose = sc.loads(scene.to_mjcf().replace('"a"', '"z"'))
    assert loose.meshes[0].name == "z"


def test_meshes_by_hand_are_checked():
    scene = sc.Scene()
    body = scene.add_body("b")
    scene.add_joint(body, "free")
    with pytest.raises(ValueError, match="either vertices or a file"):
        scene.add_mesh("m")
    with pytest.raises(ValueError, match=r"shape \(n, 3\)"):
        scene.add_mesh("m", [[1, 2], [3, 4]])
    with pytest.raises(ValueError, match="whole numbers"):
        scene.add_mesh("m", CORNERS, FACES - 1)
    with pytest.raises(ValueError, match="larger than 3"):
        scene.add_mesh("m", CORNERS, maxhullvert=2)
    with pytest.raises(ValueError, match='no mesh is named "x"'):
        scene.add_geom(body, "mesh", mesh="x")
    scene.add_mesh("few", CORNERS[:3])
    with pytest.raises(ValueError, match="the name is used twice"):
        scene.add_mesh("few", CORNERS)
    geom = scene.add_geom(body, "mesh", mesh="few")
    with pytest.raises(ValueError, match="mesh 'few' vertices = 3: must be at least 4"):
        scene.compile()
    geom.mesh = None
    with pytest.raises(ValueError, match="needs a mesh"):
        scene.compile()
    geom.mesh = sc.Mesh(vertices=CORNERS)
    with pytest.raises(ValueError, match="not in this scene"):
        scene.compile()
    scene.meshes[:] = [sc.Mesh(name="flat", vertices=CORNERS * [1, 1, 0])]
    geom.mesh = scene.meshes[0]
    with pytest.raises(ValueError, match=r"mesh 'flat'.*one plane"):
        scene.compile()
    geom.mesh = scene.meshes[0] = sc.Mesh(vertices=CORNERS, faces=FACES[:, ::-1], inertia="exact")
    with pytest.raises(ValueError, match="counter-clockwise"):
        scene.compile()
    twice = np.concatenate([FACES, FACES[:1]])
    geom.mesh = scene.meshes[0] = sc.Mesh(vertices=CORNERS, faces=twice, inertia="exact")
    with pytest.raises(ValueError, match="two faces run from vertex"):
        scene.compile()
    geom.mesh = scene.meshes[0] = sc.Mesh(vertices=CORNERS, faces=FACES + 1)
    with pytest.raises(ValueError, match="faces = 4: must be the index of a vertex"):
        scene.compile()


MISTAKES = {
    '<mesh name="m"/>': "needs one of file, vertex and builtin",
    '<mesh name="m" vertex="0 0 0 1"/>': "3 numbers for each vertex",
    '<mesh name="m" vertex="0 0 0 1 0 0 0 1 0"/>': "at least 4",
    '<mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1" face="0 1"/>': "3 indices",
    '<mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1" face="0 1 9"/>': "vertex 9, of 4",
    '<mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1" face="0 1 -1"/>': "indices",
    '<mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1" maxhullvert="3"/>': "larger than 3",
    '<mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1" inertia="solid"/>': "one of convex",
    '<mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 nan 1"/>': "finite numbers",
    '<mesh name="m" builtin="blob"/>': "must be one of plate, square",
    '<mesh name="m" builtin="cone" params="2 0"/>': "nvert must be at least 3",
    '<mesh name="m" builtin="cone" params="3 0 0"/>': "requires 2 parameters",
    '<mesh name="m" builtin="plate" params="3 4"/>': "coplanar vertices",
    '<mesh name="m" builtin="supertorus" params="5000 .5 1 1"/>': "at most 128",
    '<mesh name="m" builtin="wedge" params="9 5000 9 9 .5"/>': "= (9.0, 5000.0, 9.0, 9.0, 0.5)",
    '<mesh name="m" builtin="cone" params="2001 1"/>': "at most 2000",
    '<mesh name="m" builtin="grid" params="41 2 2 1 1 1"/>': "at most 40",
    '<mesh name="m" file="" />': "the name of a file",
    '<mesh name="m" file="a.stl" vertex="0 0 0"/>': "file and vertex",
    '<mesh name="m" file="a.stl"/><mesh name="m" file="b.stl"/>': "used twice",
    '<mesh vertex="0 0 0"/>': "needs a name or a file",
    '<mesh name="m2" file="a.stl"/>': 'mesh="m": no such mesh; nearest: "m2"',
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_the_text_has_its_line(mistake):
    text = f"""<mujoco><worldbody><body><freejoint/><geom type="mesh" mesh="m"/>
    </body></worldbody><asset>
    {mistake}</asset></mujoco>"""
    with pytest.raises(sc.MJCFError) as caught:
        sc.loads(text, name="m.xml", base=".")
    assert MISTAKES[mistake] in str(caught.value)
    assert str(caught.value).startswith(("m.xml:3:", "m.xml:1:"))


@pytest.mark.parametrize("file", [False, True])
def test_a_height_field_of_one_row_is_refused_with_its_line(tmp_path, file):
    given = 'nrow="1" ncol="4" elevation="0 0 0 0"'
    if file:
        given = 'file="h.bin"'
        (tmp_path / "h.bin").write_bytes(struct.pack("<ii4f", 1, 4, 0, 0, 0, 0))
    text = f"""<mujoco><asset>
    <hfield name="h" {given} size="1 1 1 1"/></asset>
    <worldbody><geom type="hfield" hfield="h"/></worldbody></mujoco>"""
    with pytest.raises(sc.MJCFError, match=r"^m.xml:2: .*nrow, ncol = \(1, 4\): must be at"):
        sc.loads(text, name="m.xml", base=tmp_path)


ODD = (
    *("", "nan", "inf", "-1", "0", "1e308", "1e-320", "1e400", "a", "0 0 0", "1 2 3 4 5 6 7 8"),
    *(
        "true",
        "-0",
        "9" * 400,
        "../../../../dev/zero",
        "/dev/stdin",
        "a.stl",
        "1 1",
        "\u00b2",
        "mesh",
    ),
)


def test_attributes_changed_at_random_are_read_or_refused(tmp_path):
    """One line with its place, or a model whose masses are numbers."""
    (tmp_path / "a.stl").write_bytes(binary_stl())
    (tmp_path / "not_there.stl").write_bytes(text_stl())
    (tmp_path / "not_there.png").write_bytes(grey(np.arange(12).reshape(3, 4)))
    text = ROBOT.format(compiler='fitaabb="false"', file="a.stl")
    places = [match.span(1) for match in re.finditer(r'="([^"]*)"', text)]
    rng = np.random.default_rng(2)
    read = 0
    for _ in range(600):
        start, stop = places[rng.integers(len(places))]
        changed = text[:start] + ODD[rng.integers(len(ODD))] + text[stop:]
        try:
            model = sc.loads(changed, base=tmp_path, name="m.xml").compile()
        except FileNotFoundError as error:
            assert str(error).startswith("m.xml:")
        except ValueError as error:
            assert "\n" not in str(error)
        else:
            read += 1
            assert np.isfinite(model.body_mass).all()
    assert read > 50


def test_a_value_of_a_mesh_by_its_path():
    """Twice as long in every direction is eight times the mass."""
    scene = sc.Scene()
    body = scene.add_body("b")
    scene.add_joint(body, "free")
    scene.add_geom(body, "mesh", mesh=scene.add_mesh("m", CORNERS, FACES))
    one, two = scene.compile(), scene.compile().with_values({"mesh/m/scale": (2, 2, 2)})
    assert two.body_mass[1] == 8 * one.body_mass[1]
    with pytest.raises(ValueError, match="no value"):
        one.with_values({"mesh/m/file": "a"})
