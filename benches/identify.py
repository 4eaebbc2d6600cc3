"""`stepcore.identify` beside `mujoco.sysid`, on the two problems of its end-to-end tests.

    pip install "mujoco[sysid]"
    python benches/identify.py [--pairs N]

Both sides get the same model, the same log, which MuJoCo's rollout made, the same first guess and
the same bounds, in one process and in turn. mujoco.sysid knows the first state; stepcore estimates
it too, and finds intervals and the share of the integration error in the same call. Wall time, the
median of the pairs. "steps" are the steps of rollouts; of stepcore's the linearised ones stand
apart, each of which also steps four models nearby for each parameter, in vector lanes. The
problems and their figures are those of mujoco/sysid/tests/test_integration.py, written anew.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

import stepcore as sc
from stepcore.report.table import Table

SPRING = """<mujoco model="spring"><option timestep="0.002"><flag contact="disable"/></option>
<worldbody><body name="ball" pos="0 0 .1"><inertial pos="0 0 0" mass="{mass}"
 diaginertia=".001 .001 .001"/><joint name="slide" type="slide" axis="1 0 0" stiffness="100"
 damping="5"/><geom type="sphere" size=".05"/></body></worldbody>
<actuator><motor name="push" joint="slide"/></actuator>
<sensor><jointpos joint="slide"/><jointvel joint="slide"/></sensor></mujoco>"""
# Of each link: mass, axis, armature, damping, length, moments of inertia.
LINKS = (
    (1.0, "0 0 1", 0.5, 1.0, 0.1, "0.01 0.01 0.005"),
    (0.8, "0 1 0", 0.4, 0.8, 0.1, "0.008 0.008 0.004"),
    (0.6, "0 1 0", 0.3, 0.6, 0.1, "0.006 0.006 0.003"),
    (0.4, "0 0 1", 0.2, 0.4, 0.08, "0.004 0.004 0.002"),
    (0.2, "0 1 0", 0.1, 0.2, 0.06, "0.002 0.002 0.001"),
)
# Of the controls of the arm: amplitude [N·m], frequency [Hz], phase.
WAVES = ((5, 0.5, 0.0), (4, 0.7, 0.5), (3, 0.4, 1.0), (2, 0.9, 1.5), (1, 0.6, 2.0))


def arm() -> str:
    """The arm of five hinges, as MJCF."""
    inner = ""
    for k in range(len(LINKS), 0, -1):
        mass, axis, armature, damping, length, inertia = LINKS[k - 1]
        before = 0.1 if k == 1 else LINKS[k - 2][4]
        inner = (
            f'<body name="link{k}" pos="0 0 {before}"><inertial pos="0 0 {length / 2}" '
            f'mass="{mass}" diaginertia="{inertia}"/><joint name="joint{k}" axis="{axis}" '
            f'range="-3.14 3.14" armature="{armature}" damping="{damping}"/>'
            f'<geom type="capsule" size=".03" fromto="0 0 0 0 0 {length}"/>{inner}</body>'
        )
    joints = [f"joint{k + 1}" for k in range(len(LINKS))]
    sensors = [f'<{kind} joint="{name}"/>' for kind in ("jointpos", "jointvel") for name in joints]
    motors = [f'<motor joint="{name}"/>' for name in joints]
    return (
        '<mujoco model="arm"><compiler angle="radian" autolimits="true"/><option timestep="0.002" '
        'integrator="implicitfast"><flag contact="disable"/></option>'
        f"<worldbody>{inner}</worldbody><actuator>{''.join(motors)}</actuator>"
        f"<sensor>{''.join(sensors)}</sensor></mujoco>"
    )


@dataclass(frozen=True)
class Problem:
    """Values of a model to be found in a log.

    xml: the model with the true values. ctrl: of each step. true: by path. guess, low, high: of
        every value.
    """

    name: str
    xml: str
    ctrl: np.ndarray
    true: Mapping[str, float]
    guess: float
    low: float
    high: float


def problems() -> list[Problem]:
    times, later = np.arange(1500) * 0.002, np.arange(1000) * 0.002
    push = 5 * np.sin(2 * np.pi * 1.5 * times) + 3 * np.sin(2 * np.pi * 3.7 * times)
    waves = [size * np.sin(2 * np.pi * hz * later + phase) for size, hz, phase in WAVES]
    armatures = {f"joint/joint{k + 1}/armature": link[2] for k, link in enumerate(LINKS)}
    spring = SPRING.format(mass=1.0)
    return [
        Problem("mass", spring, push[:, None], {"body/ball/mass": 1.0}, 2.0, 0.3, 3.0),
        Problem("armatures", arm(), np.column_stack(waves), armatures, 0.01, 0.001, 1.0),
    ]


def measured(problem: Problem) -> tuple[Any, Any, np.ndarray, np.ndarray]:
    """The spec, its first state, and the times and sensors of MuJoCo's rollout."""
    import mujoco
    from mujoco import rollout, sysid

    if not hasattr(sysid, "create_initial_state"):
        # mujoco.sysid is empty, without an error, where a package of its own extra is missing.
        raise SystemExit('mujoco.sysid is not complete: pip install "mujoco[sysid]"')
    spec = mujoco.MjSpec.from_string(problem.xml)
    model = spec.compile()
    data = mujoco.MjData(model)
    start = sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
    state, sensor = rollout.rollout(model, data, start, problem.ctrl[:-1])
    return spec, start, np.squeeze(state, 0)[:, 0], np.squeeze(sensor, 0)


