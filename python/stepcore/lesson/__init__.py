"""The lesson's scenes, and its tables compared with reference numbers.

>>> from stepcore import lesson
>>> rows = lesson.run("numpy", sections=(1,))
>>> all(row.ok for row in rows)
True
"""

from stepcore.lesson.run import Row, report, run
from stepcore.lesson.scenes import drop, grasp, slip, spring, stack, tower

__all__ = ["Row", "drop", "grasp", "report", "run", "slip", "spring", "stack", "tower"]
