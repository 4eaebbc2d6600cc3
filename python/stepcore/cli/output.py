"""Output of a command's result as text, JSON, a plot or a page."""

from __future__ import annotations

import argparse
import contextlib
import os
import stat
from collections.abc import Callable
from pathlib import Path

from stepcore import files
from stepcore.cli.terminal import Usage, print_above
from stepcore.needs import installing
from stepcore.report.outputs import is_replaceable
from stepcore.report.result import Result

# Arguments that name output files, and their options.
OPTIONS = {name: f"--{name}" for name in ("plot", "html", "json", "save", "replay", "junit")}
OPTIONS |= {"page": "--html", "sarif": "--sarif", "save_baseline": "--save-baseline"}

# Output files, and the functions that write them.
Writes = list[tuple[str, Callable[[], object]]]


def add_output(
    command: argparse.ArgumentParser, *, full: str = "print every row of the tables"
) -> None:
    """Add the options of a command that returns a `Result`; full: the help of --all."""
    output = command.add_argument_group("output")
    output.add_argument("--plot", metavar="OUT", help="write the plot (.png, .svg, .pdf)")
    output.add_argument("--html", metavar="OUT", help="write a page of plot, text and tables")
    output.add_argument(
        "--json", nargs="?", const="-", metavar="OUT", help="print JSON, or write it to a file"
    )
    add_force(output)
    output.add_argument("--all", action="store_true", help=f"{full}, and every note")


def add_force(command: argparse._ActionsContainer) -> None:
    """Add the option --force of a command that writes files."""
    command.add_argument(
        "--force",
        action="store_true",
        help="replace existing files that stepcore did not write; files that the command reads are "
        "never replaced",
    )


def check_output(args: argparse.Namespace) -> None:
    """Check before the run that every output file can be written."""
    named = ((option, getattr(args, name, None)) for name, option in OPTIONS.items())
    outputs = [(option, out) for option, out in named if isinstance(out, str) and out != "-"]
    files.outputs.clear()
    control = getattr(args, "control", None) or ""
    inputs = [
        *(getattr(args, name, None) for name in ("file", "ctrl", "baseline")),
        control.rpartition(":")[0],
    ]
    inputs += getattr(args, "logs", ())
    for option, out in outputs:
        path = Path(out).resolve()
        if path.is_dir():
            raise Usage(f"{option} {out}: is a folder, not a file")
        if not path.parent.is_dir():
            raise Usage(f"{option} {out}: no such folder")
        if any(source and _same(out, source) for source in inputs):
            raise Usage(f"{option} {out}: is read by this command, so it is not written over")
        with contextlib.suppress(OSError):
            status = os.stat(out)
            if stat.S_ISREG(status.st_mode):
                # The command must not read this file later.
                files.outputs.add((status.st_dev, status.st_ino))
        if any(_same(out, other) for name, other in outputs if name != option):
            raise Usage(f"{option} {out}: another output of the command is the same file")
        if not is_replaceable(out) and not args.force:
            reason = "exists and is no earlier output of stepcore"
            raise Usage(f"{option} {out}: {reason}; --force replaces it")
    _check_matplotlib(getattr(args, "plot", None), getattr(args, "html", None))


def _same(path: str, other: str) -> bool:
    try:
        return os.path.samefile(path, other)
    except OSError:
        return os.path.realpath(path) == os.path.realpath(other)


def deliver(result: Result, args: argparse.Namespace) -> None:
    """Write and print a result according to the options of `add_output`."""
    writes: Writes = [
        (args.plot, lambda: result.plot(args.plot)),
        (args.html, lambda: result.to_html(args.html)),
        (args.json, lambda: Path(args.json).write_text(result.to_json() + "\n", encoding="utf-8")),
    ]
    failed = attempted([write for write in writes if write[0] not in (None, "-")])
    print_above(result.to_json() if args.json == "-" else result.text(full=args.all))
    for error in failed:
        raise error


def attempted(writes: Writes) -> list[Exception]:
    """Write files and return the errors, so that the result can be printed before raising them."""
    failed: list[Exception] = []
    for out, write in writes:
        try:
            write()
        except Exception as error:
            if isinstance(error, OSError) and error.filename is None:
                error.filename = out
            failed.append(error)
    return failed


def _check_matplotlib(plot: str | None, html: str | None) -> None:
    """Check that a plot or a page can be drawn, and that the plot's format is supported."""
    if plot is None and html is None:
        return
    try:
        from matplotlib.figure import Figure
    except ImportError:
        option = "--html" if plot is None else "--plot"
        raise Usage(f"{option} needs matplotlib: {installing('plot')}") from None
    formats = Figure().canvas.get_supported_filetypes()
    if plot is not None and Path(plot).suffix.lstrip(".").lower() not in formats:
        raise Usage(f"--plot {plot}: the extension must be one of {', '.join(sorted(formats))}")