def of_mujoco(problem: Problem, made: Any) -> tuple[dict[str, float], int, int]:
    """What mujoco.sysid finds, its steps, and 0 linearised ones."""
    from mujoco import sysid

    spec, start, times, sensors = made
    steps = 0

    def assign(path: str, spec: Any, parameter: Any) -> None:
        kind, name, field = path.split("/")
        setattr(getattr(spec, kind)(name), field, parameter.value[0])

    parameters = sysid.ParameterDict()
    for path, true in problem.true.items():
        ends = {"min_value": problem.low, "max_value": problem.high}
        modifier = partial(assign, path)
        parameters.add(sysid.Parameter(path, nominal=true, modifier=modifier, **ends))
        parameters[path].value[:] = problem.guess
    clock = np.arange(len(problem.ctrl)) * 0.002
    control = sysid.TimeSeries(clock, problem.ctrl)
    seen = sysid.TimeSeries.from_names(times, sensors, spec.compile())
    sequences = sysid.ModelSequences(problem.name, spec, "log", start, control, seen)
    residual = sysid.build_residual_fn(models_sequences=[sequences])

    def counted(x: np.ndarray, *args: Any, **keywords: Any) -> Any:
        nonlocal steps
        steps += (1 if np.ndim(x) == 1 else np.shape(x)[1]) * len(times)
        return residual(x, *args, **keywords)

    with contextlib.redirect_stdout(io.StringIO()):
        best, _ = sysid.optimize(
            initial_params=parameters, residual_fn=counted, optimizer="mujoco", verbose=False
        )
    return {path: float(best[path].value[0]) for path in problem.true}, steps, 0


def of_stepcore(problem: Problem, made: Any) -> tuple[dict[str, float], int, int]:
    """What stepcore finds, its steps, and how many of them were linearised."""
    _, _, times, sensors = made
    model = sc.loads(problem.xml).compile().with_values(dict.fromkeys(problem.true, problem.guess))
    # MuJoCo's sensors are those of the state where a step began.
    log = {"time": times - 0.002, "ctrl": problem.ctrl[:-1]}
    log |= {"qpos": sensors[:, : model.nv], "qvel": sensors[:, model.nv :]}
    found = sc.identify(model, log, dict.fromkeys(problem.true, (problem.low, problem.high)))
    return found.values, found.steps, found.linearised


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=5, help="timed pairs (default 5)")
    pairs = parser.parse_args().pairs
    rows = []
    for problem in problems():
        made = measured(problem)
        sides = {"stepcore": of_stepcore, "mujoco.sysid": of_mujoco}
        samples: dict[str, list[float]] = {name: [] for name in sides}
        results = {name: side(problem, made) for name, side in sides.items()}
        for _ in range(pairs):
            for name, side in sides.items():
                begin = time.perf_counter()
                side(problem, made)
                samples[name].append(time.perf_counter() - begin)
        for name, (values, steps, linearised) in results.items():
            off = max(abs(values[path] - true) for path, true in problem.true.items())
            rows.append(
                {
                    "problem": problem.name,
                    "side": name,
                    "largest error": off,
                    "steps": steps,
                    "linearised": linearised,
                    "time [s]": float(np.median(samples[name])),
                }
            )
        ours, theirs = rows[-2:]
        ratio = np.median(np.divide(samples["stepcore"], samples["mujoco.sysid"]))
        fewer = ours["steps"] / theirs["steps"]
        words = f"{fewer:.2f} of the steps, {ratio:.2f} of the time of mujoco.sysid"
        print(f"{problem.name}: {words}")
    print(Table(rows))


if __name__ == "__main__":
    main()
