"""Select the compiled module with the widest vector instructions of this processor.

A release's wheel for x86-64 contains two modules: one in the package for every processor, and one
in a subfolder for processors with AVX2. A build from source contains the one for its processor.
Both give bit-identical results. The environment variable `STEPCORE_VECTORS` overrides the
selection.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from importlib.machinery import EXTENSION_SUFFIXES

VARIABLE = "STEPCORE_VECTORS"
BASELINE = "baseline"


def select_module(path: list[str]) -> None:
    """Change `path`, so that `import stepcore._core` loads the widest module.

    path: the package's `__path__`.

    Raises ImportError if STEPCORE_VECTORS names none of `levels()`, or if there are none.
    """
    known_levels = levels()
    if not known_levels:
        raise ImportError(
            "this installation of stepcore was built for processors with AVX2, and this processor "
            "has none: build it on this machine with 'pip install .', or install a release's "
            "wheel, which runs on every processor"
        )
    name = os.environ.get(VARIABLE) or next(iter(known_levels))
    if name not in known_levels:
        names = "', '".join(known_levels)
        limit = f"one of '{names}', which this installation has and this processor can run"
        raise ImportError(f"{VARIABLE} = '{name}': must be {limit}")
    if name != BASELINE:
        path.insert(0, known_levels[name])


def levels() -> dict[str, str]:
    """Return name and folder of each installed module that this processor can run, widest first."""
    package = os.path.dirname(__file__)
    wider = {name: os.path.join(package, f"_{name}") for name in _RUNS}
    wider = {name: folder for name, folder in wider.items() if os.path.isdir(folder)}
    there = {name: folder for name, folder in wider.items() if _RUNS[name]()}
    modules = (os.path.join(package, f"_core{suffix}") for suffix in EXTENSION_SUFFIXES)
    # Without any module the import error names the missing one.
    if not wider or any(map(os.path.exists, modules)):
        there[BASELINE] = package
    return there


def has_avx2() -> bool:
    """Return whether the processor has AVX2 and the operating system allows its use."""
    if sys.platform == "linux":
        return "avx2" in _flags()
    import ctypes

    if sys.platform == "win32":
        avx2_instructions_available = 40
        return bool(ctypes.windll.kernel32.IsProcessorFeaturePresent(avx2_instructions_available))
    if sys.platform == "darwin":
        value, size = ctypes.c_int(0), ctypes.c_size_t(ctypes.sizeof(ctypes.c_int))
        answer = (ctypes.byref(value), ctypes.byref(size), None, 0)
        failed = ctypes.CDLL(None).sysctlbyname(b"hw.optional.avx2_0", *answer)
        return not failed and bool(value.value)
    return False


def _flags() -> list[str]:
    try:
        # Read line by line: Linux generates the file on reading, and one entry is enough.
        with open("/proc/cpuinfo", encoding="ascii", errors="replace") as facts:
            return next((line for line in facts if line.startswith("flags")), "").split()
    except OSError:
        return []


# The modules apart from the baseline, widest first, with a test of the processor.
_RUNS: dict[str, Callable[[], bool]] = {"avx2": has_avx2}
