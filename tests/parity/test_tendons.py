"""Tendons against MuJoCo, against differences of their own lengths, and against closed forms.

Law: lengths and arms to 1e-9 at a hundred random states of each scene (arms through a geom to
1e-6: MuJoCo ends its search for the bend there); what is known of them at qpos0 likewise. Forces,
accelerations and steps are compared for the scenes of the zoo in `test_parity_zoo`.
"""

from __future__ import annotations

import copy
import importlib.util
import math
import pickle
from pathlib import Path

import menagerie
import mujoco
import numpy as np
import peers
import pytest
import zoo
from hypothesis import given, settings
from hypothesis import strategies as st

import stepcore as sc
from stepcore.engine.features import MotionUsage, RemovableFeatures, without

INERT = 'contype="0" conaffinity="0"'
MOVES = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))


def around(geom: str, side: str = "", at: str = "0 0 .5") -> str:
    """Two points that go anywhere, and a rope between them round a body that turns."""
    return f"""<mujoco><worldbody>
      <body name="drum"><joint type="ball"/><geom name="drum" {geom} mass="1" {INERT}/>
        <site name="side" pos="{at}"/></body>
      <body pos="1 0 0">{MOVES}<geom size=".01" {INERT}/><site name="a"/></body>
      <body pos="-1 0 0">{MOVES}<geom size=".01" {INERT}/><site name="b"/></body></worldbody>
      <tendon><spatial name="rope" stiffness="3"><site site="a"/><geom geom="drum" {side}/>
        <site site="b"/></spatial></tendon></mujoco>"""


SPHERE, CYLINDER = 'type="sphere" size=".3"', 'type="cylinder" size=".3 .5"'
SIDE = 'sidesite="side"'
AROUND = {
    "sphere": around(SPHERE),
    "cylinder": around(CYLINDER),
    "sphere with a side": around(SPHERE, SIDE, ".3 .4 .1"),
    "cylinder with a side": around(CYLINDER, SIDE, ".3 .4 .1"),
    # Outside of the sphere, though its shadow in the plane of the path is inside.
    "sphere with a high side": around(SPHERE, SIDE, "0 .05 .5"),
    "cylinder with a high side": around(CYLINDER, SIDE, ".1 .05 .4"),
}
THROUGH = {
    "through a sphere": around(SPHERE, SIDE, ".1 .05 .2"),
    "through a cylinder": around(CYLINDER, SIDE, ".1 .05 .2"),
}
ZOO = {name: zoo.ZOO[name].text for name in zoo.ZOO if name.startswith("tendon")}
SCENES = ZOO | AROUND | THROUGH


