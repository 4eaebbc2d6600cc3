"""Products of factors as test cases: a covering part every day, the rest with `pytest -m long`.

A fault that depends on two factors at once (a law under an integrator, a solver in f32) is found by
any design in which every pair of their values occurs. Such designs are as long as the two longest
factors multiplied; the product of all factors is not needed each day.
"""

import itertools

import pytest


def every_pair(where=None, /, **factors):
    """Parametrizes with a product of which every pair of two factors' values occurs by default."""
    return _parametrize(where, factors, strength=2)


def every_value(where=None, /, **factors):
    """Parametrizes with a product of which every value of each factor occurs by default.

    For factors that other tests pair, or whose pairs are no law of their own.
    """
    return _parametrize(where, factors, strength=1)


def first(count, /, **factor):
    """Parametrizes with the first draws of one long factor (seeds); the later ones are long."""
    ((name, values),) = factor.items()
    return pytest.mark.parametrize(
        name, [_case([value], i < count, None) for i, value in enumerate(values)]
    )


def covering(cases, strength):
    """The places of few cases that hold all combinations of `strength` values that any case holds.

    Greedy: each next case brings the most combinations that are not there yet.
    """
    left = [set(itertools.combinations(enumerate(case), strength)) for case in cases]
    chosen, covered = [], set()
    gains = [len(combinations) for combinations in left]
    while max(gains, default=0):
        best = max(range(len(cases)), key=gains.__getitem__)
        # A gain only sinks: the largest is looked at again before it is believed.
        left[best] -= covered
        if len(left[best]) < gains[best]:
            gains[best] = len(left[best])
            continue
        chosen.append(best)
        covered |= left[best]
        gains[best] = 0
    return chosen


def _parametrize(where, factors, strength):
    named = [_named(name, values) for name, values in factors.items()]
    places = [
        case
        for case in itertools.product(*(range(len(values)) for values in named))
        if where is None or where(*(values[i][1] for values, i in zip(named, case, strict=True)))
    ]
    everyday = set(covering(places, strength))
    cases = []
    for i, case in enumerate(places):
        names, values = zip(*(named[k][place] for k, place in enumerate(case)), strict=True)
        cases.append(_case(values, i in everyday, "-".join(names)))
    return pytest.mark.parametrize(list(factors), cases)


def _named(factor, values):
    """Each value with what it is called in the name of a case, as pytest calls values."""
    short = [
        str(value) if isinstance(value, (str, float, int)) else getattr(value, "__name__", "")
        for value in values
    ]
    return [
        (word if 0 < len(word) < 40 else f"{factor}{i}", value)
        for i, (word, value) in enumerate(zip(short, values, strict=True))
    ]


def _case(values, everyday, name):
    return pytest.param(*values, marks=() if everyday else pytest.mark.long, id=name)
