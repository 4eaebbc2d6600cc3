"""Stability maps: cells against theory and closed forms, theory against the engine's step."""

import itertools
import json
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

import stepcore as sc
from stepcore import lesson
from stepcore.cli import main
from stepcore.deadline import OutOfTime
from stepcore.engine.linear_maps import INTEGRATORS, step_matrix
from stepcore.experiment import Change, Study
from stepcore.measure.stability import (
    SYMBOLS,
    largest_stable_dt,
    limit_of_springs,
    stability_map,
)

SPRING = "joint/spring/stiffness"
ONE, NONE = np.eye(1), np.zeros((1, 1))


def spring_map(**options):
    return stability_map("lesson:spring", **{"path": SPRING} | options)


def states(panel):
    return [cell.state for cell in panel.cells]


# --- the boundary by theory ---------------------------------------------------------------------


@pytest.mark.parametrize("omega", (1.0, 300.0))
def test_limits_of_an_undamped_oscillator(omega):
    """ω dt = 2 for the Eulers that move by the new velocity, 2√2 for rk4, none, any; to 1e-5."""
    stiffness = omega**2 * ONE
    for name in ("semi-implicit", "euler", "implicitfast"):
        found = largest_stable_dt(name, ONE, stiffness, NONE, NONE)
        assert omega * found == pytest.approx(2, rel=1e-5)
    rk4 = largest_stable_dt("rk4", ONE, stiffness, NONE, NONE)
    assert omega * rk4 == pytest.approx(2 * np.sqrt(2), rel=1e-5)
    assert largest_stable_dt("explicit", ONE, stiffness, NONE, NONE) == 0
    assert largest_stable_dt("midpoint", ONE, stiffness, NONE, NONE) == np.inf


@pytest.mark.parametrize("ratio", (0.05, 0.5, 2.0))
def test_limits_of_a_damped_oscillator(ratio):
    """2√(ζ² + 1) + 2ζ with damping implicit, − 2ζ explicit; `explicit` itself 2ζ below ζ = 1."""
    damping, root = 2 * ratio * ONE, 2 * np.sqrt(ratio**2 + 1)
    implicit = largest_stable_dt("implicitfast", ONE, ONE, damping, damping)
    assert implicit == pytest.approx(root + 2 * ratio, rel=1e-5)
    split = largest_stable_dt("semi-implicit", ONE, ONE, damping, NONE)
    assert split == pytest.approx(root - 2 * ratio, rel=1e-5)
    if ratio < 1:
        explicit = largest_stable_dt("explicit", ONE, ONE, damping, NONE)
        assert explicit == pytest.approx(2 * ratio, rel=1e-3)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_the_step_matrix_is_the_engines(integrator):
    """Two coupled slides with spring, damper and servo: M, K and D alone give the step, 1e-12."""
    scene = sc.Scene(gravity=(0, 0, 0))
    cart = scene.add_body("cart", mass=2, inertia=(1, 1, 1))
    scene.add_joint(cart, "slide", name="a", axis=(1, 0, 0), stiffness=30, damping=0.7)
    rider = scene.add_body("rider", cart, mass=1, inertia=(1, 1, 1))
    scene.add_joint(rider, "slide", name="b", axis=(1, 0, 0), armature=0.3)
    scene.add_actuator("b", "position", kp=5, kv=0.2, gear=2)
    sim = sc.Sim(scene, dt=0.03, integrator=integrator, law="lesson", solver="pgs")
    mass = np.array([[3.0, 1.0], [1.0, 1.3]])
    assert sim.mass_matrix() == pytest.approx(mass)
    stiffness, joint, servo = np.diag([30.0, 20.0]), np.diag([0.7, 0]), np.diag([0, 0.8])
    implicit = joint if integrator == "euler" else joint + servo
    ours = step_matrix(integrator, 0.03, mass, stiffness, joint + servo, implicit)
    assert pytest.approx(ours, abs=1e-12) == sim.linearize().A
    expected = largest_stable_dt(integrator, mass, stiffness, joint + servo, implicit)
    limit = limit_of_springs(sim.model, None, integrator)
    assert limit == pytest.approx(expected, rel=1e-9)


