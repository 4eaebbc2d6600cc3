"""`ablate` on scenes with answers in closed form."""

import dataclasses
import functools
import json
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from small import unstable

import stepcore as sc
from stepcore import lesson
from stepcore.cli import main
from stepcore.engine.features import MotionUsage, RemovableFeatures, without
from stepcore.experiment.change import Change
from stepcore.report.terminal import WIDE

# A block that slides on the floor, a pendulum that neither meets it nor its limit, and a
# ball far away that meets nothing.
KNOWN = """<mujoco><option timestep="0.005" cone="elliptic"/><worldbody>
  <geom name="floor" type="plane" size="5 5 .1" friction="{mu}"/>
  <body name="sledge" pos="0 0 .1"><joint name="x" type="slide" axis="1 0 0"/>
    <joint name="z" type="slide" axis="0 0 1"/><geom size=".1" mass="1" friction="{mu}"/></body>
  <body name="pendulum" pos="0 3 2"><joint name="swing" axis="1 0 0" range="-170 170"/>
    <geom name="bob" size=".1" pos="0 0 -.5" mass="1"/></body>
  <body name="far" pos="0 -50 9"><joint type="slide" axis="0 0 1" stiffness="100"/>
    <geom size=".1" mass="1"/></body>
</worldbody>
<keyframe><key qpos="0 0 .5 0" qvel="{v} 0 0 0"/></keyframe></mujoco>"""
SHORT = {"horizon": 0.4, "starts": 2, "progress": False}


@functools.cache
def known(mu: float = 0.5, v: float = 1.0) -> sc.Ablation:
    return sc.ablate(sc.loads(KNOWN.format(mu=mu, v=v)), **SHORT)


def row(result: sc.Ablation, kind: str):
    (found,) = [row for row in result.rows if row.removal.kind == kind]
    return found


def test_an_error_is_a_length_or_a_share_and_a_motion_its_fields() -> None:
    """The same tolerance in three forms; the first one determines the scene's size."""
    scene = sc.loads(KNOWN.format(mu=0.5, v=1.0))
    written = sc.ablate(scene, sc.Motion(horizon=0.4, starts=2), added="1mm", progress=False)
    assert written.tolerance == known().tolerance == 1e-3
    assert written.removed == known().removed
    share = sc.ablate(scene, added="0.2%", **SHORT)
    # Its farthest body is 51 m from the origin.
    assert 0.10 < share.tolerance < 0.104
    kinds = [{removal.kind for removal in result.removed} for result in (written, share)]
    assert "friction" in kinds[1] - kinds[0]


def test_a_limit_that_is_never_reached_matters_nothing() -> None:
    limits = row(known(), "limits")
    assert limits.removal.name == "1 joint whose limit is never reached"
    assert limits.trial.errors.tolist() == [0.0, 0.0]
    assert limits.removal in known().removed


def test_pairs_that_never_meet_matter_nothing() -> None:
    """The sledge meets the floor; the other bodies meet nothing."""
    colliders = row(known(), "colliders")
    assert colliders.trial.error == 0.0
    assert colliders.removal in known().removed
    met = [row.removal.name for row in known().rows if row.removal.kind == "collider"]
    assert met == ["world/sledge"]


def test_friction_that_brakes_matters_as_much_as_it_brakes() -> None:
    """Without friction the sledge goes on: the rms of μ g t²/2 over the samples, a third of the
    bodies; soft contact lets it settle, which moves this by less than a tenth."""
    friction = row(known(mu=0.2), "friction")
    times = np.linspace(0.02, 0.4, 20)
    expected = np.sqrt(np.mean((0.5 * 0.2 * 9.81 * times**2) ** 2) / 3)
    assert friction.trial.error == pytest.approx(expected, rel=0.1)
    assert friction.removal not in known(mu=0.2).removed


def test_friction_of_what_stands_never_acts() -> None:
    """Nothing pushes the sledge along: without friction it stays as well. (A start moves it by
    5 cm/s at most, and the floor stops it within millimetres.)"""
    result = sc.ablate(sc.loads(KNOWN.format(mu=0.5, v=0)), added=2e-2, **SHORT)
    friction = row(result, "friction")
    assert friction.trial.errors[0] < 1e-12
    assert friction.removal in result.removed
    assert result.smallest.geoms[1].condim == 1


