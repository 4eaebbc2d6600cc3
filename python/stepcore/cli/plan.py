"""List what a step of a model computes and how many operations each entry costs, and what the step
leaves out and why.

Example:
  stepcore plan gymnasium:half_cheetah --time
"""

from __future__ import annotations

import argparse

from stepcore.cli.motion import add_file, add_key, key_of, model_of
from stepcore.cli.output import add_output
from stepcore.engine.sim import Sim
from stepcore.measure.plan import plan
from stepcore.report.result import Result


def add(command: argparse.ArgumentParser) -> None:
    add_file(command)
    add_key(command)
    command.add_argument("--time", action="store_true", help="also measure times [µs]")
    add_output(command, full="print every entry, the names of all its elements")


def call(args: argparse.Namespace) -> Result:
    model, sim = model_of(args), None
    if args.key is not None:
        sim = Sim(model)
        sim.reset(key=key_of(args, model))
    return plan(model, sim=sim, time=args.time)
