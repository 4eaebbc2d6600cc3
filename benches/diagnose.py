"""What a diagnosis takes by the size of the model.

    python benches/diagnose.py

Processor time of `stepcore.diagnose(model, threads=1)`; the shorter of two.
"""

from __future__ import annotations

import time

import stepcore as sc


def chain(links: int) -> sc.Scene:
    """Hinges with springs, one after the other, that meet nothing."""
    scene = sc.Scene(name=f"chain of {links} hinges").with_settings(dt=1e-3)
    parent = scene.world
    for link in range(links):
        parent = scene.add_body(f"link{link}", parent, pos=(0, 0, -0.1 if link else 0.0))
        scene.add_joint(parent, "hinge", axis=(0, 1, 0), stiffness=5.0, damping=0.01)
        ends = (0, 0, 0, 0, 0, -0.1)
        scene.add_geom(parent, "capsule", 0.02, fromto=ends, contype=0, conaffinity=0)
    return scene


def balls(count: int) -> sc.Scene:
    """Free balls side by side on a plane."""
    scene = sc.Scene(name=f"{count} free balls on a plane")
    scene.add_geom("world", "plane", name="floor")
    for ball in range(count):
        body = scene.add_body(f"ball{ball}", pos=(0.3 * ball, 0, 0.0999))
        scene.add_joint(body, "free")
        scene.add_geom(body, "sphere", 0.1, name=f"ball{ball}", mass=1.0)
    return scene


def taken(scene: sc.Scene) -> float:
    """[s]"""
    begin = time.process_time()
    sc.diagnose(scene, threads=1, progress=False)
    return time.process_time() - begin


def main() -> None:
    print(f"{'model':28} {'dofs':>5} {'s':>6}")
    gym = [sc.load(f"gymnasium:{name}") for name in ("half_cheetah", "ant")]
    for scene in (*gym, chain(10), chain(30), chain(60), balls(10)):
        least = min(taken(scene) for _ in range(2))
        print(f"{scene.name:28} {scene.compile().nv:5} {least:6.2f}")


if __name__ == "__main__":
    main()
