"""The section `<custom>`: data that the simulation does not use."""

from stepcore.mjcf.schema.notation import spec

CUSTOM = spec(
    "",
    {
        "numeric": spec("name size data", role="data"),
        "text": spec("name data", role="data"),
        "tuple": spec("name", {"element": spec("objtype objname prm", role="data")}, "data"),
    },
)
