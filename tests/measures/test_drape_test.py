"""The drape test: a disc of cloth over a smaller one."""

from __future__ import annotations

import numpy as np
import pytest

from pb4u.errors import InputError
from pb4u.garment.material import FABRICS
from pb4u.measures.drape_test import HELD, RADIUS, disc, drape_test, published, shadow


def test_a_disc_that_lies_flat_has_all_of_its_shadow() -> None:
    garment = disc(0.014, FABRICS["linen"])
    assert garment.face_areas.sum() == pytest.approx(np.pi * RADIUS**2, rel=0.01)
    assert shadow(garment.vertices, garment.faces) == pytest.approx(garment.face_areas.sum(), rel=0.01)
    held = np.hypot(*garment.vertices[garment.pinned][:, [0, 2]].T)
    assert held.max() == pytest.approx(HELD)


@pytest.mark.slow
def test_a_jersey_drapes_as_knits_do_and_foam_stands() -> None:
    band = published()["cotton-jersey"]
    knit, foam = (drape_test(FABRICS[name], 0.02, 2.0) for name in ("cotton-jersey", "neoprene"))
    assert band.lowest - 8.0 < knit.coefficient < band.highest + 8.0
    assert foam.coefficient > 80.0
    assert knit.unsolved == foam.unsolved == 0
    assert max(knit.speed, foam.speed) < 0.01


def test_an_edge_that_makes_no_folds_is_refused() -> None:
    with pytest.raises(InputError, match="edges of 3 to 30 mm, not 50"):
        drape_test(FABRICS["linen"], 0.05)


def test_what_is_published_names_its_source() -> None:
    for name, band in published().items():
        assert name in FABRICS
        assert 0.0 < band.lowest < band.highest <= 100.0
        assert len(band.source) > 20
