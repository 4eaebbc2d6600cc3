"""Files that were made to break a reader: deep, huge, in circles, with numbers of no use."""

from __future__ import annotations

import html
import random
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

from cases import ODD, run

import stepcore as sc
from stepcore.mjcf.schema import ROOT, Spec

BODY = '<body name="{0}"><joint name="j{0}"/><geom size=".1"/>{1}</body>'
TAGS = (
    *("body", "frame", "replicate", "default", "geom", "joint", "site", "composite", "include"),
    *("attach", "tendon", "sensor", "asset", "mesh", "worldbody", "option", "custom", "flexcomp"),
)


def world(inside: str, rest: str = "", head: str = "") -> str:
    return f"{head}<mujoco><worldbody>{inside}</worldbody>{rest}</mujoco>"


def nested(rng: random.Random) -> dict[str, str]:
    """Elements in elements, thousands deep, of which some may not stand there."""
    depth = rng.choice((50, 499, 501, 3000, 50_000))
    tag = rng.choice(TAGS)
    attribute = ' count="1" offset="0 0 1"' if tag == "replicate" else ""
    inside = f"<{tag}{attribute}>" * depth + f"</{tag}>" * depth
    return {"model.xml": rng.choice((world(inside), inside, f"<mujoco>{inside}</mujoco>"))}


def counted(rng: random.Random) -> dict[str, str]:
    """Counts that ask for more than any machine has."""
    count = rng.choice(("1000", "1001", "1000000", "2147483648", "1e9", "-5", "0", "9" * 40))
    actuator = '<motor joint="ja" nsample="{0}" delay="1" interp="linear"/>'
    texts = (
        world(f'<replicate count="{count}">{BODY.format("a", "")}</replicate>'),
        world(
            f'<replicate count="{count}" sep="-"><replicate count="{count}" sep="+">'
            f"{BODY.format('a', '')}</replicate></replicate>",
            '<sensor><jointpos joint="ja"/></sensor>',
        ),
        world(BODY.format("a", ""), f"<actuator>{actuator.format(count)}</actuator>"),
        world(BODY.format("a", ""), f'<keyframe><key qpos="{"0 " * 100_000}"/></keyframe>'),
        world(BODY.format("a", ""), f'<size nkey="{count}" memory="{count}"/>'),
        world(
            '<geom type="hfield" hfield="h"/>',
            f'<asset><hfield name="h" nrow="{count}" ncol="{count}" size="1 1 1 1"/></asset>',
        ),
        world(
            '<geom type="mesh" mesh="m"/>',
            f'<asset><mesh name="m" builtin="sphere" params="{count}"/></asset>',
        ),
        world(
            BODY.format("a", ""),
            f'<asset><texture name="t" builtin="flat" width="{count}" height="{count}"/></asset>',
        ),
    )
    return {"model.xml": rng.choice(texts)}


def bomb(rng: random.Random) -> dict[str, str]:
    """Entities that double, or name a file."""
    lines = "".join(f'<!ENTITY e{k} "&e{k - 1};&e{k - 1};&e{k - 1};">' for k in range(1, 30))
    kind = rng.choice(
        (
            f'<!DOCTYPE m [<!ENTITY e0 "aaaaaaaa">{lines}]>',
            '<!DOCTYPE m [<!ENTITY e29 SYSTEM "file:///etc/passwd">]>',
            '<!DOCTYPE m SYSTEM "http://localhost:1/none.dtd" [<!ENTITY e29 "x">]>',
            '<!DOCTYPE m [<!ENTITY e29 "&e29;">]>',
        )
    )
    where = rng.choice((BODY.format("&e29;", ""), "<body>&e29;</body>"))
    return {"model.xml": world(where, head=kind)}


def circle(rng: random.Random) -> dict[str, str]:
    """Files that include or attach each other."""
    count = rng.choice((1, 2, 5))
    found = {}
    for k in range(count):
        other = f"part{(k + 1) % count}.xml"
        include = f'<include file="{other}"/>'
        attach = f'<asset><model name="n" file="{other}"/></asset>'
        inside = f'<attach model="n" prefix="p{k}"/>'
        found[f"part{k}.xml"] = rng.choice(
            (
                f"<mujoco>{include}</mujoco>",
                f"<mujoco><worldbody>{include}</worldbody></mujoco>",
                f"<mujoco>{attach}<worldbody><body>{inside}</body></worldbody></mujoco>",
                f'<mujoco><worldbody><replicate count="3">{include}</replicate></worldbody>'
                "</mujoco>",
            )
        )
    return {"model.xml": '<mujoco><include file="part0.xml"/></mujoco>'} | found


