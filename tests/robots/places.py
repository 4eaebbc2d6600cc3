"""Where the public robots are, if somebody put them beside the checkout."""

from pathlib import Path

import pytest

_PLACES = [parent / "shared" / "data" / "menagerie" for parent in Path(__file__).parents]
MENAGERIE = next((place for place in _PLACES if place.is_dir()), Path("nowhere"))

needs_robots = pytest.mark.skipif(not MENAGERIE.is_dir(), reason="no shared/data/menagerie")

SO101 = str(MENAGERIE / "robotstudio_so101" / "so101.xml")
SO101_CUBE = str(MENAGERIE / "robotstudio_so101" / "scene_box.xml")
UR5E = str(MENAGERIE / "universal_robots_ur5e" / "ur5e.xml")
PANDA = str(MENAGERIE / "franka_emika_panda" / "panda.xml")
