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
import os
import re
from typing import Any

from stepcore import vectors

vectors.select_module(__path__)

# The module of each public name, from the list that type checkers read. A module is imported on the
# first use of one of its names, so that a script that steps a scene does not wait for the
# measurements.
with open(os.path.join(os.path.dirname(__file__), "__init__.pyi"), encoding="utf-8") as _list:
    _MODULES = {
        name: f"stepcore.{name}" if module == "stepcore" else module
        for module, name in re.findall(r"^from (\S+) import (\w+)", _list.read(), re.MULTILINE)
    }

__all__ = ["__version__", *_MODULES]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("stepcore")
    elif name in _MODULES:
        value = importlib.import_module(_MODULES[name])
        if _MODULES[name] != f"stepcore.{name}":
            value = getattr(value, name)
    else:
        raise AttributeError(f"module 'stepcore' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