def test_a_collider_that_carries_cannot_go() -> None:
    """Without the floor the sledge falls: the rms of g t²/2, a third of the bodies."""
    fallen = row(known(v=0.0), "collider")
    times = np.linspace(0.02, 0.4, 20)
    expected = np.sqrt(np.mean((0.5 * 9.81 * times**2) ** 2) / 3)
    assert fallen.trial.error == pytest.approx(expected, rel=0.1)


def test_the_smallest_model_is_a_file_that_moves_alike(tmp_path: Path) -> None:
    result = known()
    path = tmp_path / "small.xml"
    result.smallest.save(path)
    scene = sc.load(path)
    assert scene == result.smallest
    assert scene.settings == result.smallest.settings
    assert result.proof.missed == 0
    runs = []
    for one in (sc.loads(KNOWN.format(mu=0.5, v=1.0)), scene):
        sim = sc.Sim(one.compile())
        sim.reset(key=0)
        runs.append(sim.run(0.4).qpos)
    assert np.sqrt(np.mean((runs[0] - runs[1]) ** 2)) <= result.tolerance
    assert result.best.trial.work < result.whole.trial.work
    assert result.saved(result.whole) == 0


# A weight held by two connections at the same point.
TWICE_TIED = """<mujoco><option timestep="0.005"/><worldbody>
  <body name="weight" pos="0 0 1"><freejoint/><geom size=".1" mass="1"/></body></worldbody>
  <equality><connect name="one" body1="weight" anchor="0 0 0"/>
    <connect name="other" body1="weight" anchor="0 0 0"/></equality></mujoco>"""


def test_of_two_features_that_do_the_same_one_stays() -> None:
    """Either connection holds the weight, so removing one adds millimetres; without both it falls
    by g t²/2. Elements that are removed together are measured together."""
    result = sc.ablate(sc.loads(TWICE_TIED), added=1e-2, **SHORT)
    ties = [row for row in result.rows if row.removal.kind == "equality"]
    assert len(ties) == 2 and all(row.trial.error < 5e-3 for row in ties)
    assert sum(row.removal in result.removed for row in ties) == 1
    assert result.best.trial.error <= 1e-2
    neither = without(sc.loads(TWICE_TIED), [row.removal for row in ties])
    assert not any(equality.active for equality in neither.equalities)


EVERYTHING = """<mujoco><option cone="elliptic"/><worldbody>
  <geom type="plane" size="1 1 1" group="2"/>
  <body name="a" pos="0 0 1"><freejoint/><geom size=".1" pos=".1 0 0"/>
    <body name="b" pos=".3 0 0"><joint name="j" axis="0 1 0" range="-20 20" damping="1"
      armature=".1" frictionloss=".1" stiffness="2"/><geom size=".1"/>
      <body name="c" pos=".3 0 0"><joint name="k" range="-1 1"/><geom size=".1"/></body></body>
  </body></worldbody>
  <equality><connect name="tie" body1="c" anchor="0 0 0"/></equality></mujoco>"""


def test_every_feature_is_found_and_removed() -> None:
    model = sc.loads(EVERYTHING).compile()
    usage = MotionUsage(frozenset({(0, 1)}), frozenset({("joint", 1)}))
    removals = RemovableFeatures(model).removals(usage, model.settings)
    assert [removal.label for removal in removals] == [
        "cone: elliptic → pyramidal",
        "friction: condim 1",
        "friction loss: 1 joint",
        "armature: 1 joint",
        "joint damping: 1 joint",
        "joint springs: 1 joint",
        "velocity forces: Coriolis, gyroscopic",
        "limits: 1 joint whose limit is never reached",
        "limit: j",
        "colliders: 3 pairs of bodies that never touch",
        "collider: world/a",
        "self-collision: 1 pair of bodies",
        "collider group: group 0 (3 geoms)",
        "collider group: group 2 (1 geom)",
        "equality: tie",
        "warm start",
    ]
    for removal in removals:
        scene = without(model.scene, [removal])
        # Each is another scene, with the same states, that can be saved and read.
        assert scene != model.scene
        assert scene.compile().nq == model.nq
        assert sc.loads(scene.to_mjcf()) == scene
        # The change that measurements run is this scene.
        changed = Change(without=[removal]).of(model)
        assert changed.settings == scene.compile().settings and changed.scene == scene
    assert without(model.scene, []) == model.scene


SLIDING = """<mujoco><option timestep="0.005" cone="elliptic" iterations="2" solver="PGS"/>
  <worldbody>
  <geom type="plane" size="5 5 .1" friction=".5"/>
  <body pos="0 0 .1"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/></body>
</worldbody><keyframe><key qpos="0 0 .1 1 0 0 0" qvel="1 .7 0 0 0 2"/></keyframe></mujoco>"""


