"""The section `<asset>`."""

from stepcore.mjcf.schema import visual
from stepcore.mjcf.schema.notation import BOOL, spec
from stepcore.mjcf.schema.plugin import plugin

_MESH_DEFAULT = "scale:3 maxhullvert:int inertia:convex|exact|legacy|shell"
_MESH = (
    f"name class content_type file vertex:* normal:* texcoord:* face:int* refpos:3 refquat:4 "
    f"{_MESH_DEFAULT} smoothnormal:{BOOL} builtin params:* material"
)
ASSET = spec(
    "",
    {
        "mesh": spec(_MESH, {"plugin": plugin()}),
        "hfield": spec("name content_type file nrow:int ncol:int size!:4 elevation:*"),
        "model": spec("name file! content_type"),
        **visual.ASSETS,
    },
)
DEFAULTS = {"mesh": spec(_MESH_DEFAULT)}
