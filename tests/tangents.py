"""Central differences of the real step in tangent coordinates, in plain numpy."""

import numpy as np


def product(a, b):
    """The product of two quaternions."""
    w, x, y, z = a
    matrix = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return matrix @ b


def turns(model):
    """(first of qpos, first dof, whether it turns) of every part of every joint."""
    for kind, q, v in zip(model.jnt_type, model.jnt_qposadr, model.jnt_dofadr, strict=True):
        if kind == "ball":
            yield q, v, True
        elif kind == "free":
            yield from ((q + k, v + k, False) for k in range(3))
            yield q + 3, v + 3, True
        else:
            yield q, v, False


def moved(model, qpos, dq):
    """qpos ⊕ dq."""
    out = qpos.copy()
    for q, v, turn in turns(model):
        if not turn:
            out[q] += dq[v]
            continue
        w = dq[v : v + 3]
        angle = np.linalg.norm(w)
        half = np.array([np.cos(angle / 2), *(0.5 * w * np.sinc(angle / 2 / np.pi))])
        out[q : q + 4] = product(qpos[q : q + 4], half)
    return out


def apart(model, there, here):
    """dq with here ⊕ dq = there."""
    out = np.zeros(model.nv)
    for q, v, turn in turns(model):
        if not turn:
            out[v] = there[q] - here[q]
            continue
        back = here[q : q + 4] * [1, -1, -1, -1] / (here[q : q + 4] @ here[q : q + 4])
        r = product(back, there[q : q + 4])
        sine = np.linalg.norm(r[1:])
        out[v : v + 3] = r[1:] * (2 * np.arctan2(sine, r[0]) / sine if sine else 2.0)
    return out


def differences(sim, h):
    """A and B side by side, of fourth order in h; the sim is left as it was."""
    model = sim.model
    nv, width = model.nv, 2 * model.nv + model.nu
    start = sim.state()
    qpos, qvel, ctrl = sim.qpos.copy(), sim.qvel.copy(), sim.ctrl.copy()
    sim.step()
    next_qpos, next_qvel = sim.qpos.copy(), sim.qvel.copy()

    def after(column, size):
        change = np.zeros(width)
        change[column] = size
        sim.restore(start)
        sim.qpos[:] = moved(model, qpos, change[:nv])
        sim.qvel[:] = qvel + change[nv : 2 * nv]
        sim.ctrl[:] = ctrl + change[2 * nv :]
        sim.step()
        return np.concatenate([apart(model, sim.qpos, next_qpos), sim.qvel - next_qvel])

    columns = [
        (8 * (after(k, h) - after(k, -h)) - (after(k, 2 * h) - after(k, -2 * h))) / (12 * h)
        for k in range(width)
    ]
    sim.restore(start)
    return np.array(columns).T.reshape(2 * nv, width)
