"""The plan lists the operations of a step: counted on the step itself."""

import json
from pathlib import Path

import numpy as np
import pytest

import stepcore as sc
from stepcore.cli import main
from stepcore.engine.features import RemovableFeatures
from stepcore.report.terminal import WIDE

# Everything that can be left out is in it once.
SCENE = """<mujoco><option timestep="0.002" integrator="implicitfast"/>
<compiler angle="radian"/><asset><mesh name="shell" file="shell.stl"/></asset>
<worldbody>
  <geom name="floor" type="plane" size="3 3 .1"/>
  <body name="post"><geom name="wall" type="plane" size="3 3 .1"/></body>
  <body name="base" pos="0 0 1"><joint name="turn" axis="0 0 1"/>
    <geom name="base" size=".1"/><geom name="knob" size=".02" pos=".1 0 0"/>
    <geom name="skin" type="mesh" mesh="shell" contype="0" conaffinity="0" mass="0"/>
    <geom name="paint" size=".2" contype="0" conaffinity="0" mass="0"/>
    <body name="upper"><joint name="shoulder" axis="0 1 0" damping=".1"/>
      <geom name="upper" type="capsule" size=".04" fromto="0 0 0 .4 0 0"/>
      <body name="lower" pos=".4 0 0"><joint name="elbow" axis="0 1 0" range="0 1.2"/>
        <geom name="lower" type="capsule" size=".04" fromto="0 0 0 .3 0 0"/>
        <body name="hand" pos=".3 0 0"><joint name="wrist" axis="0 1 0" range="-.5 .5"/>
          <geom name="hand" size=".05" condim="1"/></body></body></body></body>
  <body name="ball" pos="2 0 .1"><freejoint name="free"/><geom name="ball" size=".1"
    friction="0"/></body>
  <body name="lift" pos="-2 0 1"><joint name="rail" type="slide" axis="0 0 1" stiffness="50"/>
    <geom name="lift" size=".1" contype="2" conaffinity="2"/></body>
</worldbody>
<contact><exclude body1="ball" body2="base"/></contact>
<equality><connect name="tie" body1="hand" anchor="0 0 0" active="false"/></equality></mujoco>"""


def scene(law: str = "solref") -> sc.Scene:
    scene = sc.loads(SCENE)
    for geom in scene.geoms:
        if geom.name in ("floor", "wall", "ball"):
            geom.condim = geom.condim if geom.name == "ball" else 1
            geom.friction = 0.0
    if law != "solref":
        scene.options |= {"law": law, "solver": "pgs", "integrator": "semi-implicit"}
    return scene


def left_out(plan) -> dict[tuple[str, str], tuple[int, tuple[str, ...]]]:
    return {(e.name, e.why): (e.count, e.names) for e in plan.left_out}


def test_what_is_left_out_has_its_reason() -> None:
    plan = scene().compile().plan()
    out = left_out(plan)
    assert out["files not read", "used for drawing only"] == (1, ("shell.stl",))
    assert out["pairs", "on the same body"] == (1, ("base/knob",))
    assert out["pairs", "no joint between their bodies"] == (1, ("floor/wall",))
    assert out["pairs", "one body is the parent of the other"][0] == 4
    assert out["pairs", "excluded"] == (2, ("base/ball", "knob/ball"))
    assert out["pairs", "contype and conaffinity share no bit"][0] == 8
    why = "kept apart by the ranges of elbow, wrist; tested only outside them"
    assert ("upper/hand" in out["pairs", why][1]) or ("hand/upper" in out["pairs", why][1])
    assert out["all pairs of geoms", "contype and conaffinity are 0"] == (1, ("paint",))
    gone = "mass matrix, factors and bias force (by tree)"
    assert out[gone, "isotropic: constant, and no gyroscopic term"] == (1, ("ball",))
    assert out[gone, "constant: nothing rotates"] == (1, ("lift",))
    assert out["gyroscopic derivative (by free body)", "isotropic"] == (1, ("ball",))
    assert out["limits", "no range"][1] == ("turn", "shoulder", "rail")
    assert out["connections", "not active"] == (1, ("tie",))
    assert out["poses of bodies", "no step uses them"] == (1, ("lift",))


def test_friction_that_is_none_is_left_out_under_coulombs_law() -> None:
    """MuJoCo's law has a least coefficient, which the plan reports; Coulomb's has none."""
    kept = [e for e in scene().compile().plan().used if e.name == "friction of contacts, μ 0"]
    assert set(kept[0].names) == {"floor/ball", "wall/ball"} and "1e-5" in kept[0].why
    model = scene("rigid").compile()
    assert left_out(model.plan())["friction of contacts", "μ is 0"] == (
        2,
        kept[0].names,
    )
    sim = sc.Sim(model)
    sim.step(200)
    rows = sim.rows[sim.rows["kind"] == "contact"]
    assert sorted(map(str, rows["name"])) == ["contact `floor`/`ball`", "contact `wall`/`ball`"]


