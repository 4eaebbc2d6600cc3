"""The schema of MJCF: elements, their attributes, and the type of each attribute.

From the schema of MuJoCo 4. Attributes are the words of a string: ``pos:3`` holds three
reals, ``size:1-3`` one to three, ``qpos:*`` any number, ``group:int`` an integer,
``limited:false|true|auto`` a keyword, and a bare name any text. ``!`` marks a required one.
Elements that draw, sense or are not built yet are in `schema_unread`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from stepcore.mjcf import schema_unread as unread

BOOL = "false|true"
AUTO = "false|true|auto"
ABLE = "disable|enable"

ORIENTATION = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
POSE = "pos:3 quat:4 axisangle:4 xyaxes:6 zaxis:3 euler:3 "


@dataclass
class Spec:
    """An element: its attributes (name → type), required ones, and the elements it may hold.

    role: "" for an element that is read, else why it is not: "draws", "senses", "data", "unbuilt".
    once: children that can appear only once.
    """

    attrs: dict[str, str] = field(default_factory=dict)
    required: tuple[str, ...] = ()
    children: dict[str, Spec] = field(default_factory=dict)
    role: str = ""
    once: tuple[str, ...] = ()


def spec(
    attrs: str = "",
    children: dict[str, Spec] | None = None,
    role: str = "",
    once: tuple[str, ...] = (),
) -> Spec:
    """A `Spec` from the notation above."""
    types: dict[str, str] = {}
    required = []
    for word in attrs.split():
        name, _, kind = word.partition(":")
        if name.endswith("!"):
            name = name[:-1]
            required.append(name)
        types[name] = kind
    return Spec(types, tuple(required), children or {}, role, once)


def without(attrs: str, names: str) -> str:
    """`attrs` without the named ones."""
    drop = set(names.split())
    return " ".join(w for w in attrs.split() if w.partition(":")[0].rstrip("!") not in drop)


def tree(words: unread.Tree, role: str) -> Spec:
    """A `Spec` from the plain tables of `schema_unread`."""
    attrs, children = words if isinstance(words, tuple) else (words, {})
    return spec(attrs, {tag: tree(inner, role) for tag, inner in children.items()}, role)


def trees(table: dict[str, unread.Tree], role: str) -> dict[str, Spec]:
    return {tag: tree(words, role) for tag, words in table.items()}


JOINT = (
    "name class type:free|ball|slide|hinge group:int pos:3 axis:3 springdamper:2 "
    f"limited:{AUTO} actuatorfrclimited:{AUTO} solreflimit:1-2 solimplimit:1-5 "
    "solreffriction:1-2 solimpfriction:1-5 stiffness:1-3 range:2 actuatorfrcrange:2 "
    f"actuatorgravcomp:{BOOL} margin:1 ref:1 springref:1 springyield:1 armature:1 "
    "damping:1-3 frictionloss:1 user:*"
)
GEOM = (
    "name class type:plane|hfield|sphere|capsule|ellipsoid|cylinder|box|mesh|sdf contype:int "
    "conaffinity:int condim:int group:int priority:int size:1-3 material friction:1-3 mass:1 "
    f"density:1 shellinertia:{BOOL} solmix:1 solref:1-2 solimp:1-5 margin:1 gap:1 surfacevel:6 "
    f"adhesion:1 fromto:6 {POSE} hfield mesh fitscale:1 rgba:4 castshadow:{BOOL} "
    "fluidshape:none|ellipsoid fluidcoef:1-5 user:*"
)
PAIR = (
    "name class geom1! geom2! condim:int friction:1-5 solref:1-2 solreffriction:1-2 solimp:1-5 "
    "gap:1 margin:1 adhesion:1"
)
SITE = (
    "name class type:sphere|capsule|ellipsoid|cylinder|box|mesh group:int "
    f"{POSE} material mesh size:1-3 fromto:6 rgba:4 user:*"
)
MESH_DEFAULT = "scale:3 maxhullvert:int inertia:convex|exact|legacy|shell"
MESH = (
    f"name class content_type file vertex:* normal:* texcoord:* face:int* refpos:3 refquat:4 "
    f"{MESH_DEFAULT} smoothnormal:{BOOL} builtin params:* material"
)
HFIELD = "name content_type file nrow:int ncol:int size!:4 elevation:*"
INERTIAL = without(POSE, "pos") + " pos!:3 mass!:1 diaginertia:3 fullinertia:6"
EQUALITY = f"name class active:{BOOL} solref:1-2 solimp:1-5 "
ACTUATOR = (
    "name class group:int nsample:int interp:zoh|linear|cubic delay:1 ctrlrange:2 user:* "
    f"ctrllimited:{AUTO} forcelimited:{AUTO} forcerange:2 lengthrange:2 gear:1-6 damping:1-3 "
    "armature:1 cranklength:1 joint jointinparent tendon slidersite cranksite site refsite"
)
# What the actuators that are built have beyond that.
GAINS = {
    "motor": "",
    "position": "inheritrange:1 kp:1 kv:1 dampratio:1 timeconst:1",
    "velocity": "kv:1",
    "general": f"actlimited:{AUTO} actrange:2 body actdim:int input velrange:2 ffrange:2 "
    "inheritrange:1 dyntype:none|integrator|filter|filterexact|pid|dcmotor|muscle|user "
    "gaintype:fixed|affine|muscle|dcmotor|pid|so3|user "
    f"biastype:none|affine|muscle|dcmotor|so3|user dynprm:* gainprm:* biasprm:* actearly:{BOOL}",
}
# References and names have no place in a default.
OWN = (
    "name class geom1 geom2 target lengthrange joint jointinparent tendon slidersite cranksite "
    "site refsite body body1 body2 instance plugin"
)

TREE_CHILDREN: dict[str, Spec] = {
    "inertial": spec(INERTIAL),
    "joint": spec(JOINT),
    "freejoint": spec(f"name group:int align:{AUTO}"),
    "geom": spec(GEOM, {"plugin": tree(unread.PLUGIN, "unbuilt")}),
    "site": spec(SITE),
    "camera": spec(unread.CAMERA, role="draws"),
    "light": spec(unread.LIGHT, role="draws"),
    "plugin": tree(unread.PLUGIN, "unbuilt"),
    "attach": spec("model! body frame prefix", role="unbuilt"),
    "flexcomp": tree(unread.FLEXCOMP, "unbuilt"),
    "composite": spec(role="unbuilt"),
}
BODY = spec(
    f"name childclass {POSE} mocap:{BOOL} gravcomp:1 sleep:auto|never|allowed|init "
    "simple:false|auto fuse:false|auto user:*",
    once=("inertial",),
)
FRAME = spec(f"name childclass {POSE} scale:1-3 scaling:similar|geometry massscale:1")
REPLICATE = spec("count!:int sep offset:3 euler:3", role="unbuilt")
for _parent in (BODY, FRAME, REPLICATE):
    _parent.children = TREE_CHILDREN
TREE_CHILDREN |= {"body": BODY, "frame": FRAME, "replicate": REPLICATE}
NOT_IN_WORLD = ("joint", "freejoint", "inertial")
WORLD = spec("", {tag: inner for tag, inner in TREE_CHILDREN.items() if tag not in NOT_IN_WORLD})

DEFAULT = spec(
    "class",
    {
        "joint": spec(without(JOINT, OWN)),
        "geom": spec(without(GEOM, "name class")),
        "site": spec(without(SITE, "name class")),
        "equality": spec(without(EQUALITY, OWN)),
        **{tag: spec(without(f"{ACTUATOR} {more}", OWN)) for tag, more in GAINS.items()},
        # The defaults of what is not built may stand in a file: they act only where they are used.
        **{tag: spec(without(f"{ACTUATOR} {more}", OWN)) for tag, more in unread.ACTUATORS.items()},
        "orientation": spec(without(f"{ACTUATOR} {unread.ORIENTATION_SERVO}", OWN)),
        "pair": spec(without(PAIR, OWN)),
        "tendon": spec(without(unread.TENDON + " width material rgba", OWN)),
        "camera": spec(without(unread.CAMERA, OWN)),
        "light": spec(without(unread.LIGHT, OWN + " texture")),
        "mesh": spec(MESH_DEFAULT),
        "texture": spec(unread.TEXTURE_LOOK),
        "material": tree((without(unread.MATERIAL, "name class"), unread.LAYER), ""),
    },
    once=(
        *("joint", "geom", "site", "equality", "pair", "tendon"),
        *("camera", "light", "mesh", "texture", "material"),
    ),
)
DEFAULT.children["default"] = DEFAULT

FLAGS = (
    "constraint equality frictionloss limit contact spring damper gravity clampctrl warmstart "
    "filterparent actuation refsafe sensor midphase eulerdamp autoreset nativeccd island "
    "multiccd override energy fwdinv invdiscrete sleep diagexact ipc speculative"
)
OPTION = spec(
    "timestep:1 impratio:1 tolerance:1 ls_tolerance:1 noslip_tolerance:1 ccd_tolerance:1 "
    "sleep_tolerance:1 gravity:3 wind:3 magnetic:3 density:1 viscosity:1 o_margin:1 "
    "o_solref:1-2 o_solimp:1-5 o_friction:1-5 "
    "integrator:Euler|RK4|implicit|implicitfast|discrete cone:pyramidal|elliptic "
    "jacobian:dense|sparse|auto solver:PGS|CG|Newton iterations:int ls_iterations:int "
    "noslip_iterations:int ccd_iterations:int sdf_iterations:int sdf_initpoints:int "
    "actuatorgroupdisable:int*",
    {"flag": spec(" ".join(f"{name}:{ABLE}" for name in FLAGS.split()))},
    once=("flag",),
)
COMPILER = spec(
    f"autolimits:{BOOL} boundmass:1 boundinertia:1 settotalmass:1 balanceinertia:{BOOL} "
    f"strippath:{BOOL} coordinate:local|global angle:radian|degree fitaabb:{BOOL} eulerseq "
    f"meshdir texturedir discardvisual:{BOOL} usethread:{BOOL} fusestatic:{BOOL} "
    f"inertiafromgeom:{AUTO} inertiagrouprange:int2 saveinertial:{BOOL} savecompiled:{BOOL} "
    f"savecanonical:{BOOL} assetdir alignfree:{BOOL} conflict:warning|merge|error "
    "passthrough:none|textures",
    {"lengthrange": spec(unread.LENGTHRANGE)},
)
ACTUATORS = spec(
    "",
    {
        **{tag: spec(f"{ACTUATOR} {more}") for tag, more in GAINS.items()},
        **{
            tag: spec(f"{ACTUATOR} {more}", role="unbuilt")
            for tag, more in unread.ACTUATORS.items()
        },
        "orientation": spec(f"{ACTUATOR} {unread.ORIENTATION_SERVO}", role="unbuilt"),
        "plugin": tree((f"{ACTUATOR} {unread.ACTUATOR_PLUGIN}", unread.CONFIG), "unbuilt"),
    },
)
ROOT = spec(
    "model",
    {
        "option": OPTION,
        "compiler": COMPILER,
        "default": DEFAULT,
        "worldbody": WORLD,
        "contact": spec(
            "",
            {
                "exclude": spec("name body1! body2!"),
                "pair": spec(PAIR),
            },
        ),
        "equality": spec(
            "",
            {
                "connect": spec(f"{EQUALITY} body1 body2 anchor:3 site1 site2"),
                **trees(unread.EQUALITIES, "unbuilt"),
            },
        ),
        "actuator": ACTUATORS,
        "keyframe": spec(
            "", {"key": spec("name time:1 qpos:* qvel:* act:* mpos:* mquat:* ctrl:* plastic:*")}
        ),
        "size": spec(unread.SIZE),
        "statistic": spec(unread.STATISTIC, role="draws"),
        "visual": tree(("", unread.VISUAL), "draws"),
        "asset": spec(
            "",
            {
                "mesh": spec(MESH, {"plugin": tree(unread.PLUGIN, "unbuilt")}),
                "hfield": spec(HFIELD),
                **trees(unread.ASSETS, "draws"),
            },
        ),
        "custom": spec("", trees(unread.CUSTOM, "data")),
        "sensor": spec("", trees(unread.SENSORS, "senses")),
        "tendon": spec("", trees(unread.TENDONS, "unbuilt")),
        "deformable": spec(
            "", {"flex": tree(unread.FLEX, "unbuilt"), "skin": tree(unread.SKIN, "draws")}
        ),
        "extension": spec("", trees(unread.EXTENSION, "unbuilt")),
    },
)
