"""stepcore against PyBullet, a ball drop and piles of spheres: see `falling.py`.

Bullet's contacts are hard, its friction is a pyramid and its method sequential impulses, in double
precision in this package: what stepcore calls law `rigid` under PGS. Bullet keeps its 50
iterations, stepcore takes the fewest sweeps at which its spheres overlap no deeper. Both take one
call from Python a step.
"""

from __future__ import annotations

import numpy as np
import pybullet
import record
from falling import CASES, DT, Case, compare, header

SWEEPS = 50  # Bullet's default


class Bullet:
    """Spheres over planes, in a process without graphics."""

    name = "Bullet"
    threads = False

    def __init__(self, case: Case) -> None:
        self.client = pybullet.connect(pybullet.DIRECT)
        here = {"physicsClientId": self.client}
        pybullet.setGravity(0, 0, -9.81, **here)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=DT, numSolverIterations=SWEEPS, numSubSteps=0, **here
        )
        sides = [((0, 0, 1), (0, 0, 0))]
        if case.walls:
            for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                sides.append(((x, y, 0), (-x * case.walls, -y * case.walls, 0)))
        rubs = {"lateralFriction": 1.0, "restitution": 0.0, **here}
        for normal, place in sides:
            plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, planeNormal=normal, **here)
            wall = pybullet.createMultiBody(0, plane, basePosition=place, **here)
            pybullet.changeDynamics(wall, -1, **rubs)
        ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=case.radius, **here)
        self.bodies = []
        for centre in case.centres:
            body = pybullet.createMultiBody(1.0, ball, basePosition=tuple(centre), **here)
            pybullet.changeDynamics(body, -1, linearDamping=0.0, angularDamping=0.0, **rubs)
            self.bodies.append(body)

    def step(self, n: int) -> None:
        for _ in range(n):
            pybullet.stepSimulation(physicsClientId=self.client)

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        of = {"physicsClientId": self.client}
        places = [pybullet.getBasePositionAndOrientation(body, **of)[0] for body in self.bodies]
        speeds = [pybullet.getBaseVelocity(body, **of)[0] for body in self.bodies]
        return np.array(places), np.array(speeds)


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    note = f"dt {DT} s; stepcore law rigid; Bullet {SWEEPS} iterations; both f64"
    report = record.Report("vs_bullet", options, note)
    header(report, Bullet)
    for case in CASES:
        if options.only in case.name:
            compare(case, options, report, Bullet)
    report.close()


if __name__ == "__main__":
    main()
