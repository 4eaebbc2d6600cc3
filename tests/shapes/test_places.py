"""A contact's point lies on both meshes, whichever corners of a face are the deepest by rounding.

Law: the depth is how far the origin lies inside the hull of all differences of vertices, and the
point, half the depth to either side along the normal, is on both hulls to 1e-9 of their size.
"""

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

import stepcore as sc

# What is left of two meshes of a robot: a face of one is even with the deepest corner of the other.
ONE = [
    (0.01234812, -0.02847378, 0.00130724),
    (-0.04642829, 0.03173306, 0.00564465),
    (-0.04553713, 0.03179242, 0.00633464),
    (-0.04450252, 0.03180325, 0.00678547),
]
TWO = [
    (-0.03617853, -0.0334085, -0.00249835),
    (0.03064668, -0.02819458, 0.02694434),
    (0.02462734, -0.00876702, -0.03056511),
    (-0.04436407, -0.03445706, -0.00497475),
    (0.04317361, -0.02261372, -0.03718392),
]


@pytest.mark.parametrize("meshes", [(ONE, TWO), (TWO, ONE)], ids=["as found", "swapped"])
def test_the_deepest_point_is_on_both_meshes(meshes):
    numbers = [" ".join(map(repr, np.ravel(mesh).tolist())) for mesh in meshes]
    sim = sc.Sim(
        sc.loads(
            f"""<mujoco><asset><mesh name="a" vertex="{numbers[0]}"/>
            <mesh name="b" vertex="{numbers[1]}"/></asset><worldbody><geom type="mesh" mesh="a"/>
            <body><freejoint/><geom type="mesh" mesh="b"/></body></worldbody></mujoco>"""
        )
    )
    sim.forward()
    one, two = map(np.array, meshes)
    dist = ConvexHull((two[None] - one[:, None]).reshape(-1, 3)).equations[:, 3].max()
    (contact,) = sim.contacts
    assert contact["dist"] == pytest.approx(dist, abs=1e-9)
    for mesh, side in ((one, -0.5), (two, 0.5)):
        planes = ConvexHull(mesh).equations
        point = contact["pos"] + side * contact["dist"] * contact["normal"]
        assert (planes[:, :3] @ point + planes[:, 3]).max() < 1e-9


@pytest.mark.parametrize(
    "turn", ["0 0 159.658", "0 0 20", "0 0 -77.1", "180 0 33", "90 0 0", "0 -90 0"]
)
def test_a_capsule_turned_about_itself_keeps_the_order_of_its_ends(turn):
    """Its axis is z, up to rounding: contacts with a plane come in MuJoCo's order."""
    text = f"""<mujoco><worldbody><geom type="plane" size="5 5 1"/>
    <body pos="0 0 .03" euler="90 0 10"><freejoint/>
    <geom type="capsule" size=".05 .2" euler="{turn}" margin="1"/></body></worldbody></mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(text)
    data, sim = mujoco.MjData(theirs), sc.Sim(sc.loads(text))
    mujoco.mj_forward(theirs, data)
    sim.forward()
    assert np.abs(sim.contacts["pos"] - data.contact.pos).max() < 1e-12
