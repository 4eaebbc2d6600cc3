"""Reading takes work that grows with the file: counted, not timed.

Where one call does all the work (a regular expression, a sum over an array), the file is so large
that any growth with the square would take hours.
"""

import sys
import zlib

import numpy as np
import pytest
from png_writer import SIGNATURE, chunk, grey

import stepcore as sc
from stepcore.mjcf import nodes
from stepcore.mjcf.nodes import repaired
from stepcore.scene import asset_files


def calls(function, *arguments):
    """How many Python functions a call enters, and how often generators go on."""
    count = 0

    def event(frame, kind, argument):
        nonlocal count
        count += kind == "call"

    sys.setprofile(event)
    try:
        function(*arguments)
    finally:
        sys.setprofile(None)
    return count


def world(bodies, rest=""):
    return f"<mujoco><worldbody>{bodies}</worldbody>{rest}</mujoco>"


def times(count, text):
    return "".join(text.replace("#", str(i)) for i in range(count))


BODIES = '<body name="b#"><joint name="j#"/><geom name="g#" size=".1"/><site name="s#"/></body>'
MESH = '<mesh name="m#" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/>'
HFIELD = '<hfield name="m#" nrow="2" ncol="2" size="1 1 1 1"/>'


def section(tag, text):
    return lambda n: world(times(n, BODIES), f"<{tag}>{times(n, text)}</{tag}>")


def assets(text, geom):
    return lambda n: world(times(n, geom), f"<asset>{times(n, text)}</asset>")


def chain(kind):
    def robot(n):
        shape = "<collision><geometry><box size='1 1 1'/></geometry></collision>"
        mass = "<inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1'/></inertial>"
        links = times(n + 1, f'<link name="l#">{shape}{mass}</link>')
        joints = "".join(
            f'<joint name="j{i}" type="{kind}"><parent link="l{i}"/>'
            f'<child link="l{i + 1}"/></joint>'
            for i in range(n)
        )
        return f'<robot name="r">{links}{joints}</robot>'

    return robot


TEXTS = {
    "bodies": lambda n: world(times(n, BODIES)),
    "sensors": section("sensor", '<framepos objtype="geom" objname="g#"/><jointpos joint="j#"/>'),
    "actuators": section("actuator", '<motor joint="j#"/>'),
    "tendons": section("tendon", '<fixed><joint joint="j#" coef="1"/></fixed>'),
    "welds": section("equality", '<weld body1="b#"/><connect site1="s#" site2="fixed"/>'),
    "joint equalities": section("equality", '<joint joint1="j#"/>'),
    "excludes": section("contact", '<exclude body1="b#" body2="world"/>'),
    "keys": section("keyframe", '<key name="k#"/>'),
    "meshes": assets(MESH, '<geom type="mesh" mesh="m#"/>'),
    "height fields": assets(HFIELD, '<geom type="hfield" hfield="m#"/>'),
    "fixed links": chain("fixed"),
    "hinged links": chain("continuous"),
}


def read(text):
    scene = sc.loads(text)
    # What `compile` does in Python; the rest is the engine's.
    scene.to_dict()


@pytest.mark.parametrize("kind", TEXTS)
def test_twice_the_elements_take_twice_the_calls(kind):
    text = TEXTS[kind]
    if kind == "welds":
        text = lambda n: TEXTS[kind](n).replace("<worldbody>", '<worldbody><site name="fixed"/>')  # noqa: E731
    read(text(2))
    one, two = (calls(read, text(n)) for n in (200, 400))
    assert two < 2.1 * one


def test_a_chain_of_thousands_of_links_is_read_and_checked():
    scene = sc.loads(chain("fixed")(2000))
    assert len(scene.to_dict()["bodies"]) == 1 and len(scene.fused) == 2001
    scene = sc.loads(chain("fixed")(2000), fuse=False)
    assert len(scene.to_dict()["bodies"]) == 2002
    scene = sc.loads(chain("continuous")(2000))
    assert len(scene.to_dict()["joints"]) == 2000


def test_the_errors_of_a_file_are_looked_up_up_to_a_number(monkeypatch):
    text = world(
        times(2000, '<geom type="mesh" mesh="wrong#"/>'), f"<asset>{times(9, MESH)}</asset>"
    )
    with pytest.raises(sc.MJCFError) as caught:
        sc.loads(text)
    assert len(caught.value.errors) == nodes.MOST_ERRORS


def test_comments_without_an_end_are_looked_for_once():
    text = b"<!--" * 500_000
    assert repaired(text) == text
    assert repaired(b"<a><!-- one -- two --><!-----></a>") == b"<a><!-- one    two --><!-- --></a>"


def test_urdf_meshes_of_one_name_are_numbered_in_turn(tmp_path):
    def robot(n):
        mesh = '<collision><geometry><mesh filename="d#/m.stl"/></geometry></collision>'
        return f'<robot name="r"><link name="l">{times(n, mesh)}</link></robot>'

    def refused(text):
        with pytest.raises(FileNotFoundError):
            sc.loads(text, base=tmp_path)

    refused(robot(2))
    one, two = (calls(refused, robot(n)) for n in (200, 400))
    assert two < 2.1 * one


