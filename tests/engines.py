"""The implementations that a law is tested on, and one way to make a Sim of either."""

import oracle

import stepcore

ENGINES = ["rust", "numpy"]
# For laws whose many steps or sweeps would take plain numpy an hour.
RUST_ONLY = ["rust"]

# Every setting that the two do not share a default of.
PLAIN = {
    "solver": "pgs",
    "acceleration": "none",
    "integrator": "semi-implicit",
    "law": "rigid",
    "sweeps": 50,
    "tolerance": 0.0,
    "warm_start": False,
    "dt": 0.002,
}


def make(engine, scene, key=None, **settings):
    """A Sim of the scene with its own settings over PLAIN, and these over both."""
    chosen = PLAIN | scene.options | settings
    if engine == "rust":
        sim = stepcore.Sim(scene.compile(), **chosen)
    else:
        sim = oracle.Sim(scene, **chosen)
    if key is not None:
        sim.reset(key=key)
    return sim
