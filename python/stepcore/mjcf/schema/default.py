"""The section `<default>`: the attributes that a class can hold, element by element."""

from stepcore.mjcf.schema import actuator, asset, contact, equality, tendon, tree, visual
from stepcore.mjcf.schema.notation import spec

# All actuators share one set of defaults, whatever shortcut wrote it.
ACTUATORS = tuple(actuator.DEFAULTS)
# Actuators have one element of a default class for each shortcut.
_ONCE = {
    **tree.DEFAULTS,
    **equality.DEFAULTS,
    **contact.DEFAULTS,
    **tendon.DEFAULTS,
    **visual.DEFAULTS,
    **asset.DEFAULTS,
}
DEFAULT = spec("class", {**_ONCE, **actuator.DEFAULTS}, once=tuple(_ONCE))
DEFAULT.children["default"] = DEFAULT
