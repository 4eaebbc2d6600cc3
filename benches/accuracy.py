"""Steps within an accuracy: asked and delivered, and the largest fixed step that is as good.

Every scene, those of `trade_validation.py` among them, runs under controls that move each servo
slowly over a tenth of its range. At every control period its bodies are compared with a converged
run of fixed steps, whose own error (`truth`) is how far it is from twice the step.
`delivered/asked`: the largest error of a body's position, over accuracy times horizon; at most 1 is
as asked, where the truth is known so well. `fixed/this`: time of the largest fixed step (halvings
of 4 ms) that delivers as much, over the time within the accuracy; above 1 the accuracy is cheaper,
and `-` stands where no such step was tried. The worst come first.

`--random N` runs N chains of one to four bodies instead, on random springs, dampers and servos with
bounds, whose controls drift: at steps of 1 and 10 ms, against a run at an accuracy of 1e-6 m. Left
out are those that this does not know to a tenth of what is asked, and those in which a push of
1 mm/s or 1 mrad/s grows to more than half a millimetre: an accuracy bounds what a step adds.

`--drake` adds Drake's error-controlled integrators on the first two scenes: `pip install drake`.
"""

from __future__ import annotations

import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import record
import scenes
from trade_cases import CASES

import stepcore as sc

PERIOD, FINEST = 0.02, 8192
ACCURACIES = (1e-2, 1e-3, 1e-4)
ROBOTS = ("hopper", "half_cheetah", "walker2d", "ant", "humanoid")
SHARE, RATE = 0.1, 6.0  # of the controls' range; rad/s

LINKS = 5
CHAIN = (
    '<mujoco model="chain"><option timestep=".002" gravity="0 0 -9.81"/><worldbody>'
    + "".join(
        f'<body name="link{k}" pos="{0.2 if k else 0} 0 0"><joint axis="0 1 0"/>'
        '<geom type="capsule" size=".02" fromto="0 0 0 .2 0 0" mass=".3" contype="0" '
        'conaffinity="0"/>'
        for k in range(LINKS)
    )
    + "</body>" * LINKS
    + "</worldbody></mujoco>"
)
BALL = """<mujoco model="ball"><option timestep=".002"/><worldbody>
 <geom type="plane" size="5 5 .1"/>
 <body name="ball" pos="0 0 .5"><freejoint/><geom size=".1" mass="1"/></body>
 </worldbody></mujoco>"""


def main() -> None:
    with_drake = "--drake" in sys.argv
    sys.argv = [word for word in sys.argv if word != "--drake"]
    warnings.simplefilter("ignore", sc.EnergyWarning)
    if "--random" in sys.argv:
        return random_chains(int(sys.argv[sys.argv.index("--random") + 1]))
    options = record.arguments(__doc__.splitlines()[0])
    options.pairs = 0
    report = record.Report("accuracy", options, f"control period {PERIOD * 1e3:g} ms, one world")
    rows = []
    for name, scene, horizon in cases():
        if options.only in name:
            rows += measured(name, scene.compile(), horizon, options.quick, report)
    report.say()
    report.say(
        f"{'scene':26}{'asked':>9}{'truth':>9}{'delivered':>11}{'delivered/asked':>17}"
        f"{'ms per s':>10}{'fixed/this':>12}"
    )
    for row in sorted(rows, key=lambda row: -row["delivered"] / row["asked"]):
        fixed = "-" if row["fixed"] is None else f"{row['fixed'] / row['cost']:.2f}"
        report.say(
            f"{row['name']:26}{row['asked']:9.1e}{row['truth']:9.1e}{row['delivered']:11.1e}"
            f"{row['delivered'] / row['asked']:17.4f}{row['cost'] * 1e3:10.2f}{fixed:>12}"
        )
    known = [row for row in rows if row["truth"] < 0.2 * row["asked"]]
    kept = sum(row["delivered"] <= row["asked"] for row in known)
    report.say(f"as asked: {kept} of {len(known)} whose truth is known to a fifth of it")
    if with_drake:
        drake(report)
    report.close()


