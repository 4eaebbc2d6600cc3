"""stepcore: a rigid-body physics engine that measures what speed costs in accuracy.

>>> import stepcore as sc
>>> scene = sc.loads('''<mujoco><worldbody><body pos="0 0 1"><freejoint/>
... <geom size="0.1" mass="1"/></body></worldbody></mujoco>''')
>>> sim = sc.Sim(scene.compile(), dt=0.005)
>>> sim.step(100)
>>> round(sim.time, 6)
0.5
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from stepcore import vectors

if TYPE_CHECKING:
    from stepcore import lesson as lesson
    from stepcore._core import EnergyWarning as EnergyWarning
    from stepcore._core import Settings as Settings
    from stepcore._core import SimulationError as SimulationError
    from stepcore.engine.batch import Batch as Batch
    from stepcore.engine.error_bar import ErrorBar as ErrorBar
    from stepcore.engine.gradients import Gradients as Gradients
    from stepcore.engine.gradients import GradientWarning as GradientWarning
    from stepcore.engine.linearization import Linearization as Linearization
    from stepcore.engine.linearization import Linearizations as Linearizations
    from stepcore.engine.model import Model as Model
    from stepcore.engine.noise import Noise as Noise
    from stepcore.engine.plan import Plan as Plan
    from stepcore.engine.postmortem import PostMortem as PostMortem
    from stepcore.engine.replay import Replay as Replay
    from stepcore.engine.replay import replay as replay
    from stepcore.engine.rollout import Rollout as Rollout
    from stepcore.engine.sim import Sim as Sim
    from stepcore.engine.stiffness import StiffnessWarning as StiffnessWarning
    from stepcore.engine.tables import Keyframe as Keyframe
    from stepcore.engine.trajectory import Trajectory as Trajectory
    from stepcore.engine.unsolved import UnsolvedWarning as UnsolvedWarning
    from stepcore.experiment.motion import Motion as Motion
    from stepcore.experiment.policy import policy as policy
    from stepcore.measure.ablation import Ablation as Ablation
    from stepcore.measure.ablation import ablate as ablate
    from stepcore.measure.check import Check as Check
    from stepcore.measure.check import check as check
    from stepcore.measure.convergence import Convergence as Convergence
    from stepcore.measure.convergence import converge as converge
    from stepcore.measure.diagnosis import Diagnosis as Diagnosis
    from stepcore.measure.diagnosis import diagnose as diagnose
    from stepcore.measure.identification import Identification as Identification
    from stepcore.measure.identification import identify as identify
    from stepcore.measure.monitors import Finding as Finding
    from stepcore.measure.plan import plan as plan
    from stepcore.measure.predictability import Predictability as Predictability
    from stepcore.measure.predictability import predict as predict
    from stepcore.measure.run import SimulationRun as SimulationRun
    from stepcore.measure.run import run as run
    from stepcore.measure.stability import StabilityMap as StabilityMap
    from stepcore.measure.stability import stability_map as stability_map
    from stepcore.measure.sweep import sweep as sweep
    from stepcore.measure.trade import Trade as Trade
    from stepcore.measure.trade import trade as trade
    from stepcore.measure.tune import Tuning as Tuning
    from stepcore.measure.tune import tune as tune
    from stepcore.mjcf.nodes import MJCFError as MJCFError
    from stepcore.reading import load as load
    from stepcore.reading import loads as loads
    from stepcore.report.report import Report as Report
    from stepcore.report.table import Table as Table
    from stepcore.scene.elements import Actuator as Actuator
    from stepcore.scene.elements import Body as Body
    from stepcore.scene.elements import ContactOverride as ContactOverride
    from stepcore.scene.elements import Equality as Equality
    from stepcore.scene.elements import Features as Features
    from stepcore.scene.elements import Geom as Geom
    from stepcore.scene.elements import HField as HField
    from stepcore.scene.elements import Joint as Joint
    from stepcore.scene.elements import Key as Key
    from stepcore.scene.elements import LengthRange as LengthRange
    from stepcore.scene.elements import MassRules as MassRules
    from stepcore.scene.elements import Mesh as Mesh
    from stepcore.scene.elements import Pair as Pair
    from stepcore.scene.elements import Pulley as Pulley
    from stepcore.scene.elements import Sensor as Sensor
    from stepcore.scene.elements import Site as Site
    from stepcore.scene.elements import Tendon as Tendon
    from stepcore.scene.scene import Scene as Scene
    from stepcore.viewing.live import View as View
    from stepcore.viewing.live import view as view
    from stepcore.viewing.picture import picture as picture

vectors.choose(__path__)

# The module of each public name. A module is imported on the first use of one of its names, so
# that a script that steps a scene does not wait for the measurements. Type checkers read the
# block above; a test compares the two lists.
_MODULES = {
    "stepcore._core": "EnergyWarning Settings SimulationError",
    "stepcore.engine.batch": "Batch",
    "stepcore.engine.error_bar": "ErrorBar",
    "stepcore.engine.gradients": "Gradients GradientWarning",
    "stepcore.engine.linearization": "Linearization Linearizations",
    "stepcore.engine.model": "Model",
    "stepcore.engine.noise": "Noise",
    "stepcore.engine.plan": "Plan",
    "stepcore.engine.postmortem": "PostMortem",
    "stepcore.engine.replay": "Replay replay",
    "stepcore.engine.rollout": "Rollout",
    "stepcore.engine.sim": "Sim",
    "stepcore.engine.tables": "Keyframe",
    "stepcore.engine.trajectory": "Trajectory",
    "stepcore.engine.unsolved": "UnsolvedWarning",
    "stepcore.experiment.motion": "Motion",
    "stepcore.experiment.policy": "policy",
    "stepcore.measure.ablation": "Ablation ablate",
    "stepcore.measure.check": "Check check",
    "stepcore.measure.convergence": "Convergence converge",
    "stepcore.measure.diagnosis": "Diagnosis diagnose",
    "stepcore.engine.stiffness": "StiffnessWarning",
    "stepcore.measure.identification": "Identification identify",
    "stepcore.measure.monitors": "Finding",
    "stepcore.measure.plan": "plan",
    "stepcore.measure.predictability": "Predictability predict",
    "stepcore.measure.run": "SimulationRun run",
    "stepcore.measure.stability": "StabilityMap stability_map",
    "stepcore.measure.sweep": "sweep",
    "stepcore.measure.trade": "Trade trade",
    "stepcore.measure.tune": "Tuning tune",
    "stepcore.mjcf.nodes": "MJCFError",
    "stepcore.reading": "load loads",
    "stepcore.report.report": "Report",
    "stepcore.report.table": "Table",
    "stepcore.scene.elements": (
        "Actuator Body ContactOverride Equality Features Geom HField Joint Key "
        "LengthRange MassRules Mesh Pair Pulley Sensor Site Tendon"
    ),
    "stepcore.scene.scene": "Scene",
    "stepcore.viewing.live": "View view",
    "stepcore.viewing.picture": "picture",
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names.split()}
_SUBMODULES = ("lesson",)

__all__ = ["__version__", *_MODULE_OF, *_SUBMODULES]


def __getattr__(name: str) -> Any:
    if name in _MODULE_OF:
        value: Any = getattr(importlib.import_module(_MODULE_OF[name]), name)
    elif name in _SUBMODULES:
        value = importlib.import_module(f"stepcore.{name}")
    elif name == "__version__":
        from importlib.metadata import version

        value = version("stepcore")
    else:
        raise AttributeError(f"module 'stepcore' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
