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

from stepcore import starting as starting  # before all that takes time
from stepcore._core import Settings, SimulationError
from stepcore.engine.batch import Batch
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.measure.sweep import sweep
from stepcore.measure.trade import Trade, trade
from stepcore.scene.scene import Scene

if TYPE_CHECKING:
    from stepcore.engine.linearization import Linearization
    from stepcore.loading import load
    from stepcore.measure.ablation import Ablation, ablate
    from stepcore.measure.convergence import Convergence, converge
    from stepcore.measure.diagnosis import Diagnosis, StiffnessWarning, diagnose
    from stepcore.measure.plan import Plan, plan
    from stepcore.measure.postmortem import PostMortem, Replay, replay
    from stepcore.measure.predictability import predictability
    from stepcore.measure.stability import StabilityMap, stability_map
    from stepcore.mjcf import loads

__all__ = [
    "Ablation",
    "Batch",
    "Convergence",
    "Diagnosis",
    "Linearization",
    "Model",
    "Plan",
    "PostMortem",
    "Replay",
    "Scene",
    "Settings",
    "Sim",
    "SimulationError",
    "StabilityMap",
    "StiffnessWarning",
    "Trade",
    "__version__",
    "ablate",
    "converge",
    "diagnose",
    "load",
    "loads",
    "plan",
    "predictability",
    "replay",
    "stability_map",
    "sweep",
    "trade",
]

# Names that are imported when they are first used, so that `import stepcore` is quick.
_LATER = {
    "Convergence": "stepcore.measure.convergence",
    "converge": "stepcore.measure.convergence",
    "Diagnosis": "stepcore.measure.diagnosis",
    "StiffnessWarning": "stepcore.measure.diagnosis",
    "diagnose": "stepcore.measure.diagnosis",
    "Linearization": "stepcore.engine.linearization",
    "Ablation": "stepcore.measure.ablation",
    "ablate": "stepcore.measure.ablation",
    "StabilityMap": "stepcore.measure.stability",
    "stability_map": "stepcore.measure.stability",
    "Plan": "stepcore.measure.plan",
    "plan": "stepcore.measure.plan",
    "predictability": "stepcore.measure.predictability",
    "PostMortem": "stepcore.measure.postmortem",
    "Replay": "stepcore.measure.postmortem",
    "load": "stepcore.loading",
    "loads": "stepcore.mjcf",
    "replay": "stepcore.measure.postmortem",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("stepcore")
    elif name in _LATER:
        value = getattr(importlib.import_module(_LATER[name]), name)
    else:
        raise AttributeError(f"module 'stepcore' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
