"""What the ledger costs: the same steps with it off and on, in turns, in processor time.

    python benches/ledger.py [--rounds 15] [--seconds 0.05]

Each round plays both sides one after the other from the same state; the figure is the median of
the rounds' ratios, with the quartiles. The aim is below 5 %.
"""

import argparse
import statistics
import time

from scenes import find  # noqa: I001  (the benches' own models)

import stepcore as sc
from stepcore import lesson
