"""`Sim`: one world, and the loop place, detect, solve, commit that steps it."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from . import commit, detect, equalities, halves, place, rows, solve
from .compile import compile_scene
from .rotation import Array
from .settings import Settings
from .world import World


class Sim(World):
    """One world in plain numpy: the yardstick for the engine's numbers and its speed.

    Takes a Scene (or its dict) and settings by keyword. f64 only.
    """

    def __init__(self, scene: Any, **settings: Any) -> None:
        scene = getattr(scene, "scene", scene)  # a compiled model remembers its scene
        names = {f.name for f in fields(Settings)}
        own = {k: v for k, v in getattr(scene, "options", {}).items() if k in names}
        wanted = Settings(**(own | settings))
        m = compile_scene(scene)
        detect.check(m)
        held = any(j["range"] or j["frictionloss"] for j in m.joints) or m.scene["equalities"]
        if wanted.law == "penalty" and held:
            raise ValueError("law 'penalty': the reference has it for contacts only")
        super().__init__(m, wanted)
        self.sweeps_done = 0
        self._warm: dict[Any, float] = {}  # impulse of each row of the last step, by the row's key
        self.forward()

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.steps * self.settings.dt

    def reset(self, key: str | None = None) -> None:
        """Back to the scene's pose at rest, or to a named key; warm impulses are forgotten."""
        named = {k["name"]: k for k in self.model.scene["keys"]}
        if key is not None and key not in named:
            raise ValueError(
                f"no key is named '{key}'; the scene has: {', '.join(named) or 'none'}"
            )
        start = named.get(key, {})
        for name, rest in (("qpos", self.model.qpos0), ("qvel", 0.0), ("ctrl", 0.0)):
            value = start.get(name)
            getattr(self, name)[:] = rest if value is None else value
        self.qfrc_applied[:], self.xfrc_applied[:] = 0.0, 0.0
        self.steps, self._warm = 0, {}

    def step(self, n: int = 1) -> None:
        """n passes of the loop."""
        for _ in range(n):
            commit.commit(self, *self._place_detect_solve())
            self._warm = {
                row.key: impulse
                for row, impulse in zip(self.system.rows, self.impulses, strict=True)
            }

    def forward(self) -> None:
        """Place, detect and solve at the present state; nothing is committed."""
        self._place_detect_solve()

    def _place_detect_solve(self) -> tuple[Array, Array]:
        """The mean and the last velocity of the step, with the rows solved."""
        start = halves.started(self)
        guess, last = commit.SMOOTH[self.settings.integrator](self, start, self._acceleration)
        self.placed = place.place(self.model, self.qpos)
        M = place.mass_matrix(self.model, self.placed)
        self.contacts = detect.detect(self.model, self.placed)
        self.system = rows.build(self, self.placed, self.contacts, M, start, guess)
        warm = self._warm if self.settings.warm_start else {}
        inside, held = self.settings.connects_inside, equalities.KINDS.values()
        begin = np.array(
            [
                0.0 if inside and row.key[0] in held else warm.get(row.key, 0.0)
                for row in self.system.rows
            ]
        )
        self.guess = guess
        self.solved, self.impulses, self.sweeps_done = solve.solve(
            self.system, guess, begin, self.settings
        )
        final, self.beside = self.solved, np.zeros_like(self.impulses)
        if last is not guess:
            final = last + (self.solved - guess)
        if self.settings.stages and self.system.rows:
            solved = (self.solved, self.impulses)
            final, self.beside = halves.second(
                self, self.system, solved, begin, final, last - guess
            )
        self.qacc = (final - self.qvel) / self.settings.dt
        return self.solved, final

    def _acceleration(self, qpos: Array, v: Array) -> Array:
        """M^-1 f of everything but the rows, at any state."""
        placed = place.place(self.model, qpos)
        M = place.mass_matrix(self.model, placed)
        force = place.known_forces(self, placed, qpos, v)
        if self.settings.law == "penalty":
            found = detect.detect(self.model, placed)
            force = force + rows.penalty_force(self, placed, found, v, M)
        smooth = np.asarray(np.linalg.solve(M, force), float)
        return halves.connected(self, qpos, placed, M, v, smooth)

    def mass_matrix(self) -> Array:
        """The mass matrix at the present positions, armature included, shape (nv, nv)."""
        return place.mass_matrix(self.model, place.place(self.model, self.qpos))

    @property
    def rows(self) -> np.ndarray[Any, Any]:
        """The rows of the last solve: a structured array, one entry a row.

        kind and key name the source; block counts rows that are solved together; A is the
        diagonal of J M^-1 J^T [1/kg], mass that of the trees the row touches [kg].
        """
        system = self.system
        numbers = ("impulse", "target", "regulariser", "residual", "A", "mass")
        fields = [("kind", "U16"), ("key", "i8", 4), ("block", "i8")]
        out = np.zeros(len(system.rows), fields + [(name, "f8") for name in numbers])
        for i, row in enumerate(system.rows):
            out["kind"][i] = row.key[0]
            out["key"][i, : len(row.key) - 1] = row.key[1:]
        for block, (i, _) in enumerate(system.blocks):
            out["block"][i:] = block
        out["impulse"] = self.impulses + self.beside
        out["target"], out["regulariser"] = system.t, system.c
        out["residual"] = solve.residual_rows(system, self.solved, self.impulses, self.settings)
        out["A"], out["mass"] = system.A, system.mass
        return out

    @property
    def residual(self) -> float:
        """Largest velocity error that the rows of the last solve still hold [m/s]."""
        return solve.residual(self.system, self.solved, self.impulses, self.settings)

    @property
    def energy(self) -> place.Energy:
        """Kinetic and potential energy now [J]."""
        return place.energy(self.model, self.qpos, self.qvel)

    @property
    def xpos(self) -> Array:
        """Position of each body at the last solve [m], shape (nbody, 3)."""
        return self.placed.xpos

    def state(self) -> tuple[Any, ...]:
        """Everything that a later step depends on."""
        arrays = (self.qpos, self.qvel, self.ctrl, self.qfrc_applied, self.xfrc_applied)
        return tuple(a.copy() for a in arrays), self.steps, dict(self._warm)

    def restore(self, state: tuple[Any, ...]) -> None:
        """Continue from a state; the next steps repeat bit for bit."""
        arrays, self.steps, warm = state
        mine = (self.qpos, self.qvel, self.ctrl, self.qfrc_applied, self.xfrc_applied)
        for own, saved in zip(mine, arrays, strict=True):
            own[:] = saved
        self._warm = dict(warm)
