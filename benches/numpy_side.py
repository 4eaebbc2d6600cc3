"""The lesson's scenes by hand in numpy: one world at its plainest, many worlds at its best.

All laws are the engine's: semi-implicit Euler, and rows that exist where the guess v̂ = v + dt a
would overlap or where bodies touch, solved by projected Gauss-Seidel sweep after sweep from zero.
The target of a row that touches without closing is that no overlap is left: t = −dist/dt.
"""

from __future__ import annotations

import numpy as np

G, BETA, SOFTNESS, DT = 9.81, 0.2, 0.5, 0.002
SPRING_DT, STIFFNESS = 0.01, 100.0
SWEEPS = 20
RADIUS = 0.1
NEAR = RADIUS / 1024  # bodies touch, up to rounding


class PlainSpring:
    """A mass on a spring, one world: v ← v − dt M⁻¹K q; q ← q + dt v on arrays of one number."""

    def __init__(self, start: np.ndarray) -> None:
        self.start = start
        self.mass_inverse = np.eye(1)
        self.stiffness = STIFFNESS * np.eye(1)
        self.reset()

    def reset(self) -> None:
        self.qpos, self.qvel = self.start.copy(), np.zeros(1)

    def step(self, n: int) -> None:
        for _ in range(n):
            force = -self.stiffness @ self.qpos
            self.qvel = self.qvel + SPRING_DT * (self.mass_inverse @ force)
            self.qpos = self.qpos + SPRING_DT * self.qvel


class PlainTower:
    """Balls of 1 kg on vertical slides over a floor, one world, with generic rows.

    Row i is the contact under ball i: J v = v_i − v_(i−1), distance offset + J q. `relaxed`: the
    softness stands in the denominator only; else it is a regulariser too (law `lesson`).
    """

    def __init__(self, start: np.ndarray, sweeps: int, relaxed: bool) -> None:
        n = len(start)
        self.start, self.sweeps = start, sweeps
        self.softness = 0.0 if relaxed else SOFTNESS
        self.jacobian = np.eye(n) - np.eye(n, k=-1)
        self.moved = np.linalg.inv(np.eye(n)) @ self.jacobian.T  # M⁻¹Jᵀ
        self.denominator = np.diag(self.jacobian @ self.moved) + SOFTNESS
        self.reset()

    def reset(self) -> None:
        self.qpos, self.qvel = self.start.copy(), np.zeros(len(self.start))

    def step(self, n: int) -> None:
        for _ in range(n):
            v = self.qvel - DT * G
            dist = self.jacobian @ self.qpos
            closing = dist + DT * (self.jacobian @ v) < 0.0
            active = np.flatnonzero(closing | (dist <= NEAR))
            target = (
                -(BETA * np.minimum(dist, 0.0) + np.where(closing, 0.0, np.maximum(dist, 0.0))) / DT
            )
            impulse = np.zeros(len(dist))
            for _ in range(self.sweeps):
                for i in active:
                    short = target[i] - self.jacobian[i] @ v - self.softness * impulse[i]
                    new = max(0.0, impulse[i] + short / self.denominator[i])
                    v = v + self.moved[:, i] * (new - impulse[i])
                    impulse[i] = new
            self.qvel = v
            self.qpos = self.qpos + DT * v


class ManySprings:
    """The spring in many worlds: whole-array operations into arrays that exist already."""

    def __init__(self, start: np.ndarray) -> None:
        self.start = start[:, 0].copy()
        self.x, self.v, self.work = (np.empty_like(self.start) for _ in range(3))
        self.reset()

    def reset(self) -> None:
        self.x[:], self.v[:] = self.start, 0.0

    @property
    def qpos(self) -> np.ndarray:
        return self.x[:, None]

    def step(self, n: int) -> None:
        x, v, work = self.x, self.v, self.work
        for _ in range(n):
            np.multiply(x, SPRING_DT * STIFFNESS, out=work)
            np.subtract(v, work, out=v)
            np.multiply(v, SPRING_DT, out=work)
            np.add(x, work, out=x)


