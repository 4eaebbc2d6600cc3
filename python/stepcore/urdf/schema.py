"""The elements of URDF that say how a robot moves; others are listed as ignored.

Format documentation: wiki.ros.org/urdf/XML. The notation is that of `mjcf.notation`.
"""

from __future__ import annotations

from stepcore.mjcf.notation import spec

ORIGIN = spec("xyz:3 rpy:3")
GEOMETRY = spec(
    "",
    {
        "box": spec("size!:3"),
        "sphere": spec("radius!:1"),
        "cylinder": spec("radius!:1 length!:1"),
        "capsule": spec("radius!:1 length!:1"),
        "mesh": spec("filename! scale:3"),
    },
)
INERTIAL = spec(
    "",
    {
        "origin": ORIGIN,
        "mass": spec("value!:1"),
        "inertia": spec("ixx!:1 iyy!:1 izz!:1 ixy:1 ixz:1 iyz:1"),
    },
    once=("origin", "mass", "inertia"),
)
COLLISION = spec(
    "name group", {"origin": ORIGIN, "geometry": GEOMETRY}, once=("origin", "geometry")
)
MATERIAL = spec(
    "name", {"color": spec("rgba:4"), "texture": spec("filename!")}, once=("color", "texture")
)
VISUAL = spec(
    "name group",
    {"origin": ORIGIN, "geometry": GEOMETRY, "material": MATERIAL},
    once=("origin", "geometry", "material"),
)
INSIDE_LINK = {"inertial": INERTIAL, "collision": COLLISION}
LINK = spec("name! type", INSIDE_LINK, once=("inertial",))
DRAWN_LINK = spec("name! type", {**INSIDE_LINK, "visual": VISUAL}, once=("inertial",))
TYPES = "revolute|continuous|prismatic|fixed|floating|planar"
JOINT = spec(
    f"name! type!:{TYPES}",
    {
        "origin": ORIGIN,
        "parent": spec("link!"),
        "child": spec("link!"),
        "axis": spec("xyz:3"),
        "limit": spec("lower:1 upper:1 effort:1 velocity:1"),
        "dynamics": spec("damping:1 friction:1"),
        "mimic": spec("joint! multiplier:1 offset:1"),
    },
    once=("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
)
ROBOT = spec("name version", {"link": LINK, "joint": JOINT})
# With what only draws.
DRAWN_ROBOT = spec("name version", {"link": DRAWN_LINK, "joint": JOINT, "material": MATERIAL})

# Attributes that other programs add, however near their names are to URDF's; the last three are
# entries of a symmetric matrix that are given already.
FOREIGN = ("concave", "iyx", "izx", "izy")
# What only draws.
DRAWS = ("visual", "material")
# What the program xacro may leave in the URDF that it makes: nothing depends on it any more.
XACRO_ONLY = ("xacro:property", "xacro:arg")
