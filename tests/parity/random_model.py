"""Writes random MJCF models: a tree, and tendons, equalities, actuators and sensors on it."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

SCALAR = ("hinge", "slide")
# Pairs whose contacts both engines have in closed form: boxes meet no boxes and no capsules.
BALL, ROUND = 'contype="1" conaffinity="3"', 'contype="1" conaffinity="1"'
BOX, PASSING = 'contype="2" conaffinity="0"', 'contype="0" conaffinity="0"'


class Maker:
    """Draws one model from `chance`; `model()` is its text."""

    def __init__(self, chance: Random) -> None:
        self.chance = chance
        self.count = 0
        # Names that were given, by kind.
        self.bodies: list[str] = []
        self.moving: list[str] = []
        self.joints: dict[str, list[str]] = {kind: [] for kind in (*SCALAR, "ball", "free")}
        self.sites: list[str] = []
        self.geoms: list[str] = []
        self.wraps: list[tuple[str, str]] = []
        self.tendons: list[str] = []
        self.spatial = False
        self.actuators: list[str] = []
        self.drivers: list[str] = []
        self.limited: set[str] = set()

    # Values

    def name(self, kind: str) -> str:
        self.count += 1
        return f"{kind}{self.count}"

    def numbers(self, count: int, low: float = -1.0, high: float = 1.0) -> str:
        return " ".join(f"{self.chance.uniform(low, high):.4f}" for _ in range(count))

    def some(self, text: str, share: float = 0.3) -> str:
        return text if self.chance.random() < share else ""

    def maybe(self, write: Callable[[], str], share: float) -> str:
        """What `write` gives, or nothing: names are given only to what is written."""
        return write() if self.chance.random() < share else ""

    def pick(self, *kinds: str) -> str:
        return self.chance.choice(kinds)

    def turn(self) -> str:
        return self.pick(
            "",
            f'quat="{self.numbers(1, 0.2, 1)} {self.numbers(3)}"',
            f'euler="{self.numbers(3, -90, 90)}"',
            f'axisangle="{self.numbers(3, 0.1, 1)} {self.numbers(1, 10, 120)}"',
            f'zaxis="{self.numbers(3, 0.1, 1)}"',
        )

    def pose(self, size: float = 0.3) -> str:
        return f'pos="{self.numbers(3, -size, size)}" {self.turn()}'

    def soft(self, kind: str = "") -> str:
        times = f"{self.numbers(1, 0.02, 0.1)} {self.numbers(1, 0.5, 2)}"
        direct = f"-{self.numbers(1, 50, 500)} -{self.numbers(1, 1, 9)}"
        text = self.some(f' solref{kind}="{self.pick(times, times, direct)}"')
        power = self.pick("1", "2", "3")
        return text + self.some(f' solimp{kind}=".7 .95 {self.numbers(1, 0.001, 0.1)} .4 {power}"')

    def low_high(self, size: float) -> str:
        return f'"{self.numbers(1, -size, 0)} {self.numbers(1, 0.01, size)}"'

    def polynomial(self, high: float) -> str:
        return self.pick(
            self.numbers(1, 0.1, high),
            f"{self.numbers(1, 0.1, high)} {self.numbers(2, 0, high / 3)}",
        )

    # The tree

    def geom(self) -> str:
        name = self.name("g")
        self.geoms.append(name)
        shape = self.pick(
            f'type="sphere" size="{self.numbers(1, 0.05, 0.15)}" {BALL} {self.pose(0.1)}',
            f'type="capsule" size="{self.numbers(2, 0.04, 0.2)}" {ROUND} {self.pose(0.1)}',
            f'type="capsule" size=".05" fromto="0 0 0 {self.numbers(3, 0.1, 0.3)}" {ROUND}',
            f'type="box" size="{self.numbers(3, 0.05, 0.2)}" {BOX} {self.pose(0.1)}',
            f'type="ellipsoid" size="{self.numbers(3, 0.05, 0.2)}" {PASSING} {self.pose(0.1)}',
            f'type="cylinder" size="{self.numbers(2, 0.05, 0.2)}" {PASSING} {self.pose(0.1)}',
        )
        rest = self.some(f' mass="{self.numbers(1, 0.2, 2)}"') + self.some(' class="a"', 0.1)
        rest += self.some(f' condim="{self.pick("1", "3", "4", "6")}"')
        rest += self.some(f' friction="{self.numbers(1, 0.2, 1.5)} .01 .002"')
        rest += self.some(' margin=".02"', 0.2) + self.some(' gap=".01"', 0.1)
        rest += self.some(' priority="1"', 0.1) + self.some(' solmix="2"', 0.1)
        rest += self.some(' fluidshape="ellipsoid"', 0.2) + self.soft()
        return f'<geom name="{name}" {shape}{rest}/>'

    def site(self) -> str:
        self.sites.append(self.name("s"))
        return f'<site name="{self.sites[-1]}" {self.pose()} size=".1"/>'

    def drum(self) -> str:
        """A geom for tendons to go round, and a site outside of it that says on which side."""
        geom, side = self.name("drum"), self.name("side")
        self.wraps.append((geom, side))
        shape = self.pick('type="sphere" size=".1"', 'type="cylinder" size=".08 .2"')
        at = self.pose(0.1)
        return (
            f'<frame {at}><geom name="{geom}" {shape} {PASSING}/>'
            f'<site name="{side}" pos=".3 {self.numbers(2, -0.2, 0.2)}"/></frame>'
        )

    def joint(self, kind: str) -> str:
        name = self.name("j")
        self.joints[kind].append(name)
        text = f'<joint name="{name}" type="{kind}" pos="{self.numbers(3, -0.1, 0.1)}"'
        if kind in SCALAR:
            size = 0.6 if kind == "hinge" else 0.2
            reach = (
                f'"{self.numbers(1, -40, -5)} {self.numbers(1, 5, 60)}"'
                if kind == "hinge"
                else self.low_high(size)
            )
            text += f' axis="{self.numbers(3, 0.1, 1)}"' + self.some(
                f' ref="{self.numbers(1, -0.3, 0.3)}"'
            )
            if self.chance.random() < 0.3:
                text += f" range={reach}"
                self.limited.add(name)
            text += self.some(f' springref="{self.numbers(1, -0.3, 0.3)}"')
            text += self.some(f" actuatorfrcrange={self.low_high(5)}", 0.2)
            text += self.some(' springdamper=".3 .8"', 0.1)
        elif self.chance.random() < 0.3:
            text += ' range="0 40"'
            self.limited.add(name)
        text += self.some(f' stiffness="{self.polynomial(8)}"')
        text += self.some(f' damping="{self.polynomial(2)}"') + self.some(' frictionloss=".3"', 0.2)
        text += self.some(f' armature="{self.numbers(1, 0.01, 0.3)}"') + self.some(
            ' margin=".03"', 0.1
        )
        return text + self.soft("limit") + self.soft("friction") + "/>"

    def body(self, depth: int, top: bool = False) -> str:
        name = self.name("b")
        self.bodies.append(name)
        kind = self.pick(
            "scalar", "scalar", "scalar", "ball", "mixed", "fixed", *["free"] * (2 * top)
        )
        joints = ""
        if kind in ("scalar", "mixed"):
            joints = "".join(
                self.joint(self.pick(*SCALAR)) for _ in range(self.chance.randint(1, 2))
            )
        if kind in ("ball", "mixed"):
            joints += self.joint("ball")
        if kind == "free":
            self.joints["free"].append(self.name("j"))
            joints = f'<freejoint name="{self.joints["free"][-1]}"/>'
        if kind != "fixed":
            self.moving.append(name)
        inertial = self.some(
            f'<inertial mass="{self.numbers(1, 0.3, 2)}" {self.pose(0.1)} '
            'diaginertia=".02 .03 .04"/>',
            0.15,
        )
        inertial = inertial or self.some(
            f'<inertial mass="{self.numbers(1, 0.3, 2)}" pos="{self.numbers(3, -0.1, 0.1)}" '
            'fullinertia=".02 .03 .04 .001 -.002 .003"/>',
            0.1,
        )
        inside = "".join(self.geom() for _ in range(self.chance.randint(1, 2))) + self.site()
        inside += self.maybe(self.site, 0.3) + self.maybe(self.drum, 0.2)
        for _ in range(self.chance.randint(0, 2) if depth else 0):
            held = self.body(depth - 1)
            inside += self.pick(held, f"<frame {self.pose(0.1)}>{held}</frame>")
        look = self.some(f' gravcomp="{self.numbers(1, 0, 1.3)}"', 0.2) + self.some(
            ' childclass="a"', 0.1
        )
        high = f'pos="{self.numbers(2, -0.6, 0.6)} {self.numbers(1, 0.1, 0.6)}"'
        where = f"{high} {self.turn()}" if top else self.pose()
        return f'<body name="{name}" {where}{look}>{joints}{inertial}{inside}</body>'

    def mocap(self) -> str:
        self.bodies.append(self.name("hand"))
        held = self.geom() + self.site()
        return f'<body name="{self.bodies[-1]}" mocap="true" {self.pose(0.5)}>{held}</body>'

    # What holds, pulls, drives and senses

    def scalars(self) -> list[str]:
        return self.joints["hinge"] + self.joints["slide"]

    def tendon(self) -> str:
        name = self.name("t")
        chance, joints = self.chance, self.scalars()
        text = f' name="{name}"' + self.some(f' stiffness="{self.polynomial(20)}"')
        text += self.some(f' damping="{self.polynomial(2)}"') + self.some(' frictionloss=".4"', 0.2)
        text += self.some(' springlength=".1 .3"', 0.2) + self.some(' margin=".02"', 0.1)
        text += self.some(f" actuatorfrcrange={self.low_high(5)}", 0.15)
        text += self.soft("limit") + self.soft("friction")
        limited = self.chance.random() < 0.3
        if joints and chance.random() < 0.5:
            some = chance.sample(joints, min(len(joints), chance.randint(1, 3)))
            path = "".join(f'<joint joint="{one}" coef="{self.numbers(1)}"/>' for one in some)
            text += " range=" + self.low_high(0.3) if limited else ""
            kind = "fixed"
        else:
            path = self.path()
            text += (
                f' range="{self.numbers(1, 0.1, 0.4)} {self.numbers(1, 0.5, 1)}"' if limited else ""
            )
            kind, self.spatial = "spatial", True
        self.tendons.append(name)
        if limited:
            self.limited.add(name)
        if "geom" not in path:
            text += self.some(f' armature="{self.numbers(1, 0.05, 0.3)}"', 0.2)
        return f"<{kind}{text}>{path}</{kind}>"

    def path(self) -> str:
        chance = self.chance
        points = chance.sample(self.sites, min(len(self.sites), chance.randint(2, 4)))
        path = f'<site site="{points[0]}"/>'
        for point in points[1:]:
            if self.wraps and chance.random() < 0.5:
                geom, side = chance.choice(self.wraps)
                of_side = self.some(f' sidesite="{side}"', 0.5)
                path += f'<geom geom="{geom}"{of_side}/>'
            path += f'<site site="{point}"/>'
        if len(points) == 4 and chance.random() < 0.3:
            one, two, three, four = (f'<site site="{point}"/>' for point in points)
            return f'{one}{two}<pulley divisor="2"/>{three}{four}'
        return path

    def equality(self) -> str:
        chance = self.chance
        rest = self.soft() + self.some(' active="false"', 0.2)
        kinds = ["connect", "weld", "sites"]
        kinds += ["joint"] * (len(self.scalars()) > 1) + ["tendon"] * (len(self.tendons) > 1)
        kind = chance.choice(kinds)
        torque = self.some(f' torquescale="{self.numbers(1, 0.2, 2)}"')
        if kind == "sites":
            one, two = chance.sample(self.sites, 2)
            tag = self.pick("connect", "weld")
            return f'<{tag} site1="{one}" site2="{two}"{rest}{torque if tag == "weld" else ""}/>'
        if kind in ("joint", "tendon"):
            one, two = chance.sample(self.scalars() if kind == "joint" else self.tendons, 2)
            other = self.some(f' {kind}2="{two}"', 0.7)
            return f'<{kind} {kind}1="{one}"{other} polycoef="{self.numbers(5, -0.4, 0.4)}"{rest}/>'
        one = chance.choice(self.moving)
        two = [f' body2="{other}"' for other in self.bodies if other != one]
        rest += chance.choice([*two, ""])
        anchor = f' anchor="{self.numbers(3, -0.2, 0.2)}"'
        if kind == "connect":
            return f'<connect body1="{one}"{anchor}{rest}/>'
        relpose = self.some(f' relpose="{self.numbers(3, -0.2, 0.2)} 1 {self.numbers(3)}"')
        return f'<weld body1="{one}"{self.some(anchor)}{relpose}{torque}{rest}/>'

    def transmission(self) -> tuple[str, bool]:
        """Attributes, and whether the length is one number of a joint or a tendon."""
        chance, joints = self.chance, self.scalars()
        kinds = ["site", "refsite", "crank"]
        kinds += ["joint"] * 6 * bool(joints) + ["tendon"] * 3 * bool(self.tendons)
        kinds += ["turn"] * bool(self.joints["ball"] + self.joints["free"])
        kind = chance.choice(kinds)
        one, two = chance.sample(self.sites, 2)
        gear = f'gear="{self.numbers(6)}"'
        if kind == "joint":
            return f'joint="{chance.choice(joints)}" gear="{self.numbers(1)}"', True
        if kind == "tendon":
            return f'tendon="{chance.choice(self.tendons)}" gear="{self.numbers(1)}"', True
        if kind == "turn":
            which = self.pick("joint", "jointinparent")
            return (
                f'{which}="{chance.choice(self.joints["ball"] + self.joints["free"])}" {gear}',
                False,
            )
        if kind == "crank":
            crank = f'cranksite="{one}" slidersite="{two}" cranklength="{self.numbers(1, 0.3, 1)}"'
            return f'{crank} gear="{self.numbers(1)}"', False
        return f'site="{one}" {gear}' + (f' refsite="{two}"' if kind == "refsite" else ""), False

    def actuator(self) -> str:
        self.actuators.append(self.name("a"))
        on, along = self.transmission()
        rest = f' name="{self.actuators[-1]}" {on}' + self.some(f" ctrlrange={self.low_high(1)}")
        rest += self.some(f" forcerange={self.low_high(4)}", 0.2)
        rest += self.some(' damping=".1"', 0.1) * along + self.some(' armature=".05"', 0.1) * along
        early = self.some(' actearly="true"') + self.some(f" actrange={self.low_high(0.8)}")
        laws = [
            "<motor{0}/>",
            f'<position{{0}} kp="{self.numbers(1, 1, 20)}" {self.pick("", self.damped(along))}/>',
            '<position{0} kp="8" kv=".5" timeconst=".03"/>',
            f'<velocity{{0}} kv="{self.numbers(1, 0.1, 3)}"/>',
            f'<intvelocity{{0}} kp="6" kv=".3" actrange={self.low_high(1)}/>',
            '<cylinder{0} timeconst=".05" area="2" bias=".2 -3 -.4"/>',
        ]
        if along:
            laws.append('<muscle{0} lengthrange="-1.5 1.5" force="12"/>')
            laws.append(
                '<muscle{0} lengthrange="-1 2" tausmooth=".3" timeconst=".02 .06" scale="20"/>'
            )
        for kind in ("none", "integrator", "filter", "filterexact"):
            dynamics = (
                ""
                if kind == "none"
                else f' dyntype="{kind}" dynprm="{self.numbers(1, 0.01, 0.1)}"{early}'
            )
            laws.append(
                f'<general{{0}}{dynamics} gaintype="affine" gainprm="{self.numbers(3)}" '
                f'biastype="affine" biasprm="{self.numbers(1)} {self.numbers(2, -2, 0)}"/>'
            )
        text = self.chance.choice(laws).format(rest)
        name = self.actuators[-1]
        if self.chance.random() < 0.05:
            body = self.chance.choice(self.moving)
            return f'<adhesion name="{name}" body="{body}" ctrlrange="0 1" gain="5"/>'
        self.drivers.append(name)
        if self.chance.random() < 0.05:
            return f'<damper name="{name}" {on} kv="2" ctrlrange="0 1"/>'
        return text

    def damped(self, along: bool) -> str:
        return self.pick('kv=".7"', *(['dampratio=".8"'] if along else []))

    def sensor(self) -> str:
        chance = self.chance
        lists: dict[str, tuple[tuple[str, ...], list[str]]] = {
            "joint": (("jointpos", "jointvel", "jointactuatorfrc"), self.scalars()),
            "actuator": (("actuatorpos", "actuatorfrc"), self.actuators),
            "driver": (("actuatorvel",), self.drivers),
            "tendon": (("tendonpos", "tendonvel"), self.tendons),
            "site": (
                ("touch", "accelerometer", "velocimeter", "gyro", "magnetometer", "rangefinder")
                + (() if self.spatial else ("force", "torque")),
                self.sites,
            ),
            "body": (("subtreecom", "subtreelinvel", "subtreeangmom"), self.bodies),
            "limit": (
                ("jointlimitpos", "jointlimitvel", "jointlimitfrc"),
                [one for one in self.scalars() if one in self.limited],
            ),
            "tendonlimit": (
                ("tendonlimitpos", "tendonlimitvel", "tendonlimitfrc"),
                [one for one in self.tendons if one in self.limited],
            ),
            "ball": (("ballquat", "ballangvel"), self.joints["ball"]),
            "frame": (("framepos", "framequat", "framexaxis", "framelinvel", "frameangvel"), ["-"]),
            "acceleration": (("framelinacc", "frameangacc"), ["-"]),
            "world": (("clock", "e_potential", "e_kinetic"), ["-"]),
        }
        kind = chance.choice([kind for kind, (_, names) in lists.items() if names])
        word, of = chance.choice(lists[kind][0]), chance.choice(lists[kind][1])
        rest = f' name="{self.name("sensor")}"' + self.some(
            f' cutoff="{self.numbers(1, 0.1, 3)}"', 0.15
        )
        if "quat" in word or "axis" in word:
            rest = f' name="{self.name("sensor")}"'
        if kind == "world":
            return f"<{word}{rest}/>"
        if kind in ("frame", "acceleration"):
            rest += f" {self.thing('obj')}"
            return f"<{word}{rest} {self.some(self.thing('ref')) if kind == 'frame' else ''}/>"
        attribute = {
            "limit": "joint",
            "tendonlimit": "tendon",
            "ball": "joint",
            "driver": "actuator",
        }.get(kind, kind)
        return f'<{word}{rest} {attribute}="{of}"/>'

    def thing(self, prefix: str) -> str:
        kind = self.pick("body", "xbody", "geom", "site")
        names = {"geom": self.geoms, "site": self.sites}.get(kind, self.bodies)
        return f'{prefix}type="{kind}" {prefix}name="{self.chance.choice(names)}"'

    def option(self) -> str:
        text = f'timestep="{self.pick(".001", ".002", ".005")}"'
        text += f' cone="{self.pick("pyramidal", "elliptic")}"'
        text += f' integrator="{self.pick("Euler", "RK4", "implicit", "implicitfast")}"'
        text += self.some(f' density="{self.numbers(1, 1, 500)}"') + self.some(' viscosity=".2"')
        text += self.some(f' wind="{self.numbers(3)}"') + self.some(' impratio="3"', 0.2)
        text += self.some(f' gravity="{self.numbers(3, -10, 10)}"', 0.2)
        text += self.some(f' magnetic="{self.numbers(3)}"')
        flags = (
            "contact",
            "limit",
            "equality",
            "frictionloss",
            "gravity",
            "clampctrl",
        )
        flags += ("spring", "damper", "eulerdamp", "refsafe", "filterparent")
        flag = self.some(f'<flag {self.chance.choice(flags)}="disable"/>', 0.2)
        return f"<option {text}>{flag}</option>"

    def several(self, write, most: int) -> str:
        return "".join(write() for _ in range(self.chance.randint(0, most)))

    def model(self) -> str:
        option = self.option()
        world = '<geom name="floor" type="plane" size="3 3 .1" conaffinity="3"/>' + self.site()
        self.geoms.append("floor")
        while not self.moving:
            world += self.body(self.chance.randint(0, 2), top=True)
        world += self.maybe(lambda: self.body(1, top=True), 0.3) + self.maybe(self.mocap, 0.2)
        sections = {
            "tendon": self.several(self.tendon, 3),
            "equality": self.several(self.equality, 2),
            "actuator": self.several(self.actuator, 3),
            "sensor": self.several(self.sensor, 5),
        }
        rest = "\n".join(f"<{tag}>{text}</{tag}>" for tag, text in sections.items())
        text = f"""<mujoco>{option}
<default><geom density="400"/><default class="a"><joint damping=".5" armature=".02"/>
<geom density="700" friction=".8"/></default></default>
<worldbody>{world}</worldbody>\n{rest}</mujoco>"""
        return text.replace("><", ">\n<")
