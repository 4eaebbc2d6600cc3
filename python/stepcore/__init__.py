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

if TYPE_CHECKING:
    from stepcore import lesson as lesson
    from stepcore import reference as reference
    from stepcore._core import Settings as Settings
    from stepcore._core import SimulationError as SimulationError
    from stepcore.engine.batch import Batch as Batch
    from stepcore.engine.linearization import Linearization as Linearization
    from stepcore.engine.model import Model as Model
    from stepcore.engine.plan import Plan as Plan
    from stepcore.engine.postmortem import PostMortem as PostMortem
    from stepcore.engine.replay import Replay as Replay
    from stepcore.engine.replay import replay as replay
    from stepcore.engine.sim import Sim as Sim
    from stepcore.experiment.motion import Motion as Motion
    from stepcore.measure.ablation import Ablation as Ablation
    from stepcore.measure.ablation import ablate as ablate
    from stepcore.measure.convergence import Convergence as Convergence
    from stepcore.measure.convergence import converge as converge
    from stepcore.measure.diagnosis import Diagnosis as Diagnosis
    from stepcore.measure.diagnosis import diagnose as diagnose
    from stepcore.measure.diagnosis.load import StiffnessWarning as StiffnessWarning
    from stepcore.measure.plan import plan as plan
    from stepcore.measure.predictability import predictability as predictability
    from stepcore.measure.stability import StabilityMap as StabilityMap
    from stepcore.measure.stability import stability_map as stability_map
    from stepcore.measure.sweep import sweep as sweep
    from stepcore.measure.trade import Trade as Trade
    from stepcore.measure.trade import trade as trade
    from stepcore.reading import load as load
    from stepcore.reading import loads as loads
    from stepcore.scene.scene import Scene as Scene

# Where each public name comes from. A module is imported when one of its names is first used, so
# that a script that steps a scene does not wait for the measurements. Type checkers read the
# block above; a test compares the two.
_MODULES = {
    "stepcore._core": ("Settings", "SimulationError"),
    "stepcore.engine.batch": ("Batch",),
    "stepcore.engine.linearization": ("Linearization",),
    "stepcore.engine.model": ("Model",),
    "stepcore.engine.postmortem": ("PostMortem",),
    "stepcore.engine.replay": ("Replay", "replay"),
    "stepcore.engine.sim": ("Sim",),
    "stepcore.experiment.motion": ("Motion",),
    "stepcore.measure.ablation": ("Ablation", "ablate"),
    "stepcore.measure.convergence": ("Convergence", "converge"),
    "stepcore.measure.diagnosis": ("Diagnosis", "diagnose"),
    "stepcore.measure.diagnosis.load": ("StiffnessWarning",),
    "stepcore.engine.plan": ("Plan",),
    "stepcore.measure.plan": ("plan",),
    "stepcore.measure.predictability": ("predictability",),
    "stepcore.measure.stability": ("StabilityMap", "stability_map"),
    "stepcore.measure.sweep": ("sweep",),
    "stepcore.measure.trade": ("Trade", "trade"),
    "stepcore.reading": ("load", "loads"),
    "stepcore.scene.scene": ("Scene",),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}
_SUBMODULES = ("lesson", "reference")

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
