"""URDF: the scene that it becomes, against MuJoCo's own reading and against its documentation."""

import math

import mujoco
import numpy as np
import pytest

import stepcore as sc
from stepcore.engine.start import Start
from stepcore.measure.check.described import Described, described

INERTIA = '<inertia ixx=".1" iyy=".2" izz=".25" ixy=".01" ixz=".02" iyz="-.03"/>'
HEAVY = f'<inertial><origin xyz=".1 0 .2" rpy=".1 .2 .3"/><mass value="2"/>{INERTIA}</inertial>'


def link(name: str, inside: str = HEAVY) -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(name: str, kind: str, parent: str, child: str, inside: str = "") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


def robot(*parts: str, extension: str = '<compiler fusestatic="false"/>') -> str:
    return f'<robot name="arm"><mujoco>{extension}</mujoco>{"".join(parts)}</robot>'


POSE = '<origin xyz="1 2 3" rpy=".4 -.5 .6"/>'
LIMITED = '<limit lower="-1" upper="2" effort="30" velocity="3"/>'
BALL = f'<collision>{POSE}<geometry><sphere radius=".1"/></geometry></collision>'
ARM = (
    link("base", '<collision><geometry><box size=".2 .4 .6"/></geometry></collision>'),
    link(
        "upper", HEAVY + f"<collision>{POSE}<geometry><sphere radius='.1'/></geometry></collision>"
    ),
    link("lower", HEAVY),
    link("sled", HEAVY),
    link(
        "tool", '<visual><geometry><mesh filename="package://none/none.dae"/></geometry></visual>'
    ),
    joint(
        *("shoulder", "revolute", "base", "upper"),
        POSE + LIMITED + '<axis xyz="0 1 1"/><dynamics damping=".3" friction=".2"/>',
    ),
    joint("elbow", "continuous", "upper", "lower", POSE),
    joint("drawer", "prismatic", "lower", "sled", LIMITED + '<axis xyz="0 0 1"/>'),
    joint("flange", "fixed", "sled", "tool", POSE),
)


def compared(text: str) -> tuple[sc.Sim, mujoco.MjModel, mujoco.MjData]:
    theirs = mujoco.MjModel.from_xml_string(text)
    sim = sc.Sim(sc.loads(text), solver="newton", tolerance=0.0, sweeps=100)
    theirs.opt.tolerance, theirs.opt.iterations = 0.0, 100
    return sim, theirs, mujoco.MjData(theirs)


@pytest.mark.parametrize(
    "parts",
    [
        ARM,
        (link("base"), link("cart"), joint("way", "planar", "base", "cart", '<axis xyz="0 0 1"/>')),
        # Characters, as Bullet's: an effort does not bound what turns about three axes.
        (
            *(link("base"), link("arm", HEAVY)),
            joint("way", "spherical", "base", "arm", POSE + LIMITED.replace("-1", "0")),
        ),
        (
            *('<link name="world"/>', link("ship", HEAVY)),
            joint(
                "sea", "floating", "world", "ship", POSE + '<dynamics damping=".3" friction=".2"/>'
            ),
        ),
    ],
    ids=["arm", "planar", "spherical", "floating"],
)
def test_it_is_mujocos(parts):
    """Poses, masses, mass matrix, forces and acceleration at random states."""
    sim, theirs, data = compared(robot(*parts))
    names = [theirs.body(i).name for i in range(1, theirs.nbody)]
    assert list(sim.model.body_names[1:]) == names
    assert [theirs.joint(i).name for i in range(theirs.njnt)] == list(sim.model.joint_names)
    assert sim.model.body_mass == pytest.approx(theirs.body_mass)
    rng = np.random.default_rng(3)
    for _ in range(20):
        mujoco.mj_resetData(theirs, data)
        mujoco.mj_integratePos(theirs, data.qpos, rng.normal(size=theirs.nv), 1.0)
        data.qvel[:] = rng.normal(size=theirs.nv)
        sim.qpos[:], sim.qvel[:] = data.qpos, data.qvel
        mujoco.mj_forward(theirs, data)
        sim.forward()
        mass = np.zeros((theirs.nv, theirs.nv))
        mujoco.mj_fullM(theirs, data, mass)
        assert sim.xpos == pytest.approx(data.xpos, abs=1e-12)
        assert sim.mass_matrix() == pytest.approx(mass, abs=1e-10)
        assert sim.bias == pytest.approx(data.qfrc_bias, abs=1e-9)
        assert sim.qacc == pytest.approx(data.qacc, rel=1e-8, abs=1e-8)


