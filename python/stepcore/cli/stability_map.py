"""Map the stability and accuracy of a model over the time step and one of its values (a stiffness,
a mass, a gain). There is one map for each integrator, with the stability limit from theory.

Example:
  stepcore stability-map lesson:spring joint/spring/stiffness --values 10:1e4:16 --plot map.png
"""

from __future__ import annotations

import argparse
import math

from stepcore.cli.motion import OPTIONS, add_file, add_motion, model_of, motion_of
from stepcore.cli.output import add_output
from stepcore.cli.usage import Usage
from stepcore.measure.stability import STEPS, stability_map
from stepcore.report.result import Result

LIST = "numbers a,b,c or FIRST:LAST:COUNT on a log scale"
# The map runs one start, without controls.
WITHOUT = tuple(name for name in OPTIONS if name not in ("horizon", "key"))


def add(command: argparse.ArgumentParser) -> None:
    words = " (default: lesson:spring; also lesson:stack)"
    add_file(command, nargs="?", default="lesson:spring", words=words)
    command.add_argument(
        "path", metavar="VALUE", nargs="?", help='value to vary, such as "joint/knee/stiffness"'
    )
    command.add_argument("--values", metavar="LIST", help=f"values to try: {LIST}")
    command.add_argument("--dts", metavar="LIST", help=f"time steps to try [s]: {LIST}")
    command.add_argument(
        "--integrator",
        action="append",
        metavar="NAME",
        help="integrator to map; may be given several times",
    )
    command.add_argument(
        "--deviation",
        "--error",
        default="10%",
        metavar="E",
        help="deviation from the true motion above which a run is inaccurate: metres, 1mm, or a "
        "percentage of the scene's size (default: 10%%)",
    )
    command.add_argument(
        "--size",
        type=float,
        metavar="M",
        help="length that deviations are relative to [m] (default: the scene's size)",
    )
    longest = f"1, or {STEPS} times the largest time step if that is longer"
    add_motion(command, without=WITHOUT, horizon=longest)
    add_output(command)


def call(args: argparse.Namespace) -> Result:
    model = model_of(args)
    return stability_map(
        model if args.without or args.fuse is False else args.file,
        path=args.path,
        values=None if args.values is None else numbers("--values", args.values),
        dts=None if args.dts is None else numbers("--dts", args.dts),
        integrators=args.integrator,
        deviation=args.deviation,
        size=args.size,
        **motion_of(args, model),
    )


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
