"""The command `view`: a live view of a model, or a page that replays a run."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from stepcore.checks import one_line
from stepcore.cli.arguments import (
    add_file,
    add_horizon,
    add_key,
    controls_of,
    key_of,
    model_of,
    time,
)
from stepcore.cli.output import add_force, attempted
from stepcore.cli.run import add_inputs, motion_of_run, pushes_of
from stepcore.cli.terminal import Usage, put, say
from stepcore.engine.sim import Sim
from stepcore.experiment.control_table import control_table
from stepcore.measure.run import simulated
from stepcore.viewing.needs import need

TEXT = """\
Watch a model move, in a browser: paused, stepped, taken back in time, with sliders for its
controls, contact forces, energy and the residual. It prints the address of the page, which a
browser on another machine can open too (--host 0.0.0.0). With --html it runs the model and writes
a page that replays the run, which anybody opens without Python.

Example:
  stepcore view gymnasium:half_cheetah --ctrl bthigh=1,fthigh=-1 --html run.html
"""
# Default horizon of the run on a page [s].
HORIZON = 5.0


def text(name: str) -> str:
    """Return the description of the command and its example."""
    return TEXT


def add(command: argparse.ArgumentParser, name: str) -> None:
    """Add the options of the command."""
    add_file(command)
    add_key(command)
    command.add_argument(
        "--dt", type=time, metavar="S", help="time step [s] (default: the model's)"
    )
    live = command.add_argument_group("live view")
    live.add_argument(
        "--host",
        default="localhost",
        help="where the page is served; 0.0.0.0 lets other machines open it (default: this machine "
        "alone)",
    )
    live.add_argument("--port", type=int, default=8080, help="of the page (default: 8080)")
    page = command.add_argument_group("page")
    page.add_argument("--html", dest="page", metavar="OUT", help="write a page that replays a run")
    add_horizon(page, f"of that run [s] (default: {HORIZON:g})")
    add_inputs(command)
    add_force(page)


def call(args: argparse.Namespace, name: str) -> int:
    """Show the model, or write the page; return the exit status."""
    if args.page is not None:
        need("trimesh", f"--html {args.page}")
    elif args.horizon is not None:
        raise Usage("--horizon is of the run that --html writes; a live view has no end")
    horizon = args.horizon = HORIZON if args.horizon is None else args.horizon
    if not 0 < horizon < float("inf"):
        raise Usage(f"--horizon {horizon:g}: must be finite and > 0 s")
    model = model_of(args)
    sim = Sim(model, **({} if args.dt is None else {"dt": args.dt}))
    key = key_of(args, model)
    sim.reset(key=0 if key is None and model.keys else key)
    if args.page is None:
        _live(args, sim)
        return 0
    motion, pushes = motion_of_run(args, sim.model), pushes_of(args, model)
    run = simulated(sim, sim.settings, motion, horizon, pushes, ("qpos",), None)
    if run.error is not None:
        say(one_line(run.error))
    # The page of a failed run shows the motion up to the failure.
    seen = run.trajectory
    if seen is not None:
        for unsaved in attempted([(args.page, lambda: seen.save_html(args.page))]):
            raise unsaved
        put(f"{args.page}: {seen.time[-1] - seen.time[0]:g} s of motion")
    return 0 if run.success else 1


def _live(args: Any, sim: Sim) -> None:
    others = ("control", "control_dt", "follow")
    if any(getattr(args, name) is not None for name in others) or args.push:
        raise Usage("--control, --control-dt, --follow and --push drive the run that --html writes")
    if args.kind is not None:
        raise Usage("--motion drives the run that --html writes")
    if args.ctrl is not None:
        table = control_table(controls_of(args.ctrl, sim.model))
        sim.ctrl = table.log(sim.model, np.array(sim.ctrl), sim.settings.dt).rows[0]
    sim.view(host=args.host, port=args.port, wait=True)
