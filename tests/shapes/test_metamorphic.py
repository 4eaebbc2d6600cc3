"""Laws that need no reference: units, shifts, mirrors and the order of the two shapes."""

import numpy as np
import pytest
from contact_oracle.convex import Convex
from contact_oracle.judge import touched
from contact_oracle.poses import STYLES, Trial, trial
from shape_pairs import BUILT, FACES_FIRST

EVERY = pytest.mark.parametrize("pair", BUILT + FACES_FIRST, ids="-".join)


def scaled(shape, factor):
    if shape.kind == "plane":
        return shape
    vertices = None if shape.vertices is None else factor * shape.vertices
    return Convex(shape.kind, tuple(factor * x for x in shape.size), vertices)


def same(one, other, there):
    return np.array_equal(one[there], other[there])


@EVERY
@pytest.mark.parametrize("power", [-12, 1, 9])
def test_units_scale_bit_for_bit(pair, power):
    """M1: lengths in another unit, by a power of two."""
    rng, factor = np.random.default_rng(23), 2.0**power
    lengths = np.tile([factor] * 3 + [1.0] * 4, 2)
    for style in STYLES:
        one = trial(rng, pair, style, 60)
        shapes = tuple(scaled(shape, factor) for shape in one.shapes)
        ours, other = touched(one), touched(Trial(style, shapes, one.poses * lengths))
        there = ours.exists
        assert np.array_equal(there, other.exists), style
        assert same(factor * ours.dist, other.dist, there), style
        assert same(factor * ours.pos, other.pos, there), style
        assert same(ours.normal, other.normal, there), style
        assert same(ours.feature, other.feature, there), style


def deepest(touches):
    return np.where(touches.exists, touches.dist, np.inf).min(axis=1)


@EVERY
def test_the_origin_does_not_matter(pair):
    """M2: positions on a grid, and the grid shifted by whole numbers, so that only what is computed
    from positions may round."""
    rng = np.random.default_rng(29)
    for style in ("generic", "slabs", "aligned", "deep"):
        one = trial(rng, pair, style, 60)
        poses = one.poses.copy()
        for at in (0, 7):
            poses[:, at : at + 3] = np.round(poses[:, at : at + 3] * 2**16) / 2**16
        near = deepest(touched(Trial(style, one.shapes, poses)))
        for at in (0, 7):
            poses[:, at : at + 3] += (512, -1024, 256)
        far = deepest(touched(Trial(style, one.shapes, poses)))
        assert np.abs(far - near).max() < 1024 * 8e-16, style


@EVERY
def test_a_mirror_and_a_swap_show_the_same(pair):
    """M3, M4: the whole in a mirror, and the two in the other order: the same distance."""
    rng = np.random.default_rng(31)
    for style in ("generic", "slabs", "needles", "small", "large"):
        one = trial(rng, pair, style, 60)
        ours = deepest(touched(one))
        flip = np.tile([1, -1, 1, 1, -1, 1, -1], 2)
        shapes = tuple(mirrored(shape) for shape in one.shapes)
        seen = deepest(touched(Trial(style, shapes, one.poses * flip)))
        assert np.abs(ours - seen).max() < 1e-12 * one.posed.scale.max(), style
        if pair[0] == pair[1]:
            poses = np.concatenate([one.poses[:, 7:], one.poses[:, :7]], axis=1)
            back = deepest(touched(Trial(style, one.shapes[::-1], poses)))
            assert np.abs(ours - back).max() < 1e-12 * one.posed.scale.max(), style


def mirrored(shape):
    if shape.kind != "mesh":
        return shape
    return Convex("mesh", vertices=shape.vertices * (1, -1, 1))
