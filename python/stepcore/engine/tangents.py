"""Changes of positions, and those of the dofs, where these differ: quaternions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stepcore.engine.arrays import Floats

if TYPE_CHECKING:
    from stepcore.engine.model import Model


class Tangents:
    """Maps between changes of qpos and those of the dofs, where these differ: quaternions."""

    def __init__(self, model: Model) -> None:
        self.nv = model.nv
        pairs: list[tuple[int, int]] = []
        self.quats: list[tuple[int, int]] = []
        for joint, kind in enumerate(model.jnt_type):
            q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
            if kind in ("slide", "hinge"):
                pairs.append((q, v))
            elif kind == "free":
                pairs += [(q + k, v + k) for k in range(3)]
            if kind in ("ball", "free"):
                shift = 3 * (kind == "free")
                self.quats.append((q + shift, v + shift))
        self.q, self.v = (np.array([pair[k] for pair in pairs], int) for k in (0, 1))

    def _turns(self, qpos: Floats, q: int, inverse: bool) -> Floats:
        """The change of a quaternion by a turn about each body axis, (…, 3, 4).

        inverse: its pseudo-inverse, transposed. The rows are at right angles, each |q|/2 long.
        """
        quat = qpos[..., q : q + 4]
        w, x, y, z = np.moveaxis(quat, -1, 0)
        rows = [[-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]]
        turns: Floats = np.moveaxis(np.array(rows), (0, 1), (-2, -1)) / 2
        return turns * (4 / (quat**2).sum(-1))[..., None, None] if inverse else turns

    def of_dofs(self, qpos: Floats, change: Floats, inverse: bool = False) -> Floats:
        """A change of dofs as one of qpos; (…, nv) to (…, nq)."""
        out = np.zeros(qpos.shape)
        out[..., self.q] = change[..., self.v]
        for q, v in self.quats:
            turns = self._turns(qpos, q, inverse)
            out[..., q : q + 4] = np.einsum("...a,...ak->...k", change[..., v : v + 3], turns)
        return out

    def moved(self, qpos: Floats, change: Floats) -> Floats:
        """A qpos moved by a change of dofs, to first order; quaternions keep their length."""
        out: Floats = qpos + self.of_dofs(qpos, change)
        for q, _ in self.quats:
            before, after = qpos[..., q : q + 4], out[..., q : q + 4]
            after *= np.sqrt((before**2).sum(-1, keepdims=True) / (after**2).sum(-1, keepdims=True))
        return out

    def gradient(self, qpos: Floats, change: Floats) -> Floats:
        """A gradient by the dofs as one by qpos, of which quaternions are made unit."""
        return self.of_dofs(qpos, change, inverse=True)

    def to_dofs(self, qpos: Floats, gradient: Floats, inverse: bool = False) -> Floats:
        """A gradient by qpos as one by the dofs; (…, nq) to (…, nv)."""
        out = np.zeros((*qpos.shape[:-1], self.nv))
        out[..., self.v] = gradient[..., self.q]
        for q, v in self.quats:
            turns = self._turns(qpos, q, inverse)
            part = np.einsum("...k,...ak->...a", gradient[..., q : q + 4], turns)
            out[..., v : v + 3] = part
        return out

    def changed(self, qpos: Floats, change: Floats) -> Floats:
        """A change of qpos as one of the dofs; (…, nq) to (…, nv)."""
        return self.to_dofs(qpos, change, inverse=True)
