"""The reference of `tests.rs`: random and chosen arguments, and exact results in two numbers.

python reference.py 40 > reference.txt      (needs mpmath)
"""

import math
import random
import struct
import sys

import mpmath

mpmath.mp.prec = 1600  # Angles of 2¹⁰²³, and 400 bits more.
COUNT = int(sys.argv[1]) if len(sys.argv) > 1 else 40


def bits(x: float) -> str:
    return struct.pack(">d", x).hex()


def line(name: str, arguments: tuple[float, ...], exact: mpmath.mpf) -> None:
    """Nothing for results beyond the numbers or too small to have all digits."""
    if not 1e-290 < abs(exact) < 1e308:
        return
    head = float(exact)
    print(name, *map(bits, arguments), bits(head), bits(float(exact - mpmath.mpf(head))))


def spread(low: float, high: float) -> float:
    """Even in the logarithm, of either sign."""
    return random.choice((-1, 1)) * 2 ** random.uniform(low, high)


def both(low: float, high: float) -> float:
    return random.uniform(low, high)


random.seed(1)
for _ in range(COUNT):
    near_quarter = random.randrange(1, 1 << 20) * math.pi / 2
    for x in (both(-7, 7), spread(-30, 20), spread(20, 1023), near_quarter):
        line("sin", (x,), mpmath.sin(mpmath.mpf(x)))
        line("cos", (x,), mpmath.cos(mpmath.mpf(x)))
    for y, x in (
        (both(-1, 1), both(-1, 1)),
        (spread(-9, 9), spread(-9, 9)),
        (spread(-1000, 1000), spread(-1000, 1000)),
    ):
        line("atan2", (y, x), mpmath.atan2(mpmath.mpf(y), mpmath.mpf(x)))
    for x in (both(-1, 1), both(-700, 700), spread(-40, 9)):
        line("exp", (x,), mpmath.exp(mpmath.mpf(x)))
        line("exp_m1", (x,), mpmath.expm1(mpmath.mpf(x)))
    for x in (both(0.5, 2), abs(spread(-1070, 1023)), 1 + spread(-40, -2)):
        line("ln", (x,), mpmath.log(mpmath.mpf(x)))
    for x, y in (
        (both(0, 1), both(1, 6)),
        (abs(spread(-1070, 1000)), spread(-10, 2)),
        (1 + spread(-30, -4), spread(0, 30)),
        (both(0, 4), both(-300, 300)),
    ):
        line("pow", (x, y), mpmath.power(mpmath.mpf(x), mpmath.mpf(y)))
# The number of 53 bits that comes closest to a quarter turn (Kahan), and the largest.
for x in (6381956970095103 * 2.0**797, 1.7976931348623157e308):
    line("sin", (x,), mpmath.sin(mpmath.mpf(x)))
    line("cos", (x,), mpmath.cos(mpmath.mpf(x)))
