"""What only draws: cameras, lights, textures, materials, skins, statistics and settings of views.

Only the names of its attributes are checked when a scene is read.
"""

from stepcore.mjcf.schema.notation import BOOL, POSE, Spec, default_of, spec, without

_POSE = " ".join(word.partition(":")[0] for word in POSE.split())


def _draws(attrs: str, children: dict[str, Spec] | None = None) -> Spec:
    return spec(attrs, children, "draws")


_CAMERA = (
    f"name class projection fovy ipd resolution output {_POSE} mode target focal focalpixel "
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
_LAYER = {"layer": _draws("texture! role!")}

CAMERA = _draws(_CAMERA)
LIGHT = _draws(_LIGHT)
SKIN = _draws(
    "name file material rgba inflate vertex texcoord face group",
    {"bone": _draws("body bindpos bindquat vertid vertweight")},
)
ASSETS = {"skin": SKIN, "texture": _draws(_TEXTURE), "material": _draws(_MATERIAL, _LAYER)}
DEFAULTS = {
    "camera": default_of(_CAMERA),
    "light": default_of(without(_LIGHT, "texture")),
    "texture": spec(_TEXTURE_LOOK),
    "material": spec(without(_MATERIAL, "name class"), {"layer": spec("texture! role!")}),
}
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
# What views show of these, checked when something is drawn.
SEEN = {
    "light": spec(
        f"type:spot|directional|point|image directional:{BOOL} active:{BOOL} "
        "pos:3 dir:3 diffuse:3 cutoff:1"
    ),
    "headlight": spec("active:0|1|2|false|true ambient:3 diffuse:3"),
    "material": spec("texture rgba:4"),
    "texture": spec("file builtin:none|gradient|checker|flat rgb1:3 rgb2:3"),
}
VISUAL = _draws("", {tag: _draws(words) for tag, words in _VIEWS.items()})
