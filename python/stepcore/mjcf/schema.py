"""The schema of MJCF, after MuJoCo 4: the elements and their attributes.

Attributes that are fields of an element class come from the table of the class
(`stepcore.scene.element`). All others are defined here, in this notation: ``pos:3`` is three reals,
``size:1-3`` one to three, ``qpos:*`` any number of reals, ``group:int`` an integer,
``limited:false|true|auto`` a keyword, and a name without ":" any text. ``!`` marks a required
attribute. `class_fields` and `changed_attributes` convert to fields and back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from stepcore.scene.element import Element, field_rows
from stepcore.scene.elements import (
    Actuator,
    Body,
    ContactOverride,
    Equality,
    Features,
    Geom,
    HField,
    Joint,
    Key,
    LengthRange,
    MassRules,
    Mesh,
    Pair,
    Sensor,
    Site,
    Tendon,
)
from stepcore.scene.elements.actuator_laws import LAW_FIELDS
from stepcore.scene.elements.equality import FIELDS as EQUALITY_FIELDS
from stepcore.scene.elements.field_types import AUTO, BOOL
from stepcore.scene.elements.sensor import OBJECTS, OF_ACCELERATION, OF_FRAME, OF_GAP

# If these are empty, values of a default class are ignored.
TAKEN_BACK = ("material", "mesh")
ORIENTATION = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
POSE = "pos:3 quat:4 axisangle:4 xyaxes:6 zaxis:3 euler:3"


@dataclass
class Spec:
    """The schema of an element: its attributes (name → type), required attributes, and children.

    role: "" for an element that is read, else the reason why it is not: "draws", "senses", "data"
        or "unbuilt".
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
    types: dict[str, str] = {}
    required = []
    for word in attrs.split():
        name, _, kind = word.partition(":")
        if name.endswith("!"):
            name = name[:-1]
            required.append(name)
        types[name] = kind
    return Spec(types, tuple(required), children or {}, role, once)


def attrs_of(kind: type[Element], *names: str, but: str = "") -> str:
    """Return the fields of an element class that MJCF has, in the notation above.

    names: the fields to include; all if empty.
    but: the fields to leave out. A field with polynomial coefficients takes up to three numbers.
    """
    rows = [field_rows(kind)[name] for name in names] if names else field_rows(kind).values()
    return " ".join(
        f"{row.name}:{'1-3' if row.poly else row.type.attribute}".rstrip(":")
        for row in rows
        if row.type.attribute is not None and row.name not in but.split()
    )


def attrs_but(attrs: str, names: str) -> str:
    drop = set(names.split())
    return " ".join(w for w in attrs.split() if w.partition(":")[0].rstrip("!") not in drop)


# A default class has no names and no references.
_OWN = (
    "name class geom1 geom2 target lengthrange joint jointinparent tendon slidersite cranksite "
    "site refsite body body1 body2 instance plugin"
)


def default_of(attrs: str) -> Spec:
    return spec(attrs_but(attrs, _OWN).replace("!", ""))


ABLE = "disable|enable"
_TURN = attrs_but(POSE, "pos quat")
_POSE_NAMES = "pos quat axisangle xyaxes zaxis euler"

# Plugins, which can appear in several sections; none is built.
_CONFIG = spec("key! value")


def plugin(attrs: str = "plugin instance") -> Spec:
    """Return the schema of a plugin element. attrs: attributes besides the configuration."""
    return spec(attrs, {"config": _CONFIG}, "unbuilt")


_INSTANCE = spec("name", {"config": _CONFIG})
EXTENSION = spec(
    "",
    {"plugin": spec("plugin!", {"instance": _INSTANCE, "config": _CONFIG}, "unbuilt")},
)

# The sections <option>, <size> and <compiler>.

