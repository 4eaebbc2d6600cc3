"""Run a model under many settings and compare each with a converged run: what speed costs in
accuracy. Given an error or a budget, recommend settings and confirm them on further starts.

Example:
  stepcore trade gymnasium:half_cheetah --error 1mm --plot trade.png
"""

from __future__ import annotations

import argparse

from stepcore.cli.motion import add_file, add_motion, model_of, motion_of
from stepcore.cli.output import add_output
from stepcore.experiment.schedule import HORIZON, STARTS
from stepcore.measure.trade import EFFORT, trade
from stepcore.report.result import Result


def add(command: argparse.ArgumentParser) -> None:
    add_file(command)
    wanted = command.add_mutually_exclusive_group()
    wanted.add_argument(
        "--error",
        metavar="LENGTH",
        help='recommend the cheapest settings within this error: metres, "1mm" or "0.1%%" of '
        "the scene's size",
    )
    wanted.add_argument(
        "--budget",
        metavar="COST",
        help='recommend the most accurate settings within this cost: "20us/step", "5ms/s", or '
        '"100x" real time',
    )
    command.add_argument(
        "--further",
        type=int,
        default=32,
        metavar="N",
        help="number of further starts that must confirm a recommendation (default: %(default)s)",
    )
    command.add_argument(
        "--by",
        choices=("time", "flops"),
        default="time",
        help="cost metric: wall time or floating-point operations (default: %(default)s)",
    )
    command.add_argument(
        "--grid", action="store_true", help="try a full grid of settings instead of a search"
    )
    command.add_argument(
        "--effort",
        type=float,
        default=EFFORT,
        metavar="STEPS",
        help="the most that the converged motion may cost, in steps × (dofs + 2); a larger one "
        "knows errors better and judges shorter time steps (default: %(default)g)",
    )
    command.add_argument("--mujoco", action="store_true", help="run MuJoCo on the same motion too")
    add_motion(command, horizon=HORIZON, starts=STARTS)
    add_output(command, full="print every setting")


def call(args: argparse.Namespace) -> Result:
    model = model_of(args)
    return trade(
        model,
        error=args.error,
        budget=args.budget,
        further=args.further,
        by=args.by,
        search="grid" if args.grid else None,
        mujoco=args.mujoco,
        effort=args.effort,
        **motion_of(args, model),
    )
