"""`stepcore plan`."""

from __future__ import annotations

import argparse
from typing import Any

from stepcore.cli.options import add_file, add_output, check_output, deliver


def add(commands: Any) -> None:
    parser = commands.add_parser("plan", help="what a step of a model does, and what it leaves out")
    add_file(parser)
    parser.add_argument("--time", action="store_true", help="measure in µs as well")
    parser.add_argument("--all", action="store_true", help="print every name")
    add_output(parser)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> None:
    from stepcore.engine.sim import Sim
    from stepcore.measure.plan import plan
    from stepcore.reading import load

    check_output(args)
    model = load(args.file).compile()
    sim = None
    if args.key is not None:
        sim = Sim(model)
        sim.reset(key=int(args.key) if args.key.isdigit() else args.key)
    deliver(plan(model, sim=sim, time=args.time), args, full=args.all)
