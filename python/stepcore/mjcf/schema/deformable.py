"""Flexes, which are not built; skins only draw."""

from stepcore.mjcf.schema.notation import POSE, spec
from stepcore.mjcf.schema.plugin import plugin
from stepcore.mjcf.schema.visual import SKIN

_POSE = " ".join(word.partition(":")[0] for word in POSE.split())
_CONTACT = spec(
    "contype conaffinity condim priority friction solmix solref solimp margin gap selfcollide "
    "activelayers passive"
)
_ELASTICITY = spec("young poisson shear damping thickness yield elastic2d section sectionsize")
FLEX = spec(
    "name group dim radius material rgba flatskin body vertex element texcoord elemtexcoord "
    "node nodecoord cellcount dof",
    {"contact": _CONTACT, "edge": spec("stiffness damping"), "elasticity": _ELASTICITY},
    "unbuilt",
)
FLEXCOMP = spec(
    "name type group dim dof count cellcount spacing radius rigid mass inertiabox scale file "
    f"mesh point element texcoord material rgba flatskin {_POSE} origin",
    {
        "edge": spec("equality solref solimp stiffness damping"),
        "elasticity": _ELASTICITY,
        "contact": _CONTACT,
        "pin": spec("id range grid gridrange"),
        "plugin": plugin(),
    },
    "unbuilt",
)
DEFORMABLE = spec("", {"flex": FLEX, "skin": SKIN})
