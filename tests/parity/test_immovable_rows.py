"""Rows of a block that nothing can move (A = 0), in 1,000 random scenes, against MuJoCo's Newton.

Law: the same acceleration, and where one is not possible MuJoCo's own digits say so. A wheel
with a fixed axle presses on the floor and cannot leave it: its normal has no inverse mass, but
carries the load that its friction needs.
"""

import mujoco
import numpy as np
import peers
import pytest

import stepcore as sc

WHEEL = """<mujoco><option cone="elliptic"/><worldbody>
<geom type="plane" size="1 1 1"/>
<body pos="0 0 .099"><joint axis="0 1 0" name="axle"/><geom size=".1" mass="1"/></body>
</worldbody><actuator><motor joint="axle" gear="3"/></actuator></mujoco>"""


class Draw:
    """Random numbers of one scene, and its bodies' text."""

    def __init__(self, seed, condims=(1, 3, 3, 3)):
        self.rng, self.condims = np.random.default_rng([77, seed]), condims
        self.bodies, self.rest, self.count = [], [], 0

    def of(self, low, high):
        return self.rng.uniform(low, high)

    def pick(self, *choices):
        return choices[self.rng.integers(len(choices))]

    def soft(self):
        """How a contact is softened, and its friction."""
        direct = f"{-self.of(100, 5000)} {-self.of(5, 100)}"
        solref = self.pick("0.02 1", f"{self.of(0.004, 0.05)} {self.of(0.3, 2)}", direct)
        d = sorted(self.rng.uniform(0.5, 0.99, 2))
        solimp = self.pick("0.9 0.95 0.001", f"{d[0]} {d[1]} {self.of(0.0005, 0.01)}")
        friction, condim = self.pick(0.05, 0.4, 1.0, 2.0), self.pick(*self.condims)
        mu = f"{friction} {0.1 * friction} {0.02 * friction}"
        return f'solref="{solref}" solimp="{solimp}" friction="{mu}" condim="{condim}"'

    def motor(self):
        """A joint with a motor, and the text of its other attributes."""
        name = f"j{self.count}"
        self.count += 1
        gear = self.pick(0.0, self.of(-3, 3), self.of(-50, 50))
        self.rest.append(f'<motor joint="{name}" gear="{gear}"/>')
        extra = self.pick("", f'damping="{self.of(0, 2)}"', f'frictionloss="{self.of(0, 1)}"')
        return f'name="{name}" {extra} armature="{self.pick(0, 0.01)}"'

    def round(self, size):
        """A sphere, or a capsule along y."""
        shape = self.pick("", f'type="capsule" euler="90 0 0" size="{size} {self.of(0.02, 0.2)}"')
        return shape or f'size="{size}"'

    def wheel(self, x, gap):
        """An axle fixed along y, or off the centre of mass."""
        size, off = self.of(0.05, 0.2), self.pick(0, 0, 0, self.of(-0.02, 0.02))
        self.bodies.append(
            f'<body pos="{x} 0 {size - gap}"><joint axis="0 1 0" pos="{off} 0 0" {self.motor()}/>'
            f'<geom {self.round(size)} mass="{self.of(0.1, 5)}" {self.soft()}/></body>'
        )

    def slide(self, x, gap):
        """Slides parallel to the floor, a hinge across it, or both."""
        size = self.of(0.05, 0.2)
        kinds = self.pick(("1 0 0",), ("0 1 0",), ("1 0 0", "0 1 0"), ("1 2 0",))
        joints = "".join(f'<joint type="slide" axis="{axis}" {self.motor()}/>' for axis in kinds)
        if self.pick(True, False):
            joints += f'<joint axis="0 0 1" {self.motor()}/>'
        self.bodies.append(
            f'<body pos="{x} 0 {size - gap}">{joints}'
            f'<geom {self.round(size)} mass="{self.of(0.1, 5)}" {self.soft()}/></body>'
        )

    def roller_pair(self, x, gap):
        """Two fixed axles whose wheels press on each other: a friction drive."""
        one, two, z = self.of(0.05, 0.2), self.of(0.05, 0.2), 1.0
        far = np.array(self.pick([1, 0, 0], [0, 0, 1])) * (one + two - gap)
        for size, at in ((one, np.array([x, 0, z])), (two, far + np.array([x, 0, z]))):
            self.bodies.append(
                f'<body pos="{at[0]} 0 {at[2]}"><joint axis="0 1 0" {self.motor()}/>'
                f'<geom {self.round(size)} mass="{self.of(0.1, 5)}" {self.soft()}/></body>'
            )

    def cart(self, x, gap):
        """A wheel on a slide along the floor: only the normal cannot be moved."""
        size = self.of(0.05, 0.2)
        self.bodies.append(
            f'<body pos="{x} 0 {size - gap}"><joint type="slide" axis="1 0 0" {self.motor()}/>'
            f'<geom size=".03" mass="{self.of(0.1, 3)}" contype="0" conaffinity="0"/><body>'
            f'<joint axis="0 1 0" {self.motor()}/>'
            f'<geom {self.round(size)} mass="{self.of(0.1, 5)}" {self.soft()}/></body></body>'
        )

    def connect(self, x, gap):
        """Two parts joined at a point that some directions of the joint cannot follow."""
        one, two = f"c{self.count}", f"d{self.count}"
        kind = self.pick("slide", "hinge")
        axis, other = ("1 0 0", "0 1 0") if kind == "slide" else ("0 1 0", "0 1 0")
        self.bodies.append(
            f'<body name="{one}" pos="{x} 0 2"><joint type="{kind}" axis="{axis}" {self.motor()}/>'
            f'<geom size=".05" mass="{self.of(0.1, 3)}" contype="0" conaffinity="0"/></body>'
            f'<body name="{two}" pos="{x + 0.3} 0 2"><joint axis="{other}" {self.motor()}/>'
            f'<geom size=".05" mass="{self.of(0.1, 3)}" contype="0" conaffinity="0"/></body>'
        )
        anchor = f"{self.pick(0, 0.15, 0.3)} 0 {self.pick(0, 0.1)}"
        self.rest.append(f'<connect body1="{one}" body2="{two}" anchor="{anchor}"/>')

    def texts(self):
        """The scene along the world's axes, where every zero is exact, and the same turned as a
        whole, gravity with it, where zeros are rounding. What has rows along the world's axes,
        pyramids and connects, is not turned."""
        for part in range(self.rng.integers(1, 4)):
            makers = (self.wheel, self.wheel, self.slide, self.roller_pair, self.cart, self.connect)
            self.pick(*makers)(2.0 * part, self.pick(1e-3, self.of(1e-5, 5e-3)))
        motors = "".join(line for line in self.rest if line.startswith("<motor"))
        connects = "".join(line for line in self.rest if line.startswith("<connect"))
        cone = self.pick("elliptic", "elliptic", "pyramidal")
        option = (
            f'cone="{cone}" impratio="{self.pick(1, 1, 10)}" timestep="{self.pick(0.002, 0.005)}"'
        )
        quat, down = np.array([1.0, 0, 0, 0]), np.zeros(3)
        texts = []
        for _ in range(2):
            mujoco.mju_rotVecQuat(down, np.array([0, 0, -9.81]), quat)
            texts.append(
                f'<mujoco><option {option} gravity="{" ".join(map(str, down))}"/><worldbody>'
                f'<body quat="{" ".join(map(str, quat))}"><geom type="plane" size="1 1 1"/>'
                f"{''.join(self.bodies)}</body></worldbody><actuator>{motors}</actuator>"
                f"<equality>{connects}</equality></mujoco>"
            )
            if cone == "elliptic" and not connects:
                quat = self.rng.normal(size=4)
                quat /= np.linalg.norm(quat)
        return texts


