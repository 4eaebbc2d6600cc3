"""Describe the effects of elements and attributes on the motion, for errors and notes.

A kind is a section ("tendon"), an element ("actuator/muscle"), an attribute ("geom/surfacevel"),
or a key of `GROUPS`.
"""

# Kinds that appear in several sections.
GROUPS = {
    "flex": ("flexcomp", "deformable/flex", "equality/flex", "equality/flexstrain"),
    "plugin": ("plugin",),
}
# Sections that can be left out as a whole.
SECTIONS = ("contact", "tendon", "equality", "actuator", "sensor", "keyframe", "deformable")
# The most specific key takes precedence.
_EFFECTS = {
    "flex": "its points move, collide, and pull on what they are pinned to",
    "plugin": "it computes forces, shapes or sensors outside of the file",
    "composite": "MuJoCo 4 has it no more; a replicate or flexcomp takes its place",
    "attach": "it adds bodies of another model",
    "contact/exclude": "it keeps two bodies from colliding",
    "contact/pair": "it decides how two geoms collide",
    "contact": "it decides which geoms collide, and how",
    "tendon": "its springs, limits and actuators pull along a path",
    "equality": "it ties bodies, joints or tendons together",
    "actuator": "it puts a force on bodies that follows a control",
    "sensor": "it measures; nothing moves otherwise without it",
    "keyframe": "it is a state to start from",
    "deformable": "its points move with bodies",
    "geom/surfacevel": "it drags along what touches the geom",
    "geom/adhesion": "it pulls touching geoms together",
    "geom/type": "the shape collides and has mass",
    "option/density": "the fluid slows bodies down",
    "option/viscosity": "the fluid slows bodies down",
    "option/wind": "the fluid moves, and bodies in it",
    "option/integrator": "each step has another error",
    "flag/sleep": "what rests would be left out of the step until something touches it",
    "flag/diagexact": "limits, contacts and equalities would be softer or harder, by their inertia "
    "at each state instead of that at qpos0",
    "flag/ipc": "contacts would be barriers that nothing goes through",
    "flag/speculative": "contacts would act a step before bodies touch, so that none goes through "
    'another; law="rigid" or a smaller timestep does that here',
    "body/gravcomp": "a force holds the body up against gravity",
    "body/mocap": "the body stands where its user puts it",
    "joint/springdamper": "a spring and a damper of given times act on the joint",
    "joint/springyield": "the spring of the joint yields",
    **dict.fromkeys(
        ("fixed/springyield", "spatial/springyield"), "the spring of the tendon yields"
    ),
    "joint/actuatorfrcrange": "it clamps the sum of what actuators put on the joint",
    "frame/scale": "it changes sizes, masses and forces within the frame",
    "frame/massscale": "it changes masses within the frame",
}


def effect(kind: str) -> str:
    """Return the effect of a kind on the motion; "" if there is no text on it."""
    tag = kind.rpartition("/")[2]
    group = next((name for name, tags in GROUPS.items() if kind in tags or tag in tags), "")
    for name in (kind, group, tag, kind.partition("/")[0]):
        if name in _EFFECTS:
            return _EFFECTS[name]
    return ""
