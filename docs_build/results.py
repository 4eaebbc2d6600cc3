"""Results of earlier builds, reused while nothing that they depend on has changed.

They depend on the package, the models of docs/, the code in docs_build/, every installed version,
and the text that is passed as a key. Remove the folder .cache to compute everything anew.
"""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from importlib.metadata import distributions
from pathlib import Path

import stepcore

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / ".cache" / "docs"
# mkdocs prints what its own loggers report.
LOG = logging.getLogger("mkdocs.stepcore")


@cache
def folder() -> Path:
    """Return the folder of results of the present package; those of earlier ones are removed."""
    own = RESULTS / inputs_hash()
    for other in RESULTS.glob("*"):
        if other != own:
            shutil.rmtree(other)
    own.mkdir(parents=True, exist_ok=True)
    return own


def inputs_hash() -> str:
    """Return a hash of everything that any result depends on."""
    files = [*Path(stepcore.__file__).parent.rglob("*"), *(ROOT / "docs").rglob("*.xml")]
    files += (ROOT / "docs_build").glob("*.py")
    digest = sha256()
    for path in sorted(path for path in files if path.is_file() and path.suffix != ".pyc"):
        digest.update(f"{path.name}\0".encode() + sha256(path.read_bytes()).digest())
    for version in sorted(f"{each.name} {each.version}" for each in distributions()):
        digest.update(version.encode())
    return digest.hexdigest()[:16]


def reuse(title: str, key: str, compute: Callable[[], bytes]) -> bytes:
    """Return the result of an earlier build with this key, or compute it.

    title: what is computed, for the build's report.
    """
    path = folder() / sha256(f"{title}\0{key}".encode()).hexdigest()
    if path.exists():
        LOG.info("Reusing %s", title)
        return path.read_bytes()
    LOG.info("Computing %s", title)
    result = compute()
    partial = path.with_suffix(".partial")
    partial.write_bytes(result)
    partial.replace(path)
    return result
