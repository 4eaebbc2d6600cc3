"""`stepcore converge`."""

from __future__ import annotations

import argparse
from typing import Any

from stepcore.cli.options import add_file, add_motion, add_output, check_output, deliver, motion_of


def add(commands: Any) -> None:
    converge = commands.add_parser(
        "converge", help="whether a model's contacts are solved, and what would solve them"
    )
    add_file(converge)
    add_motion(converge)
    add_output(converge)
    converge.add_argument(
        "--states", type=int, default=8, help="states at which sweeps are measured"
    )
    converge.set_defaults(call=call, starts=3)


def call(args: argparse.Namespace) -> None:
    from stepcore.measure.convergence import converge
    from stepcore.reading import load

    check_output(args)
    deliver(converge(load(args.file), states=args.states, **motion_of(args)), args)