def test_what_grows_by_itself_has_no_boundary():
    """A pendulum on its head, held too softly, falls at any dt; held well, it has a limit."""
    scene = sc.Scene(gravity=(0, 0, 0))
    body = scene.add_body("pole", mass=1, inertia=(1, 1, 1))
    scene.add_joint(body, "hinge", name="hinge", stiffness=-5.0)
    scene.add_actuator("hinge", "position", name="servo", kp=4)
    assert np.isnan(limit_of_springs(scene.compile(), None, "euler"))
    held = scene.compile().with_values({"actuator/servo/kp": 30})
    assert limit_of_springs(held, None, "euler") == pytest.approx(2 / 5, rel=1e-5)
    found = stability_map(scene, path="actuator/servo/kp", values=[4, 30], dts=[0.01])
    assert [line.split()[-1] for line in found.text().splitlines()[-2:]] == ["ms", "ms"]


def test_by_default_the_first_of_a_vector_and_the_mass_of_geoms_are_varied():
    scene = sc.loads("""<mujoco><option cone="elliptic"/>
    <worldbody><geom name="floor" type="plane" size="1 1 1"/>
    <body name="box" pos="0 0 .1"><freejoint/><geom type="box" size=".1 .1 .1" mass="3"/></body>
    </worldbody></mujoco>""")
    for path, present in (("geom/floor/friction", 1.0), ("body/box/mass", 3.0)):
        found = stability_map(scene, path=path, dts=[0.002], horizon=0.02)
        assert found.values[::6] == pytest.approx([present / 100, present, present * 100])


def test_values_whose_truth_the_time_left_out_are_unknown(monkeypatch):
    """Runs are judged as far as possible: failed ones exploded, the rest is only finite."""
    grid = {"path": SPRING, "values": [100.0, 1e6], "dts": [1e-3, 1e-1], "integrators": "euler"}

    def late(*_, **__):
        raise OutOfTime("the time of the measurement is over")

    monkeypatch.setattr(Study, "truth", late)
    found = spring_map(**grid)
    assert "Not done: all converged motions" in found.text() and "unknown" in found.text()
    assert [cell.state for cell in found.rows] == ["finite"] * 3 + ["exploded"]


def test_a_scene_without_springs_has_no_boundary():
    assert np.isnan(limit_of_springs(lesson.drop().compile(), None, "euler"))


# --- the lesson's spring -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("integrator", "limit"),
    (("semi-implicit", 2.0), ("implicitfast", 2.0), ("rk4", np.sqrt(8)), ("midpoint", np.inf)),
)
def test_the_spring_explodes_where_theory_says(integrator, limit):
    """A twentieth below ω dt it does not explode, a twentieth above it does, at any stiffness."""
    for stiffness in (25.0, 1e4):
        dts = np.array([0.01, 0.95, 1.05]) * min(limit, 100.0) / np.sqrt(stiffness)
        found = spring_map(values=[stiffness], dts=dts, integrators=integrator, threads=1)
        (panel,) = found.panels
        last = "exploded" if np.isfinite(limit) else "inaccurate"
        assert states(panel)[1:] == ["inaccurate", last]
        if np.isfinite(limit):
            assert panel.boundary == pytest.approx([limit / np.sqrt(stiffness)], rel=1e-5)
            assert states(panel)[0] == "accurate"


