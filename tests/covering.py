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
        name, [_param([value], i < count) for i, value in enumerate(values)]
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
    cases = []
    for case in itertools.product(*(_values(*factor) for factor in factors.items())):
        places, names, values = zip(*case, strict=True)
        values = tuple(itertools.chain(*values))
        if where is None or where(*values):
            cases.append((places, values, "-".join(names)))
    everyday = set(covering([places for places, _, _ in cases], strength))
    return pytest.mark.parametrize(
        ",".join(factors),
        [_param(values, i in everyday, name) for i, (_, values, name) in enumerate(cases)],
    )


def _values(factor, values):
    """The place of each value, what it is called in the name of a case, and itself as arguments.

    A factor "a, b" has tuples for values, as in pytest's own parametrize.
    """
    for i, value in enumerate(values):
        arguments = value if "," in factor else (value,)
        word = "-".join(
            str(one) if isinstance(one, (str, float, int)) else getattr(one, "__name__", "")
            for one in arguments
        )
        yield i, word if 0 < len(word) < 40 else f"{factor}{i}", arguments


def _param(values, everyday, name=None):
    return pytest.param(*values, marks=() if everyday else pytest.mark.long, id=name)
