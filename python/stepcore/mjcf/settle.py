"""Bodies of attached models whose masses are made by other rules than those of this model.

As in MuJoCo, a body follows the `<compiler>` of the model that it comes from. A scene has one set
of rules: where others make another mass of a body, it gets that as its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.mjcf.masses import Weight, give, weights_under
from stepcore.scene.elements import Body, MassRules
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.mjcf.worldbody import WorldReader
    from stepcore.scene.contents import Contents

NOTE = (
    "an attached model makes masses by other rules (<compiler>): bodies have the masses that their "
    "own rules make, and changed densities or sizes of geoms would not change these"
)


def settle_masses(world: WorldReader) -> None:
    """Gives bodies their own mass and inertia where they are made by other rules than the scene's.

    The scene keeps the rules of this model, unless these would change such a mass.
    """
    scene = world.scene
    groups: dict[tuple[object, ...], tuple[MassRules, list[Body]]] = {}
    for body in Layout(scene).bodies[1:]:
        rules = world.rules_of(body)
        groups.setdefault(_words(rules), (rules, []))[1].append(body)
    if not groups.keys() - {_words(scene.mass_rules)}:
        return
    kept = scene.mass_rules
    if kept.inertiafromgeom is True or kept.boundmass > 0 or kept.boundinertia > 0:
        kept = MassRules(settotalmass=kept.settotalmass)
    settled = False
    for rules, bodies in groups.values():
        if _words(rules) == _words(kept):
            continue
        known, otherwise = weights_under(rules, scene, bodies), _weights_if(kept, scene, bodies)
        for body in bodies:
            if not _same(known[id(body)], otherwise.get(id(body))):
                settled = True
                give(body, known[id(body)])
    scene.mass_rules = kept
    world.settled = True
    if settled:
        scene.notes.append(NOTE)


def _words(rules: MassRules) -> tuple[object, ...]:
    """What of the rules concerns one body."""
    return tuple((rules.values() | {"settotalmass": None}).values())


def _weights_if(rules: MassRules, scene: Contents, bodies: list[Body]) -> dict[int, Weight]:
    """The weights of those bodies that have one under these rules, by their ``id``."""
    try:
        return weights_under(rules, scene, bodies)
    except ValueError:
        if len(bodies) == 1:
            return {}
    # One by one: a body that the rules refuse says nothing about the others.
    return {key: w for body in bodies for key, w in _weights_if(rules, scene, [body]).items()}


def _same(weight: Weight, other: Weight | None) -> bool:
    if other is None:
        return False
    pairs = zip(
        (weight.mass, *weight.ipos, *weight.inertia.flat),
        (other.mass, *other.ipos, *other.inertia.flat),
        strict=True,
    )
    return all(one == two for one, two in pairs)
