"""Random numbers of many worlds: each world's are its own, whatever the others do."""

from __future__ import annotations

import math
import pickle
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stepcore as sc
from stepcore._core import quantile


@settings(deadline=None, max_examples=50)
@given(
    st.integers(1, 40),
    st.integers(0, 2**63 - 1),
    st.lists(st.tuples(st.integers(0, 5), st.integers(0, 2**40 - 1)), max_size=5),
)
def test_a_world_draws_what_it_draws_alone(n, seed, draws):
    """Whatever is drawn of which worlds, in a batch of n and in one of n + 7."""
    few, many = sc.Noise(n, seed), sc.Noise(n + 7, seed)
    own: list[list[float]] = [[] for _ in range(n)]
    for k, bits in draws:
        mask = np.array([bits >> world & 1 for world in range(n)], dtype=bool)
        numbers = few.uniform(k, worlds=mask)
        other = np.zeros(n + 7, dtype=bool)
        other[:n] = mask
        assert np.array_equal(numbers, many.uniform(k, worlds=np.flatnonzero(other)))
        for world, row in zip(np.flatnonzero(mask), numbers, strict=True):
            own[world] += row.tolist()
    for world, numbers in enumerate(own):
        again = sc.Noise(world + 1, seed).uniform(len(numbers))[world]
        assert again.tolist() == numbers


@pytest.mark.parametrize("draw", ["normal", "uniform"])
def test_numbers_take_no_longer_than_numpys_do(draw):
    """As many again is what a busy machine needs; they took six and eight times as long."""
    noise, rng = sc.Noise(1024, seed=0), np.random.default_rng(0)
    ours, theirs = getattr(noise, draw), getattr(rng, draw)
    least = [np.inf, np.inf]
    for _ in range(30):
        for side, call in enumerate((lambda: ours(17), lambda: theirs(size=(1024, 17)))):
            begin = time.thread_time()
            call()
            least[side] = min(least[side], time.thread_time() - begin)
    assert least[0] < 3 * least[1]


def test_numbers_are_those_of_the_published_hash():
    """SplitMix64 from 0, as Java's and everybody's: e220a8397b1dcdaf, 6e789e6aa1b965f4, …"""
    from stepcore.engine.noise import GOLDEN, _mixed

    with np.errstate(over="ignore"):
        states = np.arange(3, dtype=np.uint64) * GOLDEN
    expected = [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F]
    assert _mixed(states).tolist() == expected
    first = sc.Noise(2, seed=7).uniform(2).tolist()
    assert first == sc.Noise(9, seed=7).uniform(2)[:2].tolist()


def test_quantiles_are_exact():
    rng = np.random.default_rng(0)
    shares = np.concatenate([rng.uniform(size=300), 2.0 ** -rng.uniform(1, 52, 300)])
    shares = np.concatenate([shares, 1 - shares[300:]])
    for share, found in zip(shares.tolist(), quantile(shares).tolist(), strict=True):
        # A step of Newton's on the error function of the nearer tail; 1 - share is exact there.
        least = min(share, 1 - share)
        density = math.exp(-found * found / 2) / math.sqrt(2 * math.pi)
        missed = (math.erfc(abs(found) / math.sqrt(2)) / 2 - least) / density
        assert (found < 0) == (share < 0.5)
        assert abs(missed) <= 4e-15 * max(1.0, abs(found))


def test_worlds_may_have_seeds_of_their_own():
    seeds = np.array([5, 0, 2**63 - 1, 5])
    noise = sc.Noise.of_seeds(seeds, name="start")
    numbers = noise.normal(3)
    for seed, row in zip(seeds.tolist(), numbers, strict=True):
        assert sc.Noise(1, seed, "start").normal(3)[0].tolist() == row.tolist()
    assert "seeds of their own" in repr(noise)
    for bad in ([-1, 2], [0.5], 3, [[1]]):
        with pytest.raises(ValueError, match=r"seeds = .*: must be whole numbers"):
            sc.Noise.of_seeds(bad)


def test_numbers_are_uniform_normal_and_independent():
    n = 100_000
    noise = sc.Noise(n, seed=1)
    numbers = np.sort(noise.uniform(1)[:, 0])
    # Kolmogorov and Smirnov: below 1.95 in 999 of 1000 cases.
    assert np.abs(numbers - np.arange(n) / n).max() * math.sqrt(n) < 1.95
    normal = noise.normal(3)
    assert abs(normal.mean()) < 4 / math.sqrt(3 * n)
    assert abs(normal.var() - 1) < 4 * math.sqrt(2 / (3 * n))
    pairs = [(normal[:, 0], normal[:, 1]), (normal[1:, 0], normal[:-1, 0])]
    pairs.append((normal[:, 0], sc.Noise(n, seed=2).normal(1)[:, 0]))
    pairs.append((normal[:, 2], sc.Noise(n, seed=1, name="ctrl").normal(3)[:, 2]))
    for one, other in pairs:
        assert abs(np.corrcoef(one, other)[0, 1]) < 4 / math.sqrt(n)
    bounded = noise.uniform(2, low=[-1.0, 5.0], high=[1.0, 6.0])
    assert (bounded >= [-1, 5]).all() and (bounded < [1, 6]).all()


