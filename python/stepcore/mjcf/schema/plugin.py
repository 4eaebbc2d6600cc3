"""Plugins, which can stand in several sections: none is built."""

from stepcore.mjcf.schema.notation import Spec, spec

CONFIG = spec("key! value")


def plugin(attrs: str = "plugin instance") -> Spec:
    """A plugin's element, with the attributes that it has beside its configuration."""
    return spec(attrs, {"config": CONFIG}, "unbuilt")


EXTENSION = spec(
    "",
    {
        "plugin": spec(
            "plugin!",
            {"instance": spec("name", {"config": CONFIG}), "config": CONFIG},
            "unbuilt",
        )
    },
)
