"""List what a step of a model computes and what it leaves out, with the reason and with the
operations that each entry costs.

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
    command.add_argument("--time", action="store_true", help="measure times [µs] as well")
    add_output(command, full="print the names of all elements")


def call(args: argparse.Namespace) -> Result:
    model, sim = model_of(args), None
    if args.key is not None:
        sim = Sim(model)
        sim.reset(key=key_of(args, model))
    return plan(model, sim=sim, time=args.time)
