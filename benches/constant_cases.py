"""Small questions whose answers show what a numeric constant of the measurements decides.

Each case is asked in well below a second, on one thread. Together they should reach every rule of
`measure` and `experiment`: a constant that no case reads is told apart by the bench.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

import stepcore as sc
from stepcore import lesson

QUIET: dict[str, Any] = {"threads": 1, "progress": False}
SHORT = {**QUIET, "horizon": 0.2, "starts": 2}


def mjcf(bodies: str, rest: str = "", option: str = "") -> sc.Scene:
    """Return a scene of these bodies; a load that warns does so in its own case."""
    text = f"<mujoco><option {option}/><worldbody>{bodies}</worldbody>{rest}</mujoco>"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return sc.loads(text)


def servo(kp: float = 5000, more: str = 'forcerange="-500 500"', ctrl: float = 0.5) -> sc.Scene:
    """Return one hinge with a position servo, held at its keyframe."""
    rod = '<geom type="capsule" size=".03" fromto="0 0 0 0 0 -.5" mass="1"/>'
    body = f'<body name="arm"><joint name="hip" axis="0 1 0" damping="1"/>{rod}</body>'
    drive = f'<actuator><position name="drive" joint="hip" kp="{kp}" {more}/></actuator>'
    return mjcf(body, f'{drive}<keyframe><key qpos="{ctrl}" ctrl="{ctrl}"/></keyframe>')


def arm(kp: float = 200, kv: float = 10) -> sc.Scene:
    """Return an arm of three links with servos, without contacts."""
    link = '<body name="{0}" pos="0 0 {1}"><joint name="{0}" axis="0 1 0" range="-2 2" '
    link += 'limited="true"/><geom type="capsule" size=".03" fromto="0 0 0 0 0 .3" mass="1" '
    link += 'contype="0" conaffinity="0"/>{2}</body>'
    body = ""
    for name, height in (("wrist", 0.3), ("elbow", 0.3), ("shoulder", 0)):
        body = link.format(name, height, body)
    drives = "".join(
        f'<position name="{name}" joint="{name}" kp="{kp}" kv="{kv}" ctrlrange="-2 2"/>'
        for name in ("shoulder", "elbow", "wrist")
    )
    key = '<keyframe><key name="home" qpos=".3 .6 .3" ctrl=".3 .6 .3"/></keyframe>'
    return mjcf(body, f"<actuator>{drives}</actuator>{key}", 'integrator="implicitfast"')


def hanging(links: int = 2) -> sc.Scene:
    """Return a pendulum of links, let go from the horizontal: chaotic with two or more."""
    body = ""
    for k in reversed(range(links)):
        rod = '<geom type="capsule" size=".02" fromto="0 0 0 .4 0 0" mass="1" contype="0"/>'
        at = ".4 0 0" if k else "0 0 0"
        body = f'<body pos="{at}"><joint name="j{k}" axis="0 1 0"/>{rod}{body}</body>'
    return mjcf(body)


def floor(
    body: str, fields: str = "", rest: str = "", pos: str = "0 0 .1", option: str = ""
) -> sc.Scene:
    """Return one free body above a floor; fields: attributes of all geoms."""
    plane = '<geom name="floor" type="plane" size="5 5 .1"/>'
    rest += f"<default><geom {fields}/></default>"
    return mjcf(f'{plane}<body name="it" pos="{pos}"><freejoint/>{body}</body>', rest, option)


BOX = '<geom name="box" type="box" size=".1 .1 .1" mass="1"/>'
BALL = '<geom name="ball" size=".1" mass="1"/>'
COLUMN = """<geom type="box" size=".05 .05 .5" mass="5"/><body pos="0 0 .5">
<joint name="top" axis="0 0 1" damping="1"/><geom size=".05" pos="0 0 .1" mass=".1"/></body>"""


def column() -> sc.Scene:
    """Return a column that leans too far for its servo to hold it."""
    drive = '<actuator><position joint="top" kp="10"/></actuator>'
    key = '<keyframe><key qpos="0 0 .502 .9972 0 .0749 0 0"/></keyframe>'
    return floor(COLUMN, rest=drive + key, pos="0 0 .5")


def cube() -> sc.Scene:
    """Return a cube thrown at a thin table."""
    table = '<body pos="0 0 .8"><geom name="table" type="box" size=".4 .4 .025"/></body>'
    body = (
        '<body pos="0 0 1.2"><freejoint/><geom name="cube" type="box" size=".02 .02 .02"/></body>'
    )
    key = '<keyframe><key qpos="0 0 1.2 1 0 0 0" qvel="0 0 -31 0 0 0"/></keyframe>'
    return mjcf(table + body, key)


def rattling() -> sc.Scene:
    """Return a box on undamped contacts, with a force sensor."""
    site = '<site name="s" type="box" size=".11 .11 .11"/>'
    sensor = '<sensor><touch name="t" site="s"/></sensor>'
    return floor(BOX + site, 'solref="-200000 0"', sensor, "0 0 .0999")


def loss(value: float = 5.0) -> sc.Scene:
    """Return an arm that its friction loss holds, or nearly."""
    rod = '<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".5"/>'
    return mjcf(f'<body><joint name="j" axis="0 1 0" frictionloss="{value}"/>{rod}</body>')


def stop() -> sc.Scene:
    """Return a motor that pushes a joint beyond a soft limit."""
    body = """<body><joint name="elbow" axis="0 1 0" range="-60 60" solreflimit=".1 1"
    damping=".01"/><inertial pos=".1 0 0" mass="1" diaginertia=".001 .001 .001"/></body>"""
    drive = '<actuator><motor name="drive" joint="elbow" gear="5" ctrlrange="-1 1"/></actuator>'
    return mjcf(body, drive, 'gravity="0 0 0"')


def play() -> sc.Scene:
    """Return a joint with backlash, a second joint between narrow limits."""
    body = """<body pos="0 0 .5"><joint name="calf" axis="0 1 0" range="-154.5 -52.5" damping="1"
    armature=".01"/><joint name="play" axis="0 1 0" range="-2.3 2.3"/><geom type="capsule"
    fromto="0 0 0 0 0 -.213" size=".013" mass=".2"/></body>"""
    drive = '<actuator><position joint="calf" kp="60"/></actuator>'
    key = '<keyframe><key qpos="-1.57 0" ctrl="-1.57"/></keyframe>'
    return mjcf(body, drive + key)


def hung() -> sc.Scene:
    """Return a weight on a soft connection."""
    bob = '<body name="bob" pos="0 0 1"><freejoint/><geom size=".05" mass="2" contype="0"/></body>'
    hook = '<connect name="hook" body1="bob" anchor="0 0 0" solref=".1 1"/>'
    return mjcf(bob, f"<equality>{hook}</equality>")


def swung(scene: sc.Scene, time: float = 0.4) -> Any:
    """Return a log of a scene's motion."""
    sim = sc.Sim(scene)
    sim.reset(key=0 if scene.keys else None)
    record = ("qpos", "qvel", "ctrl") if sim.model.nu else ("qpos", "qvel")
    return sim.run(time, record=record)


