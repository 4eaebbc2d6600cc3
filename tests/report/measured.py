"""A small result of each kind, made once in a process when it is first asked for."""

import functools

import pytest

import stepcore as sc
from stepcore import lesson

FAST = {"threads": 1, "progress": False}


def failure():
    sim = sc.Sim(lesson.spring(), dt=0.205, integrator="semi-implicit", ledger=True)
    sim.reset("start")
    with pytest.raises(sc.SimulationError) as error:
        sim.step(1000)
    return sc.replay(error.value.replay)


def overlapping():
    scene = lesson.drop()
    scene.keys[0].qpos = [-0.05]
    return scene


def swinging():
    sim = sc.Sim(lesson.spring())
    sim.reset("start")
    return sim.run(0.2)


RESTING = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .1"><freejoint/>
<geom name="ball" size=".1"/></body></worldbody></mujoco>"""

MADE = {
    "trade": lambda: sc.trade(
        lesson.spring(),
        horizon=0.2,
        starts=1,
        dts=[0.005, 0.01],
        integrators=["semi-implicit", "rk4"],
        error=1e-3,
        further=0,
        by="flops",
        **FAST,
    ),
    "ablation": lambda: sc.ablate(lesson.drop(), horizon=0.2, starts=1, **FAST),
    "comparison": lambda: sc.compare(
        lesson.spring(),
        lesson.spring().compile().with_values({"joint/spring/stiffness": 90.0}),
        horizon=0.2,
        starts=1,
        **FAST,
    ),
    "convergence": lambda: sc.converge(lesson.stack(), horizon=0.1, starts=1, **FAST),
    "predictability": lambda: sc.predict(lesson.spring(), horizon=0.5, starts=3, **FAST),
    "stability": lambda: sc.stability_map(
        "lesson:spring",
        path="joint/spring/stiffness",
        values=[10, 100],
        dts=[0.01, 0.1],
        integrators=["euler", "rk4"],
        **FAST,
    ),
    "check": lambda: sc.check(overlapping(), horizon=0.1, **FAST),
    "plan": lambda: sc.plan(lesson.drop()),
    "tuning": lambda: sc.tune(sc.loads(RESTING), depth="0.1mm"),
    "identification": lambda: sc.identify(
        lesson.spring(), swinging(), {"joint/spring/stiffness": (50, 200)}
    ),
    "diagnosis": lambda: sc.diagnose(lesson.spring(), progress=False),
    "postmortem": failure,
}

RESULTS = {kind: functools.cache(make) for kind, make in MADE.items()}
