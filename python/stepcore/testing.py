"""Assertions on models, for tests in pytest or any other framework.

Each raises AssertionError whose message is the answer that a command prints. Verdicts depend on
counted work and on uncertainties, not on the speed of the machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Unpack

from stepcore import checks
from stepcore.experiment.accuracy import judge_error
from stepcore.experiment.arguments import Source
from stepcore.experiment.motion import Motion, MotionFields
from stepcore.experiment.quantity import Quantity
from stepcore.experiment.study import EFFORT, Study
from stepcore.measure.check import check
from stepcore.measure.comparison import compare
from stepcore.measure.monitors.finding import SEVERITIES
from stepcore.report import units
from stepcore.report.verdict import Verdict

__all__ = ["assert_accurate", "assert_no_findings", "assert_same"]


def assert_accurate(
    model: Source,
    error: float | str,
    motion: Motion | str | None = None,
    *,
    quantity: Quantity | str | Callable[..., Any] | None = None,
    engine: str = "stepcore",
    effort: float = EFFORT,
    **fields: Unpack[MotionFields],
) -> None:
    """Assert that the settings in a model have at most an error in every start of a motion.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name").
    error: the largest accepted error: metres, "1mm", or "0.1%" of the scene's size; of another
        quantity in its unit, or "1%" of its range.
    motion: the `stepcore.Motion`, or its fields as arguments; by default one that the machine
        could make, of about 1 s.
    quantity: the quantity whose error is measured; by default the motion of all bodies.
    engine: "stepcore" or "mujoco".
    effort: the most operations of all runs.

    Raises AssertionError if a start has a larger error, and if the effort does not decide it.
    Raises ValueError for an argument outside its limits.

    >>> from stepcore import lesson
    >>> assert_accurate(lesson.spring(), "1m", horizon=0.2)
    >>> assert_accurate(lesson.spring(), "1um", horizon=0.2)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    AssertionError: failed: 41.6 mm (± ...) in the worst of 8 starts; required: error at most 1 µm
    """
    study = Study(model, motion, quantity=quantity, engine=engine, effort=effort, **fields)
    _assert(judge_error(study, error), "")


def assert_no_findings(
    model: Source,
    level: str = "warning",
    motion: Motion | str | None = None,
    **fields: Unpack[MotionFields],
) -> None:
    """Assert that `stepcore.check` has no finding of a level, or of a more severe one.

    model, motion: as in `assert_accurate`. level: "error", "warning" or "remark".

    Raises AssertionError with the findings, and ValueError for an argument outside its limits.

    >>> from stepcore import lesson
    >>> assert_no_findings(lesson.spring(), level="error")
    """
    checks.one_of(*SEVERITIES)("assert_no_findings", "level", level)
    result = check(model, motion, progress=False, **fields)
    _assert(result.verdict(level), str(result))


def assert_same(
    model: Source,
    other: Source,
    within: float | str,
    motion: Motion | str | None = None,
    **fields: Unpack[MotionFields],
) -> None:
    """Assert that two models, as shipped, make motions with at most a distance.

    model, other: as `model` in `assert_accurate`. The motion is one of the first model.
    within: the largest accepted RMS distance: metres, or a text such as "1mm".

    Raises AssertionError with the differences that matter, and ValueError for an argument outside
    its limits.

    >>> from stepcore import lesson
    >>> assert_same(lesson.drop(), lesson.drop(), within="1mm")
    """
    limit = units.length("assert_same", "within", within, math.nan)
    result = compare(model, other, motion, progress=False, **fields)
    _assert(result.verdict(limit), str(result))


def _assert(verdict: Verdict, answer: str) -> None:
    if verdict.passed is not True:
        raise AssertionError("\n\n".join(filter(None, (str(verdict), answer))))