def test_pairs_are_counted_as_they_are_tested() -> None:
    """Tested and left out together are all pairs of solid geoms."""
    model = scene().compile()
    plan = model.plan()
    tested = sum(e.count for e in plan.used if e.kind == "pair")
    out = sum(e.count for e in plan.left_out if e.name == "pairs")
    solid = 9
    assert tested + out == solid * (solid - 1) // 2
    assert tested == len(model.pairs) - sum(model.core.plan()["apart"])
    # A law that uses the guess tests all of them.
    guess = scene("rigid").compile()
    assert sum(e.count for e in guess.plan().used if e.kind == "pair") == len(guess.pairs)


def test_rows_of_the_state_are_those_of_the_step() -> None:
    model = sc.load("gymnasium:ant").compile()
    sim = sc.Sim(model)
    sim.step(100)
    before = sim.state()
    plan = model.plan(sim=sim)
    assert sim.state() == before
    sim.forward()
    assert sum(e.rows for e in plan.used if e.rows is not None) == len(sim.rows) > 4
    assert plan.at == "t = 1 s"


def test_the_page_quotes_the_half_cheetah() -> None:
    """docs/plan.md."""
    plan = sc.load("gymnasium:half_cheetah").compile().plan()
    page = (Path(__file__).parents[2] / "docs/plan.md").read_text()
    cost = {entry.name.split(",")[0]: entry.flops for entry in plan.used if entry.flops is not None}
    names = ("poses of bodies", "mass matrix and its factors (by tree)", "of which Coriolis")
    for value in (plan.flops, cost["plane-capsule pairs"], *(cost[name] for name in names)):
        assert f"{value:.0f}" in page
    pairs = sum(entry.count for entry in plan.entries if entry.kind == "pair")
    assert f"8 pairs of {pairs} " in page


def test_folded_tangents_are_told() -> None:
    """In a planar model nothing moves across the plane: three rows a contact, not four."""
    plan = sc.load("gymnasium:half_cheetah").compile().plan()
    (entry,) = [e for e in plan.used if e.name.startswith("contacts")]
    assert entry.name == "contacts, 3 rows each (pyramidal cone)"
    out = left_out(plan)
    why = "no body can move that way: 3 rows instead of 4"
    assert out["friction along one tangent", why][0] == 8
    sim = sc.Sim(sc.load("gymnasium:half_cheetah").compile())
    sim.step(200)
    assert len(sim.rows[sim.rows["kind"] == "contact"]) == 3 * len(sim.contacts) > 0


def test_a_scene_by_hand_has_a_plan() -> None:
    by_hand = sc.Scene()
    body = by_hand.add_body()
    by_hand.add_joint(body, "ball")
    by_hand.add_geom(body, "box", (0.1, 0.2, 0.3))
    plan = by_hand.compile().plan()
    names = [e.name for e in plan.used if e.stage == "commit"]
    assert names == ["integrator: euler (by joint)", "quaternions"]


def test_work_changes_as_the_plan_says() -> None:
    """An entry costs exactly the operations that are saved by removing it."""
    model = scene().compile()
    plan = model.plan()
    sim = sc.Sim(model)
    assert plan.flops == sim.count_flops(1)
    entry = {e.name: e for e in plan.used}
    for name, field in (("springs", "spring"), ("dampers", "damper")):
        less = scene()
        setattr(less.features, field, False)
        assert entry[name].flops == plan.flops - sc.Sim(less.compile()).count_flops(1)
    # A pair that is apart costs no more than one that is excluded, but for the guards.
    bare = scene()
    bare.exclude("upper", "hand")
    guards = len(model.core.plan()["guards"])
    apart = plan.flops - sc.Sim(bare.compile()).count_flops(1)
    assert 0 <= apart <= 4 * guards
    # A ball that is not round has a mass matrix that changes, and a gyroscopic term.
    odd = scene()
    ball = odd.body("ball")
    ball.mass, ball.inertia = 1.0, (0.004, 0.004, 0.005, 0, 0, 0)
    assert sc.Sim(odd.compile()).count_flops(1) > plan.flops + 100


def test_time_is_measured_when_asked() -> None:
    plan = sc.load("lesson:stack").compile().plan(time=True)
    assert plan.micros is not None and plan.micros > 0
    assert next(e.micros for e in plan.used if e.kind == "pair") is not None
    assert sc.load("lesson:stack").compile().plan().micros is None


