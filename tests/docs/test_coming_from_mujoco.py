"""docs/mujoco.md is true: each row of its tables is evaluated in MuJoCo and in stepcore."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco.rollout import rollout as mujoco_rollout

import stepcore as sc

PAGE = Path(__file__).parents[2] / "docs" / "mujoco.md"
ROW = re.compile(r"^\| `([^`]+)` \| `([^`]+)` \|.*\|$", re.MULTILINE)

MODEL = """
<mujoco model="both">
  <option timestep="0.004" density="1.2"><flag energy="enable"/></option>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 .1"/>
    <body name="slider" pos="0 0 0.5">
      <joint name="slide" type="slide" axis="1 0 0" range="-1 1" limited="true" damping="1"
        frictionloss="0.1"/>
      <geom name="rail" type="box" size=".1 .05 .05" mass="1"/>
      <site name="tip" pos="0.1 0 0"/>
      <body name="arm" pos="0 0 -0.1">
        <joint name="hinge" axis="0 1 0" stiffness="2" armature="0.01"/>
        <geom name="rod" type="capsule" size=".02" fromto="0 0 0 0 0 -.3" mass=".3"/>
        <site name="end" pos="0 0 -.3"/>
      </body>
    </body>
    <body name="ball" pos="0.5 0 0.099">
      <freejoint name="ball"/>
      <geom name="ball" size="0.1" mass="1"/>
    </body>
    <body name="target" mocap="true" pos="1 1 1"/>
  </worldbody>
  <tendon>
    <spatial name="string" stiffness="3"><site site="tip"/><site site="end"/></spatial>
  </tendon>
  <equality><joint name="hold" joint1="slide" joint2="hinge" polycoef="0 0.2 0 0 0"/></equality>
  <actuator>
    <motor name="push" joint="slide" gear="2" ctrllimited="true" ctrlrange="-1 1"/>
    <general name="lag" joint="hinge" dyntype="filter" dynprm="0.1"/>
  </actuator>
  <sensor>
    <jointpos name="angle" joint="hinge"/>
    <framelinacc name="tip" objtype="site" objname="tip"/>
  </sensor>
  <keyframe>
    <key name="bent" qpos="0.1 0.2  .5 0 .099 1 0 0 0" qvel="0.3 1  0 0.1 0 0 0 0" ctrl="0.5 0.3"
      act="0.1"/>
  </keyframe>
</mujoco>
"""


def section(title):
    """The rows of a section, up to the next heading."""
    text = PAGE.read_text(encoding="utf-8").partition(f"# {title}\n")[2]
    found = ROW.findall(re.split(r"^#", text, flags=re.MULTILINE)[0])
    assert found, title
    return found


class Both:
    """The same model, keyframe and last solve in both packages, under the page's names."""

    def __init__(self):
        self.m = mujoco.MjModel.from_xml_string(MODEL)
        self.m.opt.tolerance = 0.0
        self.d = mujoco.MjData(self.m)
        self.sim = sc.Sim(sc.loads(MODEL))
        self.sim.reset("bent")
        mujoco.mj_resetDataKeyframe(self.m, self.d, 0)
        mujoco.mj_forward(self.m, self.d)
        mujoco.mj_rnePostConstraint(self.m, self.d)
        self.sim.forward()

    def evaluate(self, expression):
        names = {"m": self.m, "d": self.d, "sim": self.sim, "model": self.sim.model}
        return eval(expression, names | {"mujoco": mujoco, "sc": sc, "np": np} | CALLS)


def full_mass_matrix(m, d):
    matrix = np.zeros((m.nv, m.nv))
    mujoco.mj_fullM(m, d, matrix)
    return matrix


def body_jacobian(m, d, body):
    jacobian = np.zeros((6, m.nv))
    mujoco.mj_jacBody(m, d, jacobian[:3], jacobian[3:], m.body(body).id)
    return jacobian


def site_jacobian(m, d, site):
    jacobian = np.zeros((6, m.nv))
    mujoco.mj_jacSite(m, d, jacobian[:3], jacobian[3:], m.site(site).id)
    return jacobian


