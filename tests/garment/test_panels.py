"""Laws of the flat panels of the built-in garments."""

from functools import cache

import numpy as np
import pytest
import torch

from pb4u.body.library import load_body
from pb4u.collision.crossings import self_crossings
from pb4u.garment import panels
from pb4u.garment.body_form import form_of
from pb4u.garment.cuts import CUTS
from pb4u.garment.garment import Garment
from pb4u.garment.library import build_garment
from pb4u.geometry.principal_stretch import principal_stretches, weighted_percentile
from pb4u.geometry.topology import Topology, uv_islands
from pb4u.geometry.triangle_mesh import carried_directions, face_areas
from pb4u.scene.packed import inverse_rest_shapes

PANELS = {
    "tshirt": 6, "tanktop": 2, "longsleeve": 6, "dress": 2, "fitted_dress": 6, "cardigan": 7, "trousers": 4, "skirt": 2,
}  # fmt: skip


@cache
def flat(name: str, who: str = "woman", triangles: int = 900) -> Garment:
    return build_garment(name, load_body(who), triangles, "flat")


def strains(garment: Garment) -> torch.Tensor:
    """Larger principal strain (faces,) of the garment worn on its panels."""
    worn, faces = torch.from_numpy(garment.vertices), torch.from_numpy(garment.faces)
    inverse = torch.from_numpy(inverse_rest_shapes(garment.rest_shape))
    return principal_stretches(worn, faces, inverse)[:, 0] - 1.0


def check(garment: Garment) -> None:
    assert garment.uvs is not None
    assert garment.uv_faces is not None
    assert garment.uvs.min() >= 0.0
    assert garment.uvs.max() <= 1.0
    assert uv_islands(garment.uv_faces).max() + 1 == PANELS[garment.name]
    areas = torch.from_numpy(garment.face_areas)
    assert float((strains(garment) * areas).sum() / areas.sum()) < 0.01
    assert float(weighted_percentile(strains(garment), areas, 95.0)) < 0.06
    # Flat: the angles around a point inside a panel are a whole turn.
    corners = garment.rest_shape
    one, two = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cross = one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0]
    assert cross.min() > 0.0
    angles = np.arctan2(cross, (one * two).sum(axis=2))
    around = np.bincount(garment.uv_faces.ravel(), angles.ravel())
    inside = ~Topology(garment.uv_faces, len(garment.uvs)).border_vertices
    np.testing.assert_allclose(around[inside], 2.0 * np.pi, atol=1e-9)
    assert not len(self_crossings(garment.vertices, garment.faces, sharing=True))


@pytest.mark.parametrize(
    ("name", "who", "triangles"),
    [
        *((name, "woman", 900) for name in CUTS),
        ("tshirt", "man", 1200),
        *(
            pytest.param(name, who, count, marks=pytest.mark.slow)
            for name in CUTS
            for who, count in (("man", 600), ("woman", 2500), ("woman", 25000))
        ),
    ],
)
def test_panels_are_flat_and_hardly_stretched_where_they_are_worn(name: str, who: str, triangles: int) -> None:
    check(flat(name, who, triangles))


@pytest.mark.parametrize("name", ["tshirt", "trousers", "longsleeve"])
def test_the_warp_runs_up_the_trunk_and_along_limbs(name: str) -> None:
    garment = flat(name)
    body = form_of(load_body("woman"))
    worn = garment.vertices[garment.faces]
    ways = carried_directions(np.tile([0.0, 1.0], (len(worn), 1)), garment.rest_shape, worn)
    islands = uv_islands(garment.uv_faces)
    assert garment.has_grain
    for number in range(islands.max() + 1):
        mine = islands == number
        middle = worn[mine].mean(axis=(0, 1))
        way = np.average(ways[mine], axis=0, weights=garment.face_areas[mine])
        up = np.array([0.0, 1.0, 0.0])
        for limb in body.legs if CUTS[name].legs else body.arms:
            if limb.side * middle[0] > (0.03 if CUTS[name].legs else 0.19):
                # Sleeves of a length up to the elbow follow the upper arm, longer ones the whole.
                up = limb.joints[0] - limb.along(min(2.0, CUTS[name].sleeve or 2.0))
        assert way @ up / np.linalg.norm(way) / np.linalg.norm(up) > np.cos(np.radians(12.0))


def test_panels_keep_the_size_of_the_garment_and_its_uvs_are_they() -> None:
    garment, moulded = flat("trousers"), build_garment("trousers", load_body("woman"), 900, "moulded")
    np.testing.assert_array_equal(garment.vertices, moulded.vertices)
    np.testing.assert_array_equal(garment.uvs, moulded.uvs)
    assert moulded.rest_uv is None
    assert not moulded.has_grain
    areas = face_areas(garment.vertices, garment.faces)
    assert 1.0 < garment.face_areas.sum() / areas.sum() < 1.05
    scale = np.ptp(garment.rest_uv)
    np.testing.assert_allclose(garment.uvs[garment.uv_faces] * scale, garment.rest_uv, atol=1e-9 * scale)


def test_a_tube_that_should_be_one_panel_is_cut_until_it_lies_flat(monkeypatch: pytest.MonkeyPatch) -> None:
    def whole(points: np.ndarray, *_: object) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(len(points), dtype=np.int64), np.tile([0.0, 1.0, 0.0], (len(points), 1))

    monkeypatch.setattr(panels, "_panels", whole)
    garment = flat("skirt")
    points, faces = panels.flat_panels(garment.vertices, garment.faces, form_of(load_body("woman")), CUTS["skirt"])
    assert uv_islands(faces).max() > 0
    areas = face_areas(np.pad(points, ((0, 0), (0, 1))), faces)
    assert areas.sum() == pytest.approx(face_areas(garment.vertices, garment.faces).sum(), rel=0.05)


def test_parts_of_a_panel_that_touch_at_a_vertex_alone_share_no_point() -> None:
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4]])
    points = panels._own_corners(faces, np.array([0, 1, 0]), 5)
    assert len(np.unique(points)) == 9
    points = panels._own_corners(faces, np.array([0, 0, 1]), 5)
    assert len(np.unique(points)) == 7