def test_surfaces_that_touch_nothing_are_left_out() -> None:
    """Belts and adhesion of geoms without a pair; the plan agrees with ablate."""
    scene = sc.loads("""<mujoco><worldbody>
      <geom name="still" type="plane" size="5 5 1" surfacevel="1 0 0 0 0 0" contype="0"
        conaffinity="0"/>
      <geom name="ghost" size=".1" pos="3 0 0" contype="0" conaffinity="0" adhesion="2"/>
      <body name="a"><freejoint/><geom name="one" size=".1" mass="1" adhesion="1"/></body>
      <body name="b" pos="0 0 1"><freejoint/>
      <geom name="two" size=".1" mass="1" surfacevel="1 0 0 0 0 0"/></body></worldbody>
      <contact><pair geom1="one" geom2="two" adhesion="3"/></contact></mujoco>""")
    model = scene.compile()
    plan = model.plan()
    listed = {
        (entry.name.partition(" (")[0], entry.used): (entry.names, entry.why)
        for entry in (*plan.used, *plan.left_out)
    }
    why = "they collide with nothing"
    assert listed["surfaces that move", True][0] == ("two",)
    assert listed["surfaces that move", False] == (("still",), why)
    assert listed["adhesion", True][0] == ("one", "one/two")
    assert listed["adhesion", False] == (("ghost",), why)
    features = RemovableFeatures(model)
    labels = {removal.label for removal in features.terms()}
    assert {"moving surfaces: 1 geom", "adhesion: 1 geom and 1 pair"} <= labels


def test_bad_arguments_are_refused() -> None:
    model = sc.load("lesson:stack").compile()
    with pytest.raises(ValueError, match="a Sim of this model"):
        model.plan(sim=sc.Sim(sc.load("lesson:drop").compile()))
    with pytest.raises(ValueError, match="time = 3"):
        model.plan(time=3)


def test_the_command_prints_and_writes(tmp_path: Path, capsys) -> None:
    out = {name: str(tmp_path / f"plan.{name}") for name in ("json", "png", "html")}
    args = ["--json", out["json"], "--plot", out["png"], "--html", out["html"]]
    assert main(["plan", "gymnasium:ant", *args]) == 0
    printed = capsys.readouterr().out
    assert len(printed.splitlines()) <= 40 and "smaller ones (--all" in printed
    assert "Computed in a step\n" in printed and "Left out of a step\n" in printed
    assert "It tests " in printed and " pairs of geoms." in printed
    assert max(map(len, printed.splitlines())) <= WIDE
    data = json.loads(Path(out["json"]).read_text())
    assert {entry["used"] for entry in data["rows"]} == {True, False}
    assert "<img" in Path(out["html"]).read_text()
    assert main(["plan", "gymnasium:ant", "--all", "--key", "nowhere"]) == 2
    capsys.readouterr()
    assert main(["plan", "gymnasium:ant", "--all"]) == 0
    listed = capsys.readouterr().out.partition("The elements of each entry")[2].split()
    assert set(sc.load("gymnasium:ant").compile().joint_names) <= set(listed)
    assert np.all([len(e["names"]) <= e["count"] for e in data["rows"]])


@pytest.mark.parametrize("axis", "xyz")
def test_what_moves_in_a_plane_is_worked_out_in_two_dimensions(axis: str) -> None:
    scene = sc.Scene()
    link = scene.add_body("link")
    scene.add_joint(link, "hinge", name="turn", axis=[float(axis == k) for k in "xyz"])
    scene.add_geom(link, "sphere", (0.1,), mass=1.0, pos=(0.1, 0.2, 0.3))
    left = {e.name: e for e in scene.compile().plan().left_out if "plane" in e.name}
    entry = left["poses, mass matrix and bias force out of a plane (by tree)"]
    assert entry.why == f"hinges turn about {axis}, slides lie across it: two dimensions"
    scene = scene.with_settings(integrator="implicit")
    left = [e.name for e in scene.compile().plan().left_out if "plane" in e.name]
    assert left == ["poses out of a plane (by tree)"]


def test_noslip_over_friction_losses_alone_is_told():
    scene = sc.loads("""<mujoco><option noslip_iterations="3"/><worldbody><body>
      <joint frictionloss=".1"/><geom size=".1"/></body></worldbody></mujoco>""")
    (entry,) = (e for e in scene.compile().plan().used if e.name.startswith("noslip"))
    assert entry.name == "noslip: 3 sweeps over friction" and entry.count == 1
