"""Every machine gives the same bits; a change that is not meant to alter numbers alters none."""

import bits
import pytest
import zoo


@pytest.mark.parametrize("name", zoo.ZOO)
def test_the_bits_are_those_on_record(name):
    """Where this fails by intent: "Numerics changed" in CHANGELOG.md, then python tests/bits.py."""
    assert bits.digests(name) == bits.record().get(name)


def test_the_record_has_no_scene_that_is_gone():
    assert bits.record().keys() == zoo.ZOO.keys()
