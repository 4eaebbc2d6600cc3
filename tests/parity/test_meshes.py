"""Meshes and height fields against MuJoCo: mass, inertia, frames, hulls, fitted shapes, heights.

Law: the same file, the same compiled model, to 1e-9. MuJoCo rounds vertices to single precision and
turns a mesh until its principal axes are right to 1e-6 rad; vertices here are given in single
precision, and orientations are compared to what that leaves.
"""

from __future__ import annotations

from pathlib import Path

import menagerie
import mujoco
import numpy as np
import pytest
from covering import every_pair, first

import stepcore as sc

MODES = ("convex", "exact", "legacy", "shell")


def numbers(array) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(array))


def whole(array) -> str:
    return " ".join(str(int(x)) for x in np.ravel(array))


def angle_solid(seed: int):
    """A closed solid with a hollow angle, stretched and turned: vertices and faces."""
    rng = np.random.default_rng(seed)
    outline = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 3), (0, 3)]
    vertices = np.array([(x, y, z) for z in (0, 0.7) for x, y in outline], float)
    lid = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    faces = [(a, c, b) for a, b, c in lid] + [(a + 6, b + 6, c + 6) for a, b, c in lid]
    for i in range(6):
        j = (i + 1) % 6
        faces += [(i, j, j + 6), (i, j + 6, i + 6)]
    stretch = np.eye(3) + 0.3 * rng.normal(size=(3, 3))
    if np.linalg.det(stretch) < 0:
        stretch[0] *= -1
    size = 10.0 ** rng.uniform(-3, 1)
    placed = (vertices @ stretch.T + rng.normal(size=3)) * size
    return placed.astype(np.float32).astype(float), np.array(faces)


def cloud(seed: int):
    """Points without faces."""
    points = np.random.default_rng(seed).normal(size=(60, 3))
    return points.astype(np.float32).astype(float), None


def model_text(asset: str, geom: str = 'type="mesh" mesh="m"', compiler: str = "") -> str:
    return f"""<mujoco><compiler {compiler}/><asset>{asset}</asset><worldbody>
    <body name="b" pos="1 2 3" quat=".8 .6 0 0"><freejoint/>
    <geom name="g" {geom} pos=".1 .2 .3" quat=".5 .5 -.5 .5"/></body></worldbody></mujoco>"""


def mesh_text(vertices, faces, more: str = "") -> str:
    face = "" if faces is None else f'face="{whole(faces)}"'
    return f'<mesh name="m" vertex="{numbers(vertices)}" {face} {more}/>'


def compare(text: str, tolerance: float = 1e-9, turn: float = 3e-6):
    """Both compile the text; body mass and inertia, geom pose and size are equal."""
    theirs = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(theirs)
    mujoco.mj_forward(theirs, data)
    ours = sc.loads(text).compile()
    same(ours, theirs, data, tolerance, turn)
    return ours, theirs


def same(ours, theirs, data, tolerance, turn):
    sim = sc.Sim(ours)
    size = np.abs(theirs.geom_size).max()
    assert ours.body_mass == pytest.approx(theirs.body_mass, rel=tolerance, abs=0)
    assert ours.body_ipos == pytest.approx(theirs.body_ipos, abs=tolerance * size)
    for body in range(theirs.nbody):
        moments = np.sort(np.linalg.eigvalsh(ours.body_inertia[body]))
        expected = np.sort(theirs.body_inertia[body])
        assert moments == pytest.approx(expected, rel=tolerance, abs=1e-12 * expected.max())
    assert sim.geom_xpos == pytest.approx(data.geom_xpos, abs=tolerance * size)
    assert sim.geom_xmat.reshape(-1, 9) == pytest.approx(data.geom_xmat, abs=turn)
    # Sizes of meshes are made of vertices that MuJoCo has rounded and turned.
    assert ours.geom_size == pytest.approx(theirs.geom_size, abs=3e-6 * size)


@every_pair(seed=range(8), mode=MODES)
def test_mass_inertia_and_frame_in_every_mode(mode, seed):
    compare(model_text(mesh_text(*angle_solid(seed), f'inertia="{mode}"')))
    if mode != "exact":
        compare(model_text(mesh_text(*cloud(seed), f'inertia="{mode}"')))


@pytest.mark.parametrize("seed", range(4))
def test_an_open_surface_and_one_with_turned_faces(seed):
    vertices, faces = angle_solid(seed)
    for mode in MODES:
        compare(model_text(mesh_text(vertices, faces[:-2], f'inertia="{mode}"')))
    for mode in ("convex", "legacy", "shell"):
        compare(model_text(mesh_text(vertices, faces[:, ::-1], f'inertia="{mode}"')))


@pytest.mark.parametrize(
    "more",
    [
        'scale="-1 1 1"',
        'scale=".3 1.7 -2.1"',
        'refpos=".1 .2 .3"',
        'refquat=".5 .1 -.2 1"',
        'refpos=".1 .2 .3" refquat=".5 .1 -.2 1" scale="1 -2 3"',
        'scale="-2 -2 -2" inertia="exact"',
        'smoothnormal="true"',
    ],
)
def test_scale_and_reference_frame(more):
    compare(model_text(mesh_text(*angle_solid(1), more)))