class ManyDrops:
    """The ball drop in many worlds: one row, so one sweep solves it.

    A row that touches without closing would do nothing.
    """

    def __init__(self, start: np.ndarray) -> None:
        self.start = start[:, 0].copy()
        self.x, self.v, self.t, self.guess = (np.empty_like(self.start) for _ in range(4))
        self.hit = np.empty(len(start), dtype=bool)
        self.reset()

    def reset(self) -> None:
        self.x[:], self.v[:] = self.start, 0.0

    @property
    def qpos(self) -> np.ndarray:
        return self.x[:, None]

    def step(self, n: int) -> None:
        x, v, t, guess, hit = self.x, self.v, self.t, self.guess, self.hit
        for _ in range(n):
            np.subtract(v, DT * G, out=v)
            np.multiply(v, DT, out=guess)
            np.add(guess, x, out=guess)
            np.less(guess, 0.0, out=hit)
            # λ = max(0, (t − v)/(1 + s)) with t = −β min(x, 0)/dt, where the guess overlaps.
            np.minimum(x, 0.0, out=t)
            np.multiply(t, -BETA / DT, out=t)
            np.subtract(t, v, out=t)
            np.multiply(t, 1.0 / (1.0 + SOFTNESS), out=t)
            np.maximum(t, 0.0, out=t)
            np.multiply(t, hit, out=t)
            np.add(v, t, out=v)
            np.multiply(v, DT, out=t)
            np.add(x, t, out=x)


class ManyStacks:
    """Two balls in many worlds, law `relaxed`, every sweep over both rows of all worlds."""

    def __init__(self, start: np.ndarray) -> None:
        self.start = np.ascontiguousarray(start.T)
        self.x, self.v = np.empty_like(self.start), np.empty_like(self.start)
        self.t, self.impulse = np.empty_like(self.start), np.empty_like(self.start)
        self.dist, self.new = np.empty_like(self.start), np.empty_like(self.start[0])
        self.hit, self.apart = (np.empty(self.start.shape, dtype=bool) for _ in range(2))
        self.reset()

    def reset(self) -> None:
        self.x[:], self.v[:] = self.start, 0.0

    @property
    def qpos(self) -> np.ndarray:
        return self.x.T

    def step(self, n: int) -> None:
        x, v, t, impulse, dist, new, hit, apart = (
            self.x, self.v, self.t, self.impulse, self.dist, self.new, self.hit, self.apart
        )  # fmt: skip
        floor, ball = 1.0 / (1.0 + SOFTNESS), 1.0 / (2.0 + SOFTNESS)
        for _ in range(n):
            np.subtract(v, DT * G, out=v)
            dist[0] = x[0]
            np.subtract(x[1], x[0], out=dist[1])
            np.subtract(v[1], v[0], out=t[1])
            np.multiply(v[0], DT, out=t[0])
            np.multiply(t[1], DT, out=t[1])
            np.add(t, dist, out=t)
            np.greater_equal(t, 0.0, out=apart)
            np.maximum(dist, 0.0, out=t)
            np.multiply(t, apart, out=t)
            np.logical_not(apart, out=hit)
            np.less_equal(dist, NEAR, out=apart)
            np.logical_or(hit, apart, out=hit)
            np.minimum(dist, 0.0, out=dist)
            np.multiply(dist, BETA, out=dist)
            np.add(t, dist, out=t)
            np.multiply(t, -1.0 / DT, out=t)
            impulse[:] = 0.0
            for _ in range(SWEEPS):
                np.subtract(t[0], v[0], out=new)
                np.multiply(new, floor, out=new)
                np.add(new, impulse[0], out=new)
                np.maximum(new, 0.0, out=new)
                np.multiply(new, hit[0], out=new)
                np.add(v[0], new, out=v[0])
                np.subtract(v[0], impulse[0], out=v[0])
                impulse[0] = new
                np.subtract(t[1], v[1], out=new)
                np.add(new, v[0], out=new)
                np.multiply(new, ball, out=new)
                np.add(new, impulse[1], out=new)
                np.maximum(new, 0.0, out=new)
                np.multiply(new, hit[1], out=new)
                np.subtract(new, impulse[1], out=impulse[1])
                np.add(v[1], impulse[1], out=v[1])
                np.subtract(v[0], impulse[1], out=v[0])
                impulse[1] = new
            np.multiply(v, DT, out=t)
            np.add(x, t, out=x)
