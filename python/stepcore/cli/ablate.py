"""Remove each modelled feature in turn (friction, damping, limits, a geom, ...) and measure how
much work that saves and how much error it adds; then find the smallest model within an error.

Example:
  stepcore ablate gymnasium:half_cheetah --added 5mm --save small.xml
"""

from __future__ import annotations

import argparse

from stepcore.cli.motion import add_file, add_motion, model_of, motion_of
from stepcore.cli.output import add_output
from stepcore.experiment.schedule import HORIZON, STARTS
from stepcore.measure.ablation import ablate
from stepcore.report.result import Result


def add(command: argparse.ArgumentParser) -> None:
    add_file(command)
    command.add_argument(
        "--added",
        "--error",
        default="1mm",
        metavar="LENGTH",
        help='error that the smallest model may add: metres, "1mm" or "0.1%%" of the '
        "scene's size (default: %(default)s)",
    )
    add_motion(command, horizon=HORIZON, starts=STARTS)
    add_output(command, full="print every feature")
    command.add_argument("--save", metavar="OUT.xml", help="write the smallest model as MJCF")


def call(args: argparse.Namespace) -> Result:
    model = model_of(args)
    result = ablate(model, added=args.added, **motion_of(args, model))
    if args.save is not None:
        result.smallest.save(args.save)
    return result