@every_pair(kind=["sphere", "capsule", "cylinder", "ellipsoid", "box"], aabb=["false", "true"])
def test_fitted_primitives(kind, aabb):
    for more in ("", 'fitscale="0.5"', 'size="3 3 3" shellinertia="true"', 'mass="2"'):
        text = model_text(
            mesh_text(*angle_solid(2)), f'type="{kind}" mesh="m" {more}', f'fitaabb="{aabb}"'
        )
        used = {"sphere": 1, "capsule": 2, "cylinder": 2}.get(kind, 3)
        theirs = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(theirs)
        mujoco.mj_forward(theirs, data)
        ours = sc.loads(text).compile()
        # A bounding box is one of rounded vertices.
        near = 1e-5 if aabb == "true" else 1e-9
        assert ours.geom_size[0, :used] == pytest.approx(theirs.geom_size[0, :used], rel=near)
        assert ours.body_mass == pytest.approx(theirs.body_mass, rel=near)
        assert sc.Sim(ours).geom_xpos == pytest.approx(data.geom_xpos, abs=near)


BUILTIN = {
    "sphere": ("0", "1", "2", "4"),
    "hemisphere": ("0", "1", "3", "10"),
    "cone": ("3 0", "4 .5", "17 1", "40 .25"),
    "supersphere": ("3 1 1", "8 .5 .7", "9 1.5 2", "4 0 1"),
    "supertorus": ("4 .5 1 1", "5 .3 .5 1.5", "20 .2 .4 .4"),
    "wedge": ("4 4 30 30 0", "3 2 40 20 0", "5 5 40 20 1", "7 4 80 60 .3", "30 30 45 90 0"),
    "grid": ("2 2 2 1 1 1", "3 4 2 .1 .2 .3"),
    "box": ("2 2 2 1 1 1", "3 4 5 .1 .2 .3"),
    "cylinder": ("4 5 3 1 1 1", "6 6 2 .1 .2 .3"),
    "ellipsoid": ("3 3 3 1 1 1", "6 5 4 .1 .2 .3"),
}


@pytest.mark.parametrize("kind", BUILTIN)
def test_builtin_meshes(kind):
    """Their vertices are single precision in MuJoCo, and principal axes are often not unique."""
    for params in BUILTIN[kind]:
        mesh = f'<mesh name="m" builtin="{kind}" params="{params}"/>'
        text = model_text(mesh, compiler='angle="radian"')
        theirs = mujoco.MjModel.from_xml_string(text)
        ours = sc.loads(text).compile()
        assert ours.body_mass == pytest.approx(theirs.body_mass, rel=2e-6), params
        assert ours.body_ipos == pytest.approx(theirs.body_ipos, abs=2e-6)
        moments = np.sort(np.linalg.eigvalsh(ours.body_inertia[1]))
        assert moments == pytest.approx(np.sort(theirs.body_inertia[1]), rel=2e-5)
        # The same solid: as far in every direction, in the frame of the file.
        assert reach(ours) == pytest.approx(reach_of(theirs), abs=3e-6)


DIRECTIONS = np.random.default_rng(5).normal(size=(200, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1)[:, None]


def reach(ours, geom=0):
    """Support of the hull about the body, in the body's axes."""
    sim = sc.Sim(ours)
    points = ours.geom_hull(geom)[0] @ sim.geom_xmat[geom].T + sim.geom_xpos[geom]
    return (points @ DIRECTIONS.T).max(axis=0)


def reach_of(theirs, geom=0):
    data = mujoco.MjData(theirs)
    mujoco.mj_forward(theirs, data)
    return (graph_points(theirs, data, geom) @ DIRECTIONS.T).max(axis=0)


def graph_points(theirs, data, geom):
    """The vertices of MuJoCo's hull in the world."""
    mesh = theirs.geom_dataid[geom]
    at = theirs.mesh_graphadr[mesh]
    count = theirs.mesh_graph[at]
    chosen = theirs.mesh_graph[at + 2 + count : at + 2 + 2 * count]
    vertices = theirs.mesh_vert[theirs.mesh_vertadr[mesh] + chosen]
    return vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]


@pytest.mark.parametrize("seed", range(10))
def test_hulls_have_the_same_vertices(seed):
    """Random points are in general position: their hull is one set of points."""
    points, _ = cloud(seed)
    ours, theirs = compare(model_text(mesh_text(points, None)))
    data = mujoco.MjData(theirs)
    mujoco.mj_forward(theirs, data)
    sim = sc.Sim(ours)
    mine = ours.geom_hull("g")[0] @ sim.geom_xmat[0].T + sim.geom_xpos[0]
    their = graph_points(theirs, data, 0)
    assert len(mine) == len(their)
    apart = np.linalg.norm(mine[:, None] - their[None], axis=2)
    assert apart.min(axis=1).max() < 1e-5 * np.abs(points).max()


