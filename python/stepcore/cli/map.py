"""`stepcore map`."""

from __future__ import annotations

import argparse
import math
from typing import Any

from stepcore.cli.options import Usage, add_output, check_output, deliver

LIST = "numbers a,b,c or FIRST:LAST:COUNT on a log scale"


def add(commands: Any) -> None:
    one = commands.add_parser("map", help="where dt and a value leave runs of use, and where not")
    one.add_argument(
        "file",
        metavar="FILE",
        nargs="?",
        default="lesson:spring",
        help="path, package:name or lesson:name (default: lesson:spring; also lesson:stack)",
    )
    one.add_argument("path", metavar="VALUE", nargs="?", help='as "joint/knee/stiffness"')
    one.add_argument("--values", metavar="LIST", help=LIST)
    one.add_argument("--dts", metavar="LIST", help=f"time steps [s], {LIST}")
    one.add_argument("--integrator", action="append", help="may be given several times")
    one.add_argument("--horizon", type=float, help="simulated time [s] (default: about 1)")
    one.add_argument("--error", type=float, default=0.1, help="a larger share is inaccurate")
    one.add_argument("--size", type=float, help="what errors are relative to [m]")
    one.add_argument("--key", help="keyframe to start from")
    one.add_argument("--threads", type=int, help="runs at once (default: one a core)")
    add_output(one)
    one.set_defaults(call=call)


def call(args: argparse.Namespace) -> None:
    from stepcore.measure.stability import stability_map

    check_output(args)
    result = stability_map(
        args.file,
        args.path,
        None if args.values is None else numbers("--values", args.values),
        None if args.dts is None else numbers("--dts", args.dts),
        integrator=args.integrator,
        horizon=args.horizon,
        error=args.error,
        size=args.size,
        key=args.key,
        threads=args.threads,
    )
    deliver(result, args)


def numbers(option: str, text: str) -> list[float]:
    """A list as it is written on the command line."""
    try:
        if ":" not in text:
            return [float(part) for part in text.split(",")]
        first, last, count = text.split(":")
        low, high, some = float(first), float(last), int(count)
    except ValueError:
        raise Usage(f"{option} {text}: must be {LIST}") from None
    if not (0 < low < high < math.inf and 2 <= some <= 1000):
        limit = "0 < FIRST < LAST and a COUNT of 2 to 1000"
        raise Usage(f"{option} {text}: must have {limit}")
    ratio = (high / low) ** (1 / (some - 1))
    return [low * ratio**k for k in range(some)]
