"""What a small file can ask for is refused before the memory ends, and the interpreter lives on.

Each case is in a process of its own, whose memory is limited once everything is imported.
"""

import subprocess
import sys

import pytest

RUN = """
import resource, sys
import numpy as np
import stepcore as sc
sc.Sim(sc.lesson.spring()).step()
limit = int(float(sys.argv[1]) * 2**30)
with open("/proc/self/statm") as pages:
    limit += int(pages.read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
TEXT = "<mujoco>{}<worldbody>{}</worldbody>{}</mujoco>"
BALL = '<body pos="{} 0 0"><freejoint/><geom size=".1"/></body>'

def file(world, asset="", after=""):
    return sc.loads(TEXT.format(asset, world, after))

def late(count, nsample):
    motors = "".join(
        f'<motor name="m{i}" joint="j" delay=".01" nsample="{nsample}"/>' for i in range(count)
    )
    after = f"<actuator>{motors}</actuator>"
    return file('<body><joint name="j"/><geom size=".1"/></body>', after=after)

def balls(count, apart=0):
    return file("".join(BALL.format(apart * k) for k in range(count)))

def chain(count):
    scene = sc.Scene()
    body = scene.world
    for _ in range(count):
        body = scene.add_body("", body, (0, 0, 0.1))
        scene.add_joint(body, "hinge")
        scene.add_geom(body, "sphere", (0.04,), contype=0, conaffinity=0)
    return scene

def points(count):
    scene = sc.Scene()
    mesh = scene.add_mesh("cloud", np.random.default_rng(0).normal(size=(count, 3)))
    scene.add_geom(scene.world, "mesh", mesh=mesh)
    return scene

def field(count):
    scene = sc.Scene()
    heights = np.zeros((2000, 2000))
    for index in range(count):
        field = scene.add_hfield(name=f"h{index}", size=(1, 1, 1, 1), elevation=heights)
        scene.add_geom(scene.world, "hfield", hfield=field)
    return scene

def keyed():
    scene = balls(3000, apart=1)
    numbers = (0.0,) * 18000
    for index in range(1500):
        scene.add_key(f"k{index}", qvel=numbers)
    return scene

SENSED = '<body><freejoint/><geom name="g" size=".1"/></body>'
NUMEROUS = '<sensor><contact geom1="g" num="2000000000"/></sensor>'

CASES = dict(
    histories=lambda: sc.Sim(late(150, 1_000_000)),
    one_history=lambda: sc.Sim(late(4, 1_000_000)),
    histories_of_threads=lambda: sc.Batch(late(1, 500_000), 8, threads=8),
    mass_matrix=lambda: sc.Sim(chain(6000)),
    mesh=lambda: sc.Sim(points(900_000)),
    hfields=lambda: sc.Sim(field(8)),
    keys=lambda: sc.Sim(keyed()),
    sensor=lambda: sc.Sim(file(SENSED, after=NUMEROUS)),
    contacts=lambda: sc.Sim(balls(500)).step(),
    near=lambda: sc.Sim(balls(2500)).step(),
    matrix=lambda: sc.Sim(balls(2500, apart=1)).mass_matrix(),
    linear_map=lambda: sc.Sim(balls(2500, apart=1)).linearize(),
    worlds=lambda: sc.Batch(sc.lesson.spring(), 10**8),
    reserved=lambda: sc.Batch(balls(2), 64, threads=64, max_contacts=1_000_000),
    small=lambda: sc.Sim(balls(50, apart=1)).step(5),
)
try:
    CASES[sys.argv[2]]()
    print("fits")
except (ValueError, MemoryError) as error:
    print(type(error).__name__, error)
"""
# Memory beside what is imported [GB], and what is said.
CASES = {
    "histories": (1.0, "GB for the past controls (nsample) of 150 actuators, most of them for"),
    "one_history": (1.0, "GB for the past controls (nsample) of 4 actuators"),
    "histories_of_threads": (0.6, "must be a number whose working space"),
    "mass_matrix": (1.0, "the mass matrix of its 6000 dofs"),
    "mesh": (0.5, "MB for the 900000 vertices of its meshes, most of them of 'cloud'"),
    "hfields": (0.95, "the 32000000 heights of its hfields, most of them of 'h"),
    "keys": (1.2, "1500 keyframes"),
    "sensor": (1.0, "num = 2000000000: must be a whole number from 1 to 10000"),
    "contacts": (0.3, "contacts = 124750: must be as many as the memory can hold"),
    "near": (0.5, "near pairs of geoms = 3123750: must be as many as the memory can hold"),
    "matrix": (
        0.8,
        "mass_matrix = 15000 × 15000 numbers: must be a matrix that the memory can hold",
    ),
    "linear_map": (0.8, "linearize = 30000 × 30000 numbers"),
    "worlds": (1.0, "n = 100000000: must be a number of worlds that the memory can hold"),
    "reserved": (1.0, "must be a number whose working space"),
    "small": (0.1, "fits"),
}


@pytest.mark.parametrize("case", CASES)
def test_what_does_not_fit_is_refused_by_name(case):
    room, said = CASES[case]
    command = [sys.executable, "-c", RUN, str(room), case]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr[-500:]
    assert said in done.stdout
    assert len(done.stdout) < 400
