"""Random models of what `random_model.Maker` leaves out, to be run for some steps.

Controllers and motors with all that they remember, late controls, activations by muscles, geoms
that adhere and move like belts, compensated weight that drives give, pairs and exclusions, meshes
that weigh, replicated bodies, attached ones, keyframes, and sensors of contacts and volumes.
"""

from __future__ import annotations

from random import Random
from xml.etree import ElementTree

from random_model import ROUND, Maker

KIT = """<mujoco><worldbody><body name="kit" pos="0 0 .1">
  <joint name="kj" axis="0 1 .2" damping=".1"/>
  <geom name="kg" size=".07" pos=".1 0 0" {0}/><site name="ks" pos=".05 0 0"/></body></worldbody>
  <actuator><position name="ka" joint="kj" kp="3"/></actuator>
  <keyframe><key name="kk" qpos=".3" ctrl=".2"/></keyframe></mujoco>"""


def moving_balls(root: ElementTree.Element) -> list[str]:
    """The names of spheres that something moves: contacts of others have no rows in MuJoCo."""
    moves = ("joint", "freejoint")
    bodies = [b for b in root.iter("body") if any(b.find(tag) is not None for tag in moves)]
    inside = [geom for body in bodies for geom in body.iter("geom") if geom.get("type") == "sphere"]
    return [geom.get("name", "") for geom in inside if geom.get("contype") == "1"]