FLAGS = (
    "constraint equality frictionloss limit contact spring damper gravity clampctrl warmstart "
    "filterparent actuation refsafe sensor midphase eulerdamp autoreset nativeccd island "
    "multiccd override energy fwdinv invdiscrete sleep diagexact ipc speculative"
)
# These flags are off by default; all others are on.
FLAGS_OFF = tuple(FLAGS.split()[FLAGS.split().index("override") :])
# Features without an MJCF flag.
OWN_FEATURES = tuple(name for name in field_rows(Features) if name not in FLAGS.split())
_OVERRIDES = " ".join(f"o_{word}" for word in attrs_of(ContactOverride, but="enable").split())
OPTION = spec(
    "timestep:1 impratio:1 tolerance:1 ls_tolerance:1 noslip_tolerance:1 ccd_tolerance:1 "
    "sleep_tolerance:1 gravity:3 wind:3 magnetic:3 density:1 viscosity:1 "
    f"{_OVERRIDES} "
    "integrator:Euler|RK4|implicit|implicitfast|discrete cone:pyramidal|elliptic "
    "jacobian:dense|sparse|auto solver:PGS|CG|Newton iterations:int ls_iterations:int "
    "noslip_iterations:int ccd_iterations:int sdf_iterations:int sdf_initpoints:int "
    "actuatorgroupdisable:int*",
    {"flag": spec(" ".join(f"{name}:{ABLE}" for name in FLAGS.split()))},
    once=("flag",),
)
SIZE = spec(
    "memory njmax nconmax nstack nuserdata nkey:int nuser_body nuser_jnt nuser_geom nuser_site "
    "nuser_cam nuser_tendon nuser_actuator nuser_sensor"
)
COMPILER = spec(
    f"autolimits:{BOOL} {attrs_of(MassRules)} strippath:{BOOL} coordinate:local|global "
    f"angle:radian|degree eulerseq meshdir texturedir discardvisual:{BOOL} usethread:{BOOL} "
    f"fusestatic:{BOOL} saveinertial:{BOOL} savecompiled:{BOOL} savecanonical:{BOOL} assetdir "
    f"alignfree:{BOOL} conflict:warning|merge|error passthrough:none|textures",
    {"lengthrange": spec(attrs_of(LengthRange))},
)

# Elements that only draw; reading a scene checks only the names of their attributes.


def _draws(attrs: str, children: dict[str, Spec] | None = None) -> Spec:
    return spec(attrs, children, "draws")


_CAMERA = (
    f"name class projection fovy ipd resolution output {_POSE_NAMES} mode target focal focalpixel "
    "principal principalpixel sensorsize user"
)
_LIGHT = (
    "name class directional type castshadow active pos dir bulbradius intensity range "
    "attenuation cutoff softness exponent ambient diffuse specular mode target texture"
)
_TEXTURE_LOOK = (
    "type colorspace gridsize gridlayout builtin rgb1 rgb2 mark markrgb random width height "
    "hflip vflip nchannel embed"
)
_TEXTURE = (
    f"name class content_type file fileright fileleft fileup filedown filefront fileback "
    f"{_TEXTURE_LOOK}"
)
_MATERIAL = (
    "name class texture texrepeat texuniform emission specular shininess reflectance metallic "
    "roughness rgba"
)
_SKIN = _draws(
    "name file material rgba inflate vertex texcoord face group",
    {"bone": _draws("body bindpos bindquat vertid vertweight")},
)
STATISTIC = _draws("meaninertia meanmass meansize extent center")
_VIEWS = {
    "global": "cameraid orthographic fovy ipd azimuth elevation linewidth glow offwidth offheight "
    "realtime ellipsoidinertia bvactive",
    "quality": "shadowsize offsamples numslices numstacks numquads",
    "headlight": "ambient diffuse specular active",
    "map": "stiffness stiffnessrot force torque alpha fogstart fogend znear zfar haze shadowclip "
    "shadowscale actuatortendon",
    "scale": "forcewidth contactwidth contactheight connect com camera light selectpoint "
    "jointlength jointwidth actuatorlength actuatorwidth framelength framewidth constraint "
    "slidercrank frustum",
    "rgba": "fog haze force inertia joint actuator actuatornegative actuatorpositive com camera "
    "light selectpoint connect contactpoint contactforce contactfriction contacttorque contactgap "
    "rangefinder constraint slidercrank crankbroken frustum bv bvactive",
}
VISUAL = _draws("", {tag: _draws(words) for tag, words in _VIEWS.items()})
# The attributes of these elements that views show; their values are checked when drawing.
SEEN = {
    "material": spec("texture rgba:4"),
    "texture": spec("file builtin:none|gradient|checker|flat rgb1:3 rgb2:3"),
}

# The sections <asset> and <deformable>.

