"""Test whether the solver's sweeps converge the contact forces of a model. The report says which
contacts are furthest from converged, how fast the sweeps converge, and whether more sweeps or
smaller time steps reduce the error more for the same work.

Example:
  stepcore converge lesson:stack --plot residual.png
"""

from __future__ import annotations

import argparse

from stepcore.cli.motion import add_file, add_motion, model_of, motion_of
from stepcore.cli.output import add_output
from stepcore.experiment.schedule import HORIZON
from stepcore.measure.convergence import STARTS, converge
from stepcore.report.result import Result


def add(command: argparse.ArgumentParser) -> None:
    add_file(command)
    command.add_argument(
        "--states",
        type=int,
        default=8,
        metavar="N",
        help="number of states at which sweeps are measured (default: %(default)s)",
    )
    add_motion(command, horizon=HORIZON, starts=STARTS)
    add_output(command, full="print every row, all runs of equal work, the residual by sweeps")


def call(args: argparse.Namespace) -> Result:
    model = model_of(args)
    return converge(model, states=args.states, **motion_of(args, model))
