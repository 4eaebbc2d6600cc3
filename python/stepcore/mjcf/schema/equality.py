"""The section `<equality>`."""

from stepcore.mjcf.schema.notation import BOOL, default_of, spec

_ALL = f"name class active:{BOOL} solref:1-2 solimp:1-5 "
EQUALITY = spec(
    "",
    {
        "connect": spec(f"{_ALL} body1 body2 anchor:3 site1 site2"),
        "weld": spec(f"{_ALL} body1 body2 relpose:7 anchor:3 site1 site2 torquescale:1"),
        "joint": spec(f"{_ALL} joint1! joint2 polycoef:1-5"),
        "tendon": spec(f"{_ALL} tendon1! tendon2 polycoef:1-5"),
        "flex": spec(f"{_ALL} flex", role="unbuilt"),
        "flexstrain": spec(f"{_ALL} flex cell", role="unbuilt"),
    },
)
# All kinds of equality share one set of defaults.
DEFAULTS = {"equality": default_of(_ALL)}