def arms(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """MuJoCo's `ten_J` as a matrix."""
    dense = np.zeros((model.ntendon, model.nv))
    rows = (model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind)
    mujoco.mju_sparse2dense(dense, data.ten_J.ravel(), *rows)
    return dense


def states(model: mujoco.MjModel, count: int, seed: int = 3):
    """Positions and velocities all around qpos0."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        qpos = model.qpos0.copy()
        mujoco.mj_integratePos(model, qpos, 0.6 * rng.normal(size=model.nv), 1.0)
        yield qpos, rng.normal(size=model.nv)


@pytest.mark.parametrize("name", SCENES)
def test_lengths_and_arms_are_mujocos(name):
    """A hundred states."""
    theirs = mujoco.MjModel.from_xml_string(SCENES[name])
    data = mujoco.MjData(theirs)
    sim = sc.Sim(sc.loads(SCENES[name]))
    through = name in THROUGH or name == "tendon_springs"
    for data.qpos[:], data.qvel[:] in states(theirs, 100):
        mujoco.mj_forward(theirs, data)
        sim.qpos, sim.qvel = data.qpos, data.qvel
        assert sim.ten_length == pytest.approx(data.ten_length, abs=1e-12)
        limit = 1e-6 if through else 1e-12
        assert np.abs(sim.ten_J - arms(theirs, data)).max() < limit
        assert np.abs(sim.ten_velocity - data.ten_velocity).max() < 10 * limit


@pytest.mark.parametrize("name", SCENES)
def test_arms_are_the_slopes_of_the_length(name):
    """Central differences along each dof, to 1e-7; velocity is their sum over the velocities."""
    theirs = mujoco.MjModel.from_xml_string(SCENES[name])
    sim = sc.Sim(sc.loads(SCENES[name]))
    h = 1e-6
    for qpos, qvel in states(theirs, 10):
        sim.qpos, sim.qvel = qpos, qvel
        got = sim.ten_J
        assert sim.ten_velocity == pytest.approx(got @ qvel, abs=1e-12)
        for dof, unit in enumerate(np.eye(theirs.nv)):
            ends = []
            for way in (h, -h):
                moved = qpos.copy()
                mujoco.mj_integratePos(theirs, moved, unit, way)
                sim.qpos = moved
                ends.append(sim.ten_length)
            slope = (ends[0] - ends[1]) / (2 * h)
            assert np.abs(slope - got[:, dof]).max() < 1e-7


@pytest.mark.parametrize("name", SCENES)
def test_what_is_known_at_qpos0(name):
    """`tendon_length0`, `tendon_invweight0` and `tendon_lengthspring` are MuJoCo's."""
    theirs = mujoco.MjModel.from_xml_string(SCENES[name])
    ours = sc.loads(SCENES[name]).compile()
    limit = 1e-7 if "through" in name or name == "tendon_springs" else 1e-12
    for table in ("tendon_length0", "tendon_lengthspring"):
        assert getattr(ours, table) == pytest.approx(getattr(theirs, table), abs=1e-12)
    assert ours.tendon_invweight0 == pytest.approx(theirs.tendon_invweight0, rel=limit, abs=limit)


@pytest.mark.parametrize(
    "springlength", ["", 'springlength="-1"', 'springlength=".2"', 'springlength="-1 .3"']
)
def test_spring_lengths(springlength):
    """One number or two; −1 is the length at the rest of the joints' springs."""
    text = f"""<mujoco><default><tendon springlength=".1 .2"/></default><worldbody><body>
      <joint name="j" type="slide" axis="1 0 0" springref=".7"/><geom size=".1"/></body></worldbody>
      <tendon><fixed stiffness="3" {springlength}><joint joint="j" coef="2"/></fixed></tendon>
      </mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(text)
    ours = sc.loads(text).compile()
    assert ours.tendon_lengthspring == pytest.approx(theirs.tendon_lengthspring, abs=1e-15)


# --- closed forms ---------------------------------------------------------------------------------


def hanging(**tendon) -> sc.Scene:
    """A mass of 2 kg on a rope from a hook, that slides up and down."""
    scene = sc.Scene()
    load = scene.add_body("load", pos=(0, 0, -1))
    scene.add_joint(load, "slide", axis=(0, 0, 1))
    scene.add_geom(load, "sphere", 0.1, mass=2.0)
    scene.add_site(name="hook")
    scene.add_site(load, name="knot")
    scene.add_tendon("rope", ["hook", "knot"], **tendon)
    return scene


def test_a_spring_swings_with_its_frequency():
    """About its rest, z = −m g/k: with ω² = k/m, to 1e-9 under rk4."""
    k, m, g = 300.0, 2.0, 9.81
    sim = sc.Sim(hanging(stiffness=k), dt=1e-3, integrator="rk4")
    sim.step(1000)
    omega = math.sqrt(k / m)
    assert sim.qpos[0] == pytest.approx(m * g / k * (math.cos(omega) - 1), abs=1e-9)
    assert sim.tendon("rope").length == pytest.approx(1 - sim.qpos[0], abs=1e-15)
    assert sim.tendon("rope").force == pytest.approx(k * sim.qpos[0], abs=1e-9)
    assert sim.energy.potential + sim.energy.kinetic == pytest.approx(-m * g, abs=1e-8)


def test_a_slack_spring_does_not_pull():
    """Between the two lengths of its rest the load falls freely; beyond, it is held."""
    sim = sc.Sim(hanging(stiffness=1e3, springlength=(0, 1.5)), dt=1e-3, integrator="rk4")
    sim.step(300)
    assert sim.qpos[0] == pytest.approx(-9.81 * 0.3**2 / 2, abs=1e-12)
    assert sim.tendon("rope").force == 0
    sim.step(50)
    assert sim.tendon("rope").force < 0


def test_atwoods_machine():
    """Two masses on one rope over a wheel: both have g (m₁ − m₂)/(m₁ + m₂), to rounding."""
    scene = sc.Scene()
    scene.add_geom(type="cylinder", size=(0.2, 0.1), quat=(1, 1, 0, 0), name="wheel", contype=0)
    scene.add_site(name="top", pos=(0, 0, 0.3))
    for name, x, mass in (("one", -0.2, 3.0), ("two", 0.2, 1.0)):
        body = scene.add_body(name, pos=(x, 0, -1))
        scene.add_joint(body, "slide", axis=(0, 0, 1))
        scene.add_geom(body, "sphere", 0.05, mass=mass, contype=0, conaffinity=0)
        scene.add_site(body, name=name)
    scene.add_tendon("rope", ["one", ("wheel", "top"), "two"], range=(0, 2 + 0.2 * math.pi))
    sim = sc.Sim(scene, dt=1e-3, law="rigid", solver="pgs", sweeps=100, tolerance=0)
    assert sim.tendon("rope").length == pytest.approx(2 + 0.2 * math.pi, abs=1e-12)
    sim.step(100)
    assert sim.qacc == pytest.approx([-9.81 / 2, 9.81 / 2], abs=1e-9)
    assert sim.rows["name"].tolist() == ["limit of tendon `rope`"]


def test_a_rope_round_a_drum():
    """Two tangents and the arc between: 2 √(d² − r²) + r (φ − 2 arccos(r/d))."""
    sim = sc.Sim(sc.loads(AROUND["cylinder with a side"].replace(".3 .4 .1", "0 1 0")))
    d, r = 0.8, 0.3
    for phi in np.linspace(2.4, 4.4, 9):
        # Both points are φ/2 from the side, on the y axis, where the slides start at x = ±1.
        x, y = d * math.sin(phi / 2), d * math.cos(phi / 2)
        sim.qpos[4:] = [x - 1, y, 0, 1 - x, y, 0]
        want = 2 * math.sqrt(d**2 - r**2) + r * (phi - 2 * math.acos(r / d))
        assert sim.ten_length[0] == pytest.approx(want, abs=1e-14)


def test_a_pulley_halves():
    """A branch after a pulley counts by its divisor, and its force likewise."""
    scene = hanging(stiffness=100, springlength=0)
    scene.add_tendon("half", [sc.Pulley(2), "hook", "knot"], stiffness=100, springlength=0)
    sim = sc.Sim(scene)
    assert sim.ten_length == pytest.approx([1, 0.5])
    assert sim.ten_J[:, 0] == pytest.approx([-1, -0.5])
    sim.forward()
    forces = {kind: f for (kind, index), f in sim.element_forces().items() if index == 1}
    assert forces["tendon spring"] == pytest.approx([0.5 * 100 * 0.5])


PULLED = f"""<mujoco><option tolerance="0"/><worldbody><geom type="plane" size="4 4 1"/>
  <site name="post" pos="3 0 .15"/>
  <body pos="0 0 3"><joint axis="0 1 0"/><geom size=".1" pos=".3 0 0" {INERT}/>
    <site name="a"/><site name="b" pos=".3 0 0"/></body>
  <body pos="2 0 .099"><freejoint/><geom size=".1"/><site name="c" pos="0 0 .1"/></body></worldbody>
  <tendon><spatial limited="true" range="0 1.2" frictionloss=".1"><site site="a"/><site site="b"/>
    <pulley divisor="1"/><site site="post"/><site site="c"/></spatial></tendon></mujoco>"""


def test_a_rope_along_one_body_and_to_another_pulls_with_its_contacts():
    """The first branch never changes; the row belongs with the contact of what the second pulls."""
    model = mujoco.MjModel.from_xml_string(PULLED)
    data, sim = mujoco.MjData(model), sc.Sim(sc.loads(PULLED))
    for _ in range(100):
        mujoco.mj_step(model, data)
    sim.step(100)
    assert data.qpos[1] > 2.01
    assert sim.qpos == pytest.approx(data.qpos, abs=1e-11)


def test_friction_holds_up_to_its_loss():
    """Below the friction loss the load hangs; above it falls with what is left."""
    for loss, left in ((30.0, 0.0), (10.0, -9.81 + 10 / 2)):
        sim = sc.Sim(hanging(frictionloss=loss), law="rigid", dt=1e-3, solver="pgs")
        sim.step(50)
        assert sim.qacc[0] == pytest.approx(left, abs=1e-9)


def test_armature_is_inertia():
    """A rope with armature m' along the way of a mass m: it falls with g m/(m + m')."""
    sim = sc.Sim(hanging(armature=6.0), dt=1e-3)
    sim.step(10)
    assert sim.qacc[0] == pytest.approx(-9.81 * 2 / 8, abs=1e-12)


def test_a_rope_keeps_its_trees_awake():
    """A load at rest does not sleep while a spring pulls it with what hangs on its other end."""
    scene = sc.Scene()
    scene.add_geom(type="plane", size=(1, 1, 1))
    for x, name, height, mass in ((0, "rests", 0.1, 50.0), (1, "swings", 2.0, 1.0)):
        body = scene.add_body(name, pos=(x, 0, height))
        scene.add_joint(body, "slide", axis=(0, 0, 1))
        scene.add_geom(body, "sphere", 0.1, mass=mass)
        scene.add_site(body, name=name)
    scene.add_tendon("rope", ["rests", "swings"], stiffness=20, springlength=1)
    sim = sc.Sim(scene, sleep=True)
    sim.step(500)
    assert not sim.asleep.any()
    scene.tendons.clear()
    alone = sc.Sim(scene, sleep=True)
    alone.step(500)
    assert alone.asleep.tolist() == [False, True, False]


# --- what no step uses ----------------------------------------------------------------------------


def test_an_unused_tendon_costs_nothing():
    """Without force, limit, inertia and friction a step has the same operations and bits."""
    scene = hanging()
    with_tendon = sc.Sim(scene.compile())
    scene.tendons.clear()
    without = sc.Sim(scene)
    assert with_tendon.count_flops(3) == without.count_flops(3)
    for sim in (with_tendon, without):
        sim.step(20)
    assert np.array_equal(with_tendon.qpos, without.qpos)
    assert with_tendon.tendon("rope").length == pytest.approx(1 - with_tendon.qpos[0])
    entries = {entry.name: entry for entry in with_tendon.model.plan().entries}
    assert entries["lengths of tendons"].why.startswith("nothing pulls along them")


@pytest.mark.parametrize("name", ["humanoid", "humanoidstandup"])
def test_gymnasiums_humanoids(name):
    """Their tendons are read, and are no part of a step."""
    model = sc.load(peers.gym_path(name)).compile()
    assert model.tendon_names == ("left_hipknee", "right_hipknee")
    theirs = mujoco.MjModel.from_xml_path(peers.gym_path(name))
    data = mujoco.MjData(theirs)
    sim = sc.Sim(model)
    for data.qpos[:], data.qvel[:] in states(theirs, 10):
        mujoco.mj_forward(theirs, data)
        sim.qpos, sim.qvel = data.qpos, data.qvel
        assert sim.ten_length == pytest.approx(data.ten_length, abs=1e-12)
        assert sim.ten_J == pytest.approx(arms(theirs, data), abs=1e-12)


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ('<site site="a"/>', "at least two sites"),
        ('<geom geom="drum"/><site site="a"/><site site="b"/>', "begin and end with a site"),
        ('<site site="a"/><geom geom="drum"/><geom geom="drum"/><site site="b"/>', "between them"),
        ('<site site="a"/><pulley divisor="0"/><site site="b"/>', "must be a finite number > 0"),
        ('<site site="c"/><site site="b"/>', 'no site is named "c"'),
        ('<site site="a"/><geom geom="drun"/><site site="b"/>', "drum"),
    ],
)
def test_paths_that_are_none(path, text):
    """Every branch runs from site to site; an error names the line."""
    source = around(SPHERE).split("<tendon>")[0]
    with pytest.raises(sc.MJCFError, match=text):
        sc.loads(f"{source}<tendon><spatial>{path}</spatial></tendon></mujoco>")


def test_armature_round_a_geom_is_refused():
    """As MuJoCo does."""
    source = around(SPHERE).replace('stiffness="3"', 'armature="3"')
    with pytest.raises(ValueError, match="armature = 3: must be 0 for a tendon that goes round"):
        sc.loads(source).compile()
    with pytest.raises(ValueError, match="wrapping not supported"):
        mujoco.MjModel.from_xml_string(source)


def test_springs_that_yield_are_refused():
    """By name, with the way to leave them out."""
    source = around(SPHERE).replace('stiffness="3"', 'stiffness="3" springyield=".1"')
    with pytest.raises(sc.MJCFError, match="springyield"):
        sc.loads(source)
    assert sc.loads(source, without=["spatial/springyield"]).tendons[0].stiffness == 3


# --- any tendon -----------------------------------------------------------------------------------


NUMBER = st.floats(0, 50).map(lambda x: round(x, 3))
LAWS = st.fixed_dictionaries(
    {},
    optional={
        "stiffness": st.tuples(NUMBER, NUMBER, NUMBER),
        "springlength": st.tuples(st.floats(0, 0.5), st.floats(0.5, 1)),
        "damping": st.tuples(NUMBER, NUMBER, NUMBER),
        "range": st.tuples(st.floats(0, 0.3), st.floats(0.5, 1)),
        "margin": st.floats(0, 0.1),
        "frictionloss": NUMBER,
        "solreflimit": st.tuples(st.floats(0.01, 0.1), st.floats(0.5, 1.5)),
        "solreffriction": st.tuples(st.floats(0.01, 0.1), st.floats(0.5, 1.5)),
    },
)
COEF = st.sampled_from([-2, -0.7, 0.3, 1.5])
SITES = ("wall", "over", "u", "l", "hook")
STEP = st.tuples(
    st.sampled_from(SITES),
    st.sampled_from(["", '<geom geom="peg"/>', '<geom geom="ball"/>', '<pulley divisor="3"/>']),
)


@st.composite
def tendon(draw):
    """A fixed or a spatial tendon on the arm of the zoo."""
    law = draw(LAWS)
    words = " ".join(
        f'{name}="{" ".join(map(str, value)) if isinstance(value, tuple) else value}"'
        for name, value in law.items()
    )
    if draw(st.booleans()):
        joints = draw(st.lists(st.sampled_from("abc"), min_size=1, max_size=3, unique=True))
        path = "".join(f'<joint joint="{j}" coef="{draw(COEF)}"/>' for j in joints)
        return f"<fixed {words}>{path}</fixed>"
    path, last = "", ""
    for site, between in draw(st.lists(STEP, min_size=1, max_size=3)):
        if last:
            other = site if site != last else SITES[(SITES.index(site) + 1) % len(SITES)]
        else:
            other = site
        path += f'<site site="{other}"/>'
        if between.startswith("<pulley"):
            path += f'<site site="{SITES[(SITES.index(other) + 2) % len(SITES)]}"/>'
        path, last = path + between, other
    ends = SITES[(SITES.index(last) + 1) % len(SITES)]
    if path.endswith('"3"/>'):
        path += f'<site site="{last}"/>'
    return f'<spatial {words}>{path}<site site="{ends}"/></spatial>'


@pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")
@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(tendon(), min_size=1, max_size=3), st.integers(0, 10**6))
def test_any_tendon(tendons, seed):
    """Forces, accelerations and a step of tendons that nobody drew by hand, to 1e-8."""
    body = zoo.tendons.ARM
    text = zoo.entry.mjcf(body, f"<tendon>{''.join(tendons)}</tendon>", dt=0.002)
    theirs = peers.strict(mujoco.MjModel.from_xml_string(text), integrator="implicitfast")
    data = mujoco.MjData(theirs)
    sim = sc.Sim(sc.loads(text), **peers.EXACT, integrator="implicitfast")
    for data.qpos[:], data.qvel[:] in states(theirs, 4, seed):
        data.qacc_warmstart[:] = 0
        mujoco.mj_forward(theirs, data)
        sim.qpos, sim.qvel = data.qpos, data.qvel
        sim.forward()
        assert sim.ten_length == pytest.approx(data.ten_length, abs=1e-11)
        size = 1 + np.abs(data.qfrc_smooth).max() + np.abs(data.qfrc_constraint).max()
        assert np.abs(sim.passive - data.qfrc_passive).max() < 1e-9 * size
        assert np.abs(sim.constraint_force - data.qfrc_constraint).max() < 1e-8 * size
        assert np.abs(sim.qacc - data.qacc).max() < 1e-8 * (1 + np.abs(data.qacc).max())
        mujoco.mj_step(theirs, data)
        sim.step()
        assert np.abs(sim.qvel - data.qvel).max() < 1e-8 * (1 + np.abs(data.qvel).max())


# --- by name --------------------------------------------------------------------------------------


def test_measurements_speak_of_tendons():
    """Diagnosis, plan, ablation and a post-mortem name what limits, is used, and blew up."""
    k, m = 1e5, 2.0
    scene = hanging(stiffness=k, damping=1.0, range=(0, 2), frictionloss=0.1, armature=0.01)
    scene.options |= {"dt": 1e-3, "integrator": "semi-implicit"}
    limit = sc.diagnose(scene, horizon=0.1)
    assert limit.stiffest("semi-implicit") == "tendon spring `rope`"
    assert limit.limit("semi-implicit") == pytest.approx(2 / math.sqrt(k / (m + 0.01)), rel=0.01)
    plan = sc.Sim(scene).model.plan().text(full=True)
    words = ("lengths of tendons", "tendon springs", "tendon damping", "tendon armature")
    for word in (*words, "tendon friction loss, one row each", "tendon limits"):
        assert word in plan
    features, sim = RemovableFeatures(scene.compile()), sc.Sim(scene, dt=0.05)
    kinds = {removal.kind: removal for removal in features.tendons()}
    assert kinds.keys() == {*words[1:], "tendon friction loss"}
    for reached, label in ((set(), "tendon limits"), ({("tendon", 0)}, "tendon limit")):
        usage = MotionUsage(frozenset(), frozenset(reached))
        own = {removal.kind: removal for removal in features.removals(usage, sim.settings)}
        assert without(scene, [own[label]]).tendons[0].range is None
    for removal in kinds.values():
        assert without(scene, [removal]).compile().ntendon == 1
    assert without(scene, [kinds["tendon springs"]]).tendons[0].stiffness == 0
    with pytest.raises(sc.SimulationError, match="tendon spring `rope`"):
        sim.step(10_000)


def test_a_copy_has_its_own_path():
    """deepcopy, pickle and the writer keep what a tendon passes."""
    scene = sc.loads(AROUND["cylinder with a side"])
    for twin in (
        copy.deepcopy(scene),
        pickle.loads(pickle.dumps(scene)),
        sc.loads(scene.to_mjcf()),
    ):
        assert twin == scene
        own = {id(e) for e in (*twin.sites, *twin.geoms)}
        assert all(id(element) in own for element in twin.tendons[0].elements())


# --- robots ---------------------------------------------------------------------------------------


def of_suite(name):
    """A model of dm_control's suite."""
    suite = importlib.util.find_spec("dm_control")
    assert suite is not None and suite.origin is not None
    return Path(suite.origin).parent / "suite" / f"{name}.xml"


@pytest.mark.parametrize(
    "path",
    (
        *map(of_suite, ("ball_in_cup", "point_mass", "quadruped", "dog")),
        pytest.param(menagerie.PANDA, marks=menagerie.needed),
    ),
    ids=lambda path: path.stem,
)
def test_robots(path):
    """Lengths, arms and smooth forces of public models with tendons, at ten states."""
    theirs = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(theirs)
    sim = sc.Sim(sc.load(path))
    rng = np.random.default_rng(0)
    for data.qpos[:], data.qvel[:] in states(theirs, 10):
        data.ctrl[:] = sim.ctrl[:] = rng.normal(size=theirs.nu)
        mujoco.mj_forward(theirs, data)
        sim.qpos, sim.qvel = data.qpos, data.qvel
        sim.forward()
        assert sim.ten_length == pytest.approx(data.ten_length, abs=1e-12)
        assert sim.ten_J == pytest.approx(arms(theirs, data), abs=1e-12)
        size = 1 + np.abs(data.qfrc_smooth).max()
        assert np.abs(sim.passive - data.qfrc_passive).max() < 1e-9 * size
        assert sim.actuator_force == pytest.approx(data.actuator_force, abs=1e-9 * size)
