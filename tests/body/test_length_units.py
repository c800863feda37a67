"""The unit of a body's file by the size of a person: right for grown-ups, and never wrong in silence."""

from __future__ import annotations

import numpy as np
import pytest

from pb4u.body.length_units import UNITS, body_unit, garment_unit
from pb4u.errors import InputError


@pytest.mark.parametrize("unit", UNITS)
def test_grown_ups_are_told_in_every_unit(unit: str) -> None:
    for height in np.linspace(1.41, 2.09, 18):
        found, note = body_unit("body.glb", float(height / UNITS[unit]))
        assert found == unit
        assert (note is None) == (unit == "metres")


def test_whatever_is_taken_has_the_size_of_a_figure() -> None:
    taken = set()
    for extent in np.geomspace(0.01, 1e5, 4000):
        try:
            unit, _ = body_unit("body.glb", float(extent))
        except InputError as refusal:
            named = [unit for unit in UNITS if f"in {unit}" in str(refusal)]
            assert len(named) != 1
            assert all(0.5 <= extent * UNITS[unit] <= 2.4 for unit in named)
            continue
        taken.add(unit)
        assert 0.5 <= extent * UNITS[unit] <= 2.4 or unit == "metres"
    assert taken == set(UNITS)


def test_what_is_ambiguous_is_asked_for() -> None:
    with pytest.raises(InputError, match=r"^child.glb: .* 90 .* a person in centimetres or in inches; .*--body-units"):
        body_unit("child.glb", 90.0)
    assert body_unit("child.glb", 90.0, "centimetres") == ("centimetres", None)


def test_a_garment_in_another_unit_is_named() -> None:
    assert garment_unit(0.7) is None
    assert "seems to be in centimetres" in str(garment_unit(70.0))
    assert "in inches or in decimetres" in str(garment_unit(12.0))
