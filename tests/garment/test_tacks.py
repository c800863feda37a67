"""Vertices sewn together: tacks keep the shapes of triangles and refuse what no cloth can have."""

from __future__ import annotations

import numpy as np
import pytest

from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.garment.material import MATERIALS
from pb4u.garment.pins import resolve_pins
from pb4u.garment.tacks import tacked
from pb4u.geometry.triangle_mesh import face_areas
from pb4u.run import Run, WornGarment


def strips(gap: float = 0.02) -> Garment:
    """Two strips of four triangles each, end to end, with a gap [m] between them."""
    x = np.array([0.0, 0.1, 0.2])
    one = np.array([[a, y, 0.0] for a in x for y in (1.0, 1.05)])
    vertices = np.concatenate([one, one + [0.2 + gap, 0.0, 0.0]])
    faces = np.array([[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]])
    return Garment("strips", vertices, np.concatenate([faces, faces + 6]), MATERIALS["default"])


def test_a_tack_makes_two_vertices_one_and_keeps_the_shapes_at_rest() -> None:
    garment = strips()
    sewn = tacked(garment, [(4, 6), (5, 7)])
    assert len(sewn.vertices) == 10
    assert len(sewn.topology.boundary_loops) == 1
    np.testing.assert_allclose(sewn.face_areas, face_areas(garment.vertices, garment.faces), rtol=1e-12)
    np.testing.assert_allclose(sewn.vertices[4], [0.21, 1.0, 0.0])
    assert sewn.vertex_areas.sum() == pytest.approx(garment.vertex_areas.sum())


def test_the_authors_vertices_stay_and_both_ends_go_with_the_seam() -> None:
    garment = strips()
    sewn = tacked(garment, [(4, 6)])
    assert sewn.source is not None
    corners = sewn.vertices[sewn.faces[sewn.source.triangle]]
    back = np.einsum("vc,vci->vi", sewn.source.barycentric, corners)
    np.testing.assert_allclose(back[[4, 6]], np.repeat([[0.21, 1.0, 0.0]], 2, axis=0))
    rest = np.setdiff1d(np.arange(12), [4, 6])
    np.testing.assert_allclose(back[rest], garment.vertices[rest])


@pytest.mark.parametrize(
    ("gap", "tack", "why"),
    [
        (2.0, (4, 6), "200 cm apart; choose vertices within 10 cm"),
        (0.02, (4, 12), "names a vertex that does not exist; the garment has 12"),
        (0.02, (4, -1), "names a vertex that does not exist"),
        (0.02, (4, 4), "the tack 4:4 sews a vertex to itself"),
        (0.02, (4, 5), "fold a triangle"),
    ],
)
def test_a_tack_that_cannot_be_is_refused_in_one_sentence(gap: float, tack: tuple[int, int], why: str) -> None:
    with pytest.raises(InputError, match=why):
        tacked(strips(gap), [tack])


def test_tacks_are_kept_in_a_scene_file(tmp_path) -> None:
    run = Run((WornGarment("tshirt", tacks=[[1, 2], [3, 4]]), WornGarment("skirt")))
    again = Run.open(run.save(tmp_path / "scene.toml"))
    assert again.garments[0].tacks == ((1, 2), (3, 4))
    assert again.garments[1].tacks == ()
    with pytest.raises(InputError, match="Tacks must be pairs"):
        WornGarment("tshirt", tacks=[[1, 2, 3]])


def test_pins_of_sewn_vertices_are_the_seam_and_nothing_beside_it() -> None:
    garment = tacked(strips(0.08), [(4, 6)])
    seam = np.flatnonzero(np.isclose(garment.vertices[:, 0], 0.24))
    for listed in ([4], [6]):
        assert np.flatnonzero(resolve_pins(listed, garment)).tolist() == seam.tolist()
