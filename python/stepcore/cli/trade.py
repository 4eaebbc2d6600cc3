"""`stepcore trade`."""

from __future__ import annotations

import argparse
from typing import Any

from stepcore.cli.options import add_file, add_motion, add_output, check_output, deliver, motion_of


def add(commands: Any) -> None:
    trade = commands.add_parser("trade", help="what speed costs in accuracy on a model")
    add_file(trade)
    wanted = trade.add_mutually_exclusive_group()
    wanted.add_argument(
        "--error", help='recommend the cheapest settings within it: metres, "1mm", "0.1%%" of size'
    )
    wanted.add_argument(
        "--budget", help='recommend the most accurate within it: "20us/step", "5ms/s", "100x"'
    )
    add_motion(trade)
    trade.add_argument(
        "--further", type=int, default=16, help="further starts that confirm (default: 16)"
    )
    trade.add_argument("--by", choices=("time", "flops"), default="time", help="what cheap means")
    trade.add_argument("--grid", action="store_true", help="a full grid in place of the search")
    trade.add_argument("--mujoco", action="store_true", help="MuJoCo on the same motion too")
    add_output(trade)
    trade.add_argument("--all", action="store_true", help="print every setting")
    trade.set_defaults(call=call)


def call(args: argparse.Namespace) -> None:
    from stepcore.measure.trade import trade

    check_output(args)
    result = trade(
        args.file,
        error=args.error,
        budget=args.budget,
        further=args.further,
        by=args.by,
        search="grid" if args.grid else None,
        mujoco=args.mujoco,
        **motion_of(args),
    )
    deliver(result, args, full=args.all)
