"""Find the element that limits the time step under each integrator: a spring, damper, servo,
contact, limit or connect, with its frequency and damping. For a time step that is not stable,
list changes of the model or the settings that make it so.

Example:
  stepcore diagnose gymnasium:half_cheetah --dt 0.01
"""

from __future__ import annotations

import argparse

from stepcore.cli.motion import add_file, add_motion, model_of, motion_of
from stepcore.cli.output import add_output
from stepcore.experiment.schedule import HORIZON
from stepcore.measure.diagnosis import diagnose
from stepcore.report.result import Result


def add(command: argparse.ArgumentParser) -> None:
    add_file(command)
    command.add_argument(
        "--dt", type=float, metavar="S", help="time step that is wanted [s] (default: the model's)"
    )
    # The states come from one run.
    add_motion(command, without=("starts",), horizon=HORIZON)
    add_output(command, full="print every element on its own, under every integrator")


def call(args: argparse.Namespace) -> Result:
    # What would be warned of is what the result says in full.
    model = model_of(args, warn=False)
    return diagnose(model, dt=args.dt, **motion_of(args, model))
