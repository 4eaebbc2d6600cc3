"""Writes scenes of solids of every shape that overlap at random, on a floor of either kind."""

from __future__ import annotations

from random import Random

import numpy as np

SHAPES = ("sphere", "capsule", "cylinder", "ellipsoid", "box", "mesh")
# Of a solid's size; what overlaps by more is judged elsewhere.
DEEP = 0.1


class Solids:
    """Draws one scene from `chance`; `model()` is its text."""

    def __init__(self, chance: Random) -> None:
        self.chance = chance
        self.meshes: list[str] = []

    def numbers(self, count: int, low: float, high: float) -> str:
        return " ".join(f"{self.chance.uniform(low, high):.4f}" for _ in range(count))

    def mesh(self) -> str:
        """A solid of random vertices on a sphere."""
        rng = np.random.default_rng(self.chance.randrange(2**32))
        points = rng.normal(size=(self.chance.randint(5, 16), 3))
        points *= 0.1 / np.linalg.norm(points, axis=1, keepdims=True)
        vertices = " ".join(f"{x:.5f}" for x in points.ravel())
        self.meshes.append(f'<mesh name="m{len(self.meshes)}" vertex="{vertices}"/>')
        return f'type="mesh" mesh="m{len(self.meshes) - 1}"'

    def solid(self) -> str:
        kind = self.chance.choice(SHAPES)
        counts = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}
        if kind == "mesh":
            return self.mesh()
        return f'type="{kind}" size="{self.numbers(counts[kind], 0.06, 0.12)}"'

    def contact(self) -> str:
        chance = self.chance
        text = (
            f'condim="{chance.choice((1, 3, 4, 6))}" friction="{self.numbers(1, 0.2, 1.2)} .02 .01"'
        )
        if chance.random() < 0.3:
            text += f' solref="{self.numbers(1, 0.01, 0.05)} {self.numbers(1, 0.5, 1.5)}"'
        if chance.random() < 0.3:
            text += f' margin="{self.numbers(1, 0.005, 0.02)}"'
        return text + (' solmix="3"' if chance.random() < 0.1 else "")

    def body(self, k: int) -> str:
        joint = self.chance.choice(
            ("<freejoint/>",) * 3 + ('<joint pos="0 .1 .3" axis=".3 1 .2" damping=".2"/>',)
        )
        at = f"{0.11 * k + self.chance.uniform(-0.03, 0.03):.4f} {self.numbers(1, -0.04, 0.04)}"
        turn = f'euler="{self.numbers(3, -180, 180)}"'
        mass = f'mass="{self.numbers(1, 0.3, 3)}"'
        return (
            f'<body pos="{at} {self.numbers(1, 0.07, 0.12)}" {turn}>{joint}'
            f"<geom {self.solid()} {mass} {self.contact()}/></body>"
        )

    def model(self) -> str:
        chance = self.chance
        bodies = "".join(self.body(k) for k in range(chance.randint(1, 4)))
        floor = '<geom type="plane" size="2 2 .1"/>'
        if chance.random() < 0.07:
            floor = '<geom type="hfield" hfield="h"/>'
            heights = 'nrow="3" ncol="3" elevation="0 0 0 0 0 0 0 0 1"'
            self.meshes.append(f'<hfield name="h" size="2 2 .1 .1" {heights}/>')
        cone, impratio = chance.choice(("pyramidal", "elliptic")), chance.choice((1, 1, 5))
        return (
            f'<mujoco><option cone="{cone}" impratio="{impratio}"/><asset>{"".join(self.meshes)}'
            f"</asset><worldbody>{floor}{bodies}</worldbody></mujoco>"
        )
