"""Compare every figure of the lesson with its reference: an integrator's growth, a contact's
depth, a stack's convergence, a grasp's force.

Example:
  stepcore lesson --extremes
"""

from __future__ import annotations

import argparse

from stepcore import lesson
from stepcore.cli.output import add_json, print_json
from stepcore.cli.usage import Usage
from stepcore.lesson import extremes


def add(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--engine", choices=("rust", "numpy"), default="rust", help="default: %(default)s"
    )
    command.add_argument(
        "--extremes", action="store_true", help="its scenes and two models at extreme values"
    )
    add_json(command)


def call(args: argparse.Namespace) -> int:
    if args.extremes and args.engine != "rust":
        raise Usage("--extremes: needs --engine rust")
    part = extremes if args.extremes else lesson
    rows = extremes.run() if args.extremes else lesson.run(args.engine)
    if args.json:
        print_json([row.to_dict() for row in rows])
    else:
        print(part.report(rows))
    return 0 if all(row.ok for row in rows) else 1
