"""Rollouts of a `Batch` for JAX, with gradients. Needs the extra "jax"."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.engine.gradients import Tape

if TYPE_CHECKING:
    from stepcore.engine.batch import Batch

__all__ = ["rollout"]


def rollout(
    batch: Batch,
    qpos: Any,
    qvel: Any,
    ctrl: Any,
    parameters: Mapping[str, Any] | None = None,
) -> tuple[Any, Any]:
    """Step every world from a state with given controls; return qpos and qvel after each step.

    batch: the worlds; their present activations and applied forces are used.
    qpos, qvel: the initial state, shapes (n, nq) and (n, nv). ctrl: shape (n, steps, nu).
    parameters: values of the model by path, as in `stepcore.torch.rollout`, of shape (n,).

    The results have shapes (n, steps, nq) and (n, steps, nv), and gradients by every array
    given (`jax.grad`, in reverse). It works under `jax.jit`, as a pure callback. It computes in
    double precision on the processor; turn on ``jax_enable_x64`` for gradients of that precision.
    """
    try:
        import jax
    except ImportError as error:
        raise ImportError("stepcore.jax needs JAX: pip install jax") from error

    values = dict(parameters or {})
    paths = tuple(values)

    def shapes(inputs: tuple[Any, ...]) -> Any:
        n, steps = inputs[2].shape[:2]
        like = inputs[0].dtype
        sizes = batch.model.nq, batch.model.nv
        return tuple(jax.ShapeDtypeStruct((n, steps, size), like) for size in sizes)

    def states(*inputs: Any) -> Any:
        tape = Tape(batch, paths, *(np.asarray(array, float) for array in inputs))
        return tuple(np.asarray(x, inputs[0].dtype) for x in tape.rollout[:2])

    def gradients(inputs: tuple[Any, ...], weights: tuple[Any, ...]) -> Any:
        tape = Tape(batch, paths, *(np.asarray(array, float) for array in inputs))
        slopes = tape.gradient(*(np.asarray(weight, float) for weight in weights))
        return tuple(np.asarray(x, array.dtype) for x, array in zip(slopes, inputs, strict=True))

    @jax.custom_vjp
    def run(*inputs: Any) -> Any:
        return jax.pure_callback(states, shapes(inputs), *inputs)

    def forward(*inputs: Any) -> Any:
        return run(*inputs), inputs

    def backward(inputs: tuple[Any, ...], weights: tuple[Any, ...]) -> Any:
        like = tuple(jax.ShapeDtypeStruct(array.shape, array.dtype) for array in inputs)
        return jax.pure_callback(gradients, like, inputs, weights)

    run.defvjp(forward, backward)
    arrays = [jax.numpy.asarray(array) for array in (qpos, qvel, ctrl, *values.values())]
    result: tuple[Any, Any] = run(*arrays)
    return result