def test_the_error_of_a_cell_is_that_of_every_measurement():
    """v-first turns by φ a step, sin(φ/2) = ω dt/2, and starts 1/2 ω dt behind: a closed form."""
    dt, omega = 0.01, 10.0
    found = spring_map(values=[omega**2], dts=[dt], integrators="semi-implicit", horizon=1.0)
    turn = 2 * np.arcsin(omega * dt / 2)
    # Steps of 10 ms share the period of 0.2 s with others: five samples.
    n = np.arange(20, 101, 20)
    ours = np.cos((n + 0.5) * turn) / np.cos(turn / 2)
    off = np.sqrt(np.mean((ours - np.cos(omega * n * dt)) ** 2))
    (cell,) = found.panels[0].cells
    # The uncertainty of the converged motion is a tenth of the 20 cm of deviation; for rk4 less.
    assert cell.error == pytest.approx(off, abs=2e-2)
    strict = spring_map(
        values=[omega**2], dts=[dt], integrators="semi-implicit", horizon=1.0, deviation="1um"
    )
    assert strict.panels[0].cells[0].error == pytest.approx(off, rel=1e-3)


# --- scenes of the user -------------------------------------------------------------------------


def test_turns_count_as_ways():
    """A hinge through the centre of mass moves no centre: its rotation counts all the same."""
    scene = sc.Scene(gravity=(0, 0, 0))
    wheel = scene.add_body("wheel", mass=1, inertia=(0.1, 0.1, 0.1))
    scene.add_joint(wheel, "hinge", name="axle", stiffness=10, damping=0.01)
    scene.add_key("turned", qpos=[0.5])
    grid = {"path": "joint/axle/stiffness", "values": [10.0], "dts": [0.001, 0.05, 0.25]}
    found = stability_map(scene, **grid, integrators="euler", deviation="5cm")
    assert states(found.panels[0]) == ["accurate", "inaccurate", "inaccurate"]
    assert found.panels[0].boundary == pytest.approx([0.2 + 0.001], rel=2e-3)


def test_contacts_are_judged_by_a_converged_run():
    """A soft contact, ever heavier: the damping of solref keeps it finite at small dt."""
    found = stability_map(
        lesson.drop("solref", solver="newton", sweeps=50),
        path="geom/shape0/mass",
        values=[1.0, 10.0],
        dts=[1e-3, 4e-3],
        horizon=0.4,
        threads=1,
    )
    assert states(found.panels[0]) == ["accurate"] * 4
    assert found.panels[0].boundary is None


def test_what_has_no_converged_run_is_not_judged(monkeypatch):
    """A converged motion of too much uncertainty: finite cells get a question mark, no error."""
    monkeypatch.setattr("stepcore.experiment.truth.RUNGS", 2)
    grid = {"path": SPRING, "values": [1e4], "dts": [0.01, 0.3]}
    found = spring_map(**grid, deviation="1nm")
    assert states(found.panels[0]) == ["inaccurate", "exploded"]
    error = found.panels[0].cells[0].error
    found = spring_map(**grid, deviation=0.9 * error)
    assert states(found.panels[0]) == ["finite", "exploded"]
    assert found.notes[0].startswith("1 finite run, marked ?, cannot be judged for accuracy")
    assert "unknown" in found.text()
    words = [text.get_text() for text in found.plot().legends[0].get_texts()]
    assert "finite, not judged" in words


def test_an_executor_gives_the_same_map():
    grid = {"path": SPRING, "values": [10.0, 1e4], "dts": [0.005, 0.05]}
    alone = spring_map(**grid, threads=1)
    with ProcessPoolExecutor(2) as pool:
        assert spring_map(**grid, executor=pool).table.records == alone.table.records
    seen = []
    spring_map(**grid, progress=lambda *told: seen.append(told))
    assert seen[-1][1:] == (4, 4)


def test_a_motion_and_its_fields_are_the_same():
    grid = {"path": SPRING, "values": [100.0], "dts": [0.01, 0.05]}
    fields = spring_map(**grid, horizon=0.5, key="start", threads=1)
    motion = sc.Motion(horizon=0.5, key="start")
    whole = stability_map("lesson:spring", motion, **grid, threads=1)
    assert whole.table.records == fields.table.records
    assert whole.motion.horizon == 0.5 and whole.motion.key == "start"
    with pytest.raises(ValueError, match="stability_map does not use starts"):
        stability_map("lesson:spring", sc.Motion(starts=2), **grid)
    with pytest.raises(TypeError, match='no argument "horizn"; nearest: "horizon"'):
        spring_map(**grid, horizn=0.5)


