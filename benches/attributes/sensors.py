"""Scenes and values for the attributes of sensors; what is compared is also what they measure."""

from attributes.scenes import BALL_BODY, TENDONS, robot

_WORLD = (
    BALL_BODY
    + '<camera name="cam" pos="0 -2 1" xyaxes="1 0 0 0 0 1"/>'
    + '<camera name="cam2" pos="0 -3 1" xyaxes="1 0 0 0 0 1"/>'
    + '<body pos="0 4 1"><joint name="lim" range="-2 -.005"/><geom size=".1"/></body>'
    + '<body pos="1 0 .097"><site name="foot" size=".2"/><site name="foot2" size=".01"/></body>'
)
_ON = {
    **dict.fromkeys(
        ("accelerometer", "velocimeter", "gyro", "force", "torque", "magnetometer"), 'site="s2"'
    ),
    "touch": 'site="s4"',
    "rangefinder": 'site="s2"',
    "camprojection": 'site="s2" camera="cam"',
    **dict.fromkeys(
        (
            *("jointpos", "jointvel", "jointactuatorfrc"),
            *("jointlimitpos", "jointlimitvel", "jointlimitfrc"),
        ),
        'joint="j"',
    ),
    **dict.fromkeys(("ballquat", "ballangvel"), 'joint="bl"'),
    **dict.fromkeys(
        (
            *("tendonpos", "tendonvel", "tendonactuatorfrc"),
            *("tendonlimitpos", "tendonlimitvel", "tendonlimitfrc"),
        ),
        'tendon="tl"',
    ),
    **dict.fromkeys(("actuatorpos", "actuatorvel", "actuatorfrc"), 'actuator="m"'),
    **dict.fromkeys(
        (
            *("framepos", "framequat", "framexaxis", "frameyaxis", "framezaxis"),
            *("framelinvel", "frameangvel", "framelinacc", "frameangacc"),
        ),
        'objtype="site" objname="s2"',
    ),
    **dict.fromkeys(("subtreecom", "subtreelinvel", "subtreeangmom"), 'body="arm"'),
    "insidesite": 'site="foot" objtype="body" objname="ball"',
    **dict.fromkeys(("distance", "normal", "fromto"), 'geom1="bg" geom2="lower" cutoff="5"'),
    "contact": 'geom1="bg"',
    **dict.fromkeys(("e_potential", "e_kinetic", "clock"), ""),
    "user": 'dim="3"',
}
BASE = {f"sensor/{tag}": words for tag, words in _ON.items()}
_TENDONS = TENDONS.replace(
    "</tendon>",
    '<fixed name="tl" limited="true" range=".001 1"><joint joint="j" coef="1"/></fixed>'
    '<fixed name="tm" limited="true" range=".002 1"><joint joint="k" coef="1"/></fixed></tendon>',
)
_ACTUATORS = (
    '<actuator><motor name="m" joint="j"/><motor name="n" joint="k"/>'
    '<motor tendon="tl" name="o" gear="2"/></actuator>'
)
_SCENE = robot(world=_WORLD, after=_TENDONS + _ACTUATORS + "<sensor><TAG @/></sensor>").replace(
    '<site name="s3"/>', '<site name="s3"/><site name="s4" size=".2"/>'
)
SCENES = {f"sensor/{tag}": _SCENE.replace("TAG", tag) for tag in _ON}
_CASES: dict[str, str | tuple[str, str]] = {
    "cutoff": ".001",
    "noise": ".1",
    "user": "1 2",
    "nsample": ("4", 'delay=".008"'),
    "interp": ("linear", 'nsample="4" delay=".006"'),
    "delay": (".008", 'nsample="4"'),
    "interval": ".008",
    "site": "s1",
    "joint": "k",
    "tendon": "tm",
    "actuator": "n",
    "body": "fore",
    "camera": "cam2",
    "objname": "s1",
    "objtype": ("body", 'objname="fore"'),
    "reftype": ("site", 'refname="s1"'),
    "refname": ("s1", 'reftype="site"'),
    "geom1": "upper",
    "geom2": "upper",
    "body1": "ball",
    "body2": "fore",
}
_OWN: dict[str, dict[str, str | tuple[str, str]]] = {
    **{tag: {"joint": "bl2"} for tag in ("ballquat", "ballangvel")},
    **{tag: {"joint": "lim"} for tag in ("jointlimitpos", "jointlimitvel", "jointlimitfrc")},
    "insidesite": {
        "enclosed": "true",
        "site": "foot2",
        "objname": "fore",
        "objtype": ("geom", 'objname="bg"'),
    },
    "contact": {
        "geom1": "lower",
        "geom2": "upper",
        "body1": "ball",
        "body2": "world",
        "subtree1": "ball",
        "subtree2": "arm",
        "site": "foot",
        "num": "2",
        "data": "force dist",
        "reduce": "netforce",
    },
    "rangefinder": {"camera": "cam", "data": "dist dir"},
    "touch": {"site": "s1"},
    "user": {
        "dim": "5",
        "datatype": "positive",
        "needstage": "acc",
        "objtype": ("body", 'objname="fore"'),
        "objname": ("fore", 'objtype="body"'),
    },
}


# Attributes of which a sensor has one; a case drops the others.
ONE_OF = {
    **dict.fromkeys(
        ("contact", "distance", "normal", "fromto"),
        (("geom1", "body1", "subtree1", "site"), ("geom2", "body2", "subtree2")),
    ),
    "rangefinder": (("site", "camera"),),
}


def case_of(tag: str, attribute: str) -> str | tuple[str, str] | None:
    """The case of a sensor's attribute."""
    return _OWN.get(tag, {}).get(attribute, _CASES.get(attribute))