def test_a_text_of_a_mesh_that_ends_with_blanks():
    blanks = b" " * 1_000_000
    facet = b"facet normal 0 0 0 outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 endloop endfacet"
    for end in (b"\nx", b"\n\nx", b" \n  \nfacet"):
        with pytest.raises(ValueError, match="neither a facet nor the end"):
            asset_files.stl(b"solid facet\nendsolid" + blanks + end)
    for end in (b"", b" of a name", b"\n\n", blanks + b"\n" + blanks):
        surface = asset_files.stl(b"solid\n" + facet + b"\n endsolid" + end)
        assert len(surface.vertices) == 3


def ring(n):
    """A cone: n corners around a face, and a tip."""
    angles = 2 * np.pi * np.arange(n) / n
    lines = [f"v {x} {y} 0" for x, y in zip(np.cos(angles), np.sin(angles), strict=True)]
    lines += ["v 0 0 1", "f " + " ".join(map(str, range(1, n + 1)))]
    return "\n".join(lines).encode()


def test_a_face_of_many_corners_is_split_with_some_calls_for_each():
    one, two = (calls(asset_files.obj, ring(n)) for n in (200, 400))
    assert two < 2.1 * one
    faces = asset_files.obj(ring(5000)).faces
    assert len(faces) == 4998
    # All triangles go the same way round and fill the ring.
    x, y = np.cos(2 * np.pi * np.arange(5000) / 5000), np.sin(2 * np.pi * np.arange(5000) / 5000)
    a, b, c = faces.T
    areas = ((x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a])) / 2
    assert areas.min() > 0
    assert areas.sum() == pytest.approx(2500 * np.sin(2 * np.pi / 5000), rel=1e-12)


def test_a_face_that_is_not_convex_is_refused():
    arrow = ["v 0 0 0", "v 2 -1 0", "v 1 0 0", "v 2 1 0", "v 0 .5 0", "v 0 0 1", "f 1 2 3 4 5"]
    star = [f"v {np.cos(k * 4 * np.pi / 5)} {np.sin(k * 4 * np.pi / 5)} 0" for k in range(5)]
    for lines in (arrow, [*star, "f 1 2 3 4 5"]):
        with pytest.raises(ValueError, match=r"a\.obj: not a whole OBJ file: .* with triangles"):
            read_obj("\n".join(lines).encode())
    # Any number of convex ones is read.
    hexagon = b"\n".join(b"v %d %d 0" % place for place in HEXAGON)
    surface = asset_files.obj(hexagon + b"\nf 1 2 3 4 5 6" * 2000)
    assert len(surface.faces) == 8000


HEXAGON = ((2, 0), (1, 2), (-1, 2), (-2, 0), (-1, -2), (1, -2))


def read_obj(data):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.obj"
        path.write_bytes(data)
        return asset_files.read_mesh(path)


def test_an_image_that_claims_too_much_is_not_unpacked():
    head = chunk(b"IHDR", (30000).to_bytes(4, "big") * 2 + bytes([8, 0, 0, 0, 0]))
    data = SIGNATURE + head + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    with pytest.raises(ValueError, match=r"it is damaged: Image size .* exceeds limit"):
        asset_files.image_levels(data)


def test_heights_of_an_image_name_pillow_where_it_is_missing(monkeypatch, tmp_path):
    (tmp_path / "h.png").write_bytes(grey(np.arange(12).reshape(3, 4)))
    monkeypatch.setitem(sys.modules, "PIL", None)
    text = """<mujoco>
    <asset><hfield name="h" file="h.png" size="1 1 1 1"/></asset>
    <worldbody><geom type="hfield" hfield="h"/></worldbody></mujoco>"""
    wanted = r"^<string>:2: .*pillow: pip install '\.\[view\]'"
    with pytest.raises(sc.MJCFError, match=wanted):
        sc.loads(text, base=tmp_path)


@pytest.mark.parametrize("kind", ["mesh", "hfield"])
def test_a_file_that_several_assets_name_is_read_once(kind, tmp_path, monkeypatch):
    (tmp_path / "h.png").write_bytes(grey(np.arange(12).reshape(3, 4)))
    (tmp_path / "m.obj").write_bytes(ring(6))
    (tmp_path / "n.obj").write_bytes(ring(6))
    own = {
        "mesh": ('file="{}.obj" inertia="shell"', "mn"),
        "hfield": ('file="{}.png" size="1 1 1 1"', "h"),
    }
    attributes, names = own[kind]
    assets = "".join(
        f'<{kind} name="{name}{i}" {attributes.format(name)}/>' for name in names for i in range(5)
    )
    geoms = "".join(f'<geom type="{kind}" {kind}="{name}{i}"/>' for name in names for i in range(5))
    reader, read = f"read_{kind}", []
    first = getattr(asset_files, reader)
    monkeypatch.setattr(asset_files, reader, lambda *path: read.append(path[0]) or first(*path))
    text = f"<mujoco><asset>{assets}</asset><worldbody>{geoms}</worldbody></mujoco>"
    scene = sc.loads(text, base=tmp_path)
    assert len(read) == len(names)
    held = scene.meshes if kind == "mesh" else scene.hfields
    field = "vertices" if kind == "mesh" else "elevation"
    assert len(held) == 5 * len(names)
    arrays = {id(getattr(asset, field)) for asset in held}
    assert len(arrays) == len(names)
    assert {asset.file for asset in held} == set(read)
    assert scene.compile().ngeom == len(held)
