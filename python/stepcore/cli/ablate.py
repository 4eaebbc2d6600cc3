"""`stepcore ablate`."""

from __future__ import annotations

import argparse
from typing import Any

from stepcore.cli.options import (
    add_file,
    add_motion,
    add_output,
    check_output,
    check_path,
    deliver,
    motion_of,
)


def add(commands: Any) -> None:
    ablate = commands.add_parser("ablate", help="what each feature of a model costs and matters")
    add_file(ablate)
    add_motion(ablate)
    ablate.add_argument(
        "--error", type=float, default=1e-3, help="what the smallest model may add [m]"
    )
    ablate.add_argument("--save", metavar="OUT.xml", help="write the smallest model as MJCF")
    add_output(ablate)
    ablate.set_defaults(call=call)


def call(args: argparse.Namespace) -> None:
    from stepcore.measure.ablation import ablate
    from stepcore.reading import load

    check_output(args)
    if args.save is not None:
        check_path(args.save)
    result = ablate(load(args.file), error=args.error, **motion_of(args))
    if args.save is not None:
        result.smallest.save(args.save)
    deliver(result, args)