_BUILTIN = (
    "plate|square|disc|grid|box|cylinder|ellipsoid|wedge|sphere|hemisphere|cone|supersphere|"
    "supertorus"
)
_MESH_DEFAULT = attrs_of(Mesh, "scale", "maxhullvert", "inertia")
ASSET = spec(
    "",
    {
        "mesh": spec(
            f"{attrs_of(Mesh)} class content_type vertex:* normal:* texcoord:* face:int* "
            f"smoothnormal:{BOOL} builtin:{_BUILTIN} params:* material",
            {"plugin": plugin()},
        ),
        "hfield": spec(
            f"{attrs_of(HField, 'name', 'file')} size!:4 content_type nrow:int ncol:int elevation:*"
        ),
        "model": spec("name file! content_type"),
        "skin": _SKIN,
        "texture": _draws(_TEXTURE),
        "material": _draws(_MATERIAL, {"layer": _draws("texture! role!")}),
    },
)
_FLEX_CONTACT = spec(
    "contype conaffinity condim priority friction solmix solref solimp margin gap selfcollide "
    "activelayers passive"
)
_ELASTICITY = spec("young poisson shear damping thickness yield elastic2d section sectionsize")
_FLEX = spec(
    "name group dim radius material rgba flatskin body vertex element texcoord elemtexcoord "
    "node nodecoord cellcount dof",
    {"contact": _FLEX_CONTACT, "edge": spec("stiffness damping"), "elasticity": _ELASTICITY},
    "unbuilt",
)
_FLEXCOMP = spec(
    "name type group dim dof count cellcount spacing radius rigid mass inertiabox scale file "
    f"mesh point element texcoord material rgba flatskin {_POSE_NAMES} origin",
    {
        "edge": spec("equality solref solimp stiffness damping"),
        "elasticity": _ELASTICITY,
        "contact": _FLEX_CONTACT,
        "pin": spec("id range grid gridrange"),
        "plugin": plugin(),
    },
    "unbuilt",
)
DEFORMABLE = spec("", {"flex": _FLEX, "skin": _SKIN})

# The section <worldbody>.

_JOINT = (
    f"{attrs_of(Joint, but='body')} class group:int limited:{AUTO} actuatorfrclimited:{AUTO} "
    "springyield:1 user:*"
)
_GEOM = (
    f"{attrs_of(Geom, but='body type')} type:plane|hfield|sphere|capsule|ellipsoid|cylinder|box|"
    f"mesh|sdf class material fromto:6 {_TURN} rgba:4 castshadow:{BOOL} user:*"
)
_SITE = (
    f"{attrs_of(Site, but='body type')} type:sphere|capsule|ellipsoid|cylinder|box|mesh class "
    f"group:int {_TURN} material mesh fromto:6 rgba:4 user:*"
)
_CHILDREN: dict[str, Spec] = {
    "inertial": spec(attrs_but(POSE, "pos") + " pos!:3 mass!:1 diaginertia:3 fullinertia:6"),
    "joint": spec(_JOINT),
    "freejoint": spec(f"name group:int align:{AUTO}"),
    "geom": spec(_GEOM, {"plugin": plugin()}),
    "site": spec(_SITE),
    "camera": _draws(_CAMERA),
    "light": _draws(_LIGHT),
    "plugin": plugin(),
    "attach": spec("model body frame prefix!"),
    "flexcomp": _FLEXCOMP,
    "composite": spec(role="unbuilt"),
}
_BODY = spec(
    f"{attrs_of(Body, 'name', 'pos', 'quat', 'gravcomp', 'mocap', 'sleep')} childclass {_TURN} "
    "simple:false|auto fuse:false|auto user:*",
    once=("inertial",),
)
_FRAME = spec(f"name childclass {POSE} scale:1-3 scaling:similar|geometry massscale:1")
_REPLICATE = spec("count!:int sep offset:3 euler:3 childclass")
# Elements whose unknown attributes MuJoCo ignores.
UNCHECKED = ("frame", "replicate")
for _parent in (_BODY, _FRAME, _REPLICATE):
    _parent.children = _CHILDREN
_CHILDREN |= {"body": _BODY, "frame": _FRAME, "replicate": _REPLICATE}
NOT_IN_WORLD = ("joint", "freejoint", "inertial")
WORLDBODY = spec("", {tag: inner for tag, inner in _CHILDREN.items() if tag not in NOT_IN_WORLD})

# The sections <contact>, <tendon>, <equality> and <keyframe>.

