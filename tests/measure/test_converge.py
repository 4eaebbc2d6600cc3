"""`converge`: verdicts, the parts of an error, sweeps against steps, and every output."""

import dataclasses
import json
import multiprocessing
import re
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.cli import main
from stepcore.scene.scene import Scene


def heavy_stack():
    """A thousand times the mass on top, cold, five sweeps; overlaps recover at any speed."""
    scene = lesson.stack(5, "rigid", (1.0, 1000.0), warm_start=False)
    scene.options["max_recovery_speed"] = "none"
    return scene


@pytest.fixture(scope="module")
def heavy():
    return sc.converge(heavy_stack(), horizon=0.512, starts=1, progress=False)


def test_heavy_on_light_is_under_solved(heavy):
    """It sinks, and converged forces change that."""
    assert heavy.verdict == "under-solved"
    assert heavy.ending.solver > heavy.solved.error


def test_smaller_steps_gain_more_than_sweeps(heavy):
    """Each sweep leaves 0.999 of the solver's error; a smaller step leaves less to solve."""
    assert heavy.better == "smaller steps"
    work, steps, sweeps = heavy.at_equal_work
    assert heavy.shipped.work < work and steps < sweeps < heavy.shipped.error


def test_errors_are_those_of_runs_by_hand(heavy):
    """The end of the shipped run, by hand, against a run with very many sweeps."""
    ends = []
    for more in ({}, {"sweeps": 20_000, "tolerance": 1e-13, "dt": 0.0005}):
        sim = sc.Sim(heavy_stack(), **more)
        sim.reset("start")
        sim.step(round(heavy.horizon / sim.settings.dt))
        ends.append(sim.xpos[1:].copy())
    largest = np.linalg.norm(ends[0] - ends[1], axis=1).max()
    assert heavy.ending.apart == pytest.approx(largest, rel=1e-3)
    assert heavy.shipped.error <= heavy.shipped.largest.max()


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
    found = sc.converge(scene, horizon=0.2, starts=1, progress=False)
    assert found.verdict == "solved"
    assert found.ending.solver <= max(found.solved.error, 1e-5 * found.scale)


def test_diverging_says_what_helps():
    """A spring that explicit Euler blows up: neither sweeps; a limit, so that there are rows."""
    scene = lesson.spring(k=4e4, damping=0.5, integrator="semi-implicit", dt=0.0125)
    found = sc.converge(scene, horizon=0.5, starts=1, progress=False)
    assert found.verdict == "diverging"
    assert found.shipped.failure and found.solved.failure
    # 2/ω = 10 ms: 12.5 ms blows up, the next step that is tried does not.
    assert max(trial.dt for trial in found.dts if not trial.failure) == 0.00625


# A last state whose velocities are finite, but no acceleration: 12 steps of 1 ms.
EXPLODES = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody>
  <body><joint name="a" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".03" mass="1"/>
  <body pos="0 0 -.2"><joint name="b" axis="0 1 0" armature="1e-3"/>
  <geom type="capsule" fromto="0 0 0 .03 0 -.2" size=".03" mass=".2" contype="0"/></body></body>
  </worldbody><actuator><position joint="b" kp="40" kv="60"/></actuator></mujoco>"""


@pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")
@pytest.mark.parametrize("measure", [sc.converge, partial(sc.trade, error=1e-3, further=0)])
def test_shipped_settings_that_explode_from_one_of_several_starts_are_told(measure):
    options = {"kind": "hold", "horizon": 0.2, "starts": 2, "progress": False}
    found = measure(sc.loads(EXPLODES), **options)
    assert "diverged in step 12 at" in found.shipped.failure and found.text()


@pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")
def test_what_explodes_asks_for_no_nanometres():
    """The first start errs by 4 nm, and the shipped settings explode from the other one."""
    slide = """<body pos="1 0 0"><joint type="slide" stiffness="400" springref="1e-6"/>
    <geom size=".1" mass="1"/></body></worldbody>"""
    scene = sc.loads(EXPLODES.replace("</worldbody>", slide))
    found = sc.converge(scene, kind="hold", horizon=0.2, starts=2, progress=False)
    assert found.shipped.failure and found.reference.goal == pytest.approx(1e-3 * found.size)


def test_without_rows_the_error_of_the_time_step_is_told():
    """The step was reported to have no effect on a servo that turns at 1e232 rad/s."""
    found = sc.converge(lesson.spring(), horizon=0.3, starts=1, progress=False)
    assert found.verdict == "no rows" and 0 < found.shipped.error < np.inf


def test_the_converged_motion_is_as_fine_as_the_worst_start_needs_it():
    """The first start swings by 1 µm, the others by 1 mm: its error required steps of 2 µs."""
    spring = """<mujoco><option gravity="0 0 0"/><worldbody>
      <body><joint type="slide" stiffness="400" springref="1e-6"/>
      <geom size=".1" mass="1"/></body></worldbody></mujoco>"""
    found = sc.converge(sc.loads(spring), horizon=0.3, starts=3, progress=False)
    assert found.reference.goal == pytest.approx(found.shipped.error / 100, rel=0.1)


def test_a_motion_that_is_exact_to_rounding_asks_for_no_finer_one(tmp_path):
    """A hinge that its damper nearly stops moves by about 1e-18 m: it took over 60 s."""
    file = tmp_path / "damped.xml"
    file.write_text("""<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody>
      <body><joint name="j" damping="13"/><geom size=".1"/></body></worldbody>
      <actuator><motor joint="j" gear="0.4"/></actuator></mujoco>""")
    options = {"ctrl": [[0.0], [0.1]], "control_dt": 0.05, "horizon": 0.3, "progress": False}
    found = sc.converge(file, engine="mujoco", seconds=20, **options)
    assert found.shipped.error < found.size / 1e11 <= found.reference.goal * 1.01


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
    return sc.converge(heavy_end(), horizon=0.125, starts=1, progress=False)


def test_j2_heavy_end_chain(chain):
    """A quarter of the step closes the anchors' gaps; four times the sweeps do not."""
    assert chain.verdict == "under-solved"
    (quarter,) = (trial for trial in chain.dts if trial.dt == chain.shipped.dt / 4)
    assert quarter.error < 0.5 * chain.sweeps[0].error


