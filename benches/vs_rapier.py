"""stepcore against Rapier (the rapier3d package), a ball and piles of spheres: see `falling.py`.

Rapier's contacts are soft, in single precision and tuned for games; stepcore's here are law `rigid`
in double precision, under PGS. Rapier's package has no call for several steps.
"""

from __future__ import annotations

import numpy as np
import rapier3d
import record
from falling import CASES, DT, Case, compare, header

SWEEPS = 4  # Rapier's default number of solver iterations


class Rapier:
    """Spheres over half spaces."""

    name = "Rapier"
    threads = True  # of its own, so that times are wall times

    def __init__(self, case: Case) -> None:
        self.world = rapier3d.PhysicsWorld(gravity=(0.0, 0.0, -9.81))
        self.world.set_num_threads(1)
        self.world.integration_parameters.dt = DT
        self.world.integration_parameters.num_solver_iterations = SWEEPS
        sides = [((0, 0, 1), (0, 0, 0))]
        if case.walls:
            for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                sides.append(((x, y, 0), (-x * case.walls, -y * case.walls, 0)))
        for normal, place in sides:
            wall = rapier3d.Collider.halfspace(normal).friction(1.0).translation(place)
            self.world.add_collider(wall)
        self.bodies = []
        for centre in case.centres:
            body = rapier3d.RigidBody.dynamic(translation=tuple(centre)).can_sleep(False)
            shape = rapier3d.Collider.ball(case.radius).mass(1.0).friction(1.0)
            self.bodies.append(self.world.add_body(body, [shape]))

    def step(self, n: int) -> None:
        for _ in range(n):
            self.world.step()

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        bodies = [self.world.rigid_bodies[handle] for handle in self.bodies]
        return (
            np.array([[b.translation.x, b.translation.y, b.translation.z] for b in bodies]),
            np.array([[b.linvel.x, b.linvel.y, b.linvel.z] for b in bodies]),
        )


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    note = (
        f"dt {DT} s; stepcore law rigid, f64; Rapier's own law and settings, {SWEEPS} sweeps, f32"
    )
    report = record.Report("vs_rapier", options, note)
    header(report, Rapier)
    for case in CASES:
        if options.only in case.name:
            compare(case, options, report, Rapier)
    report.close()


if __name__ == "__main__":
    main()
