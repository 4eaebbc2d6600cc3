"""Commands on the installation: `lesson` checks the engine, `info` prints versions."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sysconfig
from importlib import metadata

from stepcore.cli.terminal import print_above
from stepcore.report.table import jsonable

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
    *("stepcore", "numpy", "matplotlib", "trimesh", "viser", "imageio-ffmpeg"),
    *("pillow", "pandas", "xarray", "mcap", "pycollada", "distributed", "gymnasium", "mujoco"),
)


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
    command.add_argument("--json", action="store_true", help="print JSON instead of text")


def call(args: argparse.Namespace, name: str) -> int:
    """Run a command; return the exit status."""
    if name == "info":
        facts = _facts()
        summary = "\n".join(f"{name:<16}{fact}" for name, fact in facts.items())
        print_above(json.dumps(facts, indent=2) if args.json else summary)
        return 0
    from stepcore import lesson

    rows = lesson.run(args.engine)
    plain = json.dumps(jsonable([row.to_dict() for row in rows]), indent=2) if args.json else ""
    print_above(plain or str(lesson.report(rows, full=args.all)))
    return 0 if all(row.ok for row in rows) else 1


def _facts() -> dict[str, object]:
    from stepcore import _core, vectors

    facts: dict[str, object] = {}
    for package in PACKAGES:
        try:
            facts[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            facts[package] = "not installed"
    free_threaded = bool(sysconfig.get_config_var("Py_GIL_DISABLED"))
    return facts | {
        # The file name shows whether this is a stable-ABI or a free-threaded build.
        "module": os.path.basename(_core.__file__),
        "vectors": _core.VECTORS,
        # The values of the variable STEPCORE_VECTORS that are valid on this machine.
        "levels": ", ".join(vectors.levels()),
        "python": platform.python_version() + " free-threaded" * free_threaded,
        "machine": f"{platform.system()} {platform.machine()}",
        "cores": os.cpu_count(),
    }