def test_a_deviation_is_a_length_or_a_share_of_the_size():
    """The size of the spring is 1 m: 10 % of it are 10 cm."""
    grid = {"values": [100.0], "dts": [0.01, 0.03, 0.05, 0.1], "integrators": "euler"}
    maps_ = [spring_map(**grid, deviation=deviation) for deviation in ("10%", 0.1, "10 cm")]
    states_of = [states(found.panels[0]) for found in maps_]
    assert states_of[0] == states_of[1] == states_of[2]
    assert {"accurate", "inaccurate"} == set(states_of[0])
    strict = spring_map(**grid, deviation="1um")
    assert states(strict.panels[0]) == ["inaccurate"] * 4
    assert "is at most 1 µm" in strict.text()


# --- output --------------------------------------------------------------------------------------


def test_text_data_and_picture(tmp_path):
    grid = {"values": [1.0, 1e5], "dts": [1e-4, 1e-3, 1e-1]}
    found = spring_map(**grid, integrators=list(INTEGRATORS))
    text = found.text()
    words = " ".join(text.split())
    assert "accurate (·): " in words and "inaccurate (o): " in words and "exploded (X): " in words
    # ω = 316/s: 100 ms is beyond 2/ω and 2√2/ω; at 1 ms only rk4 is accurate.
    marks = {p.label: "".join(SYMBOLS[cell.state] for cell in p.at(1e5)) for p in found.panels}
    assert marks["semi-implicit"] == "·oX" and marks["rk4"] == "··X"

    def printed(text):
        return [line.split()[1] for line in text.splitlines() if line.startswith("1e+05")]

    assert printed(found.text(full=True)) == list(marks.values())
    # The text has the map of the scene's integrator, and lists the others.
    assert printed(text) == [marks["semi-implicit"]]
    assert found.sentences[0].startswith("semi-implicit: of 6 cells, ")
    assert "Not shown: the maps of 7 other integrators (--all" in " ".join(text.split())
    data = json.loads(found.to_json())
    assert len(data["rows"]) == 8 * 2 * 3 and data["units"]["dt"] == "s"
    assert {"setting", "value", "dt", "state", "error", "theory"} <= set(data["rows"][0])
    figure = found.plot(tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[0] == "explicit (theory: grows at any dt)" and len(titles) == 9
    page = found.to_html(tmp_path / "map.html")
    assert page.count("<img") == 1 and "stiffness" in page
    assert repr(found) == "<StabilityMap of spring: 48 cells in 8 panels>"


def test_fills_are_told_apart_without_colour():
    """Luminance (WCAG) differs by a factor of 1.4 or more between any two states."""
    from stepcore.report.plot.stability import FILLS

    def luminance(fill):
        rgb = np.array([int(fill[k : k + 2], 16) for k in (1, 3, 5)]) / 255
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722]) + 0.05

    light = sorted(map(luminance, FILLS.values()))
    assert all(b / a > 1.4 for a, b in itertools.pairwise(light))


