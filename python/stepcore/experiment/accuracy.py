"""Decide whether settings meet an error: refine the converged motion until the test is decided."""

from __future__ import annotations

from stepcore.experiment.change import Change
from stepcore.experiment.study import SHIPPED, Study
from stepcore.report.units import rounded
from stepcore.report.verdict import Verdict

# Divisors of the error in question, from which the converged motion's uncertainty follows. An
# error within a thousandth of the limit stays undecided.
FINER = (1, 10, 100)


def judge_error(study: Study, limit: float | str, change: Change = SHIPPED) -> Verdict:
    """Return whether settings have at most an error in every start of a study.

    limit: the error: metres, "1mm", or "0.1%" of the scene's size; of another quantity "2N", or
    "1%" of its range. The work is bounded by the study's effort, not by time, so that the verdict
    is the same on every machine.

    >>> from stepcore import lesson
    >>> judge_error(Study(lesson.spring(), horizon=0.2), "1m").passed
    True
    """
    error = study.error_of("judge_error", limit)
    for finer in FINER:
        trial = study.run(change, error=error / finer)
        effort = rounded(2 * study.effort, 1)
        verdict = trial.verdict(error, f"effort={effort:.0e} may decide it")
        if verdict.passed is not None:
            break
    return verdict
