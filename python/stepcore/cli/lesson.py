"""`stepcore lesson`."""

from __future__ import annotations

import argparse
import json
from typing import Any

from stepcore.cli.options import Usage
from stepcore.report.table import jsonable


def add(commands: Any) -> None:
    lesson = commands.add_parser("lesson", help="every figure of the lesson beside its reference")
    lesson.add_argument("--engine", choices=("rust", "numpy"), default="rust")
    lesson.add_argument(
        "--extremes", action="store_true", help="its scenes and two models at the extremes instead"
    )
    lesson.add_argument("--json", action="store_true", help="print data instead of text")
    lesson.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from stepcore import lesson
    from stepcore.lesson import extremes

    if args.extremes and args.engine != "rust":
        raise Usage("--extremes: runs the Rust engine only")
    part = extremes if args.extremes else lesson
    rows = extremes.run() if args.extremes else lesson.run(args.engine)
    if args.json:
        print(json.dumps(jsonable([row.to_dict() for row in rows]), indent=2))
    else:
        print(part.report(rows))
    return 0 if all(row.ok for row in rows) else 1
