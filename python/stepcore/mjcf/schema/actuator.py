"""The section `<actuator>`."""

from stepcore.mjcf.schema.notation import AUTO, BOOL, default_of, spec, without
from stepcore.mjcf.schema.plugin import plugin

_ALL = (
    "name class group:int nsample:int interp:zoh|linear|cubic delay:1 ctrlrange:2 user:* "
    f"ctrllimited:{AUTO} forcelimited:{AUTO} forcerange:2 lengthrange:2 gear:1-6 damping:1-3 "
    "armature:1 cranklength:1 joint jointinparent tendon slidersite cranksite site refsite"
)
# What actuators have beyond that.
_OWN = {
    "motor": "",
    "position": "inheritrange:1 kp:1 kv:1 dampratio:1 timeconst:1",
    "velocity": "kv:1",
    "intvelocity": f"actlimited:{AUTO} actrange:2 inheritrange:1 kp:1 kv:1 dampratio:1",
    "damper": "kv:1",
    "adhesion": "body! gain:1",
    "pid": "posrange:2 velrange:2 ffrange:2 inheritrange:1 kp:1 kv:1 dampratio:1 ki:1 imax:1 "
    "slewmax:1 input",
    "dcmotor": "motorconst:1-2 resistance:1 nominal:1-3 saturation:1-3 inductance:1-2 cogging:1-3 "
    "controller:1-6 thermal:1-6 lugre:1-5 input",
    "orientation": "kp:1 kv:1 dampratio:1 input",
    "cylinder": "timeconst:1 area:1 diameter:1 bias:3",
    "muscle": "timeconst:2 tausmooth:1 range:2 force:1 scale:1 lmin:1 lmax:1 vmax:1 fpmax:1 "
    "fvmax:1",
    "general": f"actlimited:{AUTO} actrange:2 body actdim:int input velrange:2 ffrange:2 "
    "inheritrange:1 dyntype:none|integrator|filter|filterexact|pid|dcmotor|muscle|user "
    "gaintype:fixed|affine|muscle|dcmotor|pid|so3|user "
    f"biastype:none|affine|muscle|dcmotor|so3|user dynprm:* gainprm:* biasprm:* actearly:{BOOL}",
}
# What of the attributes that all have some have not: a motor's bounds are its saturation.
_WITHOUT = {
    "dcmotor": "forcelimited forcerange",
    "orientation": "ctrllimited lengthrange gear damping armature cranklength jointinparent tendon "
    "slidersite cranksite",
}


def _common(tag: str) -> str:
    return without(_ALL, _WITHOUT[tag]) if tag in _WITHOUT else _ALL


_PLUGIN = "plugin instance actlimited actrange actdim dyntype dynprm actearly"
ACTUATOR = spec(
    "",
    {
        **{tag: spec(f"{_common(tag)} {more}") for tag, more in _OWN.items()},
        "plugin": plugin(f"{_ALL} {_PLUGIN}"),
    },
)
DEFAULTS = {tag: default_of(f"{_common(tag)} {more}") for tag, more in _OWN.items()}
