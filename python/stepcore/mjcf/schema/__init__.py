"""The schema of MJCF, from that of MuJoCo 4: a file for each section, put together here.

`notation` explains how attributes are written. A section whose elements are read has its reader in
the file of the same kind one folder up.
"""

from stepcore.mjcf.schema import visual
from stepcore.mjcf.schema.actuator import ACTUATOR
from stepcore.mjcf.schema.asset import ASSET
from stepcore.mjcf.schema.compiler import COMPILER
from stepcore.mjcf.schema.contact import CONTACT
from stepcore.mjcf.schema.custom import CUSTOM
from stepcore.mjcf.schema.default import DEFAULT
from stepcore.mjcf.schema.deformable import DEFORMABLE
from stepcore.mjcf.schema.equality import EQUALITY
from stepcore.mjcf.schema.keyframe import KEYFRAME
from stepcore.mjcf.schema.notation import spec
from stepcore.mjcf.schema.option import OPTION, SIZE
from stepcore.mjcf.schema.plugin import EXTENSION
from stepcore.mjcf.schema.sensor import SENSOR
from stepcore.mjcf.schema.tendon import TENDON
from stepcore.mjcf.schema.tree import WORLDBODY

ROOT = spec(
    "model",
    {
        "option": OPTION,
        "compiler": COMPILER,
        "default": DEFAULT,
        "worldbody": WORLDBODY,
        "contact": CONTACT,
        "tendon": TENDON,
        "equality": EQUALITY,
        "actuator": ACTUATOR,
        "sensor": SENSOR,
        "keyframe": KEYFRAME,
        "size": SIZE,
        "statistic": visual.STATISTIC,
        "visual": visual.VISUAL,
        "asset": ASSET,
        "custom": CUSTOM,
        "deformable": DEFORMABLE,
        "extension": EXTENSION,
    },
)
