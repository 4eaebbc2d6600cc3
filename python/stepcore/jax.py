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

    def shapes(given: tuple[Any, ...]) -> Any:
        n, steps = given[2].shape[:2]
        like = given[0].dtype
        sizes = batch.model.nq, batch.model.nv
        return tuple(jax.ShapeDtypeStruct((n, steps, size), like) for size in sizes)

    def states(*given: Any) -> Any:
        tape = Tape(batch, paths, *(np.asarray(array, float) for array in given))
        return tuple(np.asarray(x, given[0].dtype) for x in tape.rollout[:2])

    def gradients(given: tuple[Any, ...], weights: tuple[Any, ...]) -> Any:
        tape = Tape(batch, paths, *(np.asarray(array, float) for array in given))
        found = tape.gradient(*(np.asarray(weight, float) for weight in weights))
        return tuple(np.asarray(x, array.dtype) for x, array in zip(found, given, strict=True))

    @jax.custom_vjp
    def run(*given: Any) -> Any:
        return jax.pure_callback(states, shapes(given), *given)

    def forward(*given: Any) -> Any:
        return run(*given), given

    def backward(given: tuple[Any, ...], weights: tuple[Any, ...]) -> Any:
        like = tuple(jax.ShapeDtypeStruct(array.shape, array.dtype) for array in given)
        return jax.pure_callback(gradients, like, given, weights)

    run.defvjp(forward, backward)
    made = [jax.numpy.asarray(array) for array in (qpos, qvel, ctrl, *values.values())]
    result: tuple[Any, Any] = run(*made)
    return result
