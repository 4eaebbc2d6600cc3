"""Runs the scenes of `scenes` with and without an attribute, here and in MuJoCo."""

import re
from dataclasses import dataclass

import mujoco
import numpy as np

import stepcore as sc
from attributes import sensors
from attributes.cases import CASES, OTHERS, Case, actuator_case
from attributes.scenes import ACTUATORS
from attributes.scenes import BASE as BASES
from attributes.scenes import SCENES as OF_MOTION
from stepcore import loads
from stepcore.mjcf.nodes import MJCFError

SCENES = OF_MOTION | sensors.SCENES
BASE = BASES | sensors.BASE
STEPS = 6
# How far motions may differ, of the largest coordinate.
EXACT = 1e-7
# Where answers differ for reasons that docs/method gives: contacts of height fields have no
# walls between prisms, hulls of few vertices keep others, three sweeps have not converged, and
# MuJoCo keeps vertices in single precision.
LOOSE = {
    "asset/hfield": 0.1,
    "asset/mesh maxhullvert": 0.2,
    "option iterations": 0.05,
    "geom mesh": 1e-4,
    "geom fitscale": 1e-4,
}


def case_of(path: str, attribute: str) -> Case | None:
    """The case of an attribute, or None if there is none."""
    section, _, tag = path.partition("/")
    if section == "actuator" and tag in ACTUATORS:
        return actuator_case(tag, attribute)
    if section == "sensor" and path in SCENES:
        return sensors.case_of(tag, attribute)
    return CASES.get(path, {}).get(attribute)


def words(text: str) -> dict[str, str]:
    return dict(re.findall(r'(\w+)="([^"]*)"', text))


def models(path: str, attribute: str, case: Case) -> tuple[str, str]:
    """The texts of the scene without and with the attribute."""
    value, other, place = (*((case,) if isinstance(case, str) else case), "", "")[:3]
    attrs, end = OTHERS.get(other, (other, ""))
    base = words(BASE.get(path, "")) if not place else {}
    if path.startswith("actuator/") and "site=" in f"{other}{attribute}=":
        # A transmission of its own takes the place of the base's.
        base.pop("joint", None)
    if path.startswith("actuator/") and attribute in ("jointinparent", "tendon", "body"):
        base.pop("joint", None)
    base |= words(attrs)
    for group in sensors.ONE_OF.get(path.partition("/")[2], ()) if path in sensors.SCENES else ():
        if attribute in group:
            base = {name: word for name, word in base.items() if name not in group}
    scene = SCENES[place or path].replace("</mujoco>", f"{end}</mujoco>")

    def text(given: dict[str, str]) -> str:
        given = {name: word for name, word in given.items() if f"{name}=" not in _before(scene)}
        return scene.replace("@", " ".join(f'{n}="{w}"' for n, w in given.items()))

    return text(base), text(base | {attribute: value})


def _before(scene: str) -> str:
    """What stands in the tag before the place of the attributes."""
    head = scene.partition("@")[0]
    return head[head.rindex("<") :]


@dataclass
class Run:
    """A motion, (steps, nq + nv), and what sensors measure; or why there is none.

    listed: the sensor is not computed, and listed in `Scene.ignored`.
    """

    path: np.ndarray | None = None
    error: str = ""
    measured: np.ndarray | None = None
    listed: bool = False

    def same(self, other: "Run", relative: float = 0.0) -> bool:
        if self.path is None or other.path is None or self.path.shape != other.path.shape:
            return self.path is other.path
        if self.measured is not None and other.measured is not None:
            if self.measured.shape != other.measured.shape:
                return False
            if not np.allclose(self.measured, other.measured, relative, relative):
                return False
        if not relative:
            return bool((self.path == other.path).all())
        scale = max(1.0, float(np.abs(self.path).max()))
        return bool(np.abs(self.path - other.path).max() <= relative * scale)


def _inputs(nv: int, nu: int) -> tuple[np.ndarray, np.ndarray]:
    chance = np.random.default_rng(7)
    # Of more dofs the first ones are driven as those of fewer.
    return 0.3 * chance.uniform(-1, 1, 40)[:nv], 0.5 * chance.uniform(-1, 1, 40)[:nu]


def mujocos(text: str) -> Run:
    """MuJoCo's motion."""
    try:
        model = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        return Run(error=str(error))
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    else:
        data.qvel[:], data.ctrl[:] = _inputs(model.nv, model.nu)
    states, measured = [], []
    for _ in range(STEPS):
        mujoco.mj_step(model, data)
        states.append(np.concatenate([[data.time], data.qpos, data.qvel]))
        measured.append(data.sensordata.copy())
    return Run(np.array(states), measured=np.array(measured))


def ours(text: str) -> Run:
    """The motion here."""
    try:
        scene = loads(text)
        sim = sc.Sim(scene.compile(), tolerance=0.0)
    except MJCFError as error:
        return Run(error=str(error))
    if scene.keys:
        sim.reset(key=0)
    else:
        sim.qvel[:], sim.ctrl[:] = _inputs(sim.model.nv, sim.model.nu)
    states, measured = [], []
    for _ in range(STEPS):
        sim.step()
        # As MuJoCo's: of the state before the step.
        measured.append(np.array(sim.sensordata))
        states.append(np.concatenate([[sim.time], sim.qpos, sim.qvel]))
    listed = any("(only senses" in line for line in scene.ignored)
    return Run(np.array(states), "", np.array(measured), listed)


@dataclass
class Outcome:
    """What an attribute does. word: "honoured", "refused", "no effect" or what is wrong."""

    word: str
    text: str = ""


def measured(path: str, attribute: str, case: Case) -> Outcome:
    """Sets the attribute in both engines."""
    base, tried = models(path, attribute, case)
    theirs, theirs_base = mujocos(tried), mujocos(base)
    if theirs.path is None:
        return Outcome("bad case", theirs.error)
    here = ours(tried)
    if here.path is None:
        return Outcome("refused", here.error)
    if here.listed:
        return Outcome("senses")
    if not here.same(theirs, LOOSE.get(f"{path} {attribute}", LOOSE.get(path, EXACT))):
        if here.path.shape == theirs.path.shape:
            worst = float(np.abs(here.path - theirs.path).max())
            return Outcome("differs", f"by {worst:.2g}")
        return Outcome("differs", f"{here.path.shape} {theirs.path.shape}")
    return Outcome("no effect" if theirs.same(theirs_base) else "honoured")