def difference(seed, condims=(1, 3, 3, 3), **settings):
    """The largest difference of qacc over a few states of a scene, beside the accelerations that
    its forces alone give and the speeds over a step; and how many rows had A = 0."""
    draw = Draw(seed, condims)
    text, turned = draw.texts()
    theirs = peers.strict(mujoco.MjModel.from_xml_string(text))
    data, sim = mujoco.MjData(theirs), sc.Sim(sc.loads(turned).compile(), **peers.EXACT | settings)
    found = []
    for index in range(4):
        speed = draw.pick(0.0, 0.0, 0.3, 3.0)
        state = peers.State(
            theirs.qpos0 + (index > 1) * draw.rng.normal(0, 0.01, theirs.nq),
            speed * draw.rng.normal(size=theirs.nv),
            draw.rng.uniform(-1, 1, theirs.nu),
            np.zeros(theirs.nv),
            np.zeros((theirs.nbody, 6)),
        )
        state.to_mujoco(theirs, data)
        mujoco.mj_forward(theirs, data)
        state.to_stepcore(sim)
        sim.forward()
        size = np.abs(data.qacc_smooth).max() + np.abs(state.qvel).max() / theirs.opt.timestep + 1
        # What MuJoCo's own impulses and accelerations miss each other by.
        mass = peers.mass_matrix(theirs, data)
        missed = data.qacc - data.qacc_smooth - np.linalg.solve(mass, data.qfrc_constraint)
        found.append((np.abs(sim.qacc - data.qacc).max() / size, np.abs(missed).max() / size))
    return found