def test_limits_damping_and_effort():
    scene = sc.loads(robot(*ARM))
    shoulder = scene.joint("shoulder")
    assert shoulder.range == (-1.0, 2.0) and shoulder.damping == 0.3
    assert shoulder.frictionloss == 0.2 and shoulder.actuatorfrcrange == (-30.0, 30.0)
    assert shoulder.axis == pytest.approx((0, math.sqrt(0.5), math.sqrt(0.5)))
    assert scene.joint("elbow").range is None and scene.joint("elbow").axis == (1.0, 0.0, 0.0)
    assert any("velocity limits of 2 joints" in note for note in scene.notes)
    assert any("fixed to the world" in note for note in scene.notes)
    assert any("<visual>" in line for line in scene.ignored)


def test_a_mimic_joint_follows():
    """x2 = offset + multiplier · x1, in MuJoCo's rows too."""
    parts = (
        *(link("base"), link("one"), link("two")),
        joint("first", "revolute", "base", "one", LIMITED),
        joint(
            *("second", "revolute", "base", "two"),
            LIMITED + '<mimic joint="first" multiplier="-2" offset=".1"/>',
        ),
    )
    sim, theirs, data = compared(robot(*parts))
    assert theirs.neq == len(sim.model.scene.equalities) == 1
    sim.qpos[:] = data.qpos[:] = 0.3, 0.2
    mujoco.mj_forward(theirs, data)
    sim.forward()
    assert sim.qacc == pytest.approx(data.qacc, rel=1e-9)


def test_a_floating_link_falls():
    text = robot(link("base"), link("body"), joint("root", "floating", "base", "body", POSE))
    sim = sc.Sim(sc.loads(text))
    assert sim.model.jnt_type == ("free",) and sim.qpos[:3] == pytest.approx((1, 2, 3))
    sim.step(10)
    assert sim.qvel[2] == pytest.approx(-9.81 * sim.time, rel=1e-2)


@pytest.mark.parametrize("fuse", [None, False])
@pytest.mark.parametrize("place", range(3))
def test_floating_links_keep_their_place_among_siblings(place, fuse):
    """Law: bodies and joints have the order of the file, as in MuJoCo's import."""
    kinds = ["continuous"] * 3
    kinds[place] = "floating"
    joints = [joint(f"j{k}", kinds[k], "base", f"l{k}") for k in range(3)]
    deep = joint("deep", "continuous", f"l{place}", "tip")
    links = map(link, ("base", "l0", "l1", "l2", "tip"))
    text = robot(*links, *joints, deep, extension="")
    scene = sc.loads(text, fuse=fuse)
    theirs = mujoco.MjModel.from_xml_string(text)
    if fuse is None:
        bodies = [theirs.body(k).name for k in range(theirs.nbody)]
        assert [body.name for body in scene.bodies] == bodies
        assert scene.compile().jnt_qposadr.tolist() == theirs.jnt_qposadr.tolist()
        assert [j.name for j in scene.joints] == [theirs.joint(k).name for k in range(4)]
    assert scene.body(f"l{place}").parent is scene.world


def test_a_root_called_world_is_the_world():
    box = '<collision><geometry><box size=".2 .4 .6"/></geometry></collision>'
    scene = sc.loads(
        robot(link("world", box), link("arm"), joint("j", "continuous", "world", "arm"))
    )
    assert [body.name for body in scene.bodies] == ["world", "arm"]
    assert scene.geoms[0].body is scene.world
    assert "free" not in "".join(scene.notes)