_PAIR = attrs_of(Pair).replace("geom1", "geom1!").replace("geom2", "geom2!") + " class"
CONTACT = spec("", {"exclude": spec("name body1! body2!"), "pair": spec(_PAIR)})
_LIMITED = f"limited:{AUTO} actuatorfrclimited:{AUTO}"
_TENDON = f"{attrs_of(Tendon)} class group:int {_LIMITED} springyield:1 user:*"
_SPATIAL = f"{_TENDON} width:1 material rgba:4"
TENDON = spec(
    "",
    {
        "spatial": spec(
            _SPATIAL,
            {"site": spec("site!"), "geom": spec("geom! sidesite"), "pulley": spec("divisor!:1")},
        ),
        "fixed": spec(_TENDON, {"joint": spec("joint! coef!:1")}),
    },
)
_EQUALITY = f"{attrs_of(Equality, 'name', 'active', 'solref', 'solimp')} class"


def _equality(tag: str) -> Spec:
    ends = attrs_of(Equality, *EQUALITY_FIELDS[tag])
    return spec(f"{_EQUALITY} {ends}".replace("joint1", "joint1!").replace("tendon1", "tendon1!"))


EQUALITY = spec(
    "",
    {
        **{tag: _equality(tag) for tag in EQUALITY_FIELDS},
        "flex": spec(f"{_EQUALITY} flex", role="unbuilt"),
        "flexstrain": spec(f"{_EQUALITY} flex cell", role="unbuilt"),
    },
)
KEYFRAME = spec("", {"key": spec(f"{attrs_of(Key)} plastic:*")})

# The section <actuator>.

_ACTUATOR = f"class group:int user:* ctrllimited:{AUTO} forcelimited:{AUTO} " + attrs_of(
    Actuator,
    *("name", "nsample", "interp", "delay", "ctrlrange", "forcerange", "lengthrange", "gear"),
    *("damping", "armature", "cranklength", "joint", "jointinparent", "tendon", "slidersite"),
    *("cranksite", "site", "refsite"),
)
# Attributes of shortcuts besides the fields of their law.
_BESIDE = {
    "position": "inheritrange:1",
    "intvelocity": f"actlimited:{AUTO} actrange:2 inheritrange:1",
    "adhesion": "body!",
    "pid": "posrange:2 velrange:2 ffrange:2 inheritrange:1",
    "cylinder": "diameter:1",
}
# Attributes of individual actuators, in addition to the common ones.
_LAWS = {
    tag: f"{_BESIDE.get(tag, '')} {attrs_of(Actuator, *fields) if fields else ''}"
    for tag, fields in LAW_FIELDS.items()
    if tag not in ("input", "dcmotor", "general")
} | {
    "muscle": f"timeconst:2 {attrs_of(Actuator, *LAW_FIELDS['muscle'], but='timeconst')}",
    "dcmotor": "motorconst:1-2 resistance:1 nominal:1-3 saturation:1-3 inductance:1-2 cogging:1-3 "
    "controller:1-6 thermal:1-6 lugre:1-5 input",
    "general": f"actlimited:{AUTO} actrange:2 body actdim:int input velrange:2 ffrange:2 "
    "inheritrange:1 dyntype:none|integrator|filter|filterexact|pid|dcmotor|muscle|user "
    "gaintype:fixed|affine|muscle|dcmotor|pid|so3|user "
    f"biastype:none|affine|muscle|dcmotor|so3|user dynprm:* gainprm:* biasprm:* actearly:{BOOL}",
}
# Common attributes that some actuators lack; a DC motor's force range is its saturation.
_WITHOUT = {
    "dcmotor": "forcelimited forcerange",
    "orientation": "ctrllimited lengthrange gear damping armature cranklength jointinparent tendon "
    "slidersite cranksite",
}
_ACTUATORS = {
    tag: f"{attrs_but(_ACTUATOR, _WITHOUT.get(tag, ''))} {law}" for tag, law in _LAWS.items()
}
# All actuators share one set of defaults, regardless of the shortcut.
ACTUATORS = tuple(_ACTUATORS)
ACTUATOR = spec(
    "",
    {
        **{tag: spec(attrs) for tag, attrs in _ACTUATORS.items()},
        "plugin": plugin(
            f"{_ACTUATOR} plugin instance actlimited actrange actdim dyntype dynprm actearly"
        ),
    },
)

# The section <sensor>: computed sensors, and the names of sensors that are not computed.

