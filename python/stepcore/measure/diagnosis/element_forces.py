"""The force of every element on the dofs, at the present state of a Sim.

An element is a spring, a damper, a servo, a limit, a friction loss, a connect, a contact (all
points of one pair of geoms), or the spin of a body (its gyroscopic torque). What the engine
solved is read; no law is repeated here but the spring of the law `penalty`, which has no row.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.scene.layout import DOFS, Layout

Add = Callable[["Key", slice, Floats], None]


@dataclass(frozen=True, order=True)
class Key:
    """Which element. index: of its joint, actuator, equality or body; of both geoms of a contact.

    >>> Key("spring", (0,), "knee").label
    'spring "knee"'
    >>> Key("contact", (0, 1), "floor/foot").label
    'contact "floor"/"foot"'
    """

    kind: str
    index: tuple[int, ...]
    name: str

    def __hash__(self) -> int:
        # The name says nothing more; this is asked for very often.
        return hash((self.kind, self.index))

    @property
    def label(self) -> str:
        """As a report names it."""
        if self.kind == "inertial":
            return "inertial forces"
        return f'{self.kind} "{self.name}"'.replace("/", '"/"' if self.kind == "contact" else "/")


# What is left of the motion's derivative: gravity, Coriolis and centrifugal forces.
INERTIAL = Key("inertial", (), "")

# Kinds that are rows of the solver (contacts but under the law `penalty`).
ROWS = ("contact", "limit", "connect", "friction loss")


class ElementForces:
    """The elements of a model: which there are, and the force of each at a state."""

    def __init__(self, model: Model) -> None:
        self.model = model
        features = model.scene.features
        layout = Layout(model.scene)
        self.joints = [_name(model.joint_names, j, "joint") for j in range(model.njnt)]
        self.dofs = [
            slice(start, start + DOFS[kind])
            for start, kind in zip(model.jnt_dofadr.tolist(), model.jnt_type, strict=True)
        ]
        self.stiffness = [j.stiffness if features.spring else 0.0 for j in layout.joints]
        self.damping = [j.damping if features.damper else 0.0 for j in layout.joints]
        self.servos = range(model.nu if features.actuation else 0)
        self.actuators = [_name(model.actuator_names, i, "actuator") for i in range(model.nu)]
        # Bodies whose spin makes a torque: a ball turns about any axis alike.
        self.spins = [b for b in range(1, model.nbody) if not _isotropic(model.body_inertia[b])]
        self.spin_keys = [Key("spin", (b,), _name(model.body_names, b, "body")) for b in self.spins]
        # What the engine calls a row's element, to its joint or equality.
        self.rows: dict[str, Key] = {}
        for j, name in enumerate(model.joint_names):
            for kind in ("limit", "friction loss"):
                self.rows[_row(f"{kind} of joint", name, j)] = Key(kind, (j,), self.joints[j])
        for e, name in enumerate(model.names["equality"]):
            self.rows[_row("connect", name, e)] = Key("connect", (e,), name or f"connect {e}")
        self.anchors = [np.array(equality.anchor) for equality in model.scene.equalities]
        bodies = {id(body): b for b, body in enumerate(layout.bodies)}
        self.connected = [
            (bodies[id(pair.body1)], bodies[id(pair.body2)]) for pair in model.scene.equalities
        ]

    def of_joints(self, sim: Sim) -> dict[Key, Floats]:
        """The generalised forces of springs, dampers and servos that act, shape (nv,) each [N or
        N·m]: each depends on its own joint alone."""
        return self._found(sim, self._passive, self._servos)

    def across(self, sim: Sim) -> dict[Key, Floats]:
        """Those of rows and contacts, which may depend on every dof."""
        return self._found(sim, self._rows, self._contacts)

    def joint_dofs(self, key: Key) -> slice:
        """The dofs of the joint of a spring, damper or servo."""
        joint = key.index[0]
        return self.dofs[self.model.actuator_joint[joint] if key.kind == "servo" else joint]

    def _found(self, sim: Sim, *kinds: Callable[[Sim, Add], None]) -> dict[Key, Floats]:
        sim.forward()
        found: dict[Key, Floats] = {}

        def add(key: Key, at: slice, force: Floats) -> None:
            if key not in found:
                found[key] = np.zeros(self.model.nv)
            found[key][at] += force

        for kind in kinds:
            kind(sim, add)
        return found

    def _passive(self, sim: Sim, add: Add) -> None:
        passive, velocity = sim.passive, sim.qvel
        for j, at in enumerate(self.dofs):
            damper = -self.damping[j] * velocity[at]
            if self.stiffness[j] != 0:
                add(Key("spring", (j,), self.joints[j]), at, passive[at] - damper)
            if self.damping[j] != 0:
                add(Key("damper", (j,), self.joints[j]), at, damper)

    def _servos(self, sim: Sim, add: Add) -> None:
        forces, gears = sim.actuator_force, self.model.actuator_gear
        for i in self.servos:
            at = self.dofs[self.model.actuator_joint[i]]
            key = Key("servo", (i,), self.actuators[i])
            add(key, at, gears[i][: at.stop - at.start] * forces[i])

    def _rows(self, sim: Sim, add: Add) -> None:
        """Limits, friction losses and connects: contacts are read as contacts."""
        rows = sim.rows
        everywhere = slice(0, self.model.nv)
        seen: dict[Key, int] = {}
        for row in rows[rows["kind"] != "contact"]:
            key = self.rows[str(row["name"])]
            nth = seen[key] = seen.get(key, -1) + 1
            if key.kind == "limit":
                at, direction = self._limit(sim, key.index[0])
                add(key, at, direction * row["force"])
            elif key.kind == "friction loss":
                start = self.dofs[key.index[0]].start + nth
                add(key, slice(start, start + 1), np.array([row["force"]]))
            else:
                add(key, everywhere, self._pull(sim, key.index[0])[nth] * row["force"])

    def _limit(self, sim: Sim, joint: int) -> tuple[slice, Floats]:
        """The dofs of a limited joint, and where its nearer bound pushes."""
        at, start = self.dofs[joint], int(self.model.jnt_qposadr[joint])
        if self.model.jnt_type[joint] == "ball":
            w, *vector = sim.qpos[start : start + 4]
            size = math.hypot(*vector)
            return at, -np.sign(w or 1.0) * np.array(vector) / (size or 1.0)
        low, high = self.model.jnt_range[joint]
        position = sim.qpos[start]
        return at, np.array([1.0 if position - low < high - position else -1.0])

    def _pull(self, sim: Sim, equality: int) -> Floats:
        """How the anchor on body 1 moves against that on body 2, shape (3, nv)."""
        one, two = self.connected[equality]
        at = sim.xpos[one] + sim.xmat[one] @ self.anchors[equality]
        return point_jacobian(sim, one, at) - point_jacobian(sim, two, at)

    def _contacts(self, sim: Sim, add: Add) -> None:
        penalty = sim.settings.law == "penalty"
        everywhere = slice(0, self.model.nv)
        names = self.model.geom_names
        for contact in sim.contacts:
            geoms = (int(contact["geom1"]), int(contact["geom2"]))
            one, two = (int(self.model.geom_body[geom]) for geom in geoms)
            at = contact["pos"]
            apart = point_jacobian(sim, two, at) - point_jacobian(sim, one, at)
            force = self._penalty(sim, contact, apart) if penalty else contact["force"]
            name = "/".join(names[geom] or f"#{geom}" for geom in geoms)
            if np.any(force):
                add(Key("contact", geoms, name), everywhere, apart.T @ force)

    def _penalty(self, sim: Sim, contact: np.void, apart: Floats) -> Floats:
        """k·overlap - 2ζ√(k/A) J v along the normal; A = J M⁻¹ Jᵀ."""
        normal = contact["normal"]
        along = normal @ apart
        weight = along @ np.linalg.solve(sim.mass_matrix(), along)
        s = sim.settings
        if contact["dist"] >= 0 or weight <= 0:
            return np.zeros(3)
        damping = 2 * s.penalty_damping_ratio * math.sqrt(s.penalty_stiffness / weight)
        size = -s.penalty_stiffness * contact["dist"] - damping * (along @ sim.qvel)
        return normal * size

    def spinning(self, sim: Sim) -> SpinForces:
        """-ω × I ω of every body whose spin makes a torque, in world axes."""
        sim.forward()
        n = len(self.spins)
        turning = np.array([sim.jacobian(body)[3:] for body in self.spins])
        turning = turning.reshape(n, 3, self.model.nv)
        axes = sim.xmat[self.spins].reshape(n, 3, 3)
        own = np.array([self.model.body_inertia[body] for body in self.spins]).reshape(n, 3, 3)
        return SpinForces(turning, axes @ own @ axes.transpose(0, 2, 1), turning @ sim.qvel)


@dataclass(frozen=True)
class SpinForces:
    """turning (n, 3, nv): how the bodies turn with qvel; inertia (n, 3, 3); spin ω (n, 3)."""

    turning: Floats
    inertia: Floats
    spin: Floats

    @property
    def force(self) -> Floats:
        """Their generalised forces, shape (n, nv)."""
        moment = np.einsum("bij,bj->bi", self.inertia, self.spin)
        return np.einsum("bi,bin->bn", np.cross(moment, self.spin), self.turning)

    @property
    def damping(self) -> Floats:
        """Minus the derivatives of the forces by qvel, shape (n, nv, nv)."""
        moment = np.einsum("bij,bj->bi", self.inertia, self.spin)
        one = np.eye(3)
        # Column by column: ω × I e - (I ω) × e.
        across = np.cross(self.spin[:, None], self.inertia.transpose(0, 2, 1))
        across -= np.cross(moment[:, None], one[None])
        return self.turning.transpose(0, 2, 1) @ (across.transpose(0, 2, 1) @ self.turning)


def point_jacobian(sim: Sim, body: int, at: Floats) -> Floats:
    """How a point [m] fixed to a body moves with qvel, in world axes, shape (3, nv)."""
    jacobian = sim.jacobian(body)
    return jacobian[:3] - cross_matrix(at - sim.xpos[body]) @ jacobian[3:]


def cross_matrix(v: Floats) -> Floats:
    """The matrix of v × ·."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _isotropic(inertia: Floats) -> bool:
    size = float(np.trace(inertia)) / 3
    return bool(np.abs(inertia - size * np.eye(3)).max() <= 1e-12 * size)


def _name(names: tuple[str, ...], index: int, kind: str) -> str:
    return names[index] or f"{kind} {index}"


def _row(words: str, name: str, index: int) -> str:
    """What the engine calls the element of a row."""
    return f"{words} `{name}`" if name else f"{words} {index}"