def cases() -> list[tuple[str, sc.Scene, float]]:
    """Name, scene, horizon [s]."""
    own = [("five links", sc.loads(CHAIN), 1.0), ("ball", sc.loads(BALL), 1.0)]
    own += [(name, sc.load(scenes.gym_path(name)), 0.5) for name in ROBOTS]
    known = {name for name, *_ in own}
    made = ((case.name, case.make(), case.horizon) for case in CASES if case.name not in known)
    return own + [row for row in made if row[1].settings.law == "solref"]


def measured(
    name: str, model: sc.Model, horizon: float, quick: bool, report: record.Report
) -> list[dict[str, Any]]:
    """A row for each accuracy; errors [m], costs [s a simulated second]."""
    finest = FINEST // 16 if quick else FINEST
    model = model.with_settings(sleep=False, ledger=False, stiction=False)
    integrator = model.settings.integrator
    fixed = {"integrator": integrator if integrator not in ("rk4", "midpoint") else "euler"}
    fixed["refsafe"] = False

    def run(pieces: int, **settings: Any) -> tuple[np.ndarray, float]:
        return moved(lambda: sc.Sim(model, dt=PERIOD / pieces, **settings), pieces, horizon)

    fine, coarse = (run(pieces, **fixed)[0] for pieces in (finest, finest // 2))
    # First order: twice the finer less the coarser has neither's error.
    true, truth = 2 * fine - coarse, distance(fine, coarse)
    ladder = []
    pieces = 5
    while pieces <= finest // 8:
        try:
            poses, cost = run(pieces, **fixed)
            ladder.append((distance(poses, true), cost))
        except sc.SimulationError:
            ladder.append((np.inf, np.inf))
        pieces *= 2
    rows = []
    for accuracy in ACCURACIES:
        poses, cost = run(1, accuracy=accuracy)
        delivered = distance(poses, true)
        good = [cost for error, cost in ladder if error <= max(delivered, truth)]
        row = {"name": name, "asked": accuracy * horizon, "truth": truth, "delivered": delivered}
        rows.append(row | {"cost": cost, "fixed": good[0] if good else None})
        report.add(**rows[-1])
    return rows


def moved(make: Callable[[], sc.Sim], pieces: int, horizon: float) -> tuple[np.ndarray, float]:
    """Positions of bodies at every control period; processor time [s a simulated second]."""
    best, poses = np.inf, np.zeros(0)
    for _ in range(2):
        sim = make()
        low, high = sim.model.actuator_ctrlrange.T if sim.ctrl.size else np.zeros((2, 0))
        bound = np.isfinite(low) & np.isfinite(high)
        low, high = np.where(bound, low, 0.0), np.where(bound, high, 0.0)
        centre, width = (low + high) / 2, SHARE * (high - low)
        times = PERIOD * np.arange(round(horizon / PERIOD))
        ctrl = centre + width * np.sin(RATE * times[:, None] + np.arange(centre.size))
        began = time.process_time()
        poses = driven(sim, ctrl, pieces)
        best = min(best, time.process_time() - began)
    return poses, best / horizon


def driven(sim: sc.Sim, ctrl: np.ndarray, pieces: int) -> np.ndarray:
    """Positions of bodies after every control period of so many steps."""
    poses = []
    for row in ctrl:
        sim.ctrl[:] = row
        sim.step(pieces)
        poses.append(sim.xpos.copy())
    return np.array(poses)


def distance(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(one - other, axis=2).max())


def random_chains(count: int) -> None:
    """Say how many runs of random chains exceed what was asked, and the worst."""
    warnings.simplefilter("ignore", sc.StiffnessWarning)
    told = np.array([share for seed in range(count) for share in delivered(seed)])
    print(
        f"random chains: {(told > 1).sum()} of {len(told)} runs exceed what was asked, "
        f"{(told > 2).sum()} twice; the worst is {told.max():.1f} times that, the median "
        f"{np.median(told):.3f}"
    )


def delivered(seed: int) -> list[float]:
    """Errors of a random chain over what was asked; none where that cannot be judged."""
    rng = np.random.default_rng(seed)
    model = sc.loads(random_chain(rng)).compile()
    ctrl = np.cumsum(0.05 * rng.normal(size=(50, model.nu)), axis=0)

    def run(dt: float, accuracy: float, push: float = 0.0) -> np.ndarray:
        sim = sc.Sim(model, dt=dt, accuracy=accuracy)
        sim.qvel[:] = push
        return driven(sim, ctrl, round(PERIOD / dt))

    try:
        true, coarser, pushed = run(1e-3, 1e-6), run(1e-3, 1e-5), run(1e-3, 1e-6, push=1e-3)
    except sc.SimulationError:
        return []
    if distance(true, pushed) > 0.5e-3:
        return []
    known = [asked for asked in ACCURACIES if distance(true, coarser) < 0.1 * asked]
    return [distance(run(dt, asked), true) / asked for asked in known for dt in (1e-3, 1e-2)]


def random_chain(rng: np.random.Generator) -> str:
    bodies = actuators = ""
    count = int(rng.integers(1, 5))
    for k in range(count):
        axis = " ".join(f"{x:.3f}" for x in rng.normal(size=3))
        joint = f'<joint name="j{k}" type="{rng.choice(["hinge", "hinge", "slide"])}" axis="{axis}"'
        for name, share, low, high in (
            ("stiffness", 0.4, 0, 4),
            ("damping", 0.5, -2, 2),
            ("armature", 0.4, -4, -1),
            ("frictionloss", 0.15, -2, 0),
        ):
            if rng.random() < share:
                joint += f' {name}="{10 ** rng.uniform(low, high):.3g}"'
        mass = 10 ** rng.uniform(-1, 0.7)
        bodies += (
            f'<body pos="0 0 {-0.2 if k else 1}">{joint}/><geom type="capsule" size=".03" '
            f'fromto="0 0 0 .03 .02 -.2" mass="{mass:.3g}" contype="0" conaffinity="0"/>'
        )
        if rng.random() < 0.6:
            most = 10 ** rng.uniform(0, 3)
            bound = f'forcerange="{-most:.3g} {most:.3g}"' if rng.random() < 0.5 else ""
            kp, kv = 10 ** rng.uniform(0, 4), rng.choice([0.0, 10 ** rng.uniform(-1, 1.5)])
            actuators += f'<position joint="j{k}" kp="{kp:.3g}" kv="{kv:.3g}" {bound}/>'
    return (
        f'<mujoco><option timestep=".001" gravity="0 0 {rng.choice([0, -9.81])}"/><worldbody>'
        f"{bodies}{'</body>' * count}</worldbody><actuator>{actuators}</actuator></mujoco>"
    )


def drake(report: record.Report) -> None:
    """The same chain and ball in Drake, against its own run of an accuracy of 1e-10."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
    from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
    from pydrake.systems.framework import DiagramBuilder

    def ends(text: str, scheme: str, accuracy: float) -> tuple[np.ndarray, float]:
        builder = DiagramBuilder()
        plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "scene.xml")
            file.write_text(text)
            Parser(plant).AddModels(str(file))
        plant.Finalize()
        simulator = Simulator(builder.Build())
        config = SimulatorConfig(
            integration_scheme=scheme, accuracy=accuracy, max_step_size=0.1, use_error_control=True
        )
        ApplySimulatorConfig(config, simulator)
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        simulator.Initialize()
        began, out = time.process_time(), []
        for k in range(50):
            simulator.AdvanceTo((k + 1) * PERIOD)
            out.append(plant.GetPositions(context).copy())
        return np.array(out), time.process_time() - began

    report.say()
    report.say("Drake: largest error of a coordinate [m or rad], ms per simulated second")
    for name, text in (("five links", CHAIN), ("ball", BALL)):
        true, _ = ends(text, "runge_kutta3" if name == "five links" else "cenic", 1e-10)
        for scheme in ("cenic", "runge_kutta3"):
            for accuracy in (1e-2, 1e-3, 1e-4):
                try:
                    poses, cost = ends(text, scheme, accuracy)
                except RuntimeError as error:
                    report.say(f"{name:12} {scheme:14} {accuracy:.0e}  {str(error)[:70]}")
                    continue
                off = float(np.abs(poses - true).max())
                report.say(f"{name:12} {scheme:14} {accuracy:.0e}  {off:.1e}  {cost * 1e3:.1f} ms")


if __name__ == "__main__":
    main()