def numbers(rng: random.Random) -> dict[str, str]:
    """Numbers of no use in any attribute."""
    values = [rng.choice((*ODD, "1e308", "-1e308", "1e-308", "nan", "inf")) for _ in range(9)]
    pos, size, mass, axis, damping, ref, gear, solref, dt = values
    body = (
        f'<body pos="{pos}"><joint name="ja" axis="{axis}" damping="{damping}" ref="{ref}"/>'
        f'<geom size="{size}" mass="{mass}" solref="{solref}"/></body>'
    )
    rest = f'<option timestep="{dt}"/><actuator><motor joint="ja" gear="{gear}"/></actuator>'
    plain = world(BODY.format("a", ""), rest)
    return {"model.xml": rng.choice((world(body, rest), plain))}


NAMES = ("a", "b", "c", "world", "ja", "no", "", "model.xml")


def value(rng: random.Random, kind: str) -> str:
    """Mostly of the kind that the schema names."""
    if rng.random() < 0.1:
        return html.escape(rng.choice(ODD))
    if kind == "":
        return rng.choice(NAMES)
    if kind.startswith("int"):
        count = {"int": 1, "int*": rng.randint(0, 6)}.get(kind, 2)
        return " ".join(str(rng.choice((0, 1, 2, 3, 7, -1, 1000))) for _ in range(count))
    if "|" in kind:
        return rng.choice(kind.split("|"))
    low, _, high = kind.partition("-")
    count = rng.randint(int(low), int(high or low)) if kind != "*" else rng.randint(0, 9)
    return " ".join(f"{rng.choice((0.0, 0.1, 1.0, rng.uniform(-2, 2))):.3g}" for _ in range(count))


def element(rng: random.Random, tag: str, known: Spec, depth: int) -> str:
    """An element that the schema allows, with some of its attributes and children."""
    names = [name for name in known.attrs if name in known.required or rng.random() < 0.2]
    text = "".join(f' {name}="{value(rng, known.attrs[name])}"' for name in names)
    tags = [t for t, inner in known.children.items() if inner.role != "unbuilt" and t != "plugin"]
    count = rng.randint(0, 4) if tags and depth else 0
    chosen = [rng.choice(tags) for _ in range(count)]
    inside = "".join(element(rng, t, known.children[t], depth - 1) for t in chosen)
    return f"<{tag}{text}>{inside}</{tag}>"


def by_schema(rng: random.Random) -> dict[str, str]:
    """Any elements and attributes where MJCF has them, with values that fit by chance."""
    tree = element(rng, "worldbody", ROOT.children["worldbody"], 4)
    sections = [t for t in ROOT.children if t not in ("worldbody", "extension", "deformable")]
    chosen = rng.sample(sections, rng.randint(0, 3))
    rest = "".join(element(rng, tag, ROOT.children[tag], 3) for tag in chosen)
    body = BODY.format("a", BODY.format("b", '<site name="b"/><joint name="c" axis="1 0 0"/>'))
    return {"model.xml": f"<mujoco><worldbody>{body}</worldbody>{tree}{rest}</mujoco>"}


def robot(rng: random.Random) -> dict[str, str]:
    """A URDF with links in circles, chains, twice, or with odd values."""
    count = rng.choice((2, 40, 800))
    odd = rng.choice(ODD).replace("<", "").replace('"', "")
    links = "".join(
        f'<link name="l{k}"><inertial><mass value="{odd if k == 1 else 1}"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for k in range(count)
    )
    back = rng.random() < 0.3
    joints = "".join(
        f'<joint name="j{k}" type="{rng.choice(("continuous", "fixed", "revolute", "odd"))}">'
        f'<parent link="l{k}"/><child link="l{(k + 1) % count if back else k + 1}"/>'
        f'<axis xyz="{odd}"/></joint>'
        for k in range(count - (not back))
    )
    return {"model.urdf": f'<robot name="r">{links}{joints}</robot>'}


KINDS: tuple[Callable[[random.Random], dict[str, str]], ...] = (
    *(nested, counted, bomb, circle, numbers, by_schema, by_schema, robot),
)


def hostile_file(seed: int) -> None:
    """Loads and steps, or is refused in a sentence."""
    rng = random.Random(seed)
    files = KINDS[seed % len(KINDS)](rng)
    with tempfile.TemporaryDirectory() as folder:
        for name, content in files.items():
            (Path(folder) / name).write_text(content)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = sc.load(Path(folder) / next(iter(files)))
            sim = sc.Sim(scene)
    if sim.model.nv < 2000:
        run(sim, 3)
