"""Look for what makes a model misbehave, in seconds: overlaps, masses that no real thing has, units
that look like mm or degrees, states outside of limits, servos that are too weak, too stiff or
saturated, contacts that creep or sink in; then the element that limits the time step. Each finding
names its cure. The first command to run on a scene that misbehaves.

Example:
  stepcore check gymnasium:half_cheetah
"""

from __future__ import annotations

import argparse
from dataclasses import replace

from stepcore.cli.motion import OPTIONS, add_file, add_motion, model_of, motion_of
from stepcore.cli.output import add_output
from stepcore.experiment.schedule import HORIZON
from stepcore.measure.check import check, file_in_words
from stepcore.report.result import Result


def add(command: argparse.ArgumentParser) -> None:
    add_file(command)
    command.add_argument(
        "--depth",
        metavar="LENGTH",
        help='name the solref with which contacts rest at this depth: metres, or "0.1mm"',
    )
    add_motion(command, without=("starts",), horizon=HORIZON)
    add_output(command)


def call(args: argparse.Namespace) -> Result:
    # What would be warned of is what the result says in full.
    model = model_of(args, warn=False)
    source = model if args.without or args.fuse is False else args.file
    result = check(source, depth=args.depth, **motion_of(args, model))
    # The commands that it names take the same file and motion.
    given = {name: getattr(args, name, None) for name in OPTIONS}
    return replace(
        result,
        file=file_in_words(args.file, args.without, args.fuse is not False),
        options={name: str(value) for name, value in given.items() if value is not None},
    )
