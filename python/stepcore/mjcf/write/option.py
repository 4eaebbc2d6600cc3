"""The sections `<compiler>` and `<option>`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stepcore.mjcf.option import said, to_say
from stepcore.mjcf.schema import OWN_FEATURES
from stepcore.mjcf.write import actuators
from stepcore.mjcf.write.tags import Tag, changed, text
from stepcore.scene.elements import GRAVITY
from stepcore.scene.frames import ORIGIN
from stepcore.scene.holdings import MAGNETIC

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents

INERTIA_FROM = {None: "auto", True: "true", False: "false"}


def add_compiler(root: Tag, scene: Contents) -> None:
    """Adds the compiler section."""
    given = changed(scene.mass_rules)
    if "inertiafromgeom" in given:
        given["inertiafromgeom"] = INERTIA_FROM[given["inertiafromgeom"]]
    compiler = root.add(Tag("compiler", angle="radian", **given))
    if ranges := changed(scene.lengthrange):
        compiler.add(Tag("lengthrange", **ranges))


def add_option(root: Tag, scene: Contents) -> dict[str, Any]:
    """Adds the option section; returns the settings that it cannot hold."""
    attributes, flags, rest = said(to_say(scene.settings))
    whole = {"gravity": GRAVITY, "density": 0.0, "viscosity": 0.0, "wind": ORIGIN}
    whole["magnetic"] = MAGNETIC
    for name, usual in whole.items():
        if getattr(scene, name) != usual:
            attributes[name] = text(getattr(scene, name))
    features = changed(scene.features)
    for name, on in features.items():
        if name in OWN_FEATURES:
            rest[name] = on
        else:
            flags[name] = "enable" if on else "disable"
    override = changed(scene.contact_override)
    if override.pop("enable", False):
        flags["override"] = "enable"
    attributes |= {f"o_{name}": text(value) for name, value in override.items()}
    if any(not actuator.enabled for actuator in scene.actuators):
        attributes["actuatorgroupdisable"] = str(actuators.DISABLED)
    if attributes or flags:
        option = root.add(Tag("option", **attributes))
        if flags:
            option.add(Tag("flag", **flags))
    return rest
