"""`converge`: contraction against theory, verdicts, rows by name, equal work, every output."""

import json
import math
import multiprocessing
import re
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from covering import every_pair

import stepcore as sc
from stepcore import lesson
from stepcore.cli import main
from stepcore.measure.convergence.sweeps import (
    MotionState,
    residual_history,
    spectral_radius,
    speeds,
)
from stepcore.scene.scene import Scene


def tower(masses, **settings):
    """A tower whose balls move into each other, at its start."""
    chosen = {"law": "rigid", "solver": "pgs", "sweeps": 10, "tolerance": 0.0} | settings
    model = sc.Model(lesson.tower(masses), **chosen)
    sim = sc.Sim(model)
    sim.qpos[:] = -1e-5 * np.arange(1, len(masses) + 1)
    sim.qvel[:] = -0.01 * np.arange(1, len(masses) + 1)
    return model, MotionState(0, 0.0, sim.state())


def decimals(rate):
    """Sweeps for a factor of ten."""
    return math.log(10) / -math.log(rate)


@pytest.mark.parametrize(
    ("masses", "law"),
    [
        ((1.0, 0.1), 0.1 / 1.1),
        ((1.0, 1.0), 0.5),
        ((1.0, 10.0), 0.90909),
        ((1.0, 1000.0), 0.999001),
        ((1.0,) * 3, 0.75),
        ((1.0,) * 10, 0.975528),
        ((1.0,) * 20, math.cos(math.pi / 40) ** 2),
    ],
)
def test_c6_measured_theory_and_closed_form(masses, law):
    """Two balls m_top/(m_top + m_bottom), N equal ones cos²(π/2N): to 1 % in sweeps a decimal."""
    model, state = tower(masses)
    found = residual_history(model, model.settings, 4096, state)
    assert found.theory.closed == pytest.approx(law, rel=1e-5)
    assert decimals(found.theory.radius) == pytest.approx(decimals(found.theory.closed), rel=1e-6)
    assert decimals(found.contraction) == pytest.approx(decimals(found.theory.closed), rel=0.01)


@every_pair(
    masses=[(1.0, 3.0, 20.0), (1.0, 100.0), (5.0, 1.0, 1.0, 8.0)],
    law=["lesson", "relaxed", "solref"],
)
def test_soft_rows_have_their_own_matrix(law, masses):
    """Regularisers and under-relaxation count; the closed form of rigid rows is only a bound."""
    model, state = tower(masses, law=law, softness=0.3)
    found = residual_history(model, model.settings, 4096, state)
    assert decimals(found.contraction) == pytest.approx(decimals(found.theory.radius), rel=0.01)
    if found.theory.closed is not None and law != "relaxed":
        assert found.theory.radius < found.theory.closed


@every_pair(law=["lesson", "solref"], cone=["elliptic", "pyramidal"])
def test_cones_that_stick_are_blocks_of_it(law, cone):
    """The grasp, two sticking contacts and a limit: measured and from the matrix, within 4 %."""
    scene = lesson.grasp(law=law, cone=cone, softness=0.1, solver="pgs", sweeps=20)
    sim = sc.Sim(scene.compile())
    sim.reset(key="start")
    sim.step(50)
    state = MotionState(0, 0.0, sim.state())
    found = residual_history(sim.model, sim.settings, 4096, state)
    assert found.theory.why == ""
    assert decimals(found.contraction) == pytest.approx(decimals(found.theory.radius), rel=0.04)


def test_a_contact_that_slides_on_its_cone_has_no_matrix():
    """The same grasp, let go: the cube slides through the fingers."""
    scene = lesson.grasp(grip=0.1, law="lesson", cone="elliptic", solver="pgs", sweeps=200)
    sim = sc.Sim(scene.compile())
    sim.reset(key="start")
    sim.step(20)
    state = MotionState(0, 0.0, sim.state())
    found = residual_history(sim.model, sim.settings, 64, state)
    assert found.theory.radius is None
    assert found.theory.why == "contact `left_pad`/`cube` slides on its friction cone"


def test_a_combination_that_pushes_nothing_is_left_out():
    """Two copies of one row: what they do not share stays for ever, and is nothing."""
    A = np.array([[2.0, 2.0, 0.5], [2.0, 2.0, 0.5], [0.5, 0.5, 1.0]])
    zero = np.zeros(3)
    radius = spectral_radius(A, zero, np.diagonal(A).copy(), [[0], [1], [2]])
    assert radius == pytest.approx(0.5**2 / (2 * 1), rel=1e-9)


