"""Scenes that move violently and are healthy, by seed: dropped, driven, spun, pressed, in loops."""

import random
import warnings

import numpy as np

import stepcore as sc

LAWS = ("solref", "solref", "lesson", "relaxed", "rigid", "penalty")
INTEGRATORS = (
    *("semi-implicit", "euler", "implicitfast", "implicit", "discrete"),
    *("midpoint", "rk4"),
)
FLOOR = '<geom type="plane" size="1 1 1"/>'
KINDS = ("dropped", "pressed", "spun", "servos", "motors", "pushed", "sprung", "loop")


def text_of(kind, rng):
    """MJCF of one kind of scene, and the largest speed of its start."""
    if kind in ("dropped", "pressed"):
        return _heap(kind, rng), rng.choice([0.0, 1.0, 10.0, 100.0])
    if kind == "spun":
        size = " ".join(f"{rng.uniform(0.05, 0.3):.3f}" for _ in range(3))
        body = f'<body><freejoint/><geom type="box" size="{size}" mass="1"/></body>'
        return f'<mujoco><option gravity="0 0 0"/><worldbody>{body}</worldbody></mujoco>', 30.0
    return _arm(kind, rng), rng.choice([0.0, 1.0, 5.0])


def _heap(kind, rng):
    bodies = ""
    for k in range(rng.randint(1, 5)):
        high = 10 ** rng.uniform(-1, 2) if kind == "dropped" else 0.05 + 0.1 * k
        pos = f"{rng.uniform(-0.2, 0.2):.3f} {rng.uniform(-0.2, 0.2):.3f} {high:.3f}"
        shape = rng.choice(['size=".1"', 'type="capsule" size=".05 .1"'])
        mass = 10 ** rng.uniform(-1, 1)
        bodies += f'<body pos="{pos}"><freejoint/><geom {shape} mass="{mass:.3f}"/></body>'
    return f"<mujoco><worldbody>{FLOOR}{bodies}</worldbody></mujoco>"


def _arm(kind, rng):
    n = rng.randint(1, 6) if kind != "loop" else rng.randint(4, 12)
    arm = acts = ""
    for k in range(n):
        spring = f' stiffness="{10 ** rng.uniform(0, 4):.3g}"' if kind == "sprung" else ""
        damping = f' damping="{10 ** rng.uniform(-3, 0):.3g}"' if rng.random() < 0.5 else ""
        bound = ' limited="true" range="-60 60"' if kind != "loop" and rng.random() < 0.3 else ""
        axis = "0 1 0" if kind == "loop" else rng.choice(["0 1 0", "1 0 0", "0 0 1"])
        arm += f'<body pos="{0.3 if k else 0} 0 {0 if k else 1}">'
        arm += f'<joint name="j{k}" axis="{axis}" armature=".01"{spring}{damping}{bound}/>'
        arm += '<geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass=".5"/>'
        gain = 10 ** rng.uniform(0, 3)
        bounds = f' forcerange="-{gain:.3g} {gain:.3g}"' if rng.random() < 0.3 else ""
        if kind == "servos":
            acts += f'<position joint="j{k}" kp="{gain:.3g}" kv="{gain / 20:.3g}"{bounds}/>'
        elif kind == "motors":
            acts += f'<motor joint="j{k}" gear="{gain / 5:.3g}"/>'
    arm += f'<site name="tip" pos=".3 0 0"/>{"</body>" * n}'
    equality = ""
    if kind == "loop":
        names = arm.split("<body ")
        arm = names[0] + "".join(f'<body name="b{k}" {b}' for k, b in enumerate(names[1:]))
        equality = f'<equality><connect body1="b{n - 1}" anchor=".3 0 0"/></equality>'
    return (
        f"<mujoco><worldbody>{FLOOR}{arm}</worldbody><actuator>{acts}</actuator>{equality}</mujoco>"
    )


def play(seed, dt=None, steps=640, precision=None):
    """A scene of this seed under settings of its own, driven as its kind is.

    dt, precision: the seed's own by default. Returns what was said of its energy, the largest
    kinetic energy [J], and the seed's dt [s].
    """
    rng = random.Random(seed)
    kind = KINDS[seed % len(KINDS)]
    text, speed = text_of(kind, rng)
    own = rng.choice([5e-4, 1e-3, 2e-3])
    settings = {"law": rng.choice(LAWS), "integrator": rng.choice(INTEGRATORS)}
    settings |= {"sweeps": rng.choice([5, 20, 50]), "solver": "pgs"}
    if settings["law"] == "rigid":
        settings["restitution"] = rng.choice([0.0, 0.5, 0.9])
    if settings["law"] == "solref" and rng.random() < 0.5:
        settings |= {"solver": "newton", "sweeps": 50}
    if rng.random() < 0.2:
        settings["precision"] = "f32"
    if precision is not None:
        settings["precision"] = precision
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = sc.loads(text)
    sim = sc.Sim(scene, dt=dt or own, **settings)
    numbers = np.random.default_rng(seed)
    sim.qvel[:] = speed * numbers.uniform(-1, 1, sim.model.nv)
    portion, most = 10 * round(own / sim.settings.dt), 0.0
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", sc.EnergyWarning)
        try:
            for _ in range(steps // 10):
                if kind in ("servos", "motors"):
                    sim.ctrl[:] = numbers.uniform(-1, 1, sim.model.nu)
                if kind == "pushed":
                    sim.xfrc_applied[1:] = numbers.uniform(-50, 50, sim.xfrc_applied[1:].shape)
                sim.step(portion)
                most = max(most, sim.energy.kinetic)
            sim.balance()
        except sc.SimulationError as error:
            assert not error.gained
            most = np.inf
    return [str(one.message) for one in said], most, own
