"""Exit statuses, baselines, JUnit and SARIF files, and the assertions of `stepcore.testing`."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

import stepcore as sc
from stepcore import lesson, testing
from stepcore.cli import main
from stepcore.experiment import Change, Study
from stepcore.experiment.accuracy import judge_error
from stepcore.mjcf.places import Places
from stepcore.report.verdict import Located, Verdict, junit, sarif

# A keyframe outside of a limit: an error. Line 3 has the joint.
OUTSIDE = """<mujoco>
 <worldbody><body>
  <joint name="knee" range="-90 90"/>
  <geom size=".1"/></body></worldbody>
 <keyframe><key name="home" qpos="2"/></keyframe>
</mujoco>
"""


@pytest.fixture
def outside(tmp_path):
    file = tmp_path / "outside.xml"
    file.write_text(OUTSIDE)
    return file


def call(*args):
    return main([*map(str, args), "--threads", "1"])


def test_error_is_passed_failed_or_undecided():
    error = Study(lesson.spring(), horizon=0.2).run(Change()).error
    study = Study(lesson.spring(), horizon=0.2)
    assert judge_error(study, 1.001 * error).passed is True
    assert judge_error(study, 0.999 * error).passed is False
    spent = Study(lesson.spring(), horizon=0.2, effort=1.0)
    verdict = spent.run(Change()).verdict(1e-12)
    assert verdict.passed is False and verdict.status == 1


def test_undecided_error_names_remedy():
    trial = Study(lesson.spring(), horizon=0.2).run(Change(), error=1e-3)
    within = trial.verdict(trial.error, "effort=1 may decide it")
    assert within.passed is None and within.status == 3 and "effort=1" in within.reason


def test_verdicts_repeat():
    verdicts = {
        judge_error(Study(lesson.drop(), horizon=0.2), limit)
        for limit in ("1mm",)
        for _ in range(5)
    }
    assert len(verdicts) == 1


@pytest.mark.parametrize(("limit", "status"), [("1m", 0), ("1um", 1)])
def test_trade_has_status_of_shipped_error(capsys, limit, status):
    args = ("trade", "lesson:spring", "--horizon", 0.2, "--starts", 2, "--further", 0)
    assert call(*args, "--max-error", limit) == status
    assert call(*args) == 0


@pytest.mark.parametrize(("dt", "level", "status"), [(1e-3, "error", 0), (1.0, "error", 1)])
def test_diagnose_has_status_of_wanted_step(capsys, dt, level, status):
    args = ("diagnose", "lesson:spring", "--dt", dt, "--integrator", "semi-implicit")
    assert call(*args, "--fail-on", level) == status
    assert call(*args, "--fail-on", "never") == 0


def test_compare_has_status_of_distance(capsys, tmp_path):
    soft, stiff = tmp_path / "soft.xml", tmp_path / "stiff.xml"
    lesson.spring().save(soft)
    scene = lesson.spring()
    scene.joints[0].stiffness *= 2
    scene.save(stiff)
    args = ("compare", soft, stiff, "--horizon", 0.2, "--starts", 1)
    assert call(*args, "--max-difference", "1um") == 1
    assert call(*args, "--max-difference", "10m") == 0


def test_baseline_accepts_recorded_findings(capsys, outside, tmp_path):
    kept = tmp_path / "baseline.json"
    args = ("check", outside, "--horizon", 0.2)
    assert call(*args, "--save-baseline", kept) == 1
    assert call(*args, "--baseline", kept) == 0
    kept.write_text(json.dumps({"findings": [{"kind": "creep", "element": "contact `a`/`b`"}]}))
    capsys.readouterr()
    assert call(*args, "--baseline", kept) == 1
    said = capsys.readouterr().err
    assert "new since the baseline: outside a limit" in said
    assert "vanished since the baseline: creep contact `a`/`b`" in said


@pytest.mark.parametrize("text", [None, "{", '{"findings": [1]}'])
def test_wrong_baseline_is_refused(capsys, outside, tmp_path, text):
    kept = tmp_path / "baseline.json"
    if text is not None:
        kept.write_text(text)
    assert call("check", outside, "--horizon", 0.2, "--baseline", kept) == 2
    assert "save-baseline" in capsys.readouterr().err


def test_files_name_lines(capsys, outside, tmp_path):
    xml, log = tmp_path / "out.xml", tmp_path / "out.sarif"
    assert call("check", outside, "--horizon", 0.2, "--junit", xml, "--sarif", log) == 1
    run = json.loads(log.read_text())["runs"][0]
    result = next(row for row in run["results"] if row["ruleId"] == "outside a limit")
    place = result["locations"][0]["physicalLocation"]
    assert place["region"]["startLine"] == 3
    assert place["artifactLocation"]["uri"] == str(outside)
    suite = ElementTree.parse(xml).getroot()
    assert int(suite.get("tests")) == len(suite.findall("testcase"))
    assert suite.get("failures") == "1" and suite.find("testcase/failure") is not None
    # A second run replaces both.
    assert call("check", outside, "--horizon", 0.2, "--junit", xml, "--sarif", log) == 1


def test_sarif_has_required_properties():
    found = Located("creep", "remark", "text", "contact `a`/`b`", "robot.xml", 0, True)
    log = json.loads(sarif([found], "0.1.0"))
    assert log["version"] == "2.1.0" and log["$schema"].endswith("sarif-2.1.0.json")
    (run,) = log["runs"]
    driver, (result,) = run["tool"]["driver"], run["results"]
    assert driver["name"] and driver["rules"][result["ruleIndex"]]["id"] == result["ruleId"]
    assert result["level"] in ("none", "note", "warning", "error")
    assert result["message"]["text"] == "text"
    assert result["locations"][0]["physicalLocation"]["region"]["startLine"] >= 1
    assert result["baselineState"] == "unchanged"


@pytest.mark.parametrize(
    ("passed", "failures", "errors"), [(True, "0", "0"), (False, "1", "0"), (None, "0", "1")]
)
def test_junit_counts_outcome(passed, failures, errors):
    suite = ElementTree.fromstring(junit("suite \x07", Verdict("test", passed, "a < b & c")))
    assert (suite.get("failures"), suite.get("errors")) == (failures, errors)


def test_places_of_included_and_unnamed_elements(tmp_path):
    (tmp_path / "legs.xml").write_text(
        '<mujocoinclude>\n<body><geom name="foot" size=".1"/>\n<joint name="foot"/></body>\n'
        "</mujocoinclude>"
    )
    main_file = tmp_path / "robot.xml"
    main_file.write_text(
        '<mujoco><worldbody><include file="legs.xml"/></worldbody>\n'
        '<actuator>\n<motor name="foot" joint="foot"/></actuator></mujoco>'
    )
    places = Places(str(main_file))
    legs = str(tmp_path / "legs.xml")
    assert places.of("contact", "contact `floor`/`foot`") == (legs, 2)
    assert places.of("joint", "spring of joint `foot`") == (legs, 3)
    assert places.of("actuator", "motor `foot`") == (str(main_file), 3)
    assert places.of("actuator", "motor 0") == (str(main_file), 1)
    assert Places("lesson:spring").of("joint", "joint `spring`") == ("lesson:spring", 1)


def test_assertions_raise_with_answer(outside):
    testing.assert_accurate(lesson.spring(), "1m", horizon=0.2)
    with pytest.raises(AssertionError, match="required: error at most 1 µm"):
        testing.assert_accurate(lesson.spring(), "1um", horizon=0.2)
    with pytest.raises(AssertionError, match="outside"):
        testing.assert_no_findings(outside, level="error", horizon=0.2)
    stiff = lesson.spring().compile().with_values({"joint/spring/stiffness": 90.0})
    testing.assert_same(lesson.spring(), lesson.spring(), within="1mm", horizon=0.2)
    with pytest.raises(AssertionError, match="joint/spring/stiffness"):
        testing.assert_same(lesson.spring(), stiff, within="1mm", horizon=0.2)


def test_bad_arguments_are_refused_before_anything_runs():
    with pytest.raises(ValueError, match="error"):
        testing.assert_accurate(lesson.spring(), "1N", horizon=0.2)
    with pytest.raises(ValueError, match="remark"):
        testing.assert_no_findings(lesson.spring(), level="worst")
    with pytest.raises(ValueError, match="within"):
        testing.assert_same(lesson.spring(), lesson.spring(), within="1%")


def test_check_verdict_counts_accepted_findings():
    result = sc.check(sc.loads(OUTSIDE), progress=False, horizon=0.2)
    assert result.verdict("error").passed is False
    finding = result.findings[0]
    assert result.verdict("error", {(finding.kind, finding.element)}).passed is True
    assert result.verdict("never").passed is True


def test_action_fails_for_a_finding(tmp_path, outside):
    """The steps of action.yml and of the hook, run by a shell, without the installation."""
    root = Path(__file__).parents[2]
    action = yaml.safe_load((root / "action.yml").read_text())
    (hook,) = yaml.safe_load((root / ".pre-commit-hooks.yaml").read_text())
    script = action["runs"]["steps"][1]["run"]
    folder = tmp_path / "bin"
    folder.mkdir()
    command = folder / "stepcore"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m stepcore "$@"\n')
    command.chmod(0o755)
    quick = tmp_path / "spring.xml"
    lesson.spring().save(quick)
    env = {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}", "FAIL_ON": "error"}
    env |= {"BASELINE": "", "MAX_ERROR": "", "SARIF": str(tmp_path / "sarif")}
    for file, status in ((quick, 0), (outside, 1)):
        env["FILES"] = str(file)
        assert subprocess.run(["bash", "-c", script], env=env).returncode == status
        words = [*shlex.split(hook["entry"]), str(file)]
        assert subprocess.run(words, env=env).returncode == status
    assert len(list((tmp_path / "sarif").iterdir())) == 2


@pytest.mark.parametrize(("limit", "status"), [("1deg", 0), ("1e-9deg", 3)])
def test_trade_has_status_of_a_mean(capsys, limit, status):
    args = ("trade", "gymnasium:inverted_pendulum", "--quantity", "max(joint/hinge)")
    more = ("--horizon", 0.2, "--starts", 64, "--most", 64)
    assert call(*args, *more, "--max-error", limit) == status


def test_max_error_takes_one_quantity(capsys):
    args = ("trade", "lesson:spring", "--quantity", "energy", "--quantity", "joint/spring")
    more = ("--error", "1J", "--error", "1m", "--horizon", 0.1, "--starts", 1, "--further", 0)
    assert call(*args, *more, "--max-error", "1m") == 2
    assert "takes one quantity" in capsys.readouterr().err