def test_the_matrix_of_the_rows():
    """J M⁻¹ Jᵀ: of a tower by hand; symmetric; and it maps impulses to velocities."""
    model, state = tower((1.0, 4.0, 0.5))
    sim = sc.Sim(model)
    sim.restore(state.snapshot)
    sim.forward()
    expected = [[1, -1, 0], [-1, 1.25, -0.25], [0, -0.25, 2.25]]
    assert sim.delassus() == pytest.approx(np.array(expected), abs=1e-15)
    grasp = sc.Sim(lesson.grasp())
    grasp.reset(key="start")
    grasp.step(20)
    A, rows = grasp.delassus(), grasp.rows
    assert np.allclose(A, A.T, atol=1e-12)
    # Jᵀλ in generalised coordinates has the same energy as A has it.
    force = np.array(grasp.constraint_force) * grasp.settings.dt
    energy = force @ np.linalg.solve(grasp.mass_matrix(), force)
    assert rows["impulse"] @ A @ rows["impulse"] == pytest.approx(energy, rel=1e-9)


@every_pair(cone=["elliptic", "pyramidal"], sweeps=[1, 3])
def test_row_speeds_are_what_the_residual_is_made_of(cone, sweeps):
    sim = sc.Sim(lesson.grasp(), cone=cone, sweeps=sweeps, tolerance=0.0, warm_start=False)
    sim.reset(key="start")
    sim.step(3)
    assert speeds(sim).max() == pytest.approx(sim.residual, rel=1e-12)
    assert sim.residual > 1e-6


def heavy_stack():
    """A thousand times the mass on top, cold, five sweeps; overlaps recover at any speed."""
    scene = lesson.stack(5, "rigid", (1.0, 1000.0), warm_start=False)
    scene.options["max_recovery_speed"] = "none"
    return scene


@pytest.fixture(scope="module")
def heavy():
    return sc.converge(heavy_stack(), horizon=0.512, starts=1, states=4, progress=False)


def test_heavy_on_light_is_under_solved(heavy):
    """It sinks, and more sweeps change that; the rows are named with what they lack."""
    assert heavy.verdict == "under-solved"
    assert heavy.contraction == pytest.approx(0.999001, rel=1e-5)
    names = heavy.table["name"]
    assert set(names) == {"contact `floor`/`shape0`", "contact `shape0`/`shape1`"}
    assert all(0 <= row.force < 0.1 * row.solved for row in heavy.rows)
    verdict, rows, rate, *_ = heavy.sentences
    assert verdict.startswith("Under-solved: body `ball")
    assert rows.startswith("Force reached, of the converged force: contact `floor`/`shape0` (")
    assert "m_top/(m_top + m_bottom) = 1000/(1000 + 1)" in rate


def test_equal_work_is_equal(heavy):
    """Row updates of the four splits agree; smaller steps win, as for every slow contraction."""
    updates = [r["updates"] for r in heavy.work.records[:3]]
    assert max(updates) < 1.1 * min(updates)
    assert heavy.better == "smaller steps"
    errors = [r["error"] for r in heavy.work.records[:4]]
    assert errors[0] < errors[1] < errors[2]
    # The residual by sweeps falls, and that of the median by the theory's factor.
    late = heavy.residual(heavy.settings.dt, 4096) / heavy.residual(heavy.settings.dt, 2048)
    assert late == pytest.approx(0.999001**2048, rel=0.02)


@pytest.mark.parametrize(
    "scene",
    [
        lesson.stack(200, "rigid", (1.0, 1000.0), solver="pgs", acceleration="none", dt=1e-3),
        lesson.stack(50, "lesson", (1.0, 1.0), warm_start=True),
        lesson.tower((1.0, 1000.0)).with_settings(solver="newton"),
    ],
    ids=["warm and many", "equal", "newton"],
)
def test_well_solved_is_said_so(scene):
    if scene.options["solver"] == "pgs" and scene.options["sweeps"] == 200:
        scene.options |= {"sweeps": "auto", "tolerance": 1e-9, "warm_start": True}
    found = sc.converge(scene, horizon=0.2, starts=1, states=3, progress=False)
    assert found.verdict == "solved"
    assert found.sentences[0].startswith("Solved: ")
    assert "Force reached" not in str(found)


def test_diverging_says_what_helps():
    """A spring that explicit Euler blows up: neither sweeps; a limit, so that there are rows."""
    scene = lesson.spring(k=4e4, damping=0.5, integrator="semi-implicit", dt=0.0125)
    found = sc.converge(scene, horizon=0.5, starts=1, progress=False)
    assert found.verdict == "diverging"
    (verdict,) = [sentence for sentence in found.sentences if sentence.startswith("Diverging")]
    assert "Diverging: start 0" in verdict
    # 2/ω = 10 ms: 12.5 ms blows up, the next step that is tried does not.
    assert "Converged forces do not help; a time step of 6.25 ms does." in verdict