@pytest.mark.parametrize(
    ("kind", "settings"),
    [("cone", {"cone": "pyramidal"}), ("warm start", {"warm_start": False})],
)
def test_a_setting_that_is_left_out_is_left_out_of_the_run(kind: str, settings: dict) -> None:
    """It adds the effect that a plain loop shows, of the place and of some arcs; once nothing."""
    scene, places = sc.loads(SLIDING), []
    for own in (scene, scene.with_settings(**settings)):
        sim = sc.Sim(own)
        sim.reset(key=0)
        places.append(sim.run(0.4, record="xpos")["xpos"][1:, 1])
    apart = np.linalg.norm(places[0] - places[1], axis=1)
    result = sc.ablate(scene, horizon=0.4, starts=1, further=0, progress=False)
    assert row(result, kind).trial.error == pytest.approx(np.sqrt(np.mean(apart**2)), rel=0.2)


@pytest.mark.parametrize("kind", ["armature", "joint damping", "velocity forces", "limits"])
def test_a_removal_reaches_the_model(kind: str) -> None:
    model = sc.loads(EVERYTHING).compile()
    removals = RemovableFeatures(model).removals(
        MotionUsage(frozenset(), frozenset()), model.settings
    )
    (removal,) = [removal for removal in removals if removal.kind == kind]
    scene = without(model.scene, [removal])
    less = scene.compile()
    if kind == "armature":
        mass = sc.Sim(model).mass_matrix() - sc.Sim(less).mass_matrix()
        np.testing.assert_allclose(mass, np.diag([0.0] * 6 + [0.1, 0.0]), atol=1e-12)
    elif kind == "limits":
        assert np.all(np.isinf(less.jnt_range))
    else:
        sim = sc.Sim(less)
        sim.qvel[:] = 1.0
        (still,) = [np.array([sc.Sim(less).bias, sc.Sim(less).passive])]
        part = 0 if kind == "velocity forces" else 1
        moving = np.array([sim.bias, sim.passive])
        np.testing.assert_allclose(moving[part], still[part], atol=1e-12)


def test_processes_find_the_same() -> None:
    scene = sc.loads(KNOWN.format(mu=0.5, v=1.0))
    with ProcessPoolExecutor(1) as pool:
        result = sc.ablate(scene, executor=pool, **SHORT)
    for one, other in zip(result.rows, known().rows, strict=True):
        np.testing.assert_array_equal(one.trial.errors, other.trial.errors)
        assert one.trial.work == other.trial.work
    assert result.removed == known().removed


