"""How a command writes its result: as text, JSON, a plot or a page."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from stepcore.cli.usage import Usage
from stepcore.report.result import Result
from stepcore.report.table import jsonable


def add_output(
    command: argparse.ArgumentParser, *, full: str = "print every row of the tables"
) -> None:
    """Options of a command whose result is a `Result`; full: what --all prints."""
    output = command.add_argument_group("output")
    output.add_argument("--plot", metavar="OUT", help="write the plot (.png, .svg, .pdf)")
    output.add_argument("--html", metavar="OUT", help="write a page of plot, text and tables")
    output.add_argument(
        "--json", nargs="?", const="-", metavar="OUT", help="print JSON, or write it to a file"
    )
    output.add_argument("--all", action="store_true", help=f"{full}, and every note")


def add_json(command: argparse.ArgumentParser) -> None:
    """The option of a command whose result is no `Result`."""
    command.add_argument("--json", action="store_true", help="print JSON instead of text")


def check_output(args: argparse.Namespace) -> None:
    """Checks, before minutes of work, that everything can be written at the end."""
    for name in ("plot", "html", "json", "save", "replay"):
        out = getattr(args, name, None)
        if isinstance(out, str) and out != "-":
            check_path(out, f"--{name}")
    if getattr(args, "plot", None) is not None:
        _need_matplotlib("--plot", args.plot)
    if getattr(args, "html", None) is not None:
        _need_matplotlib("--html")


def check_path(out: str, option: str) -> None:
    """Whether a file can be written there, as far as folders tell."""
    path = Path(out).resolve()
    if path.is_dir():
        raise Usage(f"{option} {out}: is a folder, not a file")
    if not path.parent.is_dir():
        raise Usage(f"{option} {out}: no such folder")


def deliver(result: Result, args: argparse.Namespace) -> None:
    """Writes and prints a result as `add_output` was asked."""
    to_file = args.json not in (None, "-")
    failed = attempted(
        args.plot and (lambda: result.plot(args.plot)),
        args.html and (lambda: result.to_html(args.html)),
        to_file and (lambda: _write(args.json, result.to_json())),
    )
    print(result.to_json() if args.json == "-" else result.text(full=args.all))
    for error in failed:
        raise error


def _write(out: str, text: str) -> None:
    Path(out).write_text(text + "\n", encoding="utf-8")


def attempted(*writes: Callable[[], object] | Any) -> list[Exception]:
    """Writes what is to be written; the errors of doing so, which must not hide a result."""
    failed = []
    for write in filter(None, writes):
        try:
            write()
        except Exception as error:
            failed.append(error)
    return failed


def print_json(data: Any) -> None:
    """Plain data as JSON."""
    print(json.dumps(jsonable(data), indent=2))


def _need_matplotlib(option: str, out: str | None = None) -> None:
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise Usage(f"{option} needs matplotlib: pip install 'stepcore[plot]'") from None
    known = Figure().canvas.get_supported_filetypes()
    if out is not None and Path(out).suffix.lstrip(".").lower() not in known:
        raise Usage(f"{option} {out}: the extension must be one of {', '.join(sorted(known))}")
