"""What a heap costs as it grows: loading, and a step a body, from 300 to 10,000 spheres.

Loading: the scene built by `Scene.add_…` or read from MJCF text, compiled, and a `Sim` of it; in a
process of its own, its processor time and its peak of memory. A step: spheres far from each other
in the air, and in a box without a lid after 300 steps, each under `solref` and `rigid` with PGS at
10 sweeps and no tolerance, so that every size does the same work a contact. The sizes take turns;
the number is the median of 7 samples. Aims: 2 s and 1 GB; a step a body within 1.5 times of its
least.

666 (C8 of the collected cases): 216 spheres without friction fall on a floor, 10 s under `rigid`;
the mean over steps of the sum of squared penetrations, and the time of a step.
"""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np
import record
import scenes

import stepcore as sc

SIZES = (300, 1000, 3000, 10_000)
SAMPLES, SETTLE = 7, 300
FIXED = {"solver": "pgs", "sweeps": 10, "tolerance": 0.0}
LOAD = """
import resource, sys, time
import scenes
import stepcore as sc
count, way = int(sys.argv[1]), sys.argv[2]
text = scenes.in_the_air(count) if way == "mjcf" else ""
start = time.process_time()
if way == "mjcf":
    scene = sc.loads(text)
else:
    scene = sc.Scene()
    scene.add_geom("world", "plane", name="floor")
    for i in range(count):
        body = scene.add_body(f"ball{i}", pos=(0.3 * (i % 100), 0.3 * (i // 100), 50))
        scene.add_joint(body, "free")
        scene.add_geom(body, "sphere", 0.1, name=f"ball{i}", mass=1.0)
built = time.process_time()
sc.Sim(scene.compile())
end = time.process_time()
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(built - start, end - built, peak / (1e6 if sys.platform == "linux" else 1e9))
"""


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    options.pairs = 0  # Sizes take turns, not sides.
    report = record.Report("heap_scale", options, "spheres; PGS, 10 sweeps, no tolerance")
    sizes = SIZES[:2] if options.quick else SIZES
    for part in (loading, steps, penetration):
        if options.only in part.__name__:
            report.say()
            part(sizes, report)
    report.close()


def loading(sizes, report: record.Report) -> None:
    report.say(f"{'loading':10}{'spheres':>9}{'build [s]':>11}{'compile [s]':>13}{'peak [GB]':>11}")
    for way in ("api", "mjcf"):
        for count in sizes[-2:]:
            command = [sys.executable, "-c", LOAD, str(count), way]
            folder = scenes.__file__.rsplit("/", 1)[0]
            run = subprocess.run(command, capture_output=True, text=True, check=True, cwd=folder)
            built, compiled, peak = map(float, run.stdout.split())
            report.say(f"{way:10}{count:9}{built:11.2f}{compiled:13.2f}{peak:11.3f}")
            report.add(part="loading", way=way, count=count, times=(built, compiled), peak_gb=peak)


def steps(sizes, report: record.Report) -> None:
    report.say(
        f"{'place':7}{'law':8}{'spheres':>9}{'contacts':>10}{'µs a step':>12}{'ns a body':>11}"
        f"{'of the least':>14}{'ns a contact':>14}"
    )
    for place, make in (("air", scenes.in_the_air), ("box", scenes.spheres)):
        for law in ("solref", "rigid"):
            sims = [sc.Sim(sc.loads(make(n)).compile(), law=law, **FIXED) for n in sizes]
            for sim in sims:
                sim.step(SETTLE if place == "box" else 1)
            samples = np.array([[sample(sim) for sim in sims] for _ in range(SAMPLES)])
            spent = np.median(samples, axis=0)
            each = spent / np.array(sizes)
            for n, sim, us, own in zip(sizes, sims, 1e6 * spent, 1e9 * each, strict=True):
                contacts = len(sim.contacts)
                contact = f"{1e3 * us / contacts:14.0f}" if contacts else ""
                report.say(
                    f"{place:7}{law:8}{n:9}{contacts:10}{us:12.1f}{own:11.0f}"
                    f"{own / (1e9 * each.min()):14.2f}{contact}"
                )
                report.add(part="steps", place=place, law=law, count=n, us=us, contacts=contacts)


def sample(sim: sc.Sim) -> float:
    """Processor time of a step [s]."""
    count = max(2, 6000 // sim.model.nbody)
    start = time.thread_time()
    sim.step(count)
    return (time.thread_time() - start) / count


def penetration(sizes, report: record.Report) -> None:
    """The 666 case, at three sizes of step."""
    report.say(f"{'666':10}{'dt [s]':>9}{'mean of squares [m²]':>22}{'µs a step':>12}")
    first, second = np.triu_indices(216, 1)
    for dt in (1e-3, 1e-2, 1e-1):
        model = sc.loads(scenes.balls666()).compile()
        sim = sc.Sim(model, law="rigid", solver="pgs", dt=dt, restitution=0.0)
        total, spent, count = 0.0, 0.0, round(10.0 / dt)
        every = max(1, count // 1000)
        for _ in range(count // every):
            start = time.thread_time()
            sim.step(every)
            spent += time.thread_time() - start
            places = sim.qpos.reshape(-1, 7)[:, :3]
            apart = np.linalg.norm(places[first] - places[second], axis=1) - 0.2
            deep = np.concatenate([apart, places[:, 2] - 0.1]).clip(max=0.0)
            total += float((deep**2).sum())
        mean, each = total / (count // every), 1e6 * spent / count
        report.say(f"{'':10}{dt:9g}{mean:22.2e}{each:12.1f}")
        report.add(part="666", dt=dt, mean_square=mean, us=each)


if __name__ == "__main__":
    main()
