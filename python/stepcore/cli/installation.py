"""Commands on the installation: `lesson` checks the engine, `info` prints versions."""

from __future__ import annotations

import argparse
import os
import platform
import sysconfig
from importlib import metadata

from stepcore.cli.output import add_json, print_json
from stepcore.cli.terminal import put

TEXTS = {
    "lesson": """\
Check the engine on the lesson: four small scenes (spring, drop, stack, grasp) whose
results are known: the energy growth of an integrator, the depth of a contact, the convergence of a
stack, the force of a grasp.

Example:
  stepcore lesson --all
""",
    "info": """\
Print the versions of stepcore and of the packages it works with, and the machine.

Example:
  stepcore info --json
""",
}
# stepcore and its dependency, then the packages of the extras, then packages with models.
PACKAGES = (
    *("stepcore", "numpy", "matplotlib", "trimesh", "viser", "mitsuba", "imageio-ffmpeg"),
    *("pillow", "pandas", "xarray", "mcap", "distributed", "gymnasium", "mujoco"),
)
WIDTH = 16


def text(name: str) -> str:
    """Return the description of a command and its example."""
    return TEXTS[name]


def add(command: argparse.ArgumentParser, name: str) -> None:
    """Add the options of a command."""
    if name == "lesson":
        command.add_argument(
            "--engine",
            choices=("rust", "numpy"),
            default="rust",
            help="implementation to test (default: %(default)s)",
        )
        command.add_argument(
            "--all", action="store_true", help="print every figure beside its reference"
        )
    add_json(command)


def call(args: argparse.Namespace, name: str) -> int:
    """Run a command; return the exit status."""
    return _lesson(args) if name == "lesson" else _info(args)


def _lesson(args: argparse.Namespace) -> int:
    from stepcore import lesson

    rows = lesson.run(args.engine)
    if args.json:
        print_json([row.to_dict() for row in rows])
    else:
        put(str(lesson.report(rows, full=args.all)))
    return 0 if all(row.ok for row in rows) else 1


def _info(args: argparse.Namespace) -> int:
    from stepcore import _core, vectors

    free_threaded = bool(sysconfig.get_config_var("Py_GIL_DISABLED"))
    facts = {package: _version(package) for package in PACKAGES} | {
        # The file name shows whether this is a stable-ABI or a free-threaded build.
        "module": os.path.basename(_core.__file__),
        "vectors": _core.VECTORS,
        # The values of the variable STEPCORE_VECTORS that are valid on this machine.
        "levels": ", ".join(vectors.levels()),
        "python": platform.python_version() + " free-threaded" * free_threaded,
        "machine": f"{platform.system()} {platform.machine()}",
        "cores": os.cpu_count(),
    }
    if args.json:
        print_json(facts)
    else:
        for name, fact in facts.items():
            put(f"{name:<{WIDTH}}{fact}")
    return 0


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"
