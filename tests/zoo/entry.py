"""What a scene of the zoo is, and what its MJCF is put together from."""

from __future__ import annotations

from dataclasses import dataclass

CONTACT, LIMIT, FRICTION, EQUALITY = "contact", "limit", "friction", "equality"


@dataclass(frozen=True)
class Entry:
    """One scene: MJCF text, the rows its states must reach, how widely they start."""

    text: str
    rows: frozenset[str] = frozenset()
    spread: float = 0.3
    speed: float = 1.0


def mjcf(body: str, extra: str = "", dt: float = 0.004, option: str = "") -> str:
    """A whole MJCF document around the children of its world body."""
    return (
        f'<mujoco><option timestep="{dt}" {option}/><worldbody>{body}</worldbody>{extra}</mujoco>'
    )


FLOOR = '<geom name="floor" type="plane" size="3 3 .1"/>'
# Weighs, never collides.
INERT = 'contype="0" conaffinity="0"'
# What carries these bits meets the ground that carries these, and not its like.
ALOOF, GROUND = 'contype="1" conaffinity="2"', 'contype="2" conaffinity="1"'
# Boxes that meet what carries their bit, and not their like.
BOXES, MEETS_BOXES = 'contype="2" conaffinity="2"', 'contype="3" conaffinity="3"'

ZOO: dict[str, Entry] = {}


def add(name: str, body: str, *rows: str, spread: float = 0.3, speed: float = 1.0, **kw) -> None:
    ZOO[name] = Entry(mjcf(body, **kw), frozenset(rows), spread, speed)


def mover(pos: str, geom: str, joint: str = "<freejoint/>") -> str:
    return f'<body pos="{pos}">{joint}<geom {geom}/></body>'


SPHERE, CAPSULE = 'type="sphere" size=".1"', 'type="capsule" size=".06 .12"'