def test_a_root_set_free_falls():
    scene = sc.loads(robot(link("base"), extension=""), fuse=False)
    scene.add_joint("base", "free")
    sim = sc.Sim(scene)
    sim.step(10)
    assert sim.qvel[2] == pytest.approx(-9.81 * 10 * sim.settings.dt, rel=1e-2)


def test_meshes_are_found(tmp_path):
    """By package, by path, and as MuJoCo's strippath and meshdir say; each file and scale once."""
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    place = tmp_path / "gripper" / "meshes"
    place.mkdir(parents=True)
    (place / "jaw.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners))
    (tmp_path / "gripper" / "urdf").mkdir()
    file = tmp_path / "gripper" / "urdf" / "jaw.urdf"

    def shape(name: str, more: str = "") -> str:
        mesh = f'<mesh filename="{name}" {more}/>'
        return f"<collision><geometry>{mesh}</geometry></collision>"

    for name in ("package://gripper/meshes/jaw.obj", "../meshes/jaw.obj"):
        shapes = shape(name) + shape(name, 'scale="2 2 2"') + shape(name)
        file.write_text(robot(link("jaw", HEAVY + shapes), extension=""))
        scene = sc.load(file, fuse=False)
        assert len(scene.meshes) == 2 and len(scene.geoms) == 3
        scene.add_joint(scene.bodies[1], "free")
        assert sc.Sim(scene).model.ngeom == 3
        # It is saved as MJCF, and that is the same scene.
        scene.save(tmp_path / "saved.xml")
        assert (tmp_path / "saved.xml").read_text().startswith("<mujoco")
        assert sc.load(tmp_path / "saved.xml") == scene


THIN = HEAVY.replace('iyz="-.03"', 'iyz="0"').replace('ixy=".01" ixz=".02"', "")
THIN = THIN.replace('ixx=".1" iyy=".2" izz=".25"', 'ixx="1" iyy="1" izz="5"').replace("rpy", "was")
# The mass of a fused body is computed while the file is read.
FIXED = (joint("j", "revolute", "a", "b"), joint("k", "fixed", "b", "c"))
ERRORS = {
    "unknown link": (
        (link("base"), joint("j", "fixed", "base", "bose")),
        'no such link; nearest: "base"',
    ),
    "two parents": (
        (link("a"), link("b"), joint("j", "fixed", "a", "b"), joint("k", "fixed", "a", "b")),
        "two joints to a parent",
    ),
    "circle": (
        (link("a"), link("b"), joint("j", "fixed", "a", "b"), joint("k", "fixed", "b", "a")),
        "circle",
    ),
    "two roots": ((link("a"), link("b")), "both have no parent"),
    "no link": ((), "needs a link"),
    "twice": ((link("a"), link("a")), "used twice"),
    "type": ((link("a"), link("b"), joint("j", "revolut", "a", "b")), 'nearest: "revolute"'),
    "number": ((link("a", '<inertial><mass value="x"/></inertial>'),), "<mass> value"),
    "shape": (
        (link("a", "<collision><geometry><bax/></geometry></collision>"),),
        'unknown element <bax> in <geometry>; nearest: "box"',
    ),
    "size": (
        (link("a", '<collision><geometry><sphere radius="0"/></geometry></collision>'),),
        "sizes must be > 0",
    ),
    "ply": (
        (
            link(
                "a",
                '<collision><geometry><mesh filename="package://x/y.ply"/></geometry></collision>',
            ),
        ),
        "meshes are read from .stl",
    ),
    "pasted": (
        (link("a"), '<exclude body1="a" body2="b"/>'),
        "arm.urdf:3: <exclude> is of MJCF, which a URDF has inside <mujoco>",
    ),
    "inertia": (
        (link("a"), link("b", THIN), link("c"), *FIXED),
        "arm.urdf:3: body 'b' inertia = [1.000e0, 1.000e0, 5.000e0]: must be principal moments",
    ),
    "xacro": (("<xacro:macro/>",), "this is xacro"),
    "mimic": (
        (
            *(link("a"), link("b")),
            joint("j", "prismatic", "a", "b", '<mimic joint="jj"/>'),
        ),
        'no such joint; nearest: "j"',
    ),
    "limit": (
        (link("a"), link("b"), joint("j", "revolute", "a", "b", '<limit lower="2" uper="1"/>')),
        'unknown attribute "uper" of <limit>; nearest: "upper"',
    ),
    "axis": (
        (link("a"), link("b"), joint("j", "revolute", "a", "b", '<axis xyz="0 0 0"/>')),
        "not zero",
    ),
}


@pytest.mark.parametrize("case", ERRORS)
def test_errors_say_where(case):
    parts, said = ERRORS[case]
    xmlns = ' xmlns:xacro="x"'
    text = "<robot" + xmlns + ">\n" + "\n".join(parts) + "</robot>"
    with pytest.raises(ValueError) as caught:
        sc.loads(text, name="arm.urdf")
    assert str(caught.value).startswith("arm.urdf:")
    assert said in str(caught.value)


def test_every_mesh_that_is_not_read_is_told():
    ply = ERRORS["ply"][0][0]
    parts = [ply.replace('"a"', f'"{name}"').replace("y.ply", f"{name}.ply") for name in "ab"]
    with pytest.raises(ValueError) as caught:
        sc.loads("<robot>\n" + "\n".join(parts) + "</robot>", name="arm.urdf")
    lines = [line.split(": <mesh")[0] for line in str(caught.value).splitlines()]
    assert lines == ["arm.urdf:2", "arm.urdf:3"]


HINGED = """<robot name="r" {robot}><link name="a"/><link name="b"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
<limit {limit}/><dynamics damping=".5" {dynamics}/></joint>{end}</robot>"""
NO_LIMIT = ("lower='2.9' upper='-2.9'", "lower='-inf' upper='inf'", "lower='0' upper='0'")


@pytest.mark.parametrize("limit", [*NO_LIMIT, 'effort="inf" lower="-1" upper="2"'])
def test_limits_that_bound_nothing_are_none_as_in_mujoco(limit):
    text = HINGED.format(robot="", limit=limit, dynamics="", end="")
    theirs, scene = mujoco.MjModel.from_xml_string(text), sc.loads(text)
    bounded = bool(theirs.jnt_limited[0]) and bool(np.isfinite(theirs.jnt_range[0]).all())
    assert (scene.joints[0].range is not None) == bounded
    assert scene.joints[0].actuatorfrcrange is None


def test_what_extends_urdf_is_listed():
    given = {"robot": 'foo="1" xmlns:xacro="x"', "limit": 'lower="-1" upper="1" acceleration="3"'}
    end = '<xacro:property name="a" value="1"/>'
    text = HINGED.format(**given, dynamics='spring_stiffness="2"', end=end)
    text = text.replace('<link name="b"', '<link name="b" concave="yes"')
    mujoco.MjModel.from_xml_string(text)
    ignored = "\n".join(sc.loads(text).ignored)
    assert "spring_stiffness is no attribute of URDF" in ignored
    assert "acceleration is no attribute of URDF" in ignored
    assert "concave is no attribute of URDF" in ignored
    assert "<xacro:property>" in ignored


def hinged(limit='lower="-1" upper="1" effort="3"', end="") -> str:
    text = HINGED.format(robot="", limit=limit, dynamics="", end=end)
    return text.replace("<link", '<mujoco><compiler fusestatic="false"/></mujoco><link', 1)


THIRD = link("c", HEAVY)
STUCK = link("d") + joint("stuck", "fixed", "a", "d")
SPHERE = '<collision name="x"><geometry><sphere radius=".1"/>{}</geometry></collision>'
# What MuJoCo passes over: the file, and what a note says of it.
PASSED_OVER = {
    "inertia twice": (hinged().replace('iyz="0"', 'iyz="0" iyx="0" izx="0" izy="0"'), "izy is no"),
    "of Bullet": (
        hinged().replace("<inertial", SPHERE.replace('name="x"', 'concave="y"') + "<inertial"),
        "concave is no",
    ),
    "beside one that it resembles": (
        hinged('lower="-1" upper="1" effort="3" command_effort="9"'),
        "command_effort is no",
    ),
    "friction": (hinged().replace("<mass", '<friction value=".3"/><mass', 1), "<friction>"),
    "in an origin": (hinged().replace("<axis", "<origin><foo/></origin><axis"), "<foo>"),
    "in a limit": (hinged().replace("<dynamics", "<dynamics><foo/></dynamics><bar"), "<foo>"),
    "beside a shape": (hinged().replace("<inertial", SPHERE.format("<foo/>") + "<inertial"), "foo"),
    "a name twice": (hinged().replace("<inertial", SPHERE.format("") * 2 + "<inertial"), '"x"'),
    "a fixed joint that follows": (
        hinged(end=THIRD + joint("k", "fixed", "b", "c", '<mimic joint="j"/>')),
        '<mimic> does nothing where a joint neither turns nor slides: "k" ("k" is fixed)',
    ),
    "one that follows a fixed joint": (
        hinged(end=THIRD + STUCK + joint("k", "revolute", "b", "c", '<mimic joint="stuck"/>')),
        '"k" ("stuck" is fixed)',
    ),
    "a negative effort": (hinged(limit='lower="-1" upper="1" effort="-3"'), ""),
}


@pytest.mark.parametrize("what", PASSED_OVER)
def test_what_mujoco_passes_over_is_passed_over_with_a_note(what):
    text, said = PASSED_OVER[what]
    sim, theirs, data = compared(text)
    scene = sc.loads(text)
    assert said in "\n".join([*scene.ignored, *scene.notes])
    assert sim.model.body_mass == pytest.approx(theirs.body_mass)
    assert sim.model.nq == theirs.nq and len(scene.geoms) == theirs.ngeom
    names = [theirs.geom(i).name for i in range(theirs.ngeom)]
    assert [geom.name for geom in scene.geoms] == names
    forces = [j.actuatorfrcrange for j in scene.joints if j.actuatorfrcrange]
    assert forces == [tuple(pair) for pair in theirs.jnt_actfrcrange[theirs.jnt_actfrclimited == 1]]
    sim.qpos[:] = data.qpos[:] = np.linspace(0.3, 0.5, theirs.nq)
    sim.forward()
    mujoco.mj_forward(theirs, data)
    assert sim.qacc == pytest.approx(data.qacc, rel=1e-8, abs=1e-9)


# Robots that stand on the ground.

LEGS = [
    part
    for side in ("left", "right")
    for part in (
        link(f"{side}_leg", HEAVY + BALL),
        joint(f"{side}_hip", "revolute", "base", f"{side}_leg", LIMITED),
    )
]
BASE = link("base", HEAVY + '<collision><geometry><box size=".2 .4 .6"/></geometry></collision>')
WALKER = robot(BASE, *LEGS, extension="")


@pytest.mark.parametrize("fuse", [None, False])
def test_a_free_base_stands_on_the_ground(fuse):
    scene = sc.loads(WALKER, free=True, ground=True, fuse=fuse)
    sim = sc.Sim(scene)
    base = scene.joint("base")
    assert (base.type, base.body.name, scene.geoms[-1].type) == ("free", "base", "plane")
    # The lowest point is of the box, 0.3 m below the base.
    assert (base.body.pos[2], scene.geoms[-1].pos[2]) == (pytest.approx(0.3), 0)
    sim.step(10)
    assert sim.qpos[2] == pytest.approx(0.3, abs=1e-3)
    assert sc.loads(scene.to_mjcf()) == scene


@pytest.mark.parametrize("shape", ["box", "capsule", "cylinder", "mesh", "sphere"])
def test_the_ground_touches_the_lowest_geom(shape, tmp_path):
    """Under a turned geom, the ground is where the first contact appears."""
    corners = [(x, y, z) for x in (0, 0.1) for y in (0, 0.2) for z in (0, 0.3)]
    (tmp_path / "m.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners))
    sizes = {"box": 'size=".1 .2 .3"', "mesh": f'filename="{tmp_path}/m.obj"'}
    size = sizes.get(shape, 'radius=".1"' + ' length=".3"' * (shape != "sphere"))
    collision = f"<collision>{POSE}<geometry><{shape} {size}/></geometry></collision>"
    text = robot(link("base", HEAVY + collision), extension="")
    for gap in (1e-6, -1e-6):
        scene = sc.loads(text, free=True, ground=True)
        x, y, z = scene.bodies[1].pos
        scene.bodies[1].pos = (x, y, z + gap)
        sim = sc.Sim(scene)
        sim.forward()
        assert (sim.contacts["dist"] < 0).any() == (gap < 0)


def test_the_ground_is_below_a_fixed_base():
    scene = sc.loads(WALKER, ground=True)
    assert scene.geoms[-1].pos[2] == pytest.approx(-0.3) and scene.joint("left_hip")


def test_the_link_on_a_root_called_world_is_set_free():
    scene = sc.loads(
        robot(link("world", ""), BASE, joint("j", "fixed", "world", "base")), free=True
    )
    assert [(one.name, one.type) for one in scene.joints] == [("base", "free")]


@pytest.mark.parametrize(
    ("text", "option", "says"),
    [
        ("<mujoco><worldbody/></mujoco>", "free", "free: only a URDF takes it"),
        ("<mujoco><worldbody/></mujoco>", "ground", "ground: only a URDF takes it"),
        (robot(BASE, link("b"), joint("j", "floating", "base", "b")), "free", 'joint "j"'),
        (
            robot(link("world"), link("b"), joint("j", "continuous", "world", "b")),
            "free",
            "0 links",
        ),
    ],
)
def test_what_cannot_be_set_free(text, option, says):
    with pytest.raises(ValueError, match=says):
        sc.loads(text, **{option: True})


@pytest.mark.parametrize(
    ("options", "kinds"), [({}, ["fixed base"]), ({"free": True, "ground": True}, [])]
)
@pytest.mark.parametrize("fuse", [None, False])
def test_legs_under_a_fixed_base_are_a_finding(options, kinds, fuse):
    scene = sc.loads(WALKER, fuse=fuse, **options)
    read = described(
        Described(scene.compile(), Start(np.array(sc.Sim(scene).qpos), np.zeros(0)), np.zeros(0))
    )
    assert [finding.kind for finding in read if finding.kind == "fixed base"] == kinds


@pytest.mark.parametrize("variable", ["ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"])
def test_packages_are_searched_where_ros_does(variable, tmp_path, monkeypatch):
    prefix = tmp_path / "install"
    (prefix / "share" / "arm" / "meshes").mkdir(parents=True)
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    data = "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
    (prefix / "share" / "arm" / "meshes" / "m.obj").write_text(data)
    mesh = (
        '<collision><geometry><mesh filename="package://arm/meshes/m.obj"/></geometry></collision>'
    )
    (tmp_path / "r.urdf").write_text(robot(link("base", HEAVY + mesh), extension=""))
    for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(FileNotFoundError, match=f'package "arm" .*{variable}'):
        sc.load(tmp_path / "r.urdf")
    monkeypatch.setenv(variable, str(prefix / "share" if variable[0] == "R" else prefix))
    assert len(sc.load(tmp_path / "r.urdf").meshes) == 1
