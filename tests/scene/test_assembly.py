"""What `make_scene` says of a garment that nothing holds up."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from tests.garment.cloth_shapes import saved

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import load_body
from pb4u.errors import InputWarning
from pb4u.garment.library import build_garment
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.scene.assembly import make_scene


@pytest.fixture(scope="module")
def woman() -> ShapedBody:
    return load_body("woman")


def exported(name: str, body: ShapedBody, folder: Path) -> Path:
    """A built-in garment as a file, which has no pins."""
    garment = build_garment(name, body, 600)
    return saved(folder, PolygonMesh(garment.vertices, tuple(garment.faces)), f"{name}.obj")


@pytest.mark.parametrize("name", ["skirt", "trousers"])
def test_a_file_that_nothing_holds_up_is_told_with_the_cure(name: str, woman: ShapedBody, tmp_path: Path) -> None:
    file = exported(name, woman, tmp_path)
    with pytest.warns(InputWarning, match=rf"^{name}: Nothing holds the garment up.*`--pins waist`\.$") as told:
        make_scene(file, woman, frames=2, lead_in=0)
    assert len(told) == 1


@pytest.mark.parametrize("pins", ["waist", "none"])
def test_pins_that_were_given_are_not_questioned(pins: str, woman: ShapedBody, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = make_scene(exported("skirt", woman, tmp_path), woman, pins=pins, frames=2, lead_in=0)
    assert scene.garments[0].garment.pinned.any() == (pins == "waist")


def test_a_file_that_lies_on_the_shoulders_is_not_told(woman: ShapedBody, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        make_scene(exported("tanktop", woman, tmp_path), woman, frames=2, lead_in=0)


def test_a_built_in_skirt_is_pinned_and_not_told(woman: ShapedBody) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = make_scene("skirt", woman, triangles=600, frames=2, lead_in=0)
    assert scene.garments[0].garment.pinned.any()
