"""Small scenes that several tests share."""

import stepcore as sc


def pendulum(**options):
    """Two hinged rods over a floor, a motor, a site, a limit and a keyframe."""
    scene = sc.Scene(name="pendulum").with_settings(**options)
    upper = scene.add_body("upper", pos=(0, 0, 0.6))
    scene.add_joint(upper, "hinge", name="shoulder", axis=(0, 1, 0), damping=0.02)
    scene.add_geom(upper, "capsule", 0.04, fromto=(0, 0, 0, 0.4, 0, 0), name="rod", mass=1.0)
    lower = scene.add_body("lower", parent=upper, pos=(0.4, 0, 0))
    scene.add_joint(lower, "hinge", name="elbow", axis=(0, 1, 0), range=(-1.0, 1.0))
    scene.add_geom(lower, "capsule", 0.04, fromto=(0, 0, 0, 0.5, 0, 0), name="tip", mass=0.5)
    scene.add_site(lower, name="hand", pos=(0.5, 0, 0))
    scene.add_geom("world", "plane", name="floor")
    scene.add_actuator("elbow", name="motor", gear=(2.0,), ctrlrange=(-1, 1))
    scene.add_key("bent", time=0.5, qpos=(0.3, -0.5), qvel=(0.1, 0.2), ctrl=(0.7,))
    return scene


def ball(**options):
    scene = sc.Scene().with_settings(**options)
    body = scene.add_body("ball", pos=(0, 0, 0.099))
    scene.add_joint(body, "free", name="root")
    scene.add_geom(body, "sphere", 0.1, mass=2.0, name="ball")
    scene.add_geom("world", "plane", name="floor")
    return scene


def unstable(**options):
    """A stiff spring far beyond the step that its integrator can take: ω dt = 10."""
    scene = sc.Scene(gravity=(0, 0, 0)).with_settings(dt=0.1, integrator="semi-implicit")
    for name, stiffness in (("calm", 1.0), ("wild", 1e4)):
        body = scene.add_body(name)
        scene.add_joint(body, "slide", name=name, stiffness=stiffness)
        scene.add_geom(body, "sphere", 0.1, mass=1.0, contype=0, conaffinity=0)
    return scene.with_settings(**options)


def by(result, **wanted):
    """The one row with these settings."""
    (row,) = [
        row
        for row in result.rows
        if all(getattr(row.settings, name) == value for name, value in wanted.items())
    ]
    return row