class DrivesMaker(Maker):
    """Draws such a model; `files()` are those that it attaches."""

    def __init__(self, chance: Random) -> None:
        super().__init__(chance)
        self.attached = chance.random() < 0.15

    def files(self) -> dict[str, str]:
        return {"kit.xml": KIT.format(ROUND)}

    def geom(self) -> str:
        text = super().geom()
        if self.chance.random() < 0.15:
            points = self.numbers(30, -0.15, 0.15)
            self.meshes.append(f'<mesh name="{self.name("mesh")}" vertex="{points}"/>')
            name = self.name("g")
            self.geoms.append(name)
            mesh = f'type="mesh" mesh="mesh{self.count - 1}"'
            text += f'<geom name="{name}" {mesh} contype="0" conaffinity="0" {self.pose(0.1)}/>'
        rest = self.some(f' adhesion="{self.numbers(1, 0.5, 9)}"', 0.1)
        rest += self.some(f' surfacevel="{self.numbers(6)}"', 0.1)
        return text.replace("/>", rest + "/>", 1)

    @property
    def meshes(self) -> list[str]:
        return self.__dict__.setdefault("_meshes", [])

    def joint(self, kind: str) -> str:
        text = super().joint(kind)
        driven = self.some(' actuatorgravcomp="true"', 0.2) if kind != "free" else ""
        return text.replace("/>", driven + "/>")

    def late(self) -> str:
        dt = self.numbers(1, 0.001, 0.03)
        kind = self.pick("zoh", "linear", "cubic")
        return self.some(
            f' nsample="{self.chance.randint(2, 9)}" delay="{dt}" interp="{kind}"', 0.3
        )

    def actuator(self) -> str:
        if self.chance.random() < 0.3:
            return super().actuator().replace("/>", self.late() + "/>", 1)
        if self.joints["ball"] and self.chance.random() < 0.15:
            ball = self.chance.choice(self.joints["ball"])
            chart = self.some(' input="quat"')
            # No bound of its torque: whether MuJoCo's then damps is for its rounding to say.
            return f'<orientation joint="{ball}" kp="{self.numbers(1, 1, 9)}" kv=".4"{chart}/>'
        on, along = self.transmission()
        if not along:
            return self.actuator()
        self.actuators.append(self.name("a"))
        self.drivers.append(self.actuators[-1])
        rest = f' name="{self.actuators[-1]}" {on}{self.late()}'
        rest += self.some(f" ctrlrange={self.low_high(1)}", 0.2)
        rest += self.some(' damping=".1"', 0.2) + self.some(' armature=".05"', 0.2)
        return self.pick(self.pid(rest), self.motor(rest), self.muscle(rest))

    def pid(self, rest: str) -> str:
        first = self.pick("pos", "pos", "vel", "pos vel", "pos vel ff", "vel ff", "pos ff")
        text = f'<pid{rest} input="{first}" kp="{self.numbers(1, 0.5, 9)}"'
        text += self.pick(f' kv="{self.numbers(1, 0.1, 1)}"', ' dampratio=".6"')
        if "pos" in first:
            integral = f' ki="{self.numbers(1, 0.5, 3)}"'
            text += self.some(integral + self.some(' imax=".02"'))
            text += self.some(f' slewmax="{self.numbers(1, 0.5, 3)}"')
        text += self.some(f" forcerange={self.low_high(3)}")
        return text + "/>"

    def motor(self, rest: str) -> str:
        first = self.pick("voltage", "pos", "vel", "ff", "pos vel", "vel ff voltage")
        integral = self.numbers(1, 0, 2) if "pos" in first else "0"
        gains = f"{self.numbers(1, 0.5, 5)} {integral} {self.numbers(1, 0.05, 0.3)}"
        text = f'<dcmotor{rest} nominal="12 3 20" input="{first}"'
        if first != "voltage":
            text += f' controller="{gains}"'
        text += self.some(f' inductance="{self.numbers(1, 0.005, 0.03)}"')
        text += self.some(f' saturation="{self.numbers(1, 0.1, 2)}"', 0.2)
        text += self.some(' lugre="10 .1 .2 .3 .1"', 0.2) + self.some(' cogging=".1 7 .3"', 0.2)
        text += self.some(' thermal="2 30 0 .004 20 25"', 0.2)
        return text + "/>"

    def muscle(self, rest: str) -> str:
        times = self.some(f' timeconst="{self.numbers(2, 0.01, 0.06)}"')
        smooth = self.some(f' tausmooth="{self.numbers(1, 0.1, 0.5)}"')
        return f'<muscle{rest} lengthrange="-1.5 1.6" force="9"{times}{smooth}/>'

    def sensor(self) -> str:
        if self.chance.random() < 0.5:
            return super().sensor()
        name = f'name="{self.name("sensor")}"'
        round_ones = [one for one in self.geoms if one != "floor"]
        if not round_ones:
            return super().sensor()
        one, body = self.chance.choice(round_ones), self.chance.choice(self.bodies)
        site = self.chance.choice(self.sites)
        return self.pick(
            f'<insidesite {name} objtype="geom" objname="{one}" site="{site}"/>',
            f'<contact {name} geom1="{one}" data="found dist normal" num="2" reduce="mindist"/>',
            f'<contact {name} body1="{body}" data="found force" num="1" reduce="netforce"/>',
            f'<contact {name} subtree1="{body}" data="found" num="3"/>',
        )

    def pairs(self) -> str:
        round_ones = [one for one in self.geoms if one != "floor"]
        text = ""
        if len(self.bodies) > 1 and self.chance.random() < 0.3:
            one, two = self.chance.sample(self.bodies, 2)
            text += f'<exclude body1="{one}" body2="{two}"/>'
        if round_ones and self.chance.random() < 0.3:
            more = self.some(' condim="4"') + self.some(f' friction="{self.numbers(5, 0.1, 1)}"')
            more += self.some(' adhesion="3"', 0.2) + self.some(' margin=".02"') + self.soft()
            text += f'<pair geom1="floor" geom2="{self.balls[0]}"{more}/>' if self.balls else ""
        return text

    def world(self) -> str:
        """A row of bodies, and one of another file."""
        text = ""
        if self.chance.random() < 0.3:
            name = self.name("row")
            apart = f'count="3" sep="-" offset="{self.numbers(2, 0.3, 0.5)} 0"'
            apart += f' euler="0 0 {self.numbers(1, 5, 40)}"'
            text += (
                f'<replicate {apart}><body name="{name}" pos="1 0 .2"><joint axis="0 1 0"/>'
                f'<geom type="sphere" size=".09" pos=".05 0 0" {ROUND}/></body></replicate>'
            )
        if self.attached:
            text += f'<frame {self.pose()}><attach model="kit" body="kit" prefix="k-"/></frame>'
        return text

    def model(self) -> str:
        text = super().model()
        self.balls = moving_balls(ElementTree.fromstring(text))
        assets = "".join(self.meshes)
        if self.attached:
            assets += '<model name="kit" file="kit.xml"/>'
        text = text.replace("</worldbody>", f"{self.world()}</worldbody>", 1)
        more = f"<asset>{assets}</asset><contact>{self.pairs()}</contact>"
        more += self.some('<keyframe><key name="now" time=".5"/></keyframe>', 0.3)
        return text.replace("</mujoco>", more + "</mujoco>")