def test_the_command_writes_data_a_picture_a_page_and_the_model(tmp_path: Path, capsys) -> None:
    model = tmp_path / "model.xml"
    model.write_text(KNOWN.format(mu=0.5, v=1.0))
    out = {name: str(tmp_path / f"out.{name}") for name in ("json", "png", "html", "xml")}
    args = ["--horizon", "0.2", "--starts", "1", "--json", out["json"], "--plot", out["png"]]
    args += ["--html", out["html"], "--save", out["xml"]]
    assert main(["ablate", str(model), *args]) == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= WIDE
    printed = " ".join(printed.split())
    assert "he smallest model within 1 mm saves" in printed
    data = json.loads(Path(out["json"]).read_text())
    same = sc.ablate(sc.load(model), horizon=0.2, starts=1, progress=False)
    assert data["smallest"]["without"] == [removal.label for removal in same.removed] != []
    assert [row["added"] for row in data["rows"]] == [row.trial.error for row in same.rows]
    assert sc.loads(data["smallest"]["mjcf"]) == sc.load(out["xml"])
    assert Path(out["png"]).read_bytes().startswith(b"\x89PNG")
    assert "<img" in Path(out["html"]).read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"added": 0}, "added = 0: must be"),
        ({"starts": 0}, "starts = 0"),
        ({"executor": 3}, "executor = 3"),
        ({"key": "nowhere"}, "nowhere"),
    ],
)
def test_bad_arguments_are_refused(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sc.ablate(sc.loads(KNOWN.format(mu=0.5, v=1.0)), **({"horizon": 0.2} | arguments))


def test_a_model_that_explodes_at_its_own_step_is_refused() -> None:
    """Finite at the end of the motion, and 1e30 m away: its features had no result."""
    scene = unstable().with_settings(dt=0.02)
    scene.add_key(qpos=[0.01, 0.01])
    scene.joints[1].stiffness = 1e5
    with pytest.raises(ValueError, match=r"the whole model fails from start 0: .*diagnose"):
        sc.ablate(scene, horizon=0.6, starts=1, progress=False)


def test_a_scene_without_motion_is_refused(tmp_path: Path, capsys) -> None:
    with pytest.raises(ValueError, match="no joint"):
        sc.ablate(sc.Scene())
    assert main(["ablate", "lesson:stack", "--save", str(tmp_path / "no/where.xml")]) == 2
    assert "no such folder" in capsys.readouterr().err


def test_the_smallest_model_is_proven_on_untouched_starts() -> None:
    result = known()
    assert (result.proof.starts, result.proof.missed) == (32, 0)
    assert any("None of 32 held-out starts missed it" in said for said in result.sentences)
    assert result.to_dict()["smallest"]["proof"]["starts"] == 32


# A pendulum in a shaft whose wall it meets from some starts alone.
SOME_TOUCH = """<mujoco><option timestep="0.005"/><worldbody>
  <geom name="wall" type="plane" size="5 5 .1" pos="{x} 0 0" zaxis="-1 0 0"/>
  <body name="a" pos="0 0 0"><joint name="x" type="slide" axis="1 0 0"/>
    <geom size=".1" mass="1"/></body></worldbody></mujoco>"""


def test_what_other_starts_need_joins_the_choice() -> None:
    """At rest it meets nothing; some of the second set of starts drift into the wall."""
    scene = sc.loads(SOME_TOUCH.format(x=0.112))
    options = {"horizon": 1.0, "starts": 2, "added": 1e-4, "progress": False}
    alone = sc.ablate(scene, further=0, **options)
    assert [removal.kind for removal in alone.removed][:1] == ["colliders"]
    assert alone.proof is None
    both = sc.ablate(scene, **options)
    assert both.starts > 2
    assert "colliders" not in [removal.kind for removal in both.removed]


def test_what_few_starts_refute_is_not_run_from_all_and_that_is_said() -> None:
    result = sc.ablate(
        sc.loads(EVERYTHING), horizon=0.2, starts=4, threads=1, progress=False, added=1e-4
    )
    short = [row for row in result.rows if len(row.trial.starts) == 2]
    assert short and all(row.trial.error > result.tolerance for row in short)
    named = {row.removal.label for row in short}
    cells = {cell["without"]: cell for cell in result.tables(full=True)[0]}
    assert {n for n, cell in cells.items() if cell["added"].startswith("≥")} == named
    assert {n for n, cell in cells.items() if cell["starts"] == 2} == named
    assert {row["name"] for row in result.table if row["at_least"]} == {
        row.removal.name for row in short
    }
    assert all(row["starts"] == (2 if row["at_least"] else 4) for row in result.table)
    largest = max((r for r in result.rows if not r.trial.failure), key=lambda r: r.trial.error)
    (said,) = [said for said in result.sentences if said.startswith("The largest effect")]
    assert ("2 starts of 4" in said) == (largest in short)
    drawn = {text.get_text() for axes in result.plot().axes for text in axes.texts}
    assert any(text.startswith("≥") for text in drawn)


def test_a_gain_is_named_only_if_timing_can_tell_it() -> None:
    result = sc.ablate(lesson.drop(), horizon=0.2, starts=1, progress=False)
    result.removed = result.removed or [result.rows[0].removal]

    def said(cost: float) -> str:
        whole = dataclasses.replace(result.whole, cost=100.0)
        best = dataclasses.replace(result.best, cost=cost)
        return dataclasses.replace(result, whole=whole, best=best, noise=0.02).sentences[0]

    assert said(97.0).startswith("No measurable gain in speed: the smallest model within 1 mm")
    assert said(80.0).endswith(", and 20 % of the computing time as measured here.")
    assert said(120.0).startswith("No gain: ") and "20 % more time as measured here" in said(120.0)


def test_mujoco_ablates_by_its_flags() -> None:
    result = sc.ablate(sc.loads(KNOWN.format(mu=0.5, v=1.0)), engine="mujoco", **SHORT)
    # Features that the scene lacks are not ablated: no equality, loss, damper or motor.
    kinds = {row.removal.kind for row in result.rows}
    assert kinds == {"limit", "contact", "gravity", "spring", "constraint"}
    assert row(result, "limit").trial.error == 0.0
    assert row(result, "contact").trial.error > 1e-2
    assert 'limit="disable"' in result.in_file and result.smallest is None
    assert "In the file: <option><flag " in result.text()
