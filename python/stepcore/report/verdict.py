"""`Verdict`: whether a result passes a test of continuous integration; JUnit and SARIF files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

from stepcore.escapes import printable
from stepcore.report.outputs import MARK

# The exit status of a command for each outcome; 2 is a usage or input error.
STATUS = {True: 0, False: 1, None: 3}
WORDS = {True: "passed", False: "failed", None: "undecided"}
LEVELS = {"error": "error", "warning": "warning", "remark": "note"}
SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"


@dataclass(frozen=True)
class Verdict:
    """The outcome of a test.

    test: what was tested. passed: None if the uncertainty, or missing time, leaves it undecided.
    reason: the numbers that decide it, and for an undecided test how to decide it.
    """

    test: str
    passed: bool | None
    reason: str

    @property
    def status(self) -> int:
        """The exit status: 0 passed, 1 failed, 3 undecided."""
        return STATUS[self.passed]

    def __str__(self) -> str:
        return f"{WORDS[self.passed]}: {self.reason}; required: {self.test}"


@dataclass(frozen=True)
class Located:
    """A finding for a file of results.

    rule: its kind. level: "error", "warning" or "remark". text: the finding as a sentence.
    element: the name of its element, or "". file, line: the place of the element in the model's
    file. accepted: whether it is in the baseline.
    """

    rule: str
    level: str
    text: str
    element: str
    file: str
    line: int
    accepted: bool = False


def junit(suite: str, verdict: Verdict, findings: Sequence[Located] = ()) -> str:
    """Return a JUnit file: a test case for the verdict, and one for each finding.

    A finding in the baseline is a skipped test. A finding below the level that fails passes, with
    its text as output.
    """
    root = ElementTree.Element("testsuite", name=printable(suite), tests=f"{len(findings) + 1}")
    case = ElementTree.SubElement(root, "testcase", classname="stepcore", name=verdict.test)
    if verdict.passed is False:
        _add(case, "failure", verdict.reason)
    elif verdict.passed is None:
        _add(case, "error", f"undecided: {verdict.reason}")
    for finding in findings:
        name = printable(f"{finding.rule} {finding.element}".strip())
        case = ElementTree.SubElement(root, "testcase", classname=finding.level, name=name)
        case.set("file", printable(finding.file))
        case.set("line", str(finding.line))
        if finding.accepted:
            _add(case, "skipped", "in the baseline")
        else:
            ElementTree.SubElement(case, "system-out").text = printable(finding.text)
    for tag, count in (("failures", verdict.passed is False), ("errors", verdict.passed is None)):
        root.set(tag, str(int(count)))
    ElementTree.indent(root)
    return f"<!-- {MARK} -->\n{ElementTree.tostring(root, encoding='unicode')}\n"


def _add(case: ElementTree.Element, tag: str, message: str) -> None:
    ElementTree.SubElement(case, tag, message=printable(message))


def sarif(findings: Sequence[Located], version: str) -> str:
    """Return a SARIF 2.1.0 file, which code hosts show beside the lines of the model."""
    rules = sorted({finding.rule for finding in findings})
    driver = {
        "name": "stepcore",
        "version": version,
        "rules": [{"id": rule, "shortDescription": {"text": rule}} for rule in rules],
    }
    results = [_sarif_result(finding, rules) for finding in findings]
    run = {"tool": {"driver": driver}, "results": results, "properties": {"note": MARK}}
    return json.dumps({"$schema": SCHEMA, "version": "2.1.0", "runs": [run]}, indent=1) + "\n"


def _sarif_result(finding: Located, rules: Sequence[str]) -> dict[str, Any]:
    place = {
        "artifactLocation": {"uri": finding.file},
        "region": {"startLine": max(1, finding.line)},
    }
    location: dict[str, Any] = {"physicalLocation": place}
    if finding.element:
        location["logicalLocations"] = [{"name": finding.element}]
    return {
        "ruleId": finding.rule,
        "ruleIndex": rules.index(finding.rule),
        "level": LEVELS[finding.level],
        "message": {"text": finding.text},
        "locations": [location],
        "baselineState": "unchanged" if finding.accepted else "new",
    }
