"""Buttons: tacks at even distances along an open front, which files keep and pictures show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, label
from scipy.spatial import cKDTree

import pb4u
from pb4u.body.library import load_body
from pb4u.errors import InputError
from pb4u.export.pieces import pieces
from pb4u.export.selection import on_source
from pb4u.export.still_renderer import render
from pb4u.export.view import View
from pb4u.garment.garment import Garment
from pb4u.garment.material import MATERIALS
from pb4u.garment.parts import Parts
from pb4u.garment.tacks import FARTHEST, buttoned
from pb4u.run import Run, WornGarment
from pb4u.scene.loaded_garments import load_garment
from pb4u.scene.trajectory import Trajectory


def coat(gap: float = 0.05, height: float = 1.0, rows: int = 26) -> Garment:
    """A tube of a radius of 0.2 m, open in front by a gap [m]."""
    around = np.linspace(0.5 * gap / 0.2, 2.0 * np.pi - 0.5 * gap / 0.2, 25)
    ring = np.column_stack([0.2 * np.sin(around), np.zeros(25), 0.2 * np.cos(around)])
    vertices = np.concatenate([ring + [0.0, y, 0.0] for y in np.linspace(0.4, 0.4 + height, rows)])
    first = (25 * np.arange(rows - 1)[:, None] + np.arange(24)).ravel()
    faces = np.concatenate([first[:, None] + [0, 1, 26], first[:, None] + [0, 26, 25]])
    return Garment("coat", vertices, faces, MATERIALS["default"])


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Trajectory:
    """Ten frames of a cardigan with five buttons, over trousers, as a file holds them."""
    worn = [WornGarment("trousers", triangles=800), WornGarment("cardigan", triangles=800, buttons=5)]
    scene = pb4u.make_scene(worn, body="woman", motion="walk", frames=10, lead_in=0)
    path = tmp_path_factory.mktemp("buttons") / "walk.npz"
    pb4u.load_simulator("quick-solver").simulate(scene).save(path)
    return Trajectory.open(path)


def facing(garment: Garment, places: np.ndarray) -> np.ndarray:
    """How far apart [m] the borders of the front are, at the vertices (n,) of one."""
    front = Parts(garment).open_front
    ways = garment.vertices[front[:, 1]] - garment.vertices[front[:, 0]]
    rise = ways[:, 1] / np.linalg.norm(ways, axis=1)
    one, other = np.unique(front[rise > 0.5]), np.unique(front[rise < -0.5])
    gaps, nearest = cKDTree(garment.vertices[other]).query(garment.vertices[one])
    one, nearest = one[gaps < FARTHEST], nearest[gaps < FARTHEST]
    return np.linalg.norm(places[one] - places[other[nearest]], axis=1)


def test_a_buttoned_cardigan_stays_closed_while_walking(walked: Trajectory) -> None:
    open_one = load_garment(WornGarment("cardigan", triangles=800), load_body("woman"))
    assert facing(open_one, open_one.vertices).min() > 0.07
    cardigan = pieces(on_source(walked).header)[1]
    for positions in on_source(walked).positions:
        apart = facing(open_one, positions[cardigan.vertices])
        assert np.count_nonzero(apart < 1e-6) == 5
        # Above the uppermost button and below the lowest one the front falls open.
        assert np.median(apart) < 0.03


def test_files_pieces_and_the_authors_mesh_keep_buttons(walked: Trajectory) -> None:
    header, author = walked.header, on_source(walked).header
    assert header.buttons is not None
    assert author.buttons is not None
    assert (header.vertex_garment[header.buttons] == 1).all()
    np.testing.assert_allclose(author.rest_positions[author.buttons], header.rest_positions[header.buttons], atol=1e-6)
    trousers, cardigan = (piece.header for piece in pieces(header))
    assert trousers.buttons is not None
    assert cardigan.buttons is not None
    assert len(trousers.buttons) == 0
    np.testing.assert_array_equal(cardigan.rest_positions[cardigan.buttons], header.rest_positions[header.buttons])


def test_pictures_show_buttons(walked: Trajectory) -> None:
    view = View(width=300, height=400, azimuth=0.0, cloths=((0.9, 0.9, 0.9), (0.9, 0.9, 0.9)), weave=False)
    (shown,) = render(walked, [9], view)
    (without,) = render(replace(walked, header=replace(walked.header, buttons=None)), [9], view)
    # They shade the cloth around them a little.
    darker = without.astype(int).sum(axis=2) - shown.astype(int).sum(axis=2) > 90
    assert label(binary_dilation(darker, iterations=2))[1] == 5


def test_buttons_are_at_even_distances_and_keep_the_cloth() -> None:
    garment = coat()
    closed = buttoned(garment, 5)
    assert closed.buttons is not None
    np.testing.assert_allclose(closed.vertices[closed.buttons, 1], 0.4 + 0.2 * np.arange(5) + 0.1, atol=0.021)
    np.testing.assert_allclose(closed.vertices[closed.buttons, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(closed.face_areas, garment.face_areas, rtol=1e-9)
    assert buttoned(garment, None) is garment


@pytest.mark.parametrize(
    ("garment", "count", "why"),
    [
        (coat(), 3, "3 buttons would be 0.33 m apart on its front of 1.00 m; give 4 or more"),
        (coat(gap=0.3), 5, "the borders of its front lie 2. cm apart or more; buttons close gaps of up to 10 cm"),
        (coat(), 60, "60 buttons would be closer to each other than the vertices of its front; give fewer"),
    ],
)
def test_buttons_that_cannot_be_are_refused_in_one_sentence(garment: Garment, count: int, why: str) -> None:
    with pytest.raises(InputError, match=why):
        buttoned(garment, count)


def test_closed_garments_and_no_buttons_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="skirt is not open in front, so it has no place for buttons"):
        load_garment(WornGarment("skirt", triangles=600, buttons=3), load_body("woman"))
    with pytest.raises(InputError, match="buttons must be a whole number from 1 to 100, not 0"):
        WornGarment("cardigan", buttons=0)
    run = Run((WornGarment("cardigan", buttons=5),))
    run.save(tmp_path / "scene.toml")
    assert Run.open(tmp_path / "scene.toml").garments[0].buttons == 5
