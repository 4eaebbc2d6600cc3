"""The part of MJCF's schema whose elements draw, sense, hold data, or are not built yet.

Only their names are checked. The notation is that of `schema`; a pair holds attributes and inner
elements.
"""

from __future__ import annotations

from typing import TypeAlias

Tree: TypeAlias = "str | tuple[str, dict[str, Tree]]"

POSE = "pos quat axisangle xyaxes zaxis euler"
CONFIG: dict[str, Tree] = {"config": "key! value"}
PLUGIN: Tree = ("plugin instance", CONFIG)

CAMERA = (
    f"name class projection fovy ipd resolution output {POSE} mode target focal focalpixel "
    "principal principalpixel sensorsize user"
)
LIGHT = (
    "name class directional type castshadow active pos dir bulbradius intensity range "
    "attenuation cutoff softness exponent ambient diffuse specular mode target texture"
)

# Assets.
TEXTURE_LOOK = (
    "type colorspace gridsize gridlayout builtin rgb1 rgb2 mark markrgb random width height "
    "hflip vflip nchannel embed"
)
TEXTURE = (
    f"name class content_type file fileright fileleft fileup filedown filefront fileback "
    f"{TEXTURE_LOOK}"
)
MATERIAL = (
    "name class texture texrepeat texuniform emission specular shininess reflectance metallic "
    "roughness rgba"
)
LAYER: dict[str, Tree] = {"layer": "texture! role!"}
SKIN: Tree = (
    "name file material rgba inflate vertex texcoord face group",
    {"bone": "body bindpos bindquat vertid vertweight"},
)
ASSETS: dict[str, Tree] = {
    "skin": SKIN,
    "texture": TEXTURE,
    "material": (MATERIAL, LAYER),
    "model": "name file content_type",
}

# Actuators that are not built: what they have beyond the attributes of a motor.
ACTUATORS = {
    "intvelocity": "actlimited actrange inheritrange kp kv dampratio",
    "pid": "posrange velrange ffrange inheritrange kp kv dampratio ki imax slewmax input",
    "damper": "kv",
    "cylinder": "timeconst area diameter bias",
    "muscle": "timeconst tausmooth range force scale lmin lmax vmax fpmax fvmax",
    "adhesion": "body gain",
    "dcmotor": "motorconst resistance nominal saturation inductance cogging controller thermal "
    "lugre input",
}
ORIENTATION_SERVO = "kp kv dampratio input"
ACTUATOR_PLUGIN = "plugin instance actlimited actrange actdim dyntype dynprm actearly"

# Constraints, tendons, flexes.
_EQUALITY = "name class active solref solimp"
EQUALITIES: dict[str, Tree] = {
    "weld": f"{_EQUALITY} body1 body2 relpose anchor site1 site2 torquescale",
    "joint": f"{_EQUALITY} joint1! joint2 polycoef",
    "tendon": f"{_EQUALITY} tendon1! tendon2 polycoef",
    "flex": f"{_EQUALITY} flex",
    "flexstrain": f"{_EQUALITY} flex cell",
}
TENDON = (
    "name class group limited actuatorfrclimited range actuatorfrcrange solreflimit solimplimit "
    "solreffriction solimpfriction frictionloss springlength springyield margin stiffness damping "
    "armature user"
)
TENDONS: dict[str, Tree] = {
    "spatial": (
        f"{TENDON} width material rgba",
        {"site": "site!", "geom": "geom! sidesite", "pulley": "divisor!"},
    ),
    "fixed": (TENDON, {"joint": "joint! coef!"}),
}
_FLEX_CONTACT = (
    "contype conaffinity condim priority friction solmix solref solimp margin gap selfcollide "
    "activelayers passive"
)
_ELASTICITY = "young poisson shear damping thickness yield elastic2d section sectionsize"
FLEX: Tree = (
    (
        "name group dim radius material rgba flatskin body vertex element texcoord elemtexcoord "
        "node nodecoord cellcount dof"
    ),
    {"contact": _FLEX_CONTACT, "edge": "stiffness damping", "elasticity": _ELASTICITY},
)
FLEXCOMP: Tree = (
    (
        "name type group dim dof count cellcount spacing radius rigid mass inertiabox scale file "
        f"mesh point element texcoord material rgba flatskin {POSE} origin"
    ),
    {
        "edge": "equality solref solimp stiffness damping",
        "elasticity": _ELASTICITY,
        "contact": _FLEX_CONTACT,
        "pin": "id range grid gridrange",
        "plugin": PLUGIN,
    },
)

# Sensors.
_SENSOR = "name nsample interp delay interval cutoff noise user"
_PAIR = "geom1 geom2 body1 body2"


def _sensors(names: str, more: str) -> dict[str, Tree]:
    return dict.fromkeys(names.split(), f"{_SENSOR} {more}")


SENSORS: dict[str, Tree] = {
    **_sensors("touch accelerometer velocimeter gyro force torque magnetometer", "site!"),
    **_sensors("camprojection", "site! camera!"),
    **_sensors("rangefinder", "site camera data"),
    **_sensors("jointpos jointvel jointactuatorfrc ballquat ballangvel", "joint!"),
    **_sensors("jointlimitpos jointlimitvel jointlimitfrc", "joint!"),
    **_sensors("tendonpos tendonvel tendonactuatorfrc", "tendon!"),
    **_sensors("tendonlimitpos tendonlimitvel tendonlimitfrc", "tendon!"),
    **_sensors("actuatorpos actuatorvel actuatorfrc", "actuator!"),
    **_sensors(
        "framepos framequat framexaxis frameyaxis framezaxis framelinvel frameangvel",
        "objtype! objname! reftype refname",
    ),
    **_sensors("framelinacc frameangacc", "objtype! objname!"),
    **_sensors("subtreecom subtreelinvel subtreeangmom", "body!"),
    **_sensors("insidesite", "site! objtype! objname! enclosed"),
    **_sensors("distance normal fromto", _PAIR),
    **_sensors("contact", f"{_PAIR} subtree1 subtree2 site num data reduce"),
    **_sensors("e_potential e_kinetic clock", ""),
    "tactile": "name geom mesh nsample interp delay interval cutoff user",
    "user": "name objtype objname datatype needstage dim cutoff noise user",
    "plugin": ("name plugin instance cutoff objtype objname reftype refname user", CONFIG),
}

# Data and appearance.
CUSTOM: dict[str, Tree] = {
    "numeric": "name size data",
    "text": "name data",
    "tuple": ("name", {"element": "objtype objname prm"}),
}
EXTENSION: dict[str, Tree] = {
    "plugin": ("plugin!", {"instance": ("name", CONFIG), "config": "key! value"})
}
SIZE = (
    "memory njmax nconmax nstack nuserdata nkey:int nuser_body nuser_jnt nuser_geom nuser_site "
    "nuser_cam nuser_tendon nuser_actuator nuser_sensor"
)
STATISTIC = "meaninertia meanmass meansize extent center"
LENGTHRANGE = (
    "mode useexisting uselimit accel maxforce timeconst timestep inttotal interval tolrange"
)
VISUAL: dict[str, Tree] = {
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
