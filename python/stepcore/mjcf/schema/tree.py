"""The section `<worldbody>`: bodies, frames, joints, geoms and sites."""

from __future__ import annotations

from stepcore.mjcf.schema import deformable, visual
from stepcore.mjcf.schema.notation import AUTO, BOOL, POSE, Spec, default_of, spec, without
from stepcore.mjcf.schema.plugin import plugin

_JOINT = (
    "name class type:free|ball|slide|hinge group:int pos:3 axis:3 springdamper:2 "
    f"limited:{AUTO} actuatorfrclimited:{AUTO} solreflimit:1-2 solimplimit:1-5 "
    "solreffriction:1-2 solimpfriction:1-5 stiffness:1-3 range:2 actuatorfrcrange:2 "
    f"actuatorgravcomp:{BOOL} margin:1 ref:1 springref:1 springyield:1 armature:1 "
    "damping:1-3 frictionloss:1 user:*"
)
_GEOM = (
    "name class type:plane|hfield|sphere|capsule|ellipsoid|cylinder|box|mesh|sdf contype:int "
    "conaffinity:int condim:int group:int priority:int size:1-3 material friction:1-3 mass:1 "
    f"density:1 shellinertia:{BOOL} solmix:1 solref:1-2 solimp:1-5 margin:1 gap:1 surfacevel:1-6 "
    f"adhesion:1 fromto:6 {POSE} hfield mesh fitscale:1 rgba:4 castshadow:{BOOL} "
    "fluidshape:none|ellipsoid fluidcoef:1-5 user:*"
)
_SITE = (
    "name class type:sphere|capsule|ellipsoid|cylinder|box|mesh group:int "
    f"{POSE} material mesh size:1-3 fromto:6 rgba:4 user:*"
)
_INERTIAL = without(POSE, "pos") + " pos!:3 mass!:1 diaginertia:3 fullinertia:6"

_CHILDREN: dict[str, Spec] = {
    "inertial": spec(_INERTIAL),
    "joint": spec(_JOINT),
    "freejoint": spec(f"name group:int align:{AUTO}"),
    "geom": spec(_GEOM, {"plugin": plugin()}),
    "site": spec(_SITE),
    "camera": visual.CAMERA,
    "light": visual.LIGHT,
    "plugin": plugin(),
    "attach": spec("model body frame prefix!"),
    "flexcomp": deformable.FLEXCOMP,
    "composite": spec(role="unbuilt"),
}
_BODY = spec(
    f"name childclass {POSE} mocap:{BOOL} gravcomp:1 sleep:auto|never|allowed|init "
    "simple:false|auto fuse:false|auto user:*",
    once=("inertial",),
)
_FRAME = spec(f"name childclass {POSE} scale:1-3 scaling:similar|geometry massscale:1")
_REPLICATE = spec("count!:int sep offset:3 euler:3 childclass")
# Where MuJoCo checks no attributes: those that it does not know do nothing.
UNCHECKED = ("frame", "replicate")
for _parent in (_BODY, _FRAME, _REPLICATE):
    _parent.children = _CHILDREN
_CHILDREN |= {"body": _BODY, "frame": _FRAME, "replicate": _REPLICATE}
NOT_IN_WORLD = ("joint", "freejoint", "inertial")
WORLDBODY = spec("", {tag: inner for tag, inner in _CHILDREN.items() if tag not in NOT_IN_WORLD})

DEFAULTS = {
    "joint": default_of(_JOINT),
    # A geom's mesh and a site's material can be those of a class.
    "geom": spec(without(_GEOM, "name class")),
    "site": spec(without(_SITE, "name class")),
}