def loaded() -> list[str]:
    """Return what the load of a stiff scene warns of."""
    text = servo(50_000, "").to_mjcf()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sc.loads(text)
    return [str(each.message) for each in caught]


def pd(time: float, sim: Any) -> list[float]:
    """Return the torque of a spring and a damper that a user wrote."""
    return [-80 * sim.qpos[0] - 2 * sim.qvel[0]]


def motor() -> sc.Scene:
    """Return one hinge with a motor."""
    rod = '<geom type="capsule" size=".03" fromto="0 0 0 0 0 -.5" mass="1"/>'
    body = f'<body><joint name="hip" axis="0 1 0"/>{rod}</body>'
    return mjcf(body, '<actuator><motor name="drive" joint="hip"/></actuator>')


def sine() -> dict[str, Any]:
    """Return a log of commands at 50 Hz."""
    time = np.arange(0, 0.4, 0.02)
    return {"ctrl": 0.5 + 0.2 * np.sin(8 * time)[:, None], "control_dt": 0.02}


CASES: dict[str, Callable[[], Any]] = {
    "trade spring": lambda: sc.trade(lesson.spring(), error=1e-3, **SHORT),
    "trade stack": lambda: sc.trade(lesson.stack(), error=5e-3, **SHORT),
    "trade drop": lambda: sc.trade(lesson.drop(), error=1e-3, **SHORT),
    "trade servo": lambda: sc.trade(servo(), error=1e-3, **SHORT),
    "trade arm": lambda: sc.trade(arm(), error=1e-3, **SHORT),
    "trade arm, default motion": lambda: sc.trade(arm(), error=1e-3, starts=2, **QUIET),
    "trade cheetah": lambda: sc.trade("gymnasium:half_cheetah", error=0.01, **SHORT),
    "trade cheetah in time": lambda: sc.trade(
        "gymnasium:half_cheetah", error=1e-3, seconds=0.2, **SHORT
    ),
    "trade pendulum": lambda: sc.trade(hanging(), error=1e-3, horizon=3.0, starts=2, **QUIET),
    "trade log": lambda: sc.trade(servo(500, ""), error=1e-3, starts=1, **sine(), **QUIET),
    "trade mujoco": lambda: sc.trade(servo(), error=1e-3, engine="mujoco", **SHORT),
    "trade accuracy": lambda: sc.trade(floor(BALL, option='timestep=".005"'), error=1e-3, **SHORT),
    "ablate stack": lambda: sc.ablate(lesson.stack(), added=1e-3, **SHORT),
    "ablate cheetah": lambda: sc.ablate("gymnasium:half_cheetah", added=0.01, **SHORT),
    "ablate arm": lambda: sc.ablate(arm(), added=1e-3, **SHORT),
    "converge stack": lambda: sc.converge(lesson.stack(), **SHORT),
    "converge box": lambda: sc.converge(floor(BOX), **SHORT),
    "predict pendulum": lambda: sc.predict(hanging(), horizon=4.0, starts=3, **QUIET),
    "predict spring": lambda: sc.predict(lesson.spring(), horizon=0.5, starts=3, **QUIET),
    "predict cheetah": lambda: sc.predict("gymnasium:half_cheetah", **SHORT),
    "map spring": lambda: sc.stability_map(
        "lesson:spring",
        path="joint/spring/stiffness",
        values=[10, 100, 1000],
        dts=[0.01, 0.1],
        **QUIET,
    ),
    "map servo": lambda: sc.stability_map(
        servo(), path="actuator/drive/kp", values=[500, 5000], dts=[0.002, 0.02], **QUIET
    ),
    "diagnose spring": lambda: sc.diagnose(lesson.spring(), **QUIET),
    "diagnose stack": lambda: sc.diagnose(lesson.stack(), horizon=0.2, **QUIET),
    "diagnose drop": lambda: sc.diagnose(lesson.drop(), horizon=0.2, **QUIET),
    "diagnose servo": lambda: sc.diagnose(servo(), dt=0.006, horizon=0.2, **QUIET),
    "diagnose free servo": lambda: sc.diagnose(servo(5000, ""), horizon=0.2, **QUIET),
    "diagnose arm": lambda: sc.diagnose(arm(), horizon=0.2, **QUIET),
    "diagnose box": lambda: sc.diagnose(floor(BOX), horizon=0.2, **QUIET),
    "diagnose PD": lambda: sc.diagnose(motor(), control=pd, control_dt=0.02, horizon=0.2, **QUIET),
    "load": loaded,
    "check column": lambda: sc.check(column(), horizon=1.5, **QUIET),
    "check cube": lambda: sc.check(cube(), horizon=0.05, **QUIET),
    "check rattling": lambda: sc.check(rattling(), horizon=0.5, **QUIET),
    "check loss": lambda: sc.check(loss(), horizon=0.5, **QUIET),
    "check small loss": lambda: sc.check(loss(0.1), horizon=0.5, **QUIET),
    "check stop": lambda: sc.check(stop(), horizon=0.5, control=lambda time, sim: [1.0], **QUIET),
    "check play": lambda: sc.check(play(), horizon=0.5, **QUIET),
    "check hung": lambda: sc.check(hung(), horizon=1.0, **QUIET),
    "check servo": lambda: sc.check(servo(20, ""), horizon=0.5, **QUIET),
    "check weak servo": lambda: sc.check(
        servo(200, 'forcerange="-2 2" ctrlrange="-9 9"', 1.5), horizon=0.5, **QUIET
    ),
    "check deep box": lambda: sc.check(floor(BOX, pos="0 0 .08"), horizon=0.2, **QUIET),
    "check soft box": lambda: sc.check(floor(BOX, 'solref=".3 1"'), horizon=0.5, **QUIET),
    "check millimetres": lambda: sc.check(
        floor('<geom type="box" size="100 100 100"/>', pos="0 0 100"), horizon=0.2, **QUIET
    ),
    "check light body": lambda: sc.check(
        floor('<geom type="box" size=".5 .5 .5" mass="1e-4"/>', pos="0 0 .5"), horizon=0.2, **QUIET
    ),
    "check cheetah": lambda: sc.check("gymnasium:half_cheetah", horizon=0.1, **QUIET),
    "tune depth": lambda: sc.tune(floor(BOX), depth="0.1mm"),
    "tune bandwidth": lambda: sc.tune(servo(50, ""), bandwidth=3.0),
    "tune settling": lambda: sc.tune(servo(50, ""), settling="150ms"),
    "tune sag": lambda: sc.tune(servo(50, ""), sag=0.01),
    "identify spring": lambda: sc.identify(
        lesson.spring(), swung(lesson.spring()), {"joint/spring/stiffness": (50, 200)}
    ),
    "identify arm": lambda: sc.identify(
        arm(150, 8),
        swung(arm()),
        {"actuator/elbow/kp": (50, 500), "body/wrist/mass": (0.2, 5.0)},
    ),
    "run cheetah": lambda: sc.run("gymnasium:half_cheetah", horizon=0.5, **QUIET),
    "sweep": lambda: sc.sweep(
        lesson.spring(), {"dt": [0.001, 0.01]}, lambda sim: float(sim.run(0.1).qpos[-1, 0])
    ),
}
