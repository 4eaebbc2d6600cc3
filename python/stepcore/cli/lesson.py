"""Check the engine on the lesson: four small scenes (spring, drop, stack, grasp) whose results are
known: the energy growth of an integrator, the depth of a contact, the convergence of a stack, the
force of a grasp.

Example:
  stepcore lesson --all
"""

from __future__ import annotations

import argparse

from stepcore import lesson
from stepcore.cli.output import add_json, print_json
from stepcore.cli.terminal import put


def add(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--engine",
        choices=("rust", "numpy"),
        default="rust",
        help="implementation to test (default: %(default)s)",
    )
    command.add_argument(
        "--all", action="store_true", help="print every figure beside its reference"
    )
    add_json(command)


def call(args: argparse.Namespace) -> int:
    rows = lesson.run(args.engine)
    if args.json:
        print_json([row.to_dict() for row in rows])
    else:
        put(str(lesson.report(rows, full=args.all)))
    return 0 if all(row.ok for row in rows) else 1
