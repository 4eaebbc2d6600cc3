"""Every pair of values occurs by default, in few cases; the rest of the product is long."""

import itertools

import pytest
from covering import covering, every_pair, every_value, first

LAW, CONE, ENGINE = ("rigid", "lesson", "relaxed"), ("pyramidal", "elliptic"), ("rust", "numpy")


def pairs(cases):
    return {pair for case in cases for pair in itertools.combinations(enumerate(case), 2)}


@pytest.mark.parametrize("sizes", [(3, 2), (2, 2, 2), (24, 8, 5), (4, 3, 2, 2, 1), (3, 3, 3, 3)])
def test_every_pair_occurs_in_few_cases(sizes):
    """Law: no design has fewer cases than its two longest factors have pairs; 1.3 times at most."""
    product = list(itertools.product(*map(range, sizes)))
    chosen = [product[i] for i in covering(product, 2)]
    longest = sorted(sizes)[-2:]
    assert pairs(chosen) == pairs(product)
    assert len(chosen) == len(set(chosen)) <= 1.3 * longest[0] * longest[1]


def everyday(decorator):
    """The values of the default run, and how many cases there are in all."""
    cases = decorator.args[1]
    return [tuple(case.values) for case in cases if not case.marks], len(cases)


def test_the_rest_of_a_product_is_long():
    chosen, number = everyday(every_pair(law=LAW, cone=CONE, engine=ENGINE))
    assert number == 12 and len(chosen) == 6
    assert pairs(chosen) == pairs(itertools.product(LAW, CONE, ENGINE))
    chosen, number = everyday(every_value(law=LAW, cone=CONE))
    assert number == 6 and len(chosen) == 3
    assert {law for law, _ in chosen} == set(LAW) and {cone for _, cone in chosen} == set(CONE)
    assert everyday(first(3, seed=range(40))) == ([(0,), (1,), (2,)], 40)

    chosen, _ = everyday(every_pair(**{"law, cone": [("rigid", "elliptic")]}, engine=ENGINE))
    assert chosen == [("rigid", "elliptic", engine) for engine in ENGINE]


def test_what_cannot_be_together_is_no_case():
    def where(law, cone):
        return (law, cone) != ("rigid", "elliptic")

    chosen, number = everyday(every_pair(where, law=LAW, cone=CONE))
    assert number == len(chosen) == 5 and ("rigid", "elliptic") not in chosen
