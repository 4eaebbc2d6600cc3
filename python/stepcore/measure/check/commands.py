"""The next three commands that fit what a check found."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterator, Sequence

from stepcore.engine.model import Model
from stepcore.measure.diagnosis import Diagnosis
from stepcore.measure.findings import Finding

# How many are named.
NEXT = 3
# A stability margin below this deserves a look.
MARGIN = 2.0


def next_commands(
    file: str, model: Model, findings: Sequence[Finding], diagnosis: Diagnosis | None
) -> list[tuple[str, str]]:
    """Commands and why, the most useful first. file: what they call the scene."""
    left_out = [f" --without {line.split()[0]}" for line in model.scene.without]
    named = shlex.quote(file) + "".join(left_out)
    some = _fitting(named, model, {finding.kind: finding for finding in findings}, diagnosis)
    return list(dict(some).items())[:NEXT]


def _fitting(
    file: str, model: Model, found: dict[str, Finding], diagnosis: Diagnosis | None
) -> Iterator[tuple[str, str]]:
    dt = model.settings.dt
    limit = diagnosis.limit() if diagnosis else math.inf
    if limit < MARGIN * dt:
        yield f"stepcore diagnose {file}", "every element's largest stable dt, and all the advice"
    if "failure" in found:
        short = min(dt / 4, limit / 2 if limit > 0 else dt)
        yield f"stepcore run {file} --dt {short:.1g}", "whether a smaller time step survives"
        yield f"stepcore run {file}", "writes a replay of the failure for `stepcore replay`"
    if "creep" in found:
        ratio = re.search(r'impratio="(\S+)"', found["creep"].text)
        if ratio:
            changes = f"--set cone=elliptic --set impratio={ratio[1]}"
            yield f"stepcore run {file} {changes}", "whether the creep is gone"
    if "residual" in found:
        yield f"stepcore converge {file}", "how many sweeps, or how small a step, solve the rows"
    if found.keys() & {"depth at rest", "gap", "overlap", "overlap at the start"}:
        yield f"stepcore converge {file}", "whether the contacts are solved"
        yield f"stepcore run {file} --plot run.png", "energy and overlap over time"
    if found.keys() & {"limit", "saturation", "servo too weak", "servo sags", "clamped control"}:
        yield f"stepcore run {file} --plot run.png", "energy over time, with --ctrl or --control"
    if found.keys() & {"density", "inertia", "mass ratio", "units"}:
        yield f"stepcore plan {file} --all", "every body, geom and row that a step computes"
    yield f"stepcore trade {file} --error 1mm", "how large the error is, and what is cheaper"
    yield f"stepcore predict {file}", "for how long its motion can be predicted"
    yield f"stepcore plan {file}", "what a step computes"
