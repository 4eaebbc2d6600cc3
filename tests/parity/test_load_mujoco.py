"""`load` of MuJoCo's own models and specs: every digit, meshes in files and in memory."""

import mujoco
import numpy as np
import pytest

import stepcore as sc

PRECISE = """
<mujoco><option timestep="0.00123456789012345"/>
<default><joint damping="0.1234567890123"/></default>
<worldbody><body name="arm" pos="0.1234567890123456 0 1"><joint name="elbow" axis="0 1 0"/>
<geom size="0.1" mass="1.2345678901234567" friction="0.765432109876543"/></body></worldbody>
<actuator><position name="servo" joint="elbow" kp="12.3456789012345"/></actuator></mujoco>"""
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
MESH = """<mujoco><compiler meshdir="parts"/><asset><mesh file="a.obj"/></asset><worldbody>
<body><freejoint/><geom type="mesh" mesh="a"/></body></worldbody></mujoco>"""


def moved(source):
    """Where a model or a scene goes in 200 steps, and its masses."""
    sim = sc.Sim(source)
    sim.qvel[:] = 0.3
    sim.step(200)
    return np.concatenate([sim.qpos, sim.qvel, sim.model.body_mass])


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "a.obj").write_text(TETRAHEDRON)
    (tmp_path / "model.xml").write_text(MESH)
    return tmp_path


def test_a_model_and_a_spec_keep_every_digit():
    own = moved(sc.loads(PRECISE))
    np.testing.assert_array_equal(moved(mujoco.MjModel.from_xml_string(PRECISE)), own)
    spec = mujoco.MjSpec.from_string(PRECISE)
    np.testing.assert_array_equal(moved(spec), own)
    scene = sc.load(spec)
    assert scene.settings.dt == 0.00123456789012345
    assert scene.body("arm").pos[0] == 0.1234567890123456


def test_writing_a_spec_leaves_mujocos_own_digits_as_they_are():
    spec = mujoco.MjSpec.from_string(PRECISE)
    before = spec.to_xml()
    sc.load(spec)
    assert spec.to_xml() == before and "0.123457" in before


def test_edits_of_a_spec_and_of_a_model_count():
    spec = mujoco.MjSpec.from_string(PRECISE)
    spec.body("arm").pos = [0.1, 0.2, 0.3000000000000001]
    assert sc.load(spec).body("arm").pos == (0.1, 0.2, 0.3000000000000001)
    model = mujoco.MjModel.from_xml_string(PRECISE)
    model.dof_damping[0] = 0.7654321098765432
    assert sc.load(model).joint("elbow").damping == 0.7654321098765432


@pytest.mark.parametrize("source", [MESH, "<mujoco/>"])
def test_a_model_whose_xml_mujoco_has_forgotten_is_refused(source, folder):
    model = mujoco.MjModel.from_xml_string(PRECISE)
    later = PRECISE.replace('name="arm"', 'name="leg"') if source == MESH else source
    mujoco.MjModel.from_xml_string(later)
    with pytest.raises(ValueError, match=r"MjModel: MuJoCo keeps the XML .* pass the MjSpec"):
        sc.load(model)


def test_meshes_are_found_beside_the_file_and_in_memory(folder):
    path = folder / "model.xml"
    own = moved(path)
    np.testing.assert_allclose(moved(mujoco.MjSpec.from_file(str(path))), own, rtol=1e-12)
    np.testing.assert_allclose(moved(mujoco.MjModel.from_xml_path(str(path))), own, rtol=1e-12)
    spec = mujoco.MjSpec.from_string(MESH, assets={"parts/a.obj": TETRAHEDRON.encode()})
    np.testing.assert_allclose(moved(spec), own, rtol=1e-12)


def test_measurements_take_a_spec():
    spec = mujoco.MjSpec.from_string(PRECISE)
    assert (
        sc.diagnose(spec, horizon=0.1).limits == sc.diagnose(sc.loads(PRECISE), horizon=0.1).limits
    )
