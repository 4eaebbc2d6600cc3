"""The models that are compared at states of random falls, and those states, made once."""

import copy
import functools

import mujoco
import peers
import zoo

import stepcore as sc

SCENES = zoo.ZOO | zoo.INEXACT


@functools.cache
def shipped(name):
    """MuJoCo's model of a scene of the zoo or a model of gymnasium, as its file has it."""
    if name in peers.GYM:
        return mujoco.MjModel.from_xml_path(peers.gym_path(name))
    return mujoco.MjModel.from_xml_string(SCENES[name].text)


@functools.cache
def compiled(name):
    scene = sc.load(peers.gym_path(name)) if name in peers.GYM else sc.loads(SCENES[name].text)
    return scene.compile()


def strict(name, **options):
    return peers.strict(copy.copy(shipped(name)), **options)


def states_of(name, count=24):
    """So many states, eight of a heap. Fewer states of a model are the first of more."""
    return fallen(name, 8 if name in zoo.HEAPS else count)


@functools.cache
def fallen(name, count):
    if name in peers.GYM:
        return falls(shipped(name), count, peers.GYM.index(name))
    return falls(shipped(name), count, 7, SCENES[name].spread, SCENES[name].speed)


def falls(theirs, *arguments):
    """`peers.fall_states`; on the way to a state MuJoCo need not be at its most accurate."""
    model = copy.copy(theirs)
    model.opt.tolerance, model.opt.ls_tolerance, model.opt.ccd_tolerance = 1e-8, 1e-2, 1e-6
    return peers.fall_states(model, *arguments)


def both(name, count=24, **options):
    """The model in both engines, MuJoCo's scratch data, and the states to visit."""
    theirs = strict(name, **options)
    sim = sc.Sim(compiled(name), **peers.EXACT, **options)
    return sim, theirs, mujoco.MjData(theirs), states_of(name, count)
