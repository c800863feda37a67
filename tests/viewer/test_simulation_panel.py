"""The form of a simulation: what is filled in becomes a run."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import MagicMock

import pytest

pytest.importorskip("viser", reason='the studio needs the "view" extra')

from pb4u.errors import InputError
from pb4u.garment.library import garment_names
from pb4u.run import Run, WornGarment
from pb4u.viewer.simulation_panel import GarmentControls


@pytest.fixture
def controls() -> GarmentControls:
    """Controls of a skirt, on a page that keeps what each control begins with."""

    def added(*_: object, **given: object) -> MagicMock:
        return MagicMock(value=given.get("initial_value"))

    page = MagicMock()
    for kind in ("add_text", "add_number", "add_checkbox", "add_dropdown"):
        getattr(page, kind).side_effect = added
    return GarmentControls(page, garment_names(), 1, "skirt")


def filled(controls: GarmentControls) -> WornGarment:
    return controls.specification(lambda kind, name: None)


def test_fabrics_of_parts_go_into_the_scene_file(controls: GarmentControls, tmp_path: Path) -> None:
    assert filled(controls).material is None
    controls.parts.value = "hem=denim"
    assert filled(controls).material == {"hem": "denim"}
    controls.controls["material"].value, controls.parts.value = "silk", " hem = denim, waist=rib,"
    run = Run((filled(controls),))
    assert run.garments[0].material == {"body": "silk", "hem": "denim", "waist": "rib"}
    run.save(tmp_path / "scene.toml")
    assert Run.open(tmp_path / "scene.toml") == run


@pytest.mark.parametrize("text", ["denim", "hem=", "=denim"])
def test_fabrics_that_name_no_part_are_refused(controls: GarmentControls, text: str) -> None:
    controls.parts.value = text
    with pytest.raises(InputError, match="PART=MATERIAL, separated by commas, such as hem=denim"):
        filled(controls)
