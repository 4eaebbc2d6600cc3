"""Print the versions of stepcore and of the packages it works with, and the machine.

Example:
  stepcore info --json
"""

from __future__ import annotations

import argparse
import os
import platform
from importlib import metadata

from stepcore.cli.output import add_json, print_json

PACKAGES = ("stepcore", "numpy", "matplotlib", "mujoco")


def add(command: argparse.ArgumentParser) -> None:
    add_json(command)


def call(args: argparse.Namespace) -> None:
    facts = {package: _version(package) for package in PACKAGES} | {
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "cores": os.cpu_count(),
    }
    if args.json:
        print_json(facts)
    else:
        for name, fact in facts.items():
            print(f"{name:<12}{fact}")


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"