# Where MuJoCo's own accelerations and impulses agree to this, ours are compared without allowance.
BALANCED = 1e-9
# A connect of two fixed axles may leave A singular to 1e-8: then the answer depends on R, which is
# MuJoCo's least number there and ours here.
LIMIT = 1e-7


def check(seeds, **settings):
    """Prints the worst difference; fails where one is over its limit."""
    worst, strict, count = (0.0, None), 0, 0
    for seed in seeds:
        for apart, missed in difference(seed, **settings):
            count += 1
            strict += missed < BALANCED
            if missed < BALANCED:
                worst = max(worst, (apart, seed), key=lambda pair: pair[0])
            # MuJoCo's pyramids of such contacts are differences of loads near 1e15 N.
            assert apart < LIMIT + 300 * missed, f"scene {seed}: {apart} (MuJoCo misses {missed})"
    print(f"{strict} of {count} states without allowance, the worst {worst[0]:.1e} apart")
    assert strict > 0.7 * count
    return worst[0]


def test_a_sample_of_scenes():
    assert check(range(40)) < LIMIT


def test_a_sample_with_torsion_and_rolling():
    """Most of which moves nothing here: axles are fixed, and slides do not turn."""
    assert check(range(40), condims=(1, 3, 4, 6)) < LIMIT


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_thousand_scenes():
    """Measured: 3018 of 4000 states without allowance, the worst 3.7e-8 apart."""
    assert check(range(1000)) < LIMIT


def test_sweeps_reach_the_same():
    """Accelerated sweeps against Newton, where they converge: on most scenes."""
    near = 0
    for seed in range(30):
        _, turned = Draw(seed).texts()
        model = sc.loads(turned).compile()
        both = [
            sc.Sim(model, **peers.EXACT),
            sc.Sim(model, solver="pgs", acceleration="momentum", sweeps=3000, tolerance=1e-13),
        ]
        for sim in both:
            sim.ctrl[:] = np.linspace(-1, 1, model.nu)
            sim.forward()
        size = np.abs(both[0].qacc).max() + 1
        near += np.abs(both[0].qacc - both[1].qacc).max() < 1e-6 * size
    assert near >= 28


@pytest.mark.parametrize("cone", ("elliptic", "pyramidal"))
def test_the_wheel_of_the_issue(cone):
    """MuJoCo's Newton holds it still for 0.8 s, and so does stepcore."""
    text = WHEEL.replace("elliptic", cone)
    theirs = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(theirs)
    sim = sc.Sim(sc.loads(text))
    sim.ctrl[:] = data.ctrl[:] = 1.0
    mujoco.mj_step(theirs, data, 400)
    sim.step(400)
    assert abs(data.qvel[0]) < 1e-6
    assert abs(sim.qvel[0]) < 1e-6
    assert sim.residual < 1e-9
