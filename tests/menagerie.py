"""Where the public robots are, if somebody put them beside the checkout."""

from pathlib import Path

import pytest

_PLACES = [parent / "shared" / "data" / "menagerie" for parent in Path(__file__).parents]
FOLDER = next((place for place in _PLACES if place.is_dir()), Path("nowhere"))

needed = pytest.mark.skipif(not FOLDER.is_dir(), reason="no shared/data/menagerie")

SO101 = FOLDER / "robotstudio_so101" / "so101.xml"
SO101_CUBE = FOLDER / "robotstudio_so101" / "scene_box.xml"
UR5E = FOLDER / "universal_robots_ur5e" / "ur5e.xml"
PANDA = FOLDER / "franka_emika_panda" / "panda.xml"
