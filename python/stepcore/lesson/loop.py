"""The lesson's simulation loop in plain numpy: place, detect, solve, commit.

`Loop` steps bodies that each slide along one line: the spring, the ball drop and the stacks of
`stepcore.lesson`. `Loop` has the engine's contact laws, with MuJoCo's `solref` as the default, but
shares no code with the engine. A body's velocity equals its joint's velocity. The mass matrix is
therefore diagonal, and a row of J has nonzeros only at the one or two bodies of the contact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stepcore.lesson.scenes import PLAIN
from stepcore.scene.elements.field_types import SOLIMP, SOLREF
from stepcore.scene.scene import Scene

Array = NDArray[np.float64]
# Nearer than this share of the smaller radius, bodies touch: the engine's `TOUCH_SHARE`.
TOUCH_SHARE = 1 / 1024


class Loop:
    """One world of a lesson scene.

    qpos [m], qvel [m/s], qacc [m/s²]: one entry per body.
    impulse: the impulse of each row in the last step [N·s].
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, self.settings = scene, scene.settings
        bodies, joints = scene.bodies[1:], scene.joints
        if len(bodies) != len(joints) or any(joint.type != "slide" for joint in joints):
            raise ValueError("the numpy loop has bodies on one slide each, and this scene has not")
        for name in ("solver", "acceleration", "tolerance", "warm_start"):
            value = getattr(self.settings, name)
            if value != PLAIN[name]:
                raise ValueError(f"{name} = {value!r}: the numpy loop has {PLAIN[name]!r} alone")
        mass = {id(body): body.mass or 0.0 for body in bodies}
        for geom in scene.geoms:
            if id(geom.body) in mass:
                mass[id(geom.body)] += geom.mass or 0.0
        self.mass = np.array([mass[id(body)] for body in bodies])
        self.weight = self.mass * [np.dot(scene.gravity, joint.axis) for joint in joints]
        self.stiffness = np.array([joint.stiffness for joint in joints])
        self.damping = np.array([joint.damping for joint in joints])
        # Gap i lies below ball i, above the floor or ball i - 1.
        n = len(bodies)
        self.J = (np.eye(n) - np.eye(n, k=-1))[: n if scene.geoms else 0]
        balls = [geom.size[0] for geom in scene.geoms if id(geom.body) in mass]
        self.near = TOUCH_SHARE * np.minimum(balls, [np.inf, *balls[:-1]]) if balls else np.zeros(0)
        self.reset()

    def reset(self, key: str = "start") -> None:
        """Set the positions from a keyframe, and the velocities to 0."""
        self.qpos = np.array(self.scene.key(key).qpos, dtype=float)
        self.qvel = np.zeros_like(self.qpos)
        self.qacc = np.zeros_like(self.qpos)
        self.impulse = np.zeros(0)

    @property
    def rows(self) -> dict[str, Array]:
        """Impulses of the rows of the last solve [N·s], under the key "impulse"."""
        return {"impulse": self.impulse}

    def step(self, count: int = 1) -> None:
        """Make `count` steps."""
        for _ in range(count):
            self.commit(*self.forward())

    def forward(self) -> tuple[Array, Array]:
        """Place, detect and solve; return the mean and the final velocity of the step [m/s]."""
        mean, last = self.place()
        J, target, c, denominator = self.detect(mean)
        solved = self.solve(mean, J, target, c, denominator)
        last = last + (solved - mean)
        self.qacc = (last - self.qvel) / self.settings.dt
        return solved, last

    def place(self) -> tuple[Array, Array]:
        """Return the mean and the final velocity of the step without constraint rows [m/s]."""
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
        """Return M⁻¹ f [m/s²] of gravity, springs, dampers and, under `penalty`, contacts."""
        force = self.weight - self.stiffness * q - self.damping * v
        if self.settings.law == "penalty":
            k, ratio = self.settings.penalty_stiffness, self.settings.penalty_damping_ratio
            for J, phi in zip(self.J, self.J @ q, strict=True):
                if phi < 0:
                    damping = 2 * ratio * np.sqrt(k / (J / self.mass @ J))
                    force = force + J * (-k * phi - damping * (J @ v))
        return np.asarray(force / self.mass)

    def detect(self, guess: Array) -> tuple[Array, Array, Array, Array]:
        """Return J, target velocity t, regulariser c and denominator s of the active rows.

        The contact law decides which rows exist, and their t, c and s (docs/method/rows.md).
        """
        law, dt, beta = self.settings.law, self.settings.dt, self.settings.beta
        phi, soft = self.J @ self.qpos, self.settings.softness
        A = np.sum(self.J**2 / self.mass, axis=1)
        if law == "solref":
            exists = phi < 0
            target, c = self.solref(phi, A)
        elif law == "rigid":
            exists, far = self.meets(phi, guess)
            push = -beta * np.minimum(phi + self.settings.slop, 0) / dt
            bounce = -self.settings.restitution * (self.J @ self.qvel)
            arrive = (phi > 0) & (self.settings.restitution == 0)
            target, c = np.where(arrive | far, -phi / dt, np.maximum(bounce, push)), 0 * phi
        else:  # lesson, relaxed; penalty has no rows
            exists, far = self.meets(phi, guess)
            exists = exists & (law != "penalty")
            push = -beta * np.minimum(phi, 0) / dt - far * np.maximum(phi, 0) / dt
            target, c = push, np.full_like(phi, soft * (law == "lesson"))
        s = A + (soft if law == "relaxed" else c)
        return self.J[exists], target[exists], c[exists], s[exists]

    def meets(self, phi: Array, guess: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which rows exist under a law on velocities, and which of these are only near.

        Rows exist where the guess overlaps, or where bodies are so near that it may for what other
        rows do: whether the guess of bodies at rest on each other overlaps is rounding. A row that
        is only near asks that they do no more than meet.
        """
        closes = phi + self.settings.dt * self.J @ guess < 0
        return closes | (phi <= self.near), ~closes

    def solref(self, phi: Array, A: Array) -> tuple[Array, Array]:
        """Return t = J v + dt a_ref and c = R of MuJoCo's contacts, with default solref and solimp.

        a_ref = -b J v - K d φ and R = (1 - d)/d · A, A the diagonal of J M⁻¹ Jᵀ. The impedance d
        rises from 0.9 at the surface to 0.95 at a depth of 1 mm.
        """
        dt, (time, ratio), (d0, dw, width, mid, power) = self.settings.dt, SOLREF, SOLIMP
        time = max(time, 2 * dt)  # refsafe
        K, b = 1 / (dw * time * ratio) ** 2, 2 / (dw * time)
        x = np.minimum(np.abs(phi) / width, 1)
        rise = x**power / mid ** (power - 1)
        fall = 1 - (1 - x) ** power / (1 - mid) ** (power - 1)
        d = d0 + np.where(x <= mid, rise, fall) * (dw - d0)
        u = self.J @ self.qvel
        return u + dt * (-b * u - K * d * phi), (1 - d) / d * A

    def solve(self, guess: Array, J: Array, target: Array, c: Array, s: Array) -> Array:
        """Solve the rows of `detect` by projected Gauss-Seidel with impulses >= 0; return v."""
        v, self.impulse = guess.copy(), np.zeros(len(J))
        for _ in range(self.settings.sweeps):
            self.sweep(v, J, target, c, s)
        return v

    def sweep(self, v: Array, J: Array, target: Array, c: Array, s: Array) -> None:
        """Visit each row once: change its impulse, and with it the velocities `v` at once."""
        for i, row in enumerate(J):
            change = (target[i] - row @ v - c[i] * self.impulse[i]) / s[i]
            pushed = max(self.impulse[i] + change, 0.0)
            v += row / self.mass * (pushed - self.impulse[i])
            self.impulse[i] = pushed

    def commit(self, mean: Array, last: Array) -> None:
        """Advance positions by the mean velocity, and set the velocities to the final ones.

        The integrator `explicit` advances positions by the velocity before the step.
        """
        moved_by = self.qvel if self.settings.integrator == "explicit" else mean
        self.qpos = self.qpos + self.settings.dt * moved_by
        self.qvel = last
