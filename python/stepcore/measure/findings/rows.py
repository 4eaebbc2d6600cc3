"""The finding on rows that the solver does not solve."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stepcore.engine.model import Model
from stepcore.experiment.watch import Watch
from stepcore.experiment.watch.contacts import REST
from stepcore.measure.findings.finding import Finding
from stepcore.report.settings import solver_words
from stepcore.report.units import percent, speed, times

# Rows are not solved where this part of the speed that gravity gives in a step remains.
UNSOLVED = 0.1


def about_rows(model: Model, watch: Watch) -> Iterator[Finding]:
    """A residual that stays: the median over the last part of the run, beside gravity's speed."""
    settings = model.settings
    gravity = float(np.linalg.norm(model.scene.gravity)) if model.scene.features.gravity else 0.0
    given = gravity * settings.dt
    if not watch.residuals or not given:
        return
    late = watch.residuals[-max(1, int(REST * len(watch.residuals))) :]
    stays = float(np.median(late))
    if not stays > UNSOLVED * given:
        return
    share = percent(stays / given) if stays < given else times(stays / given)
    newton = ", or solver newton" if settings.law == "solref" and settings.solver == "pgs" else ""
    yield Finding(
        "residual",
        "warning",
        watch.unsolved,
        f"The rows are not solved by {solver_words(settings)}: a residual of {speed(stays)} stays, "
        f"{share} of what gravity gives in a step, worst in {watch.unsolved}: more sweeps{newton}, "
        "or smaller time steps; `stepcore converge` says how many.",
        stays,
        "m/s",
    )
