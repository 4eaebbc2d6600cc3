"""Measure how long a model's motion can be predicted: until runs that start a rounding error
apart are a thousand times as far apart. Beyond that time only statistics of the motion mean
anything, whatever the settings.

Example:
  stepcore predict gymnasium:ant --horizon 5 --plot growth.png
"""

from __future__ import annotations

import argparse

from stepcore.cli.motion import add_file, add_motion, model_of, motion_of
from stepcore.cli.output import add_output
from stepcore.experiment.schedule import STARTS
from stepcore.measure.predictability import HORIZON, predict
from stepcore.report.result import Result


def add(command: argparse.ArgumentParser) -> None:
    add_file(command)
    add_motion(command, horizon=HORIZON, starts=STARTS)
    add_output(command)


def call(args: argparse.Namespace) -> Result:
    model = model_of(args)
    return predict(model, **motion_of(args, model))
