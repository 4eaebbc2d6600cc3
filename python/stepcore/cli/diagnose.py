"""`stepcore diagnose`."""

from __future__ import annotations

import argparse
from typing import Any

from stepcore.cli.options import add_file, add_motion, add_output, check_output, deliver, motion_of


def add(commands: Any) -> None:
    diagnose = commands.add_parser("diagnose", help="which element limits the time step")
    add_file(diagnose)
    diagnose.add_argument("--dt", type=float, help="the step that is wanted [s]")
    # One start is looked along.
    add_motion(diagnose, several=False)
    add_output(diagnose)
    diagnose.set_defaults(call=call)


def call(args: argparse.Namespace) -> None:
    from stepcore.measure.diagnosis import diagnose

    check_output(args)
    motion = motion_of(args)
    if motion["horizon"] is None:
        motion.pop("horizon")
    deliver(diagnose(args.file, dt=args.dt, **motion), args)
