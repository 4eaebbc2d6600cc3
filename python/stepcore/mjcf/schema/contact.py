"""The section `<contact>`: explicit and excluded pairs."""

from stepcore.mjcf.schema.notation import default_of, spec

_PAIR = (
    "name class geom1! geom2! condim:int friction:1-5 solref:1-2 solreffriction:1-2 solimp:1-5 "
    "gap:1 margin:1 adhesion:1"
)
CONTACT = spec("", {"exclude": spec("name body1! body2!"), "pair": spec(_PAIR)})
DEFAULTS = {"pair": default_of(_PAIR)}