@pytest.mark.parametrize("most", [4, 8, 20])
def test_maxhullvert(most):
    """So many vertices and no more, all of them vertices of the mesh."""
    points, _ = cloud(3)
    points /= np.linalg.norm(points, axis=1)[:, None]
    text = model_text(mesh_text(points, None, f'maxhullvert="{most}"'))
    ours = sc.loads(text).compile()
    assert len(ours.geom_hull(0)[0]) == most
    theirs = mujoco.MjModel.from_xml_string(text)
    assert theirs.mesh_graph[0] == most


@pytest.mark.parametrize("seed", range(3))
def test_heights(seed):
    rng = np.random.default_rng(seed)
    heights = rng.normal(size=(5, 7)).astype(np.float32).astype(float)
    if seed == 2:
        heights[:] = 3.0
    text = f"""<mujoco><asset><hfield name="h" nrow="5" ncol="7" size="1 2 .5 .1"
    elevation="{numbers(heights)}"/></asset><worldbody><geom type="hfield" hfield="h"/>
    <body pos="0 0 3"><freejoint/><geom size=".1"/></body></worldbody></mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(text)
    scene = sc.loads(text)
    plain = scene.to_dict()["hfields"][0]
    data = np.array(plain["data"], np.float32)
    span = np.ptp(data)
    share = (data - data.min()) / span if span > 0 else 0 * data
    assert share == pytest.approx(theirs.hfield_data, abs=1e-7)
    assert plain["size"] == pytest.approx(theirs.hfield_size[0])
    assert (plain["nrow"], plain["ncol"]) == (5, 7)


def test_what_is_written_is_what_mujoco_reads():
    asset = mesh_text(*angle_solid(4), 'scale="1 -2 .5" inertia="exact" maxhullvert="6"')
    asset += '<hfield name="h" nrow="2" ncol="3" size="1 2 .3 .1" elevation="0 1 2 3 4 5"/>'
    text = model_text(asset, 'type="capsule" mesh="m" fitscale=".5"', 'fitaabb="true"').replace(
        "</worldbody>", '<geom type="hfield" hfield="h"/></worldbody>'
    )
    first = mujoco.MjModel.from_xml_string(text)
    second = mujoco.MjModel.from_xml_string(sc.loads(text).to_mjcf())
    for field in ("body_mass", "body_inertia", "geom_pos", "geom_size", "hfield_data"):
        assert getattr(second, field) == pytest.approx(getattr(first, field), abs=1e-12), field


def mesh_files() -> list[str]:
    """Those of robots and of dm_control's models, at most a few of each folder."""
    import dm_control

    suite = Path(dm_control.__file__).parent
    folders = [
        suite / "third_party" / "kinova" / "meshes_decimated",
        suite / "suite" / "dog_assets",
    ]
    folders += sorted(menagerie.FOLDER.glob("*/assets"))
    files = []
    for folder in folders:
        found = [path for path in sorted(folder.iterdir()) if path.suffix in (".stl", ".obj")]
        files += [str(path) for path in found[:: max(1, len(found) // 12)]]
    return files


# By default every third file.
FILES = [path for k in range(3) for path in mesh_files()[k::3]]


@first(len(FILES) // 3, path=FILES)
def test_meshes_of_robots(path):
    """As a free body: mass, frame, and the hull's reach in 200 directions."""
    for mode in ("legacy", "convex", "shell"):
        text = model_text(f'<mesh name="m" file="{path}" inertia="{mode}"/>')
        theirs = mujoco.MjModel.from_xml_string(text)
        scene = sc.Scene()
        mesh = scene.add_mesh("m", file=path, inertia=mode)
        body = scene.add_body("b", pos=(1, 2, 3), quat=(0.8, 0.6, 0, 0))
        scene.add_joint(body, "free")
        scene.add_geom(body, "mesh", mesh=mesh, pos=(0.1, 0.2, 0.3), quat=(0.5, 0.5, -0.5, 0.5))
        ours = scene.compile()
        size = np.abs(theirs.geom_size).max()
        # A text holds more digits than single precision.
        near = 1e-9 if path.endswith("stl") else 1e-6
        assert ours.body_mass == pytest.approx(theirs.body_mass, rel=near)
        assert ours.body_ipos == pytest.approx(theirs.body_ipos, abs=near * size)
        moments = np.sort(np.linalg.eigvalsh(ours.body_inertia[1]))
        assert moments == pytest.approx(np.sort(theirs.body_inertia[1]), rel=10 * near)
        data = mujoco.MjData(theirs)
        mujoco.mj_forward(theirs, data)
        assert sc.Sim(ours).geom_xpos == pytest.approx(data.geom_xpos, abs=near * size)
        assert reach(ours) == pytest.approx(reach_of(theirs), abs=2e-6 * size)
