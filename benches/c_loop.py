"""MuJoCo at its strongest: `mj_step` in a C loop, its internal timers off.

The Python package installs a timer that costs more than half a microsecond a forward pass, and a
call from Python costs more. Neither is MuJoCo's speed, so here a few lines of C, compiled with the
system's compiler into a temporary folder, restore states, set controls and step. Without a
compiler the loop is `mujoco.mj_step(nstep=…)` from Python; `how()` says which it was.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

STATE = mujoco.mjtState.mjSTATE_INTEGRATION

SOURCE = r"""
#include <string.h>
#include <mujoco/mujoco.h>

/* From each start: restore it, then for each block of controls `hold` steps. */
void play(const mjModel* m, mjData* d, int starts, const double* state, int size,
          int blocks, const double* ctrl, int hold) {
  for (int s = 0; s < starts; s++, state += size) {
    mj_setState(m, d, state, mjSTATE_INTEGRATION);
    for (int b = 0; b < blocks; b++, ctrl += m->nu) {
      memcpy(d->ctrl, ctrl, m->nu * sizeof(double));
      for (int i = 0; i < hold; i++) mj_step(m, d);
    }
  }
}
"""


def player(
    model: mujoco.MjModel, data: mujoco.MjData, states: np.ndarray, ctrl: np.ndarray, hold: int
) -> Callable[[], None]:
    """A call that plays every start of `states` (starts, size) with `ctrl` (starts, blocks, nu)."""
    states = np.ascontiguousarray(states, dtype=np.float64)
    ctrl = np.ascontiguousarray(ctrl, dtype=np.float64)
    starts, blocks = ctrl.shape[:2]
    play = _compiled()
    if play is None:
        return python_player(model, data, states, ctrl, hold, hold)

    def go(kept=(model, data, states, ctrl)) -> None:
        size = states.shape[1]
        play(model._address, data._address, starts, _at(states), size, blocks, _at(ctrl), hold)

    return go


def how() -> str:
    """How MuJoCo is stepped here."""
    if _compiled() is None:
        return "mj_step(nstep=…) from Python (no C compiler: a little slower than it can be)"
    return "mj_step in a C loop"


def timers(on: bool) -> None:
    """Switches MuJoCo's internal timers; off is faster."""
    default = _default_timer()
    _callback().value = default if on else None


def python_player(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    states: np.ndarray,
    ctrl: np.ndarray,
    hold: int,
    chunk: int = 1,
) -> Callable[[], None]:
    """The same from Python: `ctrl[:] = …; mj_step(nstep=chunk)`."""
    own, step, calls = data.ctrl, mujoco.mj_step, hold // chunk

    def go() -> None:
        for state, blocks in zip(states, ctrl, strict=True):
            mujoco.mj_setState(model, data, state, STATE)
            for u in blocks:
                for _ in range(calls):
                    own[:] = u
                    step(model, data, chunk)

    return go


def _at(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


@cache
def _library() -> Path:
    """The very library that the Python package has loaded."""
    folder = Path(mujoco.__file__).parent
    found = [
        path for pattern in ("libmujoco.so*", "libmujoco*.dylib") for path in folder.glob(pattern)
    ]
    if not found:
        raise FileNotFoundError("no MuJoCo library beside the mujoco package")
    return found[0]


@cache
def _callback() -> ctypes.c_void_p:
    return ctypes.c_void_p.in_dll(ctypes.CDLL(str(_library())), "mjcb_time")


@cache
def _default_timer() -> int | None:
    return _callback().value


@cache
def _compiled() -> Callable[..., None] | None:
    compiler = (
        os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    )
    include = Path(mujoco.__file__).parent / "include"
    if not compiler or not include.is_dir():
        return None
    folder = Path(tempfile.mkdtemp(prefix="stepcore-bench-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    source, target = folder / "loop.c", folder / "loop.so"
    source.write_text(SOURCE)
    library = _library()
    command = [*shlex.split(compiler), "-O2", "-shared", "-fPIC", f"-I{include}", str(source)]
    command += ["-o", str(target), str(library), f"-Wl,-rpath,{library.parent}"]
    try:
        subprocess.run(command, check=True, capture_output=True, timeout=60)
        play = ctypes.CDLL(str(target)).play
    except (OSError, subprocess.SubprocessError):
        return None
    number, pointer = ctypes.c_int, ctypes.c_void_p
    play.argtypes = [pointer, pointer, number, pointer, number, number, pointer, number]
    play.restype = None
    return play
