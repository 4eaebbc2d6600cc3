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
    """Parametrizes with one factor (seeds), whose first values are tried by default."""
    ((name, values),) = factor.items()
    return pytest.mark.parametrize(
        name, [_param(one, i < count, word) for i, word, one in _values(name, values)]
    )


def covering(cases, strength):
    """The places of few cases that hold all combinations of `strength` values that any case holds.

    Greedy: first the cases that bring the most combinations which are not there yet.
    """
    held = [set(itertools.combinations(enumerate(case), strength)) for case in cases]
    chosen, covered = [], set()
    for gain in range(max(map(len, held), default=0), 0, -1):
        for i, combinations in enumerate(held):
            # A gain only sinks: none is above this one any more.
            if len(combinations - covered) == gain:
                chosen.append(i)
                covered |= combinations
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
        word = "-".join(map(_word, arguments))
        yield i, word if 0 < len(word) < 40 else f"{factor}{i}", arguments


def _word(value):
    if isinstance(value, (str, float, int)):
        return str(value)
    return getattr(value, "__name__", "") or getattr(value, "name", "")


def _param(values, everyday, name):
    return pytest.param(*values, marks=() if everyday else pytest.mark.long, id=name)
