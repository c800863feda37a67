"""Scenes of the catalogue by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pb4u.errors import InputError
from pb4u.scene.assembly import make_scene
from pb4u.scene.catalogue import catalogue_scene, scene_names


def test_a_name_is_the_scene_that_it_spells() -> None:
    named = catalogue_scene("test/tanktop/dance-2000", 400, 3)
    spelled = make_scene("tanktop", motion="dance", triangles=400, frames=3, seed=2000)
    assert (named.frames, named.lead_in, named.seed, named.labels) == (3, 30, 2000, spelled.labels)
    np.testing.assert_array_equal(named.colliders[0].positions(0, 33), spelled.colliders[0].positions(0, 33))
    carried = [scene.garments[0].placement.positions(0, 33) for scene in (named, spelled)]
    np.testing.assert_array_equal(*carried)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("test/dress/wlak-2000", "did you mean test/dress/walk-2000"),
        ("nothing of the kind", r"there are train/tshirt/walk-0, .* and \d+ more\.$"),
        ("test/dress/07_02", "needs the CMU trial 07_02"),
    ],
)
def test_what_is_not_there_is_refused(name: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=says):
        catalogue_scene(name, recordings=tmp_path)


def test_an_unknown_split_is_refused_with_those_there_are() -> None:
    with pytest.raises(InputError, match="no split 'tset'; did you mean test"):
        scene_names("tset")