_SENSOR = "name nsample:int interp:zoh|linear|cubic delay:1 interval:1-2 user:* " + attrs_of(
    Sensor, "cutoff", "noise"
)
_GEOMS = "geom1 geom2 body1 body2"
_OBJECT = "body|xbody|geom|site|camera"
# Attributes that name the ends of a sensor whose type observes several kinds of elements.
_ENDS = {
    "rangefinder": "site camera data",
    **dict.fromkeys(OF_FRAME, f"objtype!:{_OBJECT} objname! reftype:{_OBJECT} refname"),
    **dict.fromkeys(OF_ACCELERATION, f"objtype!:{_OBJECT} objname!"),
    "insidesite": f"site! objtype!:{_OBJECT} objname! enclosed:{BOOL}",
    **dict.fromkeys(OF_GAP, _GEOMS),
    "contact": f"{_GEOMS} subtree1 subtree2 site {attrs_of(Sensor, 'num', 'data', 'reduce')}",
}
SENSOR = spec(
    "",
    {
        **{
            tag: spec(f"{_SENSOR} {_ENDS.get(tag, ' '.join(f'{kind}!' for kind in kinds))}")
            for tag, (kinds, _) in OBJECTS.items()
        },
        "camprojection": spec(f"{_SENSOR} site! camera!", role="senses"),
        "tactile": spec("name geom mesh nsample interp delay interval cutoff user", role="senses"),
        "user": spec(
            "name objtype objname datatype:real|positive|axis|quaternion needstage:pos|vel|acc "
            "dim!:int cutoff:1 noise:1 user:*"
        ),
        "plugin": spec(
            "name plugin instance cutoff objtype objname reftype refname user",
            {"config": _CONFIG},
            "senses",
        ),
    },
)

# The section <custom>: data that the simulation does not use.

CUSTOM = spec(
    "",
    {
        "numeric": spec("name size data", role="data"),
        "text": spec("name data", role="data"),
        "tuple": spec("name", {"element": spec("objtype objname prm", role="data")}, "data"),
    },
)

# The section <default>: the attributes that a class can have, by element.

_ONCE = {
    "joint": default_of(_JOINT),
    # A class can give the mesh of a geom and the material of a site.
    "geom": spec(attrs_but(_GEOM, "name class")),
    "site": spec(attrs_but(_SITE, "name class")),
    # All types of equality share one set of defaults, and so do both types of tendon.
    "equality": default_of(_EQUALITY),
    "pair": default_of(_PAIR),
    "tendon": default_of(_SPATIAL),
    "camera": default_of(_CAMERA),
    "light": default_of(attrs_but(_LIGHT, "texture")),
    "texture": spec(_TEXTURE_LOOK),
    "material": spec(attrs_but(_MATERIAL, "name class"), {"layer": spec("texture! role!")}),
    "mesh": spec(_MESH_DEFAULT),
}
# A default class has one actuator element for each shortcut.
DEFAULT = spec(
    "class",
    {**_ONCE, **{tag: default_of(attrs) for tag, attrs in _ACTUATORS.items()}},
    once=tuple(_ONCE),
)
DEFAULT.children["default"] = DEFAULT

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
        "statistic": STATISTIC,
        "visual": VISUAL,
        "asset": ASSET,
        "custom": CUSTOM,
        "deformable": DEFORMABLE,
        "extension": EXTENSION,
    },
)


def class_fields(kind: type[Element], values: Mapping[str, Any], *skip: str) -> dict[str, Any]:
    """Return the fields of an element class that these attributes give, except those in `skip`."""
    fields: dict[str, Any] = {}
    rows = field_rows(kind)
    for name, value in values.items():
        row = rows.get(name)
        if row is None or name in skip or row.type.attribute is None:
            continue
        if row.poly:
            value, *higher = value
            if any(higher):
                fields[row.poly] = tuple(higher)
        elif row.type.read is not None:
            value = row.type.read(value)
        fields[name] = value
    return fields


def changed_attributes(element: Element, *skip: str) -> dict[str, Any]:
    """Return the attributes for the fields of an element that differ from their defaults."""
    attributes, rows = {}, field_rows(type(element))
    for name, value in element.values().items():
        row = rows[name]
        if value is not row.checked and name not in skip and value != row.default:
            attributes[name] = value if row.type.write is None else row.type.write(value)
    return attributes
