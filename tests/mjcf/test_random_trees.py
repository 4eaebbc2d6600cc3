"""Random trees of bodies, frames, replicas, classes and compiler options are MuJoCo's models."""

import random

import compiled
import mujoco
import pytest

from stepcore import loads
from stepcore.mjcf.nodes import MJCFError

COMPILERS = (
    *('angle="radian"', 'eulerseq="zyx"', 'eulerseq="XYZ"', 'autolimits="true"'),
    *('fusestatic="true"', 'alignfree="true"', 'discardvisual="true"', 'boundmass=".01"'),
    *('inertiagrouprange="0 1"', 'settotalmass="3"', 'inertiafromgeom="auto"'),
)


class Maker:
    """Writes one random model."""

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        self.count = 0
        self.joints: list[str] = []

    def name(self, kind: str) -> str:
        self.count += 1
        # A suffix of replicas makes no other name of it.
        return f"{kind}{self.count}_"

    def numbers(self, count: int, low: float = -1.0, high: float = 1.0) -> str:
        return " ".join(f"{self.chance.uniform(low, high):.4g}" for _ in range(count))

    def pose(self) -> str:
        turns = {
            "quat": self.numbers(4),
            "euler": self.numbers(3, -90, 90),
            "axisangle": self.numbers(3) + " 1.2",
            "zaxis": self.numbers(3),
            "xyaxes": "1 .2 0 " + self.numbers(3, 0.2, 1),
        }
        kind = self.chance.choice(["", *turns])
        pos = f' pos="{self.numbers(3)}"' if self.chance.random() < 0.8 else ""
        return pos + (f' {kind}="{turns[kind]}"' if kind else "")

    def some(self, text: str, share: float = 0.3) -> str:
        return text if self.chance.random() < share else ""

    def childclass(self) -> str:
        return self.some(f' childclass="{self.chance.choice("abc")}"')

    def geom(self) -> str:
        shape = self.chance.choice(
            [
                f'size=".1"{self.pose()}',
                f'type="box" size=".1 .2 .3"{self.pose()}',
                f'type="capsule" size=".05" fromto="{self.numbers(6)}"',
                f'type="cylinder" size=".05 .1"{self.pose()}',
                self.pose(),
            ]
        )
        extra = self.some(' contype="0" conaffinity="0"', 0.2) + self.some(' group="3"', 0.2)
        extra += self.some(' class="b"', 0.1) + self.some(' mass=".7"', 0.2)
        return f'<geom name="{self.name("g")}" {shape}{extra}/>'

    def joint(self) -> str:
        self.joints.append(self.name("j"))
        kind = self.chance.choice(["hinge", "slide", "hinge"])
        values = self.some(' range="-.5 .6"') + self.some(' stiffness="2"') + self.some(' ref=".1"')
        axis = f'axis="{self.numbers(3, 0.1, 1)}"'
        return f'<joint name="{self.joints[-1]}" type="{kind}" {axis}{values}/>'

    def inside(self, depth: int, world: bool, replicas: bool = True) -> str:
        text = "".join(self.geom() for _ in range(self.chance.randint(0 if world else 1, 2)))
        text += self.some(f'<site name="{self.name("s")}"{self.pose()}/>')
        for _ in range(self.chance.randint(1, 3) if depth else 0):
            kind = self.chance.choice(["body", "body", "frame", "replicate"])
            if kind == "body":
                text += self.body(depth - 1)
            elif kind == "frame":
                held = self.inside(depth - 1, world)
                text += f"<frame{self.pose()}{self.childclass()}>{held}</frame>"
            elif replicas:
                before = len(self.joints)
                inner = self.inside(min(depth - 1, 1), world)
                # Replicas rename what they hold.
                del self.joints[before:]
                where = f'offset="{self.numbers(3)}" euler="{self.numbers(3, -40, 40)}"'
                text += (
                    f'<replicate count="{self.chance.randint(1, 3)}" {where}>{inner}</replicate>'
                )
        return text

    def body(self, depth: int) -> str:
        joints = "".join(self.joint() for _ in range(self.chance.choice([0, 1, 1, 2])))
        inertial = self.some(
            f'<inertial mass="2" diaginertia=".1 .2 .25" pos="{self.numbers(3)}"/>', 0.2
        )
        return (
            f'<body name="{self.name("b")}"{self.pose()}{self.childclass()}>{joints}{inertial}'
            f"{self.inside(depth, False)}</body>"
        )

    def model(self) -> str:
        options = " ".join(
            {one.partition("=")[0]: one for one in self.chance.sample(COMPILERS, 3)}.values()
        )
        free = f"<body><freejoint/>{self.geom()}{self.geom()}</body>"
        tree = self.inside(3, True) + self.body(2) + free
        motors = "".join(f'<motor joint="{name}" gear="2"/>' for name in self.joints[:3])
        return f"""<mujoco><compiler {options}/>
<default><geom size=".2 .1 .1" density="500"/><default class="a"><geom type="box"/>
<joint damping="1"/><default class="b"><geom density="300" size=".3"/></default></default>
<default class="c"><geom type="ellipsoid" group="2"/><joint stiffness="1"/></default></default>
<worldbody>{tree}</worldbody><actuator>{motors}</actuator></mujoco>"""


def both(seed: int) -> None:
    text = Maker(seed).model()
    try:
        theirs = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        if "mjMINVAL" in str(error):
            # A body without mass is allowed here where its children have some.
            return
        # What MuJoCo refuses is refused here too.
        with pytest.raises(ValueError):
            loads(text).compile()
        assert "rror" in str(error)
        return
    try:
        scene = loads(text)
    except MJCFError as error:
        # Fused bodies of replicas may come in another order when MuJoCo writes them.
        fused = 'fusestatic="true"' in text and "<replicate" in text
        unwritten = fused and "written without a change of its names" in str(error)
        assert unwritten or "not built yet" in str(error), text
        return
    compiled.compare(scene, theirs)
    compiled.compare(loads(scene.to_mjcf()), theirs)


@pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")
@pytest.mark.parametrize("seed", range(60))
def test_a_random_tree_is_mujocos(seed: int) -> None:
    both(seed)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::stepcore.StiffnessWarning")
@pytest.mark.parametrize("part", range(20))
def test_many_random_trees_are_mujocos(part: int) -> None:
    for seed in range(1000 + 100 * part, 1100 + 100 * part):
        both(seed)
