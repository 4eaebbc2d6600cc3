"""`max_recovery_speed`: how fast a contact may push an overlap apart.

Laws: an overlap opens no faster than the setting; what is slower is left as it was, bit for bit;
what the limit left over is reported; the default is that of the documentation.
"""

import numpy as np
import pytest
from engines import ENGINES, make

import stepcore as sc

SPHERES = """<mujoco><option gravity="0 0 0"/><worldbody>
<body pos="0 0 {a}"><joint type="slide" axis="0 0 1"/><geom size=".5" mass="1"/></body>
<body pos="0 0 {b}"><joint type="slide" axis="0 0 1"/><geom size=".5" mass="1"/></body>
</worldbody></mujoco>"""


def spheres(apart):
    return sc.loads(SPHERES.format(a=0, b=apart))


def opening(sim, steps=40):
    """The fastest that the two part within so many steps [m/s]."""
    fastest = 0.0
    for _ in range(steps):
        sim.step()
        fastest = max(fastest, float(sim.qvel[1] - sim.qvel[0]))
    return fastest


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("law", ["lesson", "relaxed", "rigid"])
def test_laws_on_velocities(engine, law):
    """Spheres 0.9 m deep: 90 m/s without a limit (β·0.9 m / 2 ms), 3 m/s by default."""
    for speed, want in (("none", 90.0), ("auto", 3.0), (0.5, 0.5)):
        sim = make(engine, spheres(0.1), law=law, max_recovery_speed=speed)
        assert opening(sim) == pytest.approx(want)


@pytest.mark.parametrize("solref", ["0.02 1", "0.004 0.2", "-50000 -1", "-1000 0"])
@pytest.mark.parametrize("options", [{"cone": "elliptic"}, {"cone": "pyramidal"}])
def test_solref(solref, options):
    """MuJoCo's spring has no limit by default; a limit holds for any damping of it."""
    text = SPHERES.format(a=0, b=0.1).replace("<geom", f'<geom solref="{solref}"')
    free = opening(sc.Sim(sc.loads(text), **options), 500)
    assert free > 3.0
    for speed in (0.1, 1.0, 0.9 * free):
        fastest = opening(sc.Sim(sc.loads(text), max_recovery_speed=speed, **options), 1000)
        assert 0.5 * speed < fastest <= speed * (1 + 1e-8)


@pytest.mark.parametrize("law", ["solref", "lesson", "relaxed", "rigid"])
def test_a_limit_that_is_not_reached_changes_no_bit(law):
    """A ball that falls on the floor, with a limit of 100 m/s and without one."""
    scene = sc.loads(
        '<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .2"><freejoint/>'
        '<geom size=".1" mass="1"/></body></worldbody></mujoco>'
    )
    solver = "newton" if law == "solref" else "pgs"
    sims = [
        sc.Sim(scene, law=law, solver=solver, max_recovery_speed=speed) for speed in (100.0, "none")
    ]
    for sim in sims:
        sim.qvel[0] = 1.0
        sim.step(300)
    assert sims[0].state() == sims[1].state()


def test_a_bounce_is_not_limited():
    """Restitution is no recovery: a ball that falls at 10 m/s leaves at 10 m/s."""
    sim = sc.Sim(spheres(1.0), law="rigid", solver="pgs", restitution=1.0)
    sim.qvel[1] = -10.0
    assert opening(sim, 5) == pytest.approx(10.0)


def test_what_is_left_over_is_reported():
    """β·depth − speed·dt of the deepest contact; 0 where the limit was not reached."""
    deep = sc.Sim(spheres(0.1), law="lesson", solver="pgs", max_recovery_speed=2.0)
    deep.forward()
    assert deep.unrecovered_overlap == pytest.approx(0.2 * 0.9 - 2.0 * 0.002)
    shallow = sc.Sim(spheres(0.9999), law="lesson", solver="pgs", max_recovery_speed=2.0)
    shallow.forward()
    assert shallow.unrecovered_overlap == 0.0
    soft = sc.Sim(spheres(0.1))
    soft.forward()
    assert soft.unrecovered_overlap == 0.0
    batch = sc.Batch(spheres(0.1), 3, law="lesson", solver="pgs", max_recovery_speed=2.0)
    batch.qpos[1, 1] = 0.8999
    batch.forward()
    assert batch.unrecovered_overlap == pytest.approx([0.176, 0.0, 0.176])
    assert (batch.unrecovered_overlap[0]) == deep.unrecovered_overlap
    run = deep.run(0.01, record=("unrecovered_overlap",))
    assert np.all(np.diff(run.unrecovered_overlap[1:]) < 0)


def test_the_setting_is_checked_and_written():
    for bad in (0.0, -1.0, float("inf"), float("nan")):
        with pytest.raises(ValueError, match="max_recovery_speed"):
            sc.Settings(max_recovery_speed=bad)
    with pytest.raises(ValueError, match=r"max_recovery_speed = 'fast': must be 'auto', 'none'"):
        sc.Settings(max_recovery_speed="fast")
    for speed in ("auto", "none", 2.5):
        scene = spheres(0.1)
        scene.options["max_recovery_speed"] = speed
        again = sc.loads(scene.to_mjcf())
        assert again.settings.max_recovery_speed == speed
        assert sc.Settings(max_recovery_speed=speed).max_recovery_speed == speed
