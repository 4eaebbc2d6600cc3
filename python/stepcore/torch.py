"""Rollouts of a `Batch` for PyTorch, with gradients. Needs PyTorch (the extra "torch")."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore import checks
from stepcore.engine.gradients import Tape

if TYPE_CHECKING:
    import torch

    from stepcore.engine.batch import Batch

__all__ = ["rollout"]


@functools.cache
def _function() -> Any:
    """Return the autograd function; PyTorch is imported where it is used."""
    try:
        import torch
    except ImportError as error:
        raise ImportError("stepcore.torch needs PyTorch: pip install torch") from error

    class Rollout(torch.autograd.Function):
        @staticmethod
        def forward(ctx: Any, batch: Any, paths: Any, *tensors: Any) -> Any:
            tape = Tape(batch, paths, *(tensor.detach().cpu().numpy() for tensor in tensors))
            ctx.tape, ctx.like = tape, [(tensor.dtype, tensor.device) for tensor in tensors]
            states = (torch.from_numpy(np.ascontiguousarray(x)) for x in tape.rollout[:2])
            return tuple(state.to(tensors[0].dtype).to(tensors[0].device) for state in states)

        @staticmethod
        @torch.autograd.function.once_differentiable
        def backward(ctx: Any, *weights: Any) -> Any:
            slopes = ctx.tape.gradient(*(weight.detach().cpu().numpy() for weight in weights))
            gradients = [
                torch.from_numpy(np.ascontiguousarray(x)).to(dtype).to(device)
                for x, (dtype, device) in zip(slopes, ctx.like, strict=True)
            ]
            return (None, None, *gradients)

    return Rollout.apply


def rollout(
    batch: Batch,
    qpos: torch.Tensor,
    qvel: torch.Tensor,
    ctrl: torch.Tensor,
    parameters: Mapping[str, torch.Tensor] | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Step every world from a state with given controls; return qpos and qvel after each step.

    batch: the worlds; their present activations, applied forces and times are used.
    qpos, qvel: the initial state, shapes (n, nq) and (n, nv). ctrl: shape (n, steps, nu).
    parameters: values of the model by path, as in `Batch.param`, of shape (n,); a single entry of a
        vector is written "geom/floor/friction[0]".

    The results have shapes (n, steps, nq) and (n, steps, nv). They have gradients by every tensor
    given, exact for each step; see `Batch.vjp`. It computes in double precision on the processor.

    Raises the same errors as `Batch.rollout`.
    """
    values = dict(parameters or {})
    for path, value in values.items():
        if not hasattr(value, "detach"):
            raise ValueError(f"parameters: {path} = {checks.shown(value)}: must be a tensor")
    states: tuple[torch.Tensor, torch.Tensor] = _function()(
        batch, tuple(values), qpos, qvel, ctrl, *values.values()
    )
    return states
