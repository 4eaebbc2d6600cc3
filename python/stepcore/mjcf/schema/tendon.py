"""The section `<tendon>`."""

from stepcore.mjcf.schema.notation import AUTO, default_of, spec

_TENDON = (
    f"name class group:int limited:{AUTO} actuatorfrclimited:{AUTO} range:2 actuatorfrcrange:2 "
    "solreflimit:1-2 solimplimit:1-5 solreffriction:1-2 solimpfriction:1-5 frictionloss:1 "
    "springlength:1-2 springyield:1 margin:1 stiffness:1-3 damping:1-3 armature:1 user:*"
)
_LOOK = "width:1 material rgba:4"
TENDON = spec(
    "",
    {
        "spatial": spec(
            f"{_TENDON} {_LOOK}",
            {"site": spec("site!"), "geom": spec("geom! sidesite"), "pulley": spec("divisor!:1")},
        ),
        "fixed": spec(_TENDON, {"joint": spec("joint! coef!:1")}),
    },
)
# Both kinds share one set of defaults.
DEFAULTS = {"tendon": default_of(f"{_TENDON} {_LOOK}")}
