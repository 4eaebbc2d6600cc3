"""`stepcore replay`."""

from __future__ import annotations

import argparse
from typing import Any

from stepcore.cli.options import add_output, check_output, deliver


def add(commands: Any) -> None:
    replay = commands.add_parser("replay", help="run a failure again and say what drove it")
    replay.add_argument("file", metavar="FILE", help="what a failed run wrote")
    add_output(replay)
    replay.set_defaults(call=call)


def call(args: argparse.Namespace) -> None:
    from stepcore.engine.replay import replay

    check_output(args)
    deliver(replay(args.file), args)
