"""Sensors against what they must read: gravity at rest, a weight on a box, a spin."""

import pytest

import stepcore as sc


def rest(sim):
    for _ in range(2000):
        sim.step()
    sim.forward()


def test_an_accelerometer_at_rest_reads_gravity():
    """Law: +g upwards, whether the body lies or hangs; 0 in free fall."""
    scene = sc.Scene()
    ball = scene.add_body("ball", pos=(0, 0, 0.1))
    scene.add_joint(ball, "free")
    scene.add_geom(ball, "sphere", 0.1, mass=2.0)
    scene.add_geom("world", "plane", name="floor")
    scene.add_site(ball, name="imu")
    scene.add_sensor("accelerometer", "imu", name="imu")
    sim = sc.Sim(scene, dt=0.002)
    rest(sim)
    assert sim.sensor("imu").data == pytest.approx([0, 0, 9.81], abs=1e-9)
    sim.qpos[2] = 3.0
    sim.forward()
    assert sim.sensor("imu").data == pytest.approx([0, 0, 0], abs=1e-12)


def test_touch_on_a_resting_box_is_its_weight():
    """Law: the normal forces add up to m g; half a zone sees half of them."""
    scene = sc.Scene()
    box = scene.add_body("box", pos=(0, 0, 0.1))
    scene.add_joint(box, "free")
    scene.add_geom(box, "box", (0.1, 0.1, 0.1), mass=3.0)
    scene.add_geom("world", "plane")
    scene.add_site(box, name="all", type="box", size=(0.2, 0.2, 0.2))
    scene.add_site(box, name="half", type="box", size=(0.1, 0.2, 0.2), pos=(0.15, 0, 0))
    scene.add_sensor("touch", "all", name="all")
    scene.add_sensor("touch", "half", name="half")
    sim = sc.Sim(scene, dt=0.002)
    rest(sim)
    assert sim.sensor("all").data == pytest.approx([3 * 9.81], rel=1e-9)
    assert sim.sensor("half").data == pytest.approx([1.5 * 9.81], rel=1e-6)


def test_a_gyro_on_a_spinning_body():
    """Law: its angular velocity in its own axes; the centre of mass does not turn the force."""
    scene = sc.Scene(gravity=(0, 0, 0))
    ball = scene.add_body("ball")
    scene.add_joint(ball, "free")
    scene.add_geom(ball, "sphere", 0.1, mass=2.0)
    scene.add_site(ball, name="imu", pos=(0.05, 0, 0), quat=(0.5, 0.5, 0.5, 0.5))
    for kind in ("gyro", "accelerometer", "velocimeter"):
        scene.add_sensor(kind, "imu", name=kind)
    sim = sc.Sim(scene, dt=0.001)
    sim.qvel[3:] = (0, 0, 4.0)
    sim.forward()
    # The site's axes are the body's y, z, x.
    assert sim.sensor("gyro").data == pytest.approx([0, 4.0, 0], abs=1e-12)
    assert sim.sensor("accelerometer").data == pytest.approx([0, 0, -0.05 * 16], abs=1e-12)
    assert sim.sensor("velocimeter").data == pytest.approx([0.2, 0, 0], abs=1e-12)