def heavy_end(balls=4, ratio=1000.0):
    """J2: light balls on a string of points, a heavy one at the end; the first hangs fixed."""
    scene = Scene(name="chain")
    before = scene.world
    for i in range(balls):
        last = i == balls - 1
        reach = 0.4 if not last else 1.0
        ball = scene.add_body(f"ball{i}", pos=(0.4 * i + reach - 0.2, 0, 0))
        scene.add_joint(ball, "free")
        mass = ratio if last else 1.0
        scene.add_geom(ball, "sphere", reach / 2, mass=mass, contype=0, conaffinity=0)
        scene.add_equality("connect", ball, before, anchor=(-reach / 2, 0, 0), name=f"link{i}")
        before = ball
    chosen = {"solver": "pgs", "law": "lesson", "integrator": "semi-implicit", "dt": 1 / 128}
    scene.options = chosen | {"sweeps": 4, "tolerance": 0.0}
    return scene


@pytest.fixture(scope="module")
def chain():
    return sc.converge(heavy_end(), horizon=0.125, starts=1, states=3, progress=False)


def test_j2_heavy_end_chain(chain):
    """Smaller steps close the anchors' gaps; as many more sweeps do not."""
    assert chain.verdict == "under-solved"
    assert all(name.startswith("connect `link") for name in chain.table["name"])
    work = {record["steps x sweeps"]: record for record in chain.work}
    assert work["shipped, 1/4 dt"]["joint"] < 0.5 * work["shipped, 4 x sweeps"]["joint"]
    assert work["shipped, 1/4 dt"]["error"] < 0.5 * work["shipped, 4 x sweeps"]["error"]
    assert work["16x4"]["joint"] < 0.1 * work["1x64"]["joint"]
    assert chain.better == "smaller steps"
    assert decimals(chain.contraction) == pytest.approx(decimals(chain.theory.radius), rel=0.01)


def test_what_has_no_rows_and_one_row():
    found = sc.converge(lesson.spring(), horizon=0.3, starts=1, progress=False)
    assert found.verdict == "no rows" and found.better == "neither"
    assert "so sweeps have no effect" in str(found)
    found = sc.converge(lesson.drop(), horizon=0.512, starts=1, states=2, progress=False)
    assert found.verdict == "solved" and found.contraction is None
    assert "No two rows act at once" in str(found)


def test_another_process_gives_the_same(heavy):
    seen = []
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        again = sc.converge(
            heavy_stack(),
            horizon=0.512,
            starts=1,
            states=4,
            executor=pool,
            progress=lambda *told: seen.append(told),
        )
    assert again.to_dict() == heavy.to_dict()
    assert {label for label, *_ in seen} == {"reference", "runs", "sweeps"}


def test_outputs(heavy, tmp_path, capsys):
    """Text within its width, JSON, a picture and a page; the command line."""
    assert max(map(len, heavy.text(90).splitlines())) <= 90
    data = json.loads(heavy.to_json())
    assert data["verdict"] == "under-solved" and len(data["work"]) == 8
    page = heavy.to_html(tmp_path / "a.html")
    assert (tmp_path / "a.html").read_text() == page and "Under-solved" in page
    ask = ["converge", "lesson:spring", "--horizon", "0.2", "--starts", "1", "--states", "2"]
    assert main([*ask, "--json", "--plot", str(tmp_path / "b.png")]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "no rows"
    assert (tmp_path / "b.png").read_bytes().startswith(b"\x89PNG")


def test_what_it_refuses():
    for wrong, words in (
        ({"states": 0}, "states = 0: must be a whole number >= 1"),
        ({"horizon": -1.0}, "horizon = -1.0"),
        ({"control_dt": 0.003}, "control_dt = 0.003: must be a whole number of steps of 0.002 s"),
        ({"executor": 3}, "executor = 3: must be"),
        ({"starts": 0}, "starts = 0"),
        ({"threads": 0}, "threads"),
    ):
        with pytest.raises(ValueError, match=words):
            sc.converge(lesson.drop(), **wrong)
    with pytest.raises(ValueError, match="nothing in it can move"):
        sc.converge(Scene())


def test_the_page_says_what_is_so():
    """docs/converge.md: where sweeps are the better buy."""
    page = Path(__file__).parents[2] / "docs" / "converge.md"
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 1
    exec(blocks[0], {})


def test_bodies_that_just_touch_at_the_start_do_not_stop_sweeps_from_converging():
    """Their impulses at the start are rounding, of which every sweep leaves all."""
    scene = sc.loads(
        """<mujoco><option timestep="0.005" solver="PGS" iterations="4"/><worldbody>
        <geom type="plane" size="1 1 1"/>
        <body pos="0 0 .1"><freejoint/><geom size=".1" mass="1"/></body>
        <body pos="0 0 .3"><freejoint/><geom size=".1" mass="100"/></body>
        </worldbody></mujoco>"""
    )
    result = sc.converge(scene, horizon=0.1, starts=1, progress=False)
    assert not any("do not converge" in said for said in result.sentences)
    assert result.contraction == pytest.approx(result.slowest.theory.radius, rel=0.02)
