"""Settings whose steps keep an accuracy, as candidates of a trade."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from stepcore._core import Settings
from stepcore.engine.linear_maps import STAGED
from stepcore.engine.sim import Sim
from stepcore.experiment.experiment import Experiment
from stepcore.measure.trade.methods import Kind, Steps
from stepcore.measure.trade.run_cache import RunCache

# Round accuracies: 1, 2 or 5 times a power of ten [m per simulated second].
ROUND = (1.0, 2.0, 5.0)
# The first accuracy tried, relative to the error that it should meet: most motions deliver a tenth
# to a hundredth of it (`benches/accuracy.py`).
FIRST = 5.0
# How many rounds of runs one error takes at most, and the longest stride in round accuracies, ten
# times.
ROUNDS, STRIDE = 8, 3
# The finest accuracy tried, as the index of a round one: 1 nm, which double precision carries.
FINEST = -27


def adaptive(cache: RunCache, steps: Steps, kind: Kind, errors: Sequence[float]) -> list[Settings]:
    """Return, for each error [m], the coarsest round accuracy that meets it in every start.

    errors: the largest first. Each setting has at most half the error of the one before, so that
    the answer can say what half costs; none is asked for that the reference cannot verify.

    A step is a control period long. The list is empty where steps cannot keep an accuracy: under a
    law or with an element that a step of a fixed length defines.
    """
    base = _base(cache.experiment, steps, kind)
    if base is None:
        return []
    found: list[Settings] = []
    starts = len(cache.experiment.schedule.starts)
    for error in errors:
        if found:
            error = min(error, cache.score(found[-1], starts).error / 2)
        setting = None
        if cache.reference.high < error < math.inf:
            setting = _coarsest(cache, base, error)
        if setting is None:
            break
        found.append(setting)
    return found


def within(
    experiment: Experiment, steps: Steps, kind: Kind, accuracies: Iterable[float]
) -> list[Settings]:
    """Return settings whose steps keep these accuracies; empty where steps cannot keep one."""
    base = _base(experiment, steps, kind)
    return [] if base is None else [base.replace(accuracy=asked) for asked in accuracies]


def rung(index: int) -> float:
    """Return a round accuracy [m]; 0 is 1 m.

    >>> [rung(k) for k in (-1, 0, 1, 2, 3)]
    [0.5, 1.0, 2.0, 5.0, 10.0]
    """
    power, k = divmod(index, len(ROUND))
    return float(f"{ROUND[k]:g}e{power}")


def _base(experiment: Experiment, steps: Steps, kind: Kind) -> Settings | None:
    shipped = kind.shipped
    changes = kind.newton if kind.smooth and kind.rows else {}
    integrator = "euler" if shipped.integrator in STAGED else shipped.integrator
    changes |= {"dt": steps.period, "integrator": integrator, "precision": "f64"}
    try:
        base = shipped.replace(accuracy=1.0, sleep=False, ledger=False, **changes)
        Sim(experiment.model, base)
    except ValueError:
        return None
    return base


def _coarsest(cache: RunCache, base: Settings, error: float) -> Settings | None:
    """Return the coarsest accuracy that meets an error in every start; None if none tried does."""
    starts = len(cache.experiment.schedule.starts)
    horizon = cache.experiment.schedule.horizon
    index = math.floor(len(ROUND) * math.log10(FIRST * error / horizon))
    meets: dict[int, bool] = {}
    stride = STRIDE
    for _ in range(ROUNDS):
        index = max(index, FINEST)
        if index in meets:
            break
        setting = base.replace(accuracy=rung(index))
        cache.screen([setting], starts, "search: accuracy")
        meets[index] = cache.score(setting, starts).error <= error
        good = max((k for k in meets if meets[k]), default=None)
        bad = min((k for k in meets if not meets[k]), default=None)
        if good is None:
            index -= stride
        elif bad is None:
            index += stride
        elif bad - good <= 1:
            break
        else:
            index = (good + bad) // 2
    good = max((k for k in meets if meets[k]), default=None)
    return None if good is None else base.replace(accuracy=rung(good))