def test_a_stream_goes_on_from_its_state():
    noise = sc.Noise(4, seed=3, name="ctrl")
    noise.normal(2, worlds=[1, 3])
    kept, copied = noise.state(), pickle.loads(pickle.dumps(noise))
    assert kept.tolist() == [0, 2, 0, 2]
    numbers = noise.normal(3)
    assert np.array_equal(copied.normal(3), numbers)
    noise.restore(kept)
    assert np.array_equal(noise.normal(3), numbers)


def test_streams_of_any_other_names_are_others():
    """Also where the names' CRC-32 are equal, as those of the first two, or are no valid UTF-8."""
    names = ["plumless", "buckeroo", "", "\ud800", "\udfff"]
    rows = {sc.Noise(1, 0, name).uniform(3).tobytes() for name in names}
    assert len(rows) == len(names)


def test_noisy_worlds_are_the_same_in_any_batch():
    def moved(n: int, threads: int) -> np.ndarray:
        batch = sc.Batch("gymnasium:hopper", n, threads=threads)
        start, ctrl = sc.Noise(n, 5, "reset"), sc.Noise(n, 5, "ctrl")
        batch.qpos += start.uniform(batch.model.nq, -0.01, 0.01)
        for step in range(20):
            batch.ctrl[:] = ctrl.normal(batch.model.nu, 0.3)
            batch.step(2)
            over = batch.qpos[:, 1] < 1.24
            if step == 10:
                rows = batch.model.qpos0 + start.uniform(batch.model.nq, -0.01, 0.01, worlds=over)
                batch.reset(worlds=over, qpos=rows)
        return batch.qpos.copy()

    many = moved(40, 2)
    assert np.array_equal(moved(9, 1), many[:9])
    assert np.array_equal(moved(1, 1), many[:1])


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: sc.Noise(0, 1), "n = 0"),
        (lambda: sc.Noise(3, -1), "seed = -1"),
        (lambda: sc.Noise(3, 1 << 63), "seed = 9223372036854775808"),
        (lambda: sc.Noise(3, True), "seed = True"),
        (lambda: sc.Noise(3, 1, 5), "name = 5"),
        (lambda: sc.Noise(3, 1).normal(-1), "k = -1"),
        (lambda: sc.Noise(3, 1).normal(1, worlds=[3]), r"worlds = \[3\]"),
        (lambda: sc.Noise(3, 1).restore([1]), r"state = \[1\]"),
    ],
)
def test_bad_arguments_are_refused(call, text):
    with pytest.raises(ValueError, match=text):
        call()


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda noise: noise.uniform(2, low=[0, 1, 2, 3]), r"low has shape \(4,\): .* \(3, 2\)"),
        (lambda noise: noise.uniform(2, high=np.ones((5, 3, 2))), r"high has shape \(5, 3, 2\)"),
        (lambda noise: noise.uniform(2, np.zeros((3, 1)), worlds=[0, 1]), r"low has .* \(2, 2\)"),
        (lambda noise: noise.uniform(2, low=1, high=0), "low = 1: must be at most high = 0"),
        (lambda noise: noise.uniform(2, low=[0, math.nan]), "low = .*: must be finite"),
        (lambda noise: noise.uniform(2, high=math.inf), "high = inf: must be finite"),
        (
            lambda noise: noise.uniform(2, -1e308, 1e308),
            r"high = 1e\+308: must be at most 1.8e\+308",
        ),
        (lambda noise: noise.uniform(2, low=[1j, 0]), "low = .*: must be real numbers"),
        (lambda noise: noise.normal(2, scale=-1), "scale = -1: must be >= 0"),
        (lambda noise: noise.normal(2, scale="x"), "scale = 'x': must be real numbers"),
        (lambda noise: noise.normal(2, scale=[1, 2, 3]), r"scale has shape \(3,\)"),
    ],
)
def test_nothing_is_drawn_where_a_bound_is_refused(call, text):
    noise = sc.Noise(3, 1)
    with pytest.raises(ValueError, match=text):
        call(noise)
    assert noise.state().tolist() == [0, 0, 0]
    assert noise.uniform(2, np.zeros((3, 1)), [1.0, 2.0]).shape == (3, 2)
