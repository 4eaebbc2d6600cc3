"""The lesson's loop in plain numpy, to be read aloud: place, detect, solve, commit.

`Loop` steps masses that slide along one line each: the spring, the ball drop and the stacks of
`stepcore.lesson`. Its laws are those of the engine, the default `solref` (MuJoCo's) among them; it
shares no code with it. The velocity of a body is that of its joint, so the mass matrix is
diagonal, and each row of J has the one or two bodies of a contact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stepcore.scene.scene import Scene

Array = NDArray[np.float64]


class Loop:
    """One world of a lesson scene; `qpos` [m] and `qvel` [m/s] have one entry a body.

    impulse: of each row of the last step [N·s].
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, self.settings = scene, scene.settings
        bodies, joints = scene.bodies[1:], scene.joints
        if len(bodies) != len(joints) or any(joint.type != "slide" for joint in joints):
            raise ValueError("the numpy loop has bodies on one slide each, and this scene has not")
        mass = {id(body): body.mass or 0.0 for body in bodies}
        for geom in scene.geoms:
            if id(geom.body) in mass:
                mass[id(geom.body)] += geom.mass or 0.0
        self.mass = np.array([mass[id(body)] for body in bodies])
        self.weight = self.mass * [np.dot(scene.gravity, joint.axis) for joint in joints]
        self.stiffness = np.array([joint.stiffness for joint in joints])
        self.damping = np.array([joint.damping for joint in joints])
        # Gap i is between ball i and what is below it: the floor, or ball i - 1.
        n = len(bodies)
        self.J = (np.eye(n) - np.eye(n, k=-1))[: n if scene.geoms else 0]
        self.reset()

    def reset(self, key: str = "start") -> None:
        """Puts the bodies at the scene's keyframe, at rest."""
        self.qpos = np.array(self.scene.key(key).qpos, dtype=float)
        self.qvel = np.zeros_like(self.qpos)
        self.qacc = np.zeros_like(self.qpos)
        self.impulse = np.zeros(0)

    @property
    def rows(self) -> dict[str, Array]:
        """The rows of the last solve: their impulses [N·s]."""
        return {"impulse": self.impulse}

    def step(self, count: int = 1) -> None:
        """Takes `count` steps."""
        for _ in range(count):
            mean, last = self.forward()
            self.commit(mean, last)

    def forward(self) -> tuple[Array, Array]:
        """Place, detect and solve; returns the mean velocity of the step and its last one."""
        mean, last = self.place()
        J, target, c, denominator = self.detect(mean)
        solved = self.solve(mean, J, target, c, denominator)
        last = last + (solved - mean)
        self.qacc = (last - self.qvel) / self.settings.dt
        return solved, last

    def place(self) -> tuple[Array, Array]:
        """The motion without rows: the mean velocity of the step, and the last one."""
        dt, q, v, a = self.settings.dt, self.qpos, self.qvel, self.acceleration
        integrator = self.settings.integrator
        if integrator in ("explicit", "semi-implicit"):
            guess = v + dt * a(q, v)
            return guess, guess
        if integrator == "midpoint":  # v' = v + dt a at the middle of the step, by iteration
            last, before = v + dt * a(q, v), np.full_like(v, np.inf)
            for _ in range(100):
                if np.array_equal(last, before):
                    break
                mean = (v + last) / 2
                last, before = v + dt * a(q + dt / 2 * mean, mean), last
            return (v + last) / 2, last
        if integrator == "rk4":
            a1, v2 = a(q, v), v + dt / 2 * a(q, v)
            a2 = a(q + dt / 2 * v, v2)
            v3 = v + dt / 2 * a2
            a3 = a(q + dt / 2 * v2, v3)
            v4 = v + dt * a3
            a4 = a(q + dt * v3, v4)
            return (v + 2 * v2 + 2 * v3 + v4) / 6, v + dt / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        raise ValueError(f"integrator = '{integrator}': the numpy loop does not have it")

    def acceleration(self, q: Array, v: Array) -> Array:
        """M⁻¹ f of gravity, springs, dampers and, under the law `penalty`, contacts [m/s²]."""
        force = self.weight - self.stiffness * q - self.damping * v
        if self.settings.law == "penalty":
            k, ratio = self.settings.penalty_stiffness, self.settings.penalty_damping_ratio
            for J, phi in zip(self.J, self.J @ q, strict=True):
                if phi < 0:
                    damping = 2 * ratio * np.sqrt(k / (J / self.mass @ J))
                    force = force + J * (-k * phi - damping * (J @ v))
        return np.asarray(force / self.mass)

    def detect(self, guess: Array) -> tuple[Array, Array, Array, Array]:
        """The rows: J, the target velocity t, the regulariser c and the denominator s.

        Each law says when a row exists and what its t, c and s are (docs/method/rows.md).
        """
        law, dt, beta = self.settings.law, self.settings.dt, self.settings.beta
        phi, soft = self.J @ self.qpos, self.settings.softness
        A = np.sum(self.J**2 / self.mass, axis=1)
        if law == "solref":
            exists = phi < 0
            target, c = self.solref(phi, A)
        elif law == "rigid":
            exists = phi + dt * self.J @ guess < 0
            push = -beta * np.minimum(phi + self.settings.slop, 0) / dt
            bounce = -self.settings.restitution * (self.J @ self.qvel)
            arrive = (phi > 0) & (self.settings.restitution == 0)
            target, c = np.where(arrive, -phi / dt, np.maximum(bounce, push)), 0 * phi
        else:  # lesson, relaxed; penalty has no rows
            exists = (phi + dt * self.J @ guess < 0) & (law != "penalty")
            target, c = -beta * np.minimum(phi, 0) / dt, np.full_like(phi, soft * (law == "lesson"))
        s = A + (soft if law == "relaxed" else c)
        return self.J[exists], target[exists], c[exists], s[exists]

    def solref(self, phi: Array, A: Array) -> tuple[Array, Array]:
        """MuJoCo's soft contact: t = J v + dt a_ref and c = R, with its default solref, solimp.

        a_ref = -b J v - K d φ; R = (1 - d)/d · A, where the impedance d rises from 0.9 at the
        surface to 0.95 at a depth of 1 mm.
        """
        dt, (time, ratio), (d0, dw, width, mid, power) = (
            self.settings.dt,
            (0.02, 1.0),
            (0.9, 0.95, 0.001, 0.5, 2.0),
        )
        time = max(time, 2 * dt)
        K, b = 1 / (dw * time * ratio) ** 2, 2 / (dw * time)
        x = np.minimum(np.abs(phi) / width, 1)
        rise = x**power / mid ** (power - 1)
        fall = 1 - (1 - x) ** power / (1 - mid) ** (power - 1)
        d = d0 + np.where(x <= mid, rise, fall) * (dw - d0)
        u = self.J @ self.qvel
        return u + dt * (-b * u - K * d * phi), (1 - d) / d * A

    def solve(self, guess: Array, J: Array, target: Array, c: Array, s: Array) -> Array:
        """Projected Gauss-Seidel: one row after the other, each impulse at least 0."""
        v, self.impulse = guess.copy(), np.zeros(len(J))
        for _ in range(self.settings.sweeps):
            for i, row in enumerate(J):
                change = (target[i] - row @ v - c[i] * self.impulse[i]) / s[i]
                pushed = max(self.impulse[i] + change, 0.0)
                v += row / self.mass * (pushed - self.impulse[i])
                self.impulse[i] = pushed
        return v

    def commit(self, mean: Array, last: Array) -> None:
        """Advances the state; `explicit` moves positions by the velocity before the step."""
        moved_by = self.qvel if self.settings.integrator == "explicit" else mean
        self.qpos = self.qpos + self.settings.dt * moved_by
        self.qvel = last
