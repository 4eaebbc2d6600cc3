"""Options of commands in continuous integration: levels and limits, baselines, JUnit, SARIF."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from stepcore import checks
from stepcore.cli.arguments import length
from stepcore.cli.terminal import Usage, print_error
from stepcore.experiment.accuracy import judge_error
from stepcore.experiment.study import Study
from stepcore.loading import model_file
from stepcore.mjcf.places import Places
from stepcore.report.outputs import MARK
from stepcore.report.result import Result
from stepcore.report.verdict import Located, Verdict, junit, sarif

LEVELS = ("error", "warning", "never")
# The option that makes a test of each command.
TESTS = {
    "check": "fail_on",
    "diagnose": "fail_on",
    "trade": "max_error",
    "compare": "max_difference",
}


def add_gate(command: argparse.ArgumentParser, name: str) -> None:
    """Add the options of a command whose result can be tested."""
    if name not in TESTS:
        return
    gate = command.add_argument_group("continuous integration")
    if name in ("check", "diagnose"):
        fails = (
            "exit with status 1 if a finding is of this level or worse, and with 3 if none is but "
            "the time was over before the run was examined"
            if name == "check"
            else "exit with status 1 if the step is unstable, unless this is 'never', and with 3 "
            "if the time was over before"
        )
        help_of_level = f"{fails} (default: %(default)s)"
        gate.add_argument("--fail-on", choices=LEVELS, default="error", help=help_of_level)
    else:
        words = {
            "trade": "error of the settings in the file: an amount as for --error",
            "compare": "distance of the two motions as shipped: an amount as for --within",
        }[name]
        gate.add_argument(
            f"--{TESTS[name].replace('_', '-')}",
            metavar="AMOUNT",
            type=length if name == "compare" else str,
            help=f"largest accepted {words}; the exit status is 0 if it is met, 1 if not, and 3 if "
            "the uncertainty leaves it undecided",
        )
    gate.add_argument("--junit", metavar="OUT", help="write the outcome as a JUnit file (.xml)")
    if name == "check":
        gate.add_argument(
            "--sarif", metavar="OUT", help="write the findings as a SARIF file, with their lines"
        )
        gate.add_argument(
            "--baseline",
            metavar="FILE",
            help="findings in this file do not fail; new and vanished ones are reported",
        )
        gate.add_argument(
            "--save-baseline", metavar="OUT", help="write the present findings as a baseline"
        )


def finish(result: Result, args: argparse.Namespace) -> int:
    """Report the outcome of the test of a result, write its files, and return the exit status."""
    if args.command not in TESTS or getattr(args, TESTS[args.command]) is None:
        return 0
    accepted = _baseline(args)
    verdict = _verdict(result, args, accepted)
    findings = _located(result, args, accepted) if args.command == "check" else []
    if getattr(args, "baseline", None) is not None:
        _report_changes(result, accepted)
    if args.command in ("trade", "compare") or verdict.passed is None:
        print_error(f"{verdict}")
    if args.junit is not None:
        suite = f"stepcore {args.command} {args.file}"
        Path(args.junit).write_text(junit(suite, verdict, findings), encoding="utf-8")
    if getattr(args, "sarif", None) is not None:
        from importlib import metadata

        text = sarif(findings, metadata.version("stepcore"))
        Path(args.sarif).write_text(text, encoding="utf-8")
    if getattr(args, "save_baseline", None) is not None:
        _save_baseline(result, args.save_baseline)
    return verdict.status


def _verdict(result: Any, args: argparse.Namespace, accepted: set[tuple[str, str]]) -> Verdict:
    verdict: Verdict
    if args.command == "check":
        verdict = result.verdict(args.fail_on, accepted)
    elif args.command == "diagnose":
        never = Verdict("the step", True, "--fail-on never")
        verdict = never if args.fail_on == "never" else result.verdict()
    elif args.command == "compare":
        verdict = result.verdict(args.max_difference)
    elif result.measure.parts:
        raise Usage(f"--max-error {args.max_error}: takes one quantity")
    elif result.kind == "outcomes":
        verdict = result.verdict(args.max_error)
    else:
        source = args.file if result.model is None else result.model
        quantity = result.measure.quantity
        how: dict[str, Any] = {"engine": result.engine, "effort": result.effort}
        study = Study(source, result.motion, quantity=quantity, **how)
        verdict = judge_error(study, args.max_error)
    return verdict


def _located(
    result: Any, args: argparse.Namespace, accepted: set[tuple[str, str]]
) -> list[Located]:
    """Return the findings of a check with file and line of their elements."""
    places = Places(model_file(args.file))
    rows = []
    for finding in result.findings:
        kind = finding.elements[0].owner_kind if finding.elements else ""
        file, line = places.of(kind, finding.element)
        old = (finding.kind, finding.element) in accepted
        text = finding.text
        rows.append(Located(finding.kind, finding.severity, text, finding.element, file, line, old))
    return rows


def _baseline(args: argparse.Namespace) -> set[tuple[str, str]]:
    """Return the kind and the element of each finding in the baseline."""
    file = getattr(args, "baseline", None)
    if file is None:
        return set()
    try:
        rows = json.loads(Path(file).read_text(encoding="utf-8"))["findings"]
        return {(str(row["kind"]), str(row["element"])) for row in rows}
    except OSError as error:
        raise Usage(f"--baseline {file}: {error.strerror}; --save-baseline writes one") from None
    except (ValueError, KeyError, TypeError):
        text = f"--baseline {checks.shown(file)}: must be a file that --save-baseline wrote"
        raise Usage(text) from None


def _report_changes(result: Any, accepted: set[tuple[str, str]]) -> None:
    present = {(finding.kind, finding.element) for finding in result.findings}
    for word, rows in (("new", present - accepted), ("vanished", accepted - present)):
        for kind, element in sorted(rows):
            print_error(f"{word} since the baseline: {kind} {element}".rstrip())


def _save_baseline(result: Any, out: str) -> None:
    rows = [{"kind": f.kind, "element": f.element, "text": f.text} for f in result.findings]
    text = json.dumps({"note": MARK, "findings": rows}, indent=1, ensure_ascii=False)
    Path(out).write_text(f"{text}\n", encoding="utf-8")