def test_what_has_no_rows_and_one_row():
    found = sc.converge(lesson.spring(), horizon=0.3, starts=1, progress=False)
    assert found.verdict == "no rows" and found.better == "neither"
    found = sc.converge(lesson.drop(), horizon=0.512, starts=1, progress=False)
    assert found.verdict == "solved" and found.has_rows


def test_another_process_gives_the_same(heavy):
    seen = []
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        again = sc.converge(
            heavy_stack(),
            horizon=0.512,
            starts=1,
            executor=pool,
            progress=lambda *told: seen.append(told),
        )
    assert again.to_dict() == heavy.to_dict()
    assert {label for label, *_ in seen} == {"runs"}


def test_outputs(heavy, tmp_path, capsys):
    """Text within its width, JSON, a picture and a page; the command line."""
    assert max(map(len, heavy.text(90).splitlines())) <= 90
    data = json.loads(heavy.to_json())
    assert data["verdict"] == "under-solved"
    assert [row["settings"] for row in data["rows"]][-3:] == [
        "20 sweeps",
        "80 sweeps",
        "converged forces",
    ]
    page = heavy.to_html(tmp_path / "a.html")
    assert (tmp_path / "a.html").read_text() == page and "Under-solved" in page
    ask = ["converge", "lesson:spring", "--horizon", "0.2", "--starts", "1"]
    assert main([*ask, "--json", "--plot", str(tmp_path / "b.png")]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "no rows"
    assert (tmp_path / "b.png").read_bytes().startswith(b"\x89PNG")


def test_what_it_refuses():
    for wrong, words in (
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
    """docs/converge.md: the example of more sweeps."""
    page = Path(__file__).parents[2] / "docs" / "converge.md"
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 1
    exec(blocks[0], {})


# --- the report where runs fail ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fails", "better"),
    [(("dts", "sweeps"), "neither"), (("sweeps",), "smaller steps"), (("dts",), "more sweeps")],
)
def test_no_advice_names_settings_that_fail(heavy, fails, better):
    failed = {
        name: [dataclasses.replace(trial, failure="fails") for trial in getattr(heavy, name)]
        for name in fails
    }
    assert dataclasses.replace(heavy, **failed).better == better


def test_errors_are_compared_at_equal_work(heavy):
    """Errors that fall as 1/work² and as 1/work, at ten times the shipped work."""

    def trials(order):
        runs = []
        for factor in (3.0, 10.0):
            error = heavy.shipped.error / factor**order
            runs.append(
                dataclasses.replace(
                    heavy.shipped,
                    errors=np.array([error]),
                    work=factor * heavy.shipped.work,
                    settings=heavy.settings.replace(dt=heavy.shipped.dt / factor),
                )
            )
        return runs

    result = dataclasses.replace(heavy, dts=trials(2), sweeps=trials(1))
    work, steps, sweeps = result.at_equal_work
    assert work == pytest.approx(10 * heavy.shipped.work)
    assert steps == pytest.approx(heavy.shipped.error / 100)
    assert sweeps == pytest.approx(heavy.shipped.error / 10)


def test_few_sweeps_can_hide_what_diverges(heavy):
    solved = dataclasses.replace(heavy.solved, failure="start 0: far off")
    found = dataclasses.replace(heavy, solved=solved, ending=None)
    assert found.verdict == "diverging"


def test_a_chain_whose_joints_whirl_is_not_solved():
    # Four sweeps a step: 48 steps lose energy, then the joints whirl at 2,400 rad/s.
    scene = heavy_end(8).with_settings(law="solref", integrator="euler", dt=1 / 60, sweeps=4)
    found = sc.converge(scene, horizon=0.8, starts=1, progress=False)
    assert found.verdict in ("diverging", "under-solved") and found.shipped.error > 0.1
