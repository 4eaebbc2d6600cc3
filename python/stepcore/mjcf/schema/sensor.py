"""The section `<sensor>`: those that are computed, and the names of those that are not."""

from stepcore.mjcf.schema.notation import BOOL, Spec, spec
from stepcore.mjcf.schema.plugin import CONFIG

_ALL = "name nsample:int interp:zoh|linear|cubic delay:1 interval:1-2 cutoff:1 noise:1 user:*"
_GEOMS = "geom1 geom2 body1 body2"
_OBJECT = "body|xbody|geom|site|camera"
_REFERENCE = f"reftype:{_OBJECT} refname"


def _sensors(names: str, more: str, role: str = "") -> dict[str, Spec]:
    return {tag: spec(f"{_ALL} {more}", role=role) for tag in names.split()}


SENSOR = spec(
    "",
    {
        **_sensors("touch accelerometer velocimeter gyro force torque magnetometer", "site!"),
        **_sensors("camprojection", "site! camera!", "senses"),
        **_sensors("rangefinder", "site camera data"),
        **_sensors("jointpos jointvel jointactuatorfrc ballquat ballangvel", "joint!"),
        **_sensors("jointlimitpos jointlimitvel jointlimitfrc", "joint!"),
        **_sensors("tendonpos tendonvel tendonactuatorfrc", "tendon!"),
        **_sensors("tendonlimitpos tendonlimitvel tendonlimitfrc", "tendon!"),
        **_sensors("actuatorpos actuatorvel actuatorfrc", "actuator!"),
        **_sensors(
            "framepos framequat framexaxis frameyaxis framezaxis framelinvel frameangvel",
            f"objtype!:{_OBJECT} objname! {_REFERENCE}",
        ),
        **_sensors("framelinacc frameangacc", f"objtype!:{_OBJECT} objname!"),
        **_sensors("subtreecom subtreelinvel subtreeangmom", "body!"),
        **_sensors("insidesite", f"site! objtype!:{_OBJECT} objname! enclosed:{BOOL}"),
        **_sensors("distance normal fromto", _GEOMS),
        **_sensors(
            "contact",
            f"{_GEOMS} subtree1 subtree2 site num:int data reduce:none|mindist|maxforce|netforce",
        ),
        **_sensors("e_potential e_kinetic clock", ""),
        "tactile": spec("name geom mesh nsample interp delay interval cutoff user", role="senses"),
        "user": spec(
            "name objtype objname datatype:real|positive|axis|quaternion needstage:pos|vel|acc "
            "dim!:int cutoff:1 noise:1 user:*"
        ),
        "plugin": spec(
            "name plugin instance cutoff objtype objname reftype refname user",
            {"config": CONFIG},
            "senses",
        ),
    },
)
