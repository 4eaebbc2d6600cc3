"""`stepcore predict`."""

from __future__ import annotations

import argparse
from typing import Any

from stepcore.cli.options import add_file, add_motion, add_output, check_output, deliver, motion_of


def add(commands: Any) -> None:
    predict = commands.add_parser("predict", help="how long a model's motion can be predicted")
    add_file(predict)
    add_motion(predict)
    add_output(predict)
    predict.set_defaults(call=call)


def call(args: argparse.Namespace) -> None:
    from stepcore.measure.predictability import predictability
    from stepcore.reading import load

    check_output(args)
    deliver(predictability(load(args.file), **motion_of(args)), args)
