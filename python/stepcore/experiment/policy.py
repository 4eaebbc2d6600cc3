"""`policy`: a network from a file (.onnx, TorchScript) as the control function of a motion."""

from __future__ import annotations

import importlib
import os
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks, files
from stepcore.engine.control import Control
from stepcore.engine.sim import Sim
from stepcore.needs import need

ONNX = ".onnx"
ENDINGS = (ONNX, ".pt", ".pth", ".ts")
Network = Callable[[np.ndarray], np.ndarray]


class Policy:
    """A network as a control function of (time, sim); `policy` makes it.

    path: the file. observe, act: see `policy`.
    """

    def __init__(
        self,
        path: str,
        observe: Callable[[float, Sim], ArrayLike] | None = None,
        act: Callable[[np.ndarray, Sim], ArrayLike] | None = None,
    ) -> None:
        self.path, self.observe, self.act = path, observe, act
        # The name in sentences: "the control function `walk.onnx`".
        self.__qualname__ = os.path.basename(path)
        # Without functions of a single Sim, one call serves all worlds of a batch.
        self.batched = observe is None and act is None
        self._network: Network | None = None
        self._lock = threading.Lock()

    def __call__(self, time: float, sim: Sim) -> ArrayLike:
        """Return the controls, shape (nu,); of many worlds (n, nu)."""
        if self.batched:
            states = np.concatenate([sim.qpos, sim.qvel], axis=-1).astype(np.float32)
            return self.network()(states)
        seen = [sim.qpos, sim.qvel] if self.observe is None else [self.observe(time, sim)]
        row = np.concatenate([np.ravel(part) for part in seen]).astype(np.float32)
        action = self.network()(row)
        return action if self.act is None else self.act(action, sim)

    def network(self) -> Network:
        """Return the network as a function of its input, a row or rows; the file is read once."""
        with self._lock:
            self._network = self._network or _loaded(self.path)
        return self._network

    def __deepcopy__(self, memo: Any) -> Policy:
        # A network has no state, so the runs share it.
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return Policy, (self.path, self.observe, self.act)

    def __repr__(self) -> str:
        return f"policy({self.path!r})"


def policy(
    path: str | os.PathLike[str],
    *,
    observe: Callable[[float, Sim], ArrayLike] | None = None,
    act: Callable[[np.ndarray, Sim], ArrayLike] | None = None,
) -> Control:
    """Return a network from a file as the control function of a motion.

    The network gets one row of numbers and returns one row, in single precision. It must be
    stateless. The file is read in the first step of a run. ONNX files need the extra "onnx", and
    TorchScript files need PyTorch.

    path: the file, .onnx, or .pt, .pth or .ts for TorchScript.
    observe: a function of (time, sim) that returns the network's input; by default qpos and qvel.
    act: a function of (output, sim) that returns the controls; by default the output is the
        controls.

    Most policies were trained at a certain period, such as 20 ms: pass it as `control_dt`.

    Raises ValueError for a path with another ending. A run raises ImportError without the package,
    and ValueError for a network with other inputs.

    >>> from stepcore import Motion, policy
    >>> Motion(control=policy("walk.onnx"), control_dt=0.02).control
    policy('walk.onnx')
    """
    source = files.as_path("path", path)
    if not source.endswith(ENDINGS):
        raise ValueError(f"path = {checks.shown(source)}: must end in {', '.join(ENDINGS)}")
    return Policy(source, observe, act)


def _loaded(path: str) -> Network:
    """Return the network of a file as a function of its input, a row or rows."""
    shown = checks.cut(path, 80)
    if not os.path.isfile(path):
        raise FileNotFoundError(f"{checks.cut(path, 300)}: no such file")
    return _onnx(path, shown) if path.endswith(ONNX) else _torch(path, shown)


def _onnx(path: str, shown: str) -> Network:
    runtime = need("onnxruntime", f"reading {shown}", "onnx")
    options = runtime.SessionOptions()
    # Measurements make several runs at the same time.
    options.intra_op_num_threads = 1
    session = runtime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    inputs = session.get_inputs()
    if len(inputs) != 1:
        names = ", ".join(entry.name for entry in inputs)
        raise ValueError(f"{path}: has {len(inputs)} inputs ({names}); write a control function")
    name, shape = inputs[0].name, list(inputs[0].shape)

    def network(observed: np.ndarray) -> np.ndarray:
        width = shape[-1] if shape else None
        if isinstance(width, int) and width != observed.shape[-1]:
            how = "observe=FUNCTION of stepcore.policy makes its input (by default qpos and qvel)"
            raise ValueError(f"{path} expects {width} inputs, not {observed.shape[-1]}: {how}")
        if observed.ndim == 2 and (len(shape) == 1 or isinstance(shape[0], int)):
            # The file has room for one row.
            return np.stack([network(row) for row in observed])
        rows = observed[None] if observed.ndim < len(shape) else observed
        output = np.asarray(session.run(None, {name: rows})[0])
        return output.reshape(len(observed), -1) if observed.ndim == 2 else np.ravel(output)

    return network


def _torch(path: str, shown: str) -> Network:
    try:
        torch = importlib.import_module("torch")
    except ImportError:
        raise ImportError(f"reading {shown} needs torch: pip install torch") from None
    module = torch.jit.load(path, map_location="cpu").eval()

    def network(observed: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            output = module(torch.from_numpy(np.atleast_2d(observed)))
        rows = (output[0] if isinstance(output, (tuple, list)) else output).numpy()
        return rows.reshape(len(rows), -1) if observed.ndim == 2 else np.ravel(rows)

    return network