@pytest.mark.parametrize(
    ("model", "options", "says"),
    (
        ("lesson:drop", {}, "path = None: must name the value"),
        ("lesson:spring", {"path": "joint/sprig/stiffness"}, 'nearest: "spring"'),
        ("lesson:spring", {"path": SPRING, "values": []}, "values"),
        (
            "lesson:spring",
            {"path": SPRING, "values": [1, -1]},
            r"values\[1\] = -1: must be a finite number > 0",
        ),
        ("lesson:spring", {"path": SPRING, "values": [1, 1]}, "the same number twice"),
        ("lesson:spring", {"path": SPRING, "dts": [0]}, r"dts\[0\] = 0"),
        ("lesson:spring", {"path": SPRING, "integrators": "rk5"}, "rk5"),
        ("lesson:spring", {"path": SPRING, "integrators": []}, "at least one"),
        ("lesson:spring", {"path": SPRING, "horizon": 1e-9}, "the largest dt"),
        ("lesson:spring", {"path": SPRING, "deviation": 0}, "deviation = 0"),
        ("lesson:spring", {"path": SPRING, "engine": "bullet"}, "engine = 'bullet'"),
        ("lesson:spring", {"path": SPRING, "key": "nowhere"}, "nowhere"),
        ("lesson:spring", {"path": SPRING, "executor": 3}, "executor"),
        ("lesson:spring", {"path": SPRING, "progress": 3}, "progress"),
        ("lesson:spring", {"path": SPRING, "threads": 0}, "threads"),
        (
            "lesson:spring",
            {"path": "joint/spring/damping"},
            "must be given, because joint/spring/damping is 0.0",
        ),
    ),
)
def test_bad_arguments_are_refused(model, options, says):
    with pytest.raises(ValueError, match=says):
        stability_map(model, **options)


def test_the_command(capsys, tmp_path):
    grid = ["--values", "10,1e4", "--dts", "1e-3:1e-1:3", "--threads", "1"]
    command = ["stability-map", "lesson:spring", SPRING, *grid, "--integrator", "rk4"]
    assert main([*command, "--json", "--plot", str(tmp_path / "m.png")]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["dts"] == pytest.approx([1e-3, 1e-2, 1e-1])
    assert [panel["setting"] for panel in data["panels"]] == ["rk4"]
    assert main([*command, "--html", str(tmp_path / "m.html")]) == 0
    assert "largest accurate" in capsys.readouterr().out
    for wrong in ("a,b", "1:2", "2:1:3", "1:2:1"):
        assert main(["stability-map", "lesson:spring", SPRING, "--values", wrong]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_rungs_that_damp_a_fast_swing_do_not_pass_for_converged():
    """Law: `discrete` in steps of 10 ms brings a swing of 1 m and 1000 rad/s to rest: its error is
    the RMS of the swing, 1/√2 m. In steps of 2.5 and of 1.25 ms rk4 brings it to rest, too."""
    scene = Change({"joint/spring/stiffness": 1e6}).of(lesson.spring().compile())
    study = Study(scene, sc.Motion(horizon=2.5, starts=1, key="start"), period=0.2)
    truth = study.truth(0.2)
    assert truth.error < 0.02
    (damped,) = study.run([Change(integrator="discrete", dt=0.01)], error=0.2)
    assert damped.error == pytest.approx(1 / np.sqrt(2), rel=0.3)


@pytest.mark.parametrize("friction", [0.0, 1.0])
def test_what_friction_alone_holds_is_said(friction):
    """kv/I is 500/s: an explicit step of more than 4 ms is unstable once the wheel turns."""
    scene = sc.loads(f"""<mujoco><option gravity="0 0 0" integrator="Euler"/><worldbody><body>
      <joint name="wheel" axis="0 0 1" frictionloss="{friction}"/>
      <inertial pos="0 0 0" mass="1" diaginertia=".01 .01 .01"/></body></worldbody><actuator>
      <velocity name="v" joint="wheel" kv="5"/></actuator><keyframe><key ctrl=".01"/></keyframe>
      </mujoco>""")
    steps = {"values": [5.0], "dts": [0.002, 0.02]}
    found = sc.stability_map(scene, path="actuator/v/kv", integrators="euler", **steps)
    short, long = (cell.state for cell in found.rows)
    assert short == "accurate" and long == ("accurate" if friction else "inaccurate")
    said = any(text.startswith("1 of the accurate runs") for text in found.sentences)
    assert said == bool(friction)
    moving = sc.Sim(scene, integrator="euler", dt=0.02)
    moving.qvel[:] = 1.0
    with pytest.raises(sc.SimulationError):
        moving.step(2000)
