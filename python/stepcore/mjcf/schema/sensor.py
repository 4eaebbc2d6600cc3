"""The section `<sensor>`: only the names of its attributes are checked."""

from stepcore.mjcf.schema.notation import Spec, spec
from stepcore.mjcf.schema.plugin import CONFIG

_ALL = "name nsample interp delay interval cutoff noise user"
_GEOMS = "geom1 geom2 body1 body2"


def _sensors(names: str, more: str) -> dict[str, Spec]:
    return {tag: spec(f"{_ALL} {more}", role="senses") for tag in names.split()}


SENSOR = spec(
    "",
    {
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
        **_sensors("distance normal fromto", _GEOMS),
        **_sensors("contact", f"{_GEOMS} subtree1 subtree2 site num data reduce"),
        **_sensors("e_potential e_kinetic clock", ""),
        "tactile": spec("name geom mesh nsample interp delay interval cutoff user", role="senses"),
        "user": spec(
            "name objtype objname datatype needstage dim cutoff noise user", role="senses"
        ),
        "plugin": spec(
            "name plugin instance cutoff objtype objname reftype refname user",
            {"config": CONFIG},
            "senses",
        ),
    },
)
