"""`stepcore check`: what it prints and writes, and how a scene that is refused is told."""

import importlib
import json
import shlex

import pytest
from covering import first

import stepcore as sc
from stepcore.cli import main, parser
from stepcore.measure.check import Check
from stepcore.measure.check.described import LIST
from stepcore.measure.monitors import Finding, Next
from stepcore.measure.monitors.finding import TEST_CONTACTS

SCENE = """<mujoco model="arm"><worldbody><body name="arm">
<joint name="knee" axis="0 0 1" range="-90 90" damping="1"/><geom size=".1"/></body></worldbody>
<actuator><position name="servo" joint="knee" kp="5" ctrlrange="-1 1"/></actuator>
<keyframe><key name="home" qpos="{}" ctrl="0.5"/></keyframe></mujoco>"""


@pytest.fixture
def scene(tmp_path):
    def write(qpos, **changes):
        text = SCENE.format(qpos)
        for before, after in changes.values():
            text = text.replace(before, after)
        file = tmp_path / "arm.xml"
        file.write_text(text)
        return str(file)

    return write


def call(capsys, *args):
    status = main(["check", *map(str, args), "--threads", "1"])
    said = capsys.readouterr()
    return status, said.out, said.err


def test_it_prints_findings_the_diagnosis_and_commands(capsys, scene, monkeypatch):
    monkeypatch.setattr("stepcore.deadline.pace", (0.0, 0.0))  # However quick the machine is.
    file = scene(2.0)
    status, out, err = call(capsys, file, "--horizon", 0.2)
    # What the file alone shows is said before anything runs.
    assert status == 1 and err.startswith("stepcore: so far: 1 finding in the file alone:")
    out = " ".join(out.split())
    found = "Error: Keyframe `home` has joint `knee` at 2 rad"
    assert out.startswith(f"arm: check {found}")
    assert "The motion: 200 ms from keyframe `home`; servos hold the" in out
    assert "A step of 2 ms is stable under euler over 200 ms" in out
    # A long path is cut where the line ends.
    assert f"stepcoretrade{file}--error1mm" in out.replace(" ", "")
    status, out, _ = call(capsys, scene(0.5), "--horizon", 0.2)
    assert status == 0 and "No problems found in geometry, inertia, limits, servos" in out


def test_it_writes_data_and_a_page(capsys, scene, tmp_path):
    page, data = tmp_path / "check.html", tmp_path / "check.json"
    args = ["--horizon", 0.2, "--html", page, "--json", data]
    assert call(capsys, scene(2.0), *args)[0] == 1
    assert "Keyframe <code>home</code> has joint <code>knee</code>" in page.read_text()
    (row,) = json.loads(data.read_text())["rows"]
    assert row["kind"] == "outside a limit" and row["severity"] == "error"
    assert row["value"] == 2.0 and row["unit"] == "rad" and row["element"] == "joint `knee`"


def test_the_motion_is_the_user_s(capsys, scene, tmp_path):
    (tmp_path / "fast.py").write_text("def fast(time, sim):\n    return [(-1) ** (time > 0.05)]\n")
    args = ["--control", f"{tmp_path / 'fast.py'}:fast", "--horizon", 0.1]
    weak = ('name="servo"', 'name="servo" forcerange="-.1 .1"')
    status, out, _ = call(capsys, scene(0.5, weak=weak), *args)
    out = " ".join(out.split())
    assert status == 0 and "Servo `servo` follows " in out and "its force ends at 100 mN·m" in out
    assert "another motion" not in out


def test_every_command_takes_the_same_file_and_motion(capsys, scene, tmp_path):
    """Each is one that the command line takes, with all that it has of what `check` was given."""
    control = f"{tmp_path / 'own.py'}:still"
    (tmp_path / "own.py").write_text("def still(time, sim):\n    return [0.0]\n")
    data = tmp_path / "check.json"
    options = {"--control": control, "--control-dt": "0.004", "--horizon": "0.1", "--seed": "3"}
    words = [word for option in options.items() for word in option]
    file = scene(2.0)
    given = [file, "--without", "sensor", "--no-fuse", "--key", "home", *words]
    assert call(capsys, *given, "--json", data)[0] == 1
    commands = [shlex.split(line) for line in json.loads(data.read_text())["next"]]
    assert len(commands) == 3
    for _, *argv in commands:
        args = parser(argv).parse_args(argv)
        assert (args.file, args.without, args.fuse, args.key) == (file, ["sensor"], False, "home")
        if argv[0] in ("trade", "predict", "diagnose", "converge"):
            assert (args.control, args.control_dt, args.horizon) == (control, 0.004, 0.1)
            assert args.seed == 3
        if argv[0] == "run":
            assert (args.control, args.control_dt, args.horizon) == (control, 0.004, 0.1)


@pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")
@first(
    2,
    options=[
        ["--ctrl", "my log.csv", "--interpolation", "linear", "--key", "home"],
        ["--ctrl", "servo=0.3", "--without", "sensor", "--horizon", "50ms"],
        ["--control", "own.py:still", "--control-dt", "4ms"],
    ],
)
def test_every_command_that_is_printed_runs(capsys, scene, tmp_path, monkeypatch, options):
    """In the folder of the user's files, each as it stands, with the user's own motion."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my log.csv").write_text("t,knee\n0,0.1\n0.025,0.3\n0.04,0.2\n")
    (tmp_path / "own.py").write_text("def still(time, sim):\n    return [0.0]\n")
    if "--horizon" not in options:
        options = [*options, "--horizon", "80ms"]
    # A servo that is nearly too stiff for the step: `diagnose` is named too.
    stiff = ('kp="5"', 'kp="7000"')
    assert call(capsys, scene(0.5, stiff=stiff), *options, "--json", "check.json")[0] == 0
    commands = json.loads((tmp_path / "check.json").read_text())["next"]
    assert len(commands) == 3
    for line in commands:
        program, *argv = shlex.split(line)
        assert program == "stepcore"
        given = [] if argv[0] in ("plan",) else options[: 2 + 2 * (options[0] == "--ctrl")]
        assert all(word in argv for word in given if word not in ("--without", "sensor"))
        assert main(argv) == 0, line
    capsys.readouterr()


def test_commands_of_python_name_the_user_s_files(scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = scene(0.5)
    (tmp_path / "log.csv").write_text("t,knee\n0,0.1\n0.025,0.3\n")
    (tmp_path / "still_arm.py").write_text("def still(time, sim):\n    return [0.0]\n")
    monkeypatch.syspath_prepend(tmp_path)
    still = importlib.import_module("still_arm").still
    motions = {
        "--ctrl log.csv": {"ctrl": "log.csv"},
        "--ctrl servo=0.3": {"ctrl": {"servo": 0.3}},
        "--ctrl 0.3": {"ctrl": [[0.3]]},
        f"--control {tmp_path / 'still_arm.py'}:still": {"control": still},
        "--ctrl FILE.npy": {"ctrl": [[0.3], [0.4]]},
    }
    for said, fields in motions.items():
        found = sc.check(file, horizon="50ms", progress=False, **fields)
        commands = [line for line, _ in found.commands]
        assert f"stepcore predict {file} --horizon 0.05 {said}" in commands


@pytest.mark.parametrize("kind", ["overlap", "creep", "failure", "residual", "units"])
def test_commands_are_ones_that_the_command_line_takes(kind):
    findings = {
        "overlap": TEST_CONTACTS,
        "creep": (Next("run", "", ("--set", "impratio=100")),),
        "failure": (Next("run", ""),),
        "residual": (Next("converge", ""),),
        "units": LIST,
    }
    found = Finding(kind, "error", "It is so", commands=findings[kind])
    every = {"horizon": "1", "seed": "2", "key": "0", "ctrl": "a b.csv", "control_dt": "0.1"}
    made = Check(sc.Settings(), sc.Motion(), [found], None, options=every, name="name")
    assert len(made.commands) == 3
    for line, _ in made.commands:
        argv = shlex.split(line)[1:]
        parser(argv).parse_args(argv)


def test_a_scene_that_is_refused_is_told_with_what_is_wrong(capsys, scene):
    """An inverted range that is asked to limit is refused at load, in one line."""
    inverted = ('range="-90 90"', 'range="90 -90" limited="true"')
    status, out, err = call(capsys, scene(0.5, inverted=inverted))
    assert status == 2 and not out and err.count("\n") == 1
    assert "range" in err and "the first smaller" in err
    status, out, err = call(capsys, scene(0.5), "--depth", "deep")
    assert status == 2 and "depth = 'deep'" in err


def test_the_exit_status_is_that_of_the_worst_finding(capsys, scene):
    file = scene(2.0)
    assert call(capsys, file, "--horizon", 0.1)[0] == 1
    assert call(capsys, file, "--horizon", 0.1, "--fail-on", "never")[0] == 0


@pytest.mark.parametrize(
    "severity, not_done, statuses",
    [
        ("error", (), (1, 1, 0)),
        ("error", ("the run as shipped",), (1, 1, 0)),
        ("warning", (), (0, 1, 0)),
        ("warning", ("the run as shipped",), (3, 1, 0)),
        ("remark", (), (0, 0, 0)),
        ("remark", ("the diagnosis of the time step",), (0, 0, 0)),
    ],
)
def test_a_finding_fails_at_its_level_and_a_missing_run_is_undecided(severity, not_done, statuses):
    shown = {"name": "arm", "settings": None, "motion": None, "diagnosis": None}
    result = Check(**shown, findings=[Finding("overlap", severity, "")], not_done=not_done)
    levels = ("error", "warning", "never")
    assert tuple(result.verdict(level).status for level in levels) == statuses