def tendon_jacobian(m, d):
    dense = np.zeros((m.ntendon, m.nv))
    for row, (first, count) in enumerate(zip(m.ten_J_rowadr, m.ten_J_rownnz, strict=True)):
        entries = slice(first, first + count)
        dense[row, m.ten_J_colind[entries]] = d.ten_J[entries]
    return dense


def body_velocity(m, d, body):
    velocity = np.zeros(6)
    kind = mujoco.mjtObj.mjOBJ_XBODY
    mujoco.mj_objectVelocity(m, d, kind, m.body(body).id, velocity, 0)
    return np.concatenate([velocity[3:], velocity[:3]])


def solved(m, d):
    result = np.zeros((1, m.nv))
    mujoco.mj_solveM(m, d, result, np.ones((1, m.nv)))
    return result[0]


def stepped_and_set_back(m, d):
    whole = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.zeros(mujoco.mj_stateSize(m, whole))
    mujoco.mj_getState(m, d, state, whole)
    mujoco.mj_step(m, d, 5)
    mujoco.mj_setState(m, d, state, whole)


def inverse_dynamics(m, d):
    mujoco.mj_inverse(m, d)
    return d.qfrc_inverse


def contact_force(m, d):
    forces = np.zeros((d.ncon, 6))
    for i, force in enumerate(forces):
        mujoco.mj_contactForce(m, d, i, force)
    frames = d.contact.frame.reshape(-1, 3, 3)
    return np.einsum("ci,cij->cj", forces[:, :3], frames)


def ray(m, d):
    return mujoco.mj_ray(
        m, d, np.array([0, 0, 2.0]), np.array([0, 0, -1.0]), None, 1, -1, np.zeros(1, np.int32)
    )


def transition_matrix(m, d):
    size = 2 * m.nv + m.na
    found = np.zeros((size, size))
    mujoco.mjd_transitionFD(m, d, 1e-9, True, found, None, None, None)
    return found


def rollout(m, d):
    mujoco.mj_resetData(m, d)
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.zeros(mujoco.mj_stateSize(m, full))
    mujoco.mj_getState(m, d, start, full)
    states, _ = mujoco_rollout(m, d, start[None], np.ones((1, 5, m.nu)))
    return states[0, -1, 1 : 1 + m.nq]


CALLS = {
    call.__name__: call
    for call in (
        *(full_mass_matrix, body_jacobian, site_jacobian, tendon_jacobian, body_velocity, solved),
        *(stepped_and_set_back, inverse_dynamics, contact_force, ray, transition_matrix, rollout),
    )
}
# Differences of steps, which contacts make curved, are as good as this.
SLACK = {"transition_matrix(m, d)": 1e-4}

VALUES = [
    *section("Sizes and constants"),
    *section("State and inputs"),
    *section("Computed quantities"),
    *section("Functions"),
]


def same(theirs, ours, slack=1e-9):
    if isinstance(theirs, str):
        return theirs == ours
    theirs, ours = np.asarray(theirs), np.asarray(ours)
    return theirs.shape == ours.shape and np.allclose(theirs, ours, rtol=slack, atol=slack)


@pytest.mark.parametrize(("theirs", "ours"), VALUES, ids=lambda text: text)
def test_a_row_has_the_same_value_in_both(theirs, ours):
    both = Both()
    a, b = both.evaluate(theirs), both.evaluate(ours)
    if a is None and b is None:
        a, b = ((state.qpos, state.qvel, state.time) for state in (both.d, both.sim))
        assert all(same(x, y) for x, y in zip(a, b, strict=True))
    else:
        assert same(a, b, SLACK.get(theirs, 1e-9)), (a, b)


@pytest.mark.parametrize(("attribute", "setting"), section("Options"), ids=lambda text: text)
def test_an_option_is_read_as_its_setting(attribute, setting):
    text = f"<mujoco><option {attribute}/></mujoco>"
    mujoco.MjModel.from_xml_string(text)
    name, _, value = setting.partition("=")
    assert getattr(sc.loads(text).settings, name) == eval(value)


def test_what_only_draws_is_listed_where_the_page_says():
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    named = re.search(r"Elements that only draw are listed in `scene\.(\w+)`", text)[1]
    scene = sc.loads("<mujoco><worldbody><light/><geom size='1'/></worldbody></mujoco>")
    assert "light" in " ".join(getattr(scene, named))
