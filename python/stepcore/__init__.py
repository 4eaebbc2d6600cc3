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
from stepcore.batch import Batch
from stepcore.model import Model
from stepcore.scene import Scene
from stepcore.sim import Sim
from stepcore.sweep import sweep
from stepcore.trade import Trade, trade

if TYPE_CHECKING:
    from stepcore.ablation import Ablation, ablate
    from stepcore.convergence import Convergence, converge
    from stepcore.diagnosis import Diagnosis, StiffnessWarning, diagnose
    from stepcore.linearization import Linearization
    from stepcore.lookup import load
    from stepcore.mjcf import loads
    from stepcore.postmortem import PostMortem, Replay, replay
    from stepcore.stability import StabilityMap, stability_map
    from stepcore.truth.predict import predictability

__all__ = [
    "Ablation",
    "Batch",
    "Convergence",
    "Diagnosis",
    "Linearization",
    "Model",
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
    "predictability",
    "replay",
    "stability_map",
    "sweep",
    "trade",
]

# Names that are imported when they are first used, so that `import stepcore` is quick.
_LATER = {
    "Convergence": "stepcore.convergence",
    "converge": "stepcore.convergence",
    "Diagnosis": "stepcore.diagnosis",
    "StiffnessWarning": "stepcore.diagnosis",
    "diagnose": "stepcore.diagnosis",
    "Linearization": "stepcore.linearization",
    "Ablation": "stepcore.ablation",
    "ablate": "stepcore.ablation",
    "StabilityMap": "stepcore.stability",
    "stability_map": "stepcore.stability",
    "predictability": "stepcore.truth.predict",
    "PostMortem": "stepcore.postmortem",
    "Replay": "stepcore.postmortem",
    "load": "stepcore.lookup",
    "loads": "stepcore.mjcf",
    "replay": "stepcore.postmortem",
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
