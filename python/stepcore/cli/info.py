"""`stepcore info`."""

from __future__ import annotations

import argparse
import json
import os
import platform
from typing import Any

from stepcore.report.table import Table


def add(commands: Any) -> None:
    info = commands.add_parser("info", help="versions and machine")
    info.add_argument("--json", action="store_true", help="print data instead of text")
    info.set_defaults(call=call)


def call(args: argparse.Namespace) -> None:
    from importlib import metadata

    def version(package: str) -> str | None:
        try:
            return metadata.version(package)
        except metadata.PackageNotFoundError:
            return None

    found = {name: version(name) for name in ("stepcore", "numpy", "matplotlib", "mujoco")}
    facts: dict[str, Any] = {
        **{name: text or "not installed" for name, text in found.items()},
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "cores": os.cpu_count(),
    }
    if args.json:
        print(json.dumps(facts, indent=2))
    else:
        print(Table({"": name, " ": str(fact)} for name, fact in facts.items()))
