"""`stepcore trade`."""

from __future__ import annotations

import argparse
from typing import Any

from stepcore.cli.options import add_file, add_motion, add_output, check_output, deliver, motion_of


def add(commands: Any) -> None:
    trade = commands.add_parser("trade", help="what speed costs in accuracy on a model")
    add_file(trade)
    add_motion(trade)
    add_output(trade)
    trade.add_argument("--all", action="store_true", help="print every setting")
    trade.set_defaults(call=call)


def call(args: argparse.Namespace) -> None:
    from stepcore.lookup import find_scene
    from stepcore.trade import trade

    check_output(args)
    result = trade(find_scene(args.file), **motion_of(args))
    deliver(result, args, full=args.all)
