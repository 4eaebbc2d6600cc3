"""Snapshots that were changed by somebody who can make their checksums."""

from __future__ import annotations

import random
import struct

from cases import Broken, _damaged, _small, finite

import stepcore as sc

WORD, MASK = 8, (1 << 64) - 1
# Words that are counts, indices and numbers at the ends of their ranges.
WORDS = (0, 1, 2, 7, 2**31, 2**32, 2**53, 2**63, MASK, *struct.unpack("<4Q", struct.pack(
    "<4d", float("nan"), float("inf"), 1e308, -1.0
)))  # fmt: skip


def checksum(data: bytes) -> int:
    """That of `snapshot.rs`, written again: of all words, and one for what is left."""
    value = len(data)
    whole = len(data) // WORD * WORD
    words = [*struct.unpack(f"<{whole // WORD}Q", data[:whole])]
    words.append(int.from_bytes(data[whole:], "little"))
    for word in words:
        value = ((value << 5 | value >> 59) & MASK) ^ word
        value = value * 0x517CC1B727220A95 & MASK
    return value


def with_sum(data: bytes) -> bytes:
    return data + checksum(data).to_bytes(WORD, "little")


def sleeper() -> sc.Sim:
    """Bodies of which some are asleep: a snapshot has all its parts."""
    text = """<mujoco><worldbody><geom type="plane" size="3 3 1"/>
    <body pos="0 0 .1"><freejoint/><geom size=".1"/></body>
    <body pos="1 0 2"><freejoint/><geom size=".1"/></body></worldbody></mujoco>"""
    sim = sc.Sim(sc.loads(text), sleep=True, sleep_time=0.05, dt=0.01)
    sim.step(30)
    return sim


def forged_snapshot(seed: int) -> None:
    """Refused, and nothing has changed; or taken, and then it is a state that steps."""
    rng = random.Random(seed)
    sim = sleeper() if rng.random() < 0.5 else sc.Sim(_small())
    sim.step(rng.choice((1, 7)))
    before = sim.state()
    data = before[:-WORD]
    if with_sum(data) != before:
        raise Broken("the checksum is another one: mend `checksum`")
    for _ in range(rng.choice((1, 1, 3))):
        at = rng.randrange(16 // WORD, len(data) // WORD) * WORD
        kind = rng.randrange(4)
        if kind == 0:
            data = data[:at] + rng.choice(WORDS).to_bytes(WORD, "little") + data[at + WORD :]
        elif kind == 1:
            data = data[:at] + rng.choice(WORDS).to_bytes(WORD, "little") + data[at:]
        elif kind == 2:
            data = data[:at]
        else:
            data = _damaged(data, rng)
    try:
        sim.restore(with_sum(data))
    except ValueError:
        if sim.state() != before:
            raise Broken("a refused snapshot changed the state") from None
        return
    # Arrays may hold anything until a step, which refuses what is not finite.
    sim.step(20)
    finite(sim)
