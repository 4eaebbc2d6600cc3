"""Numbers of threads that take turns with the same work, and what each gains over one thread."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np
import record

import stepcore as sc

COLUMNS = f"{'threads':>8}{'median [µs]':>13}{'gain':>6}{'quickest [µs]':>15}{'gain':>6}"
SAMPLES = 25
Stepped = sc.Sim | sc.Batch


def compare(
    report: record.Report, label: str, sides: Mapping[int, Stepped], calls: int, aims=None, **case
) -> None:
    """A line for each number of threads. The bits at the end are compared, which are the same.

    A sample is the quickest of so many calls of `step()`. aims: gains, by number of threads.
    """
    samples = 5 if report.options.quick else SAMPLES
    times = np.array([[quickest(side, calls) for side in sides.values()] for _ in range(samples)])
    if len({side.qpos.tobytes() for side in sides.values()}) > 1:
        raise AssertionError("the number of threads shows in the bits")
    median, least = np.median(times, axis=0), times.min(axis=0)
    for k, threads in enumerate(sides):
        aim = f"{aims[threads]:6.1f}" if aims and threads in aims else ""
        report.say(
            f"{label}{threads:8}{median[k]:13.1f}{median[0] / median[k]:6.2f}"
            f"{least[k]:15.1f}{least[0] / least[k]:6.2f}{aim}"
        )
        report.add(**case, threads=threads, median_us=median[k], least_us=least[k])


def quickest(side: Stepped, calls: int) -> float:
    """The quickest of some calls [µs]."""
    spent = []
    for _ in range(calls):
        start = time.perf_counter()
        side.step()
        spent.append(time.perf_counter() - start)
    return 1e6 * min(spent)
