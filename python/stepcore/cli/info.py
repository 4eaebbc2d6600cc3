"""Print the versions of stepcore and of the packages it works with, and the machine.

Example:
  stepcore info --json
"""

from __future__ import annotations

import argparse
import os
import platform
import sysconfig
from importlib import metadata

from stepcore.cli.output import add_json, print_json
from stepcore.cli.terminal import put

# Its own, then those of the extras, and what has models.
PACKAGES = (
    *("stepcore", "numpy", "matplotlib", "trimesh", "viser", "mitsuba", "imageio-ffmpeg"),
    *("pillow", "pandas", "xarray", "mcap", "distributed", "gymnasium", "mujoco"),
)
WIDTH = 16


def add(command: argparse.ArgumentParser) -> None:
    add_json(command)


def call(args: argparse.Namespace) -> None:
    from stepcore import _core, vectors

    facts = {package: _version(package) for package in PACKAGES} | {
        # Its name tells the stable ABI from a build for one free-threaded Python.
        "module": os.path.basename(_core.__file__),
        "vectors": _core.VECTORS,
        # What the variable STEPCORE_VECTORS could name here.
        "levels": ", ".join(vectors.levels()),
        "python": platform.python_version() + (" free-threaded" if _free_threaded() else ""),
        "machine": f"{platform.system()} {platform.machine()}",
        "cores": os.cpu_count(),
    }
    if args.json:
        print_json(facts)
    else:
        for name, fact in facts.items():
            put(f"{name:<{WIDTH}}{fact}")


def _free_threaded() -> bool:
    return bool(sysconfig.get_config_var("Py_GIL_DISABLED"))


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"
