"""Optional packages, with the command that installs a missing one."""

from __future__ import annotations

import importlib
from typing import Any


def need(package: str, purpose: str, extra: str = "view") -> Any:
    """Return the package; raise ImportError with the command that installs it."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        if error.name is not None and error.name.partition(".")[0] != package.partition(".")[0]:
            raise
        text = f"{purpose} needs {package.partition('.')[0]}: {installing(extra)}"
        raise ImportError(text, name=package) from None


def installing(extra: str) -> str:
    """Return how an extra is installed."""
    return f"pip install '.[{extra}]' in a clone of stepcore"
